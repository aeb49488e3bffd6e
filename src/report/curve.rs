//! Error over time, and what it says of one technique against another.

use super::interval::Interval;

/// The error of one run over time: at least one point, in order of time.
pub struct Curve(Vec<Point>);

struct Point {
    ln_time: f64,
    ln_error: f64,
}

impl Curve {
    /// From pairs of seconds and errors.
    pub fn new(points: impl IntoIterator<Item = (f64, f64)>) -> Curve {
        // An image without any error has no logarithm.
        let ln = |x: f64| x.max(f64::MIN_POSITIVE).ln();
        let points = points.into_iter().map(|(time, error)| Point { ln_time: ln(time), ln_error: ln(error) });
        Curve(points.collect())
    }

    /// Seconds and error at the end.
    pub fn last(&self) -> (f64, f64) {
        self.0.last().map_or((f64::NAN, f64::NAN), |last| (last.ln_time.exp(), last.ln_error.exp()))
    }

    /// Seconds until the first image.
    pub fn first_time(&self) -> f64 {
        self.0.first().map_or(f64::NAN, |first| first.ln_time.exp())
    }

    /// The error after so many seconds, between the first and the last image: as a power of time between two images.
    pub fn error_at(&self, time: f64) -> Option<f64> {
        let x = time.ln();
        let [a, b] = self.segment(|a, b| a.ln_time <= x && x <= b.ln_time)?;
        Some(between(x, [a.ln_time, b.ln_time], [a.ln_error, b.ln_error]).exp())
    }

    /// Seconds until the error is first as small; those of the first image where it is so already; none where it never is.
    pub fn time_at(&self, error: f64) -> Option<f64> {
        let y = error.ln();
        if self.0.first()?.ln_error <= y {
            return Some(self.first_time());
        }
        let [a, b] = self.segment(|_, b| b.ln_error <= y)?;
        Some(between(y, [a.ln_error, b.ln_error], [a.ln_time, b.ln_time]).exp())
    }

    /// The exponent of the power of time that fits best; none where there are fewer than two points.
    pub fn slope(&self) -> Option<f64> {
        if self.0.len() < 2 {
            return None;
        }
        let n = self.0.len() as f64;
        let mean = |f: &dyn Fn(&Point) -> f64| self.0.iter().map(f).sum::<f64>() / n;
        let (x, y) = (mean(&|p| p.ln_time), mean(&|p| p.ln_error));
        Some(mean(&|p| (p.ln_time - x) * (p.ln_error - y)) / mean(&|p| (p.ln_time - x).powi(2)))
    }

    fn segment(&self, holds: impl Fn(&Point, &Point) -> bool) -> Option<[&Point; 2]> {
        self.0.windows(2).map(|pair| [&pair[0], &pair[1]]).find(|[a, b]| holds(a, b))
    }
}

/// `to` where `from` is `x`, on the straight line.
fn between(x: f64, from: [f64; 2], to: [f64; 2]) -> f64 {
    let width = from[1] - from[0];
    let share = if width == 0.0 { 0.0 } else { (x - from[0]) / width };
    to[0] + share * (to[1] - to[0])
}

/// One technique over another, in runs taken in turn: the ratios of their errors at the same time, and of their times
/// to the same error.
pub struct Comparison {
    /// The last time that all runs have reached, in seconds.
    pub time: f64,
    /// Error over error then.
    pub error_ratio: Option<Interval>,
    /// The least error that all runs have reached.
    pub error: f64,
    /// Time over time until then.
    pub time_ratio: Option<Interval>,
}

impl Comparison {
    /// Compares run with run, in order.
    pub fn new(ours: &[Curve], theirs: &[Curve]) -> Comparison {
        let both = || ours.iter().chain(theirs);
        let time = both().map(|curve| curve.last().0).fold(f64::INFINITY, f64::min);
        let error = both().map(|curve| curve.last().1).fold(0.0, f64::max);
        Comparison {
            time,
            error_ratio: ratio(ours, theirs, |curve| curve.error_at(time)),
            error,
            time_ratio: ratio(ours, theirs, |curve| curve.time_at(error)),
        }
    }
}

/// The mean ratio (geometric) of what two techniques have, run by run; none where fewer than two pairs have it.
pub fn ratio(ours: &[Curve], theirs: &[Curve], value: impl Fn(&Curve) -> Option<f64>) -> Option<Interval> {
    let ratio = |(a, b): (&Curve, &Curve)| Some(value(a)? / value(b)?);
    let ratios: Vec<f64> = ours.iter().zip(theirs).filter_map(ratio).collect();
    (ratios.len() >= 2).then(|| Interval::of_geometric_mean(&ratios))
}
