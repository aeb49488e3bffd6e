//! The expected error of an image, estimated without a reference.

use super::metrics::RELMSE_FLOOR;
use crate::render::film::Image;

/// The expected relMSE of the denoised image, by its channel `error`: the root mean square over its three channels.
/// `None` without it.
pub fn denoised_relmse(image: &Image) -> Option<f64> {
    let error = image.channel("error")?;
    let mut squares = vec![0.0; image.pixels()];
    for name in ["denoised.R", "denoised.G", "denoised.B"] {
        let channel = image.channel(name)?;
        squares.iter_mut().zip(channel).for_each(|(sum, x)| *sum += f64::from(*x).powi(2) + RELMSE_FLOOR);
    }
    let relative = error.iter().zip(&squares).map(|(error, squares)| 3.0 * f64::from(*error).powi(2) / squares);
    Some(relative.sum::<f64>() / image.pixels() as f64)
}
