//! What audits say about the visibility map, with confidence intervals.

use serde::Serialize;
use statrs::distribution::{Beta, ContinuousCDF};

/// What audits found about the decided points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Audits {
    /// Decided points that were audited.
    pub audited: u64,
    /// Those whose shadow ray contradicted the class.
    pub wrong: u64,
    /// Estimated miss bias: the mean of |V - c| over all points.
    pub miss_bias: f64,
    /// Its 95 % interval: those of Jeffreys of points near boundaries and of the others, combined.
    pub miss_bias_interval: [f64; 2],
}

/// Decided points of one kind: what share of all points they are, how many were audited, how many of these wrong.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stratum {
    /// Share of all points, 0 to 1.
    pub share: f64,
    /// Audited points.
    pub audited: u64,
    /// Those whose shadow ray contradicted the class.
    pub wrong: u64,
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
            let found = stratum.wrong as f64 / stratum.audited.max(1) as f64;
            audits.miss_bias += stratum.share * found;
            let [low, high] = jeffreys(stratum.wrong, stratum.audited);
            below += (stratum.share * (found - low)).powi(2);
            above += (stratum.share * (high - found)).powi(2);
        }
        audits.miss_bias_interval =
            [(audits.miss_bias - below.sqrt()).max(0.0), (audits.miss_bias + above.sqrt()).min(1.0)];
        audits
    }
}

/// Wilson's score interval at 95 % of a share estimated by `part` of `whole`: its centre and its half width.
#[cfg(feature = "report")]
pub(crate) fn wilson(part: u64, whole: u64) -> (f64, f64) {
    // 97.5 % quantile of the normal distribution.
    const Z: f64 = 1.959_964;
    if whole == 0 {
        return (0.5, 0.5);
    }
    let n = whole as f64;
    let p = part as f64 / n;
    let scale = 1.0 + Z * Z / n;
    ((p + Z * Z / (2.0 * n)) / scale, Z / scale * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt())
}

/// The interval of Jeffreys at 95 % of a share, estimated by `part` of `whole` (Brown, Cai and DasGupta 2001): for the
/// few wrong audits that a render has, Wilson's interval misses the true share in one of ten renders, and that of
/// Clopper and Pearson in none.
fn jeffreys(part: u64, whole: u64) -> [f64; 2] {
    // Valid parameters: both are at least a half.
    let beta = Beta::new(part as f64 + 0.5, (whole - part) as f64 + 0.5);
    let quantile = |p: f64| beta.as_ref().map_or(f64::NAN, |beta| beta.inverse_cdf(p));
    [if part == 0 { 0.0 } else { quantile(0.025) }, if part == whole { 1.0 } else { quantile(0.975) }]
}
