//! The expected error of an image, estimated without a reference.

use super::metrics::{RELMSE_FLOOR, variance};
use crate::render::film::Image;
use crate::statistics::Statistics;

/// The expected relMSE of an image: the variance of its pixels (channels `variance.R` and so on), plus an upper bound
/// on the error of wrong classes that the audits have not met yet.
///
/// The variance assumes independent samples. Penumbra's samples are stratified, so the estimate tends to be too large.
/// `None` without the variance channels, and for fewer than two samples.
pub fn relmse(image: &Image, statistics: &Statistics) -> Option<f64> {
    if statistics.samples < 2 {
        return None;
    }
    let mut sum = 0.0;
    for name in ["R", "G", "B"] {
        let (x, v) = (image.channel(name)?, image.channel(&variance(name))?);
        sum += relative(x, v.iter().map(|v| f64::from(*v)));
    }
    Some(sum / (3 * image.pixels()) as f64 + unaudited(statistics))
}

/// The expected relMSE of the denoised image, by its channel `error`. `None` without it.
pub fn denoised_relmse(image: &Image) -> Option<f64> {
    let error = image.channel("error")?;
    let mut sum = 0.0;
    for name in ["denoised.R", "denoised.G", "denoised.B"] {
        sum += relative(image.channel(name)?, error.iter().map(|error| f64::from(*error).powi(2)));
    }
    Some(sum / (3 * image.pixels()) as f64)
}

/// The sum of squared errors over the squares of a channel, as relMSE has them.
fn relative(channel: &[f32], squares: impl Iterator<Item = f64>) -> f64 {
    channel.iter().zip(squares).map(|(x, square)| square / (f64::from(*x).powi(2) + RELMSE_FLOOR)).sum()
}

/// Wrong classes that no audit has met yet do not show in the variance. A point's estimate is c + (V - c) / p with
/// probability p, so the mean of n samples has a variance of at most |V - c| / (p n), and the audits bound the mean of
/// |V - c|.
fn unaudited(statistics: &Statistics) -> f64 {
    let decided = statistics.points.lit + statistics.points.shadowed;
    let audits = f64::from(statistics.settings.visibility_map.audit) * f64::from(statistics.samples);
    if decided == 0 { 0.0 } else { statistics.audits.miss_bias_interval[1] / audits }
}
