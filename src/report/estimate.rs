//! The expected error of an image, estimated without a reference.

use super::metrics::RELMSE_FLOOR;
use crate::render::film::Image;

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
