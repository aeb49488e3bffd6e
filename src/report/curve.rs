//! Error over time, and the comparison of two techniques by their curves.

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
        // An error of 0 has no logarithm.
        let ln = |x: f64| x.max(f64::MIN_POSITIVE).ln();
        let points = points.into_iter().map(|(time, error)| Point { ln_time: ln(time), ln_error: ln(error) });
        Curve(points.collect())
    }

    /// Seconds and error of the last image.
    pub fn last(&self) -> (f64, f64) {
        self.0.last().map_or((f64::NAN, f64::NAN), |last| (last.ln_time.exp(), last.ln_error.exp()))
    }

    /// Seconds until the first image.
    pub fn first_time(&self) -> f64 {
        self.0.first().map_or(f64::NAN, |first| first.ln_time.exp())
    }

    /// The error at a time in seconds, interpolated as a power of time between two images. `None` before the first
    /// image and after the last.
    pub fn error_at(&self, time: f64) -> Option<f64> {
        let x = time.ln();
        let [a, b] = self.segment(|a, b| a.ln_time <= x && x <= b.ln_time)?;
        Some(interpolate(x, [a.ln_time, b.ln_time], [a.ln_error, b.ln_error]).exp())
    }

    /// Seconds until the curve first reaches an error: the time of the first image if that already has it, `None` if no
    /// image has it.
    pub fn time_at(&self, error: f64) -> Option<f64> {
        let y = error.ln();
        if self.0.first()?.ln_error <= y {
            return Some(self.first_time());
        }
        let [a, b] = self.segment(|_, b| b.ln_error <= y)?;
        Some(interpolate(y, [a.ln_error, b.ln_error], [a.ln_time, b.ln_time]).exp())
    }

    /// The exponent of the power of time that fits best, by least squares of logarithms. `None` for fewer than two
    /// points.
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

/// Maps `x` linearly from the interval `from` to the interval `to`.
fn interpolate(x: f64, from: [f64; 2], to: [f64; 2]) -> f64 {
    let width = from[1] - from[0];
    let share = if width == 0.0 { 0.0 } else { (x - from[0]) / width };
    to[0] + share * (to[1] - to[0])
}

/// Ratios of one technique over another: of their errors at the same time, and of their times to the same error.
pub struct Comparison {
    /// The last time in seconds that all runs have reached.
    pub time: f64,
    /// Error over error at that time.
    pub error_ratio: Option<Interval>,
    /// The smallest error that all runs have reached.
    pub error: f64,
    /// Time over time to that error.
    pub time_ratio: Option<Interval>,
}

impl Comparison {
    /// Compares the runs in pairs, in order; they were taken in turn.
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

/// The geometric mean of the ratios of `value`, run by run. `None` if fewer than two pairs of runs have the value.
pub fn ratio(ours: &[Curve], theirs: &[Curve], value: impl Fn(&Curve) -> Option<f64>) -> Option<Interval> {
    let ratio = |(a, b): (&Curve, &Curve)| Some(value(a)? / value(b)?);
    let ratios: Vec<f64> = ours.iter().zip(theirs).filter_map(ratio).collect();
    (ratios.len() >= 2).then(|| Interval::of_geometric_mean(&ratios))
}
