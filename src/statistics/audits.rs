//! Estimates about the visibility map from audits, with confidence intervals.

use serde::Serialize;
use statrs::distribution::{Beta, ContinuousCDF};

/// Results of the audits of decided points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Audits {
    /// Decided points that were audited.
    pub audited: u64,
    /// Audited points whose shadow ray contradicted the class.
    pub wrong: u64,
    /// Estimated miss bias: the mean of |V - c| over all points.
    pub miss_bias: f64,
    /// Its 95 % interval, combined from Jeffreys intervals of three groups: points near boundaries, points in settled
    /// cells, and all others.
    pub miss_bias_interval: [f64; 2],
}

/// Decided points near boundaries, those in settled cells, or all others: their share of all points, and their audits.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stratum {
    /// Share of all points, 0 to 1.
    pub share: f64,
    /// Audited points.
    pub audited: u64,
    /// Audited points whose shadow ray contradicted the class.
    pub wrong: u64,
    /// Estimated share that is wrong: their share of the audited points, unless batches of samples had different
    /// probabilities of audits.
    pub found: f64,
}

impl Audits {
    /// The estimate from points that were audited with different probabilities. The intervals of the strata, which are
    /// independent, are combined by the method of Zou and Donner (2008): the distance of each end from the estimate is
    /// the root of the sum of the squared distances of the strata's ends.
    pub fn new(strata: &[Stratum]) -> Self {
        let mut audits = Audits::default();
        let (mut below, mut above) = (0.0, 0.0);
        for stratum in strata.iter().filter(|s| s.share > 0.0) {
            audits.audited += stratum.audited;
            audits.wrong += stratum.wrong;
            let found = stratum.found;
            audits.miss_bias += stratum.share * found;
            // The interval has the same width relative to the estimate as if all batches had been audited with one
            // probability.
            let scale = if stratum.wrong == 0 { 1.0 } else { found * stratum.audited as f64 / stratum.wrong as f64 };
            let [low, high] = jeffreys(stratum.wrong, stratum.audited).map(|end| scale * end);
            below += (stratum.share * (found - low)).powi(2);
            above += (stratum.share * (high - found)).powi(2);
        }
        audits.miss_bias_interval =
            [(audits.miss_bias - below.sqrt()).max(0.0), (audits.miss_bias + above.sqrt()).min(1.0)];
        audits
    }
}

/// 97.5 % quantile of the normal distribution: so many standard errors are half of an interval at 95 %.
pub(crate) const NORMAL_QUANTILE: f64 = 1.959_964;

/// Wilson's score interval at 95 % of a share estimated by `part` of `whole`: its centre and its half width.
pub(crate) fn wilson(part: u64, whole: u64) -> (f64, f64) {
    const Z: f64 = NORMAL_QUANTILE;
    if whole == 0 {
        return (0.5, 0.5);
    }
    let n = whole as f64;
    let p = part as f64 / n;
    let scale = 1.0 + Z * Z / n;
    ((p + Z * Z / (2.0 * n)) / scale, Z / scale * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt())
}

/// If there are at least this many wrong audits and as many right ones, Wilson's interval replaces Jeffreys'. They
/// differ by at most a fiftieth of their width, and the continued fraction of the beta distribution would need ever
/// more steps.
const MANY: u64 = 1000;

/// The 95 % Jeffreys interval of a share that is estimated by `part` of `whole` (Brown, Cai and DasGupta 2001). With
/// the few wrong audits of a render, Wilson's interval misses the true share in one of ten renders; the interval of
/// Clopper and Pearson is so wide that it never does.
fn jeffreys(part: u64, whole: u64) -> [f64; 2] {
    if part.min(whole - part) >= MANY {
        let (centre, half_width) = wilson(part, whole);
        return [centre - half_width, centre + half_width];
    }
    // Valid parameters: both are at least a half.
    let beta = Beta::new(part as f64 + 0.5, (whole - part) as f64 + 0.5);
    let quantile = |p: f64| beta.as_ref().map_or(f64::NAN, |beta| quantile(beta, p));
    [if part == 0 { 0.0 } else { quantile(0.025) }, if part == whole { 1.0 } else { quantile(0.975) }]
}

/// The share below which the distribution has the probability `p`, by bisection: `inverse_cdf` of statrs 0.19 never
/// returns for a few of ten million.
fn quantile(beta: &Beta, p: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    loop {
        let middle = f64::midpoint(low, high);
        if middle <= low || middle >= high {
            return middle;
        }
        if beta.cdf(middle) < p { low = middle } else { high = middle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles agree with distributions whose quantiles or probabilities have a closed form.
    #[test]
    fn quantiles_are_those_of_closed_forms() {
        for p in [0.025, 0.5, 0.975] {
            let arcsine = quantile(&Beta::new(0.5, 0.5).unwrap(), p);
            assert!((arcsine - (std::f64::consts::FRAC_PI_2 * p).sin().powi(2)).abs() < 1e-12, "{p}: {arcsine}");
            for n in [10.0, 1e4, 1e7, 1e9] {
                let first = quantile(&Beta::new(1.0, n).unwrap(), p);
                let expected = -((-p).ln_1p() / n).exp_m1();
                // Differences of logarithms of the gamma function lose digits to numbers of n ln n.
                assert!((first / expected - 1.0).abs() < 1e-5, "{p}, {n}: {first}, not {expected}");
                let second = quantile(&Beta::new(2.0, n).unwrap(), p);
                let probability = 1.0 - (n * (-second).ln_1p()).exp() * (1.0 + n * second);
                assert!((probability - p).abs() < 1e-5, "{p}, {n}: {probability}");
            }
        }
    }

    /// There is an interval for any numbers of audits, which is around the share that was found.
    #[test]
    fn any_numbers_have_an_interval() {
        for whole in [0, 1, 10, 1000, 100_000, 10_000_000, 1_000_000_000, 1_000_000_000_000] {
            for part in [0, 1, 2, 30, 999, 1000, 5000, whole / 2, whole].into_iter().filter(|part| *part <= whole) {
                let ([low, high], found) = (jeffreys(part, whole), part as f64 / whole.max(1) as f64);
                assert!(0.0 <= low && high <= 1.0 && low < high, "{part} of {whole}: {low}, {high}");
                assert!(whole == 0 || (low <= found && found <= high), "{part} of {whole}: {low}, {high}");
                // Five standard deviations at most, of one more than was found.
                let spread = 5.0 * (part as f64 + 1.0).sqrt() / whole.max(1) as f64;
                assert!(high - low <= spread, "{part} of {whole}: {low}, {high}");
            }
        }
    }

    /// The two intervals agree where one takes the place of the other.
    #[test]
    fn many_have_nearly_the_same_interval() {
        for whole in [2 * MANY, 10_000_000] {
            let beta = Beta::new(MANY as f64 + 0.5, (whole - MANY) as f64 + 0.5).unwrap();
            let exact = [0.025, 0.975].map(|p| quantile(&beta, p));
            let close = jeffreys(MANY, whole);
            let off = [0, 1].map(|end| (close[end] - exact[end]).abs() / (exact[1] - exact[0]));
            // The fiftieth that `MANY` states.
            assert!(off[0] < 0.02 && off[1] < 0.02, "of {whole}: {off:?}");
        }
    }
}
