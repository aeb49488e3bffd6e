//! The samples of a view so far.

use super::growth::Growth;
use super::sample_allocation::{PixelErrors, SampleAllocation};
use crate::settings::ImageSettings;

/// The samples of a view so far, and what decides on its next ones.
pub(super) struct SamplingState {
    /// Samples per pixel: the maximum over the pixels with `ImageSettings::noise`, the mean with `Sampling::Adaptive`.
    pub samples: u32,
    /// Calls of [`render_batch`](super::Renderer::render_batch) so far.
    pub batches: u32,
    /// Which pixels get samples, if some get more than others.
    pub allocation: Option<SampleAllocation>,
    /// Estimated errors of pixels that decided on gather rays, kept for the decision on samples that follows.
    pub errors: Option<PixelErrors>,
    /// The estimates that decide when records get more gather rays; `None` before the second batch.
    pub growth: Option<Growth>,
    /// See [`crate::passes::shade::ShadeParameters::at_once`].
    pub shade_at_once: bool,
    /// Samples per pixel before the visibility photons that are on trial were emitted.
    pub samples_without_photons: u32,
    /// Seconds of one sample of every pixel, by the last batch; `None` before the first batch.
    pub seconds_per_sample: Option<f64>,
    /// Seconds of the last decision on which pixels get more samples.
    pub seconds_to_decide: Option<f64>,
    /// With [`ImageSettings::noise`]: the errors were estimated after the last batch.
    pub is_noise_estimated: bool,
}

impl SamplingState {
    /// Before the first sample of an image.
    pub fn new(image: &ImageSettings, shade_at_once: bool) -> SamplingState {
        SamplingState {
            samples: 0,
            batches: 0,
            allocation: SampleAllocation::of(image),
            errors: None,
            growth: None,
            shade_at_once,
            samples_without_photons: 0,
            seconds_per_sample: None,
            seconds_to_decide: None,
            is_noise_estimated: false,
        }
    }
}
