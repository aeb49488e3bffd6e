//! How far an image is expected to be from the truth, without a reference.

use crate::render::film::Image;
use crate::statistics::Statistics;

use super::metrics::RELMSE_FLOOR;
use super::reference::variance;

/// The relMSE that an image is expected to have by the variance of its pixels (channels `variance.R` and so on) and by
/// what audits may not have seen yet. Samples of a pixel are taken for independent, while those of Penumbra are
/// stratified, so it is rather too large than too small. None without those channels, and for one sample.
pub fn relmse(image: &Image, statistics: &Statistics) -> Option<f64> {
    if statistics.samples < 2 {
        return None;
    }
    let mut sum = 0.0;
    for name in ["R", "G", "B"] {
        let (x, v) = (image.channel(name)?, image.channel(&variance(name))?);
        let share = |(x, v): (&f32, &f32)| f64::from(*v) / (f64::from(*x).powi(2) + RELMSE_FLOOR);
        sum += x.iter().zip(v).map(share).sum::<f64>();
    }
    Some(sum / (3 * image.pixels()) as f64 + unseen(statistics))
}

/// Wrong classes that no audit has met add to no variance yet. A point's estimate is c + (V - c) / p with probability p,
/// so the mean of n has a variance of |V - c| / (p n) at most, and the audits bound the mean of |V - c|.
fn unseen(statistics: &Statistics) -> f64 {
    let decided = statistics.points.lit + statistics.points.shadowed;
    let audits = f64::from(statistics.settings.visibility_map.audit) * f64::from(statistics.samples);
    if decided == 0 { 0.0 } else { statistics.audits.miss_bias_interval[1] / audits }
}
