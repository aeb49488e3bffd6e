//! The error of a denoised image as its own channels state it, without a reference.

use crate::Image;

/// The relMSE of the denoised channels of [`Renderer::denoised_image`](crate::Renderer::denoised_image) according to
/// `relative_error`; `None` without these.
pub fn denoised_relmse(image: &Image) -> Option<f64> {
    let errors = image.channel("relative_error")?;
    Some(errors.iter().map(|error| f64::from(*error).powi(2)).sum::<f64>() / image.pixels() as f64)
}
