//! Renders that are to end in time: samples and refinements that are expected to fit, and no others.

use std::time::Instant;

use super::adaptive_sampling::share_of_round;
use super::batches::Progress;
use super::denoise::Denoiser;
use super::renderer::Renderer;
use crate::Result;
use crate::settings::stages::settings_of_stage;

/// Maximum share of the remaining time that better indirect light may take. It improves the samples that follow, and
/// with half of the time spent, half as many of these fit.
const REFINEMENT_SHARE: f64 = 0.5;

/// As [`REFINEMENT_SHARE`], if gather rays still leave more error than samples do, so that further samples gain little.
/// The last quarter is kept for steps that take longer than expected.
const DOMINANT_SHARE: f64 = 0.75;

/// For photons to be emitted, this multiple of the samples for which they pay off must still fit, because composing
/// their kernels takes part of the time. Without this margin `scenes/box.glb` had 1.6 times the error of `two-pass`
/// after a second; with it, 1.1 times (docs/decisions.md, "Photons in a time budget").
const MARGIN_FOR_KERNELS: u32 = 2;

/// Expected time of a sample whose pixels are chosen by adaptive sampling, over that of one sample of all pixels, until
/// it has been measured: pixels in penumbrae trace more rays (1.1 to 2.7 times in seven scenes; docs/decisions.md,
/// "Adaptive sampling with a fixed budget"). The first decision on pixels takes about as long as a sample of all
/// pixels.
const ALLOCATED_SAMPLE: f64 = 2.0;

/// Expected times of samples.
#[derive(Clone, Copy)]
struct Expected {
    /// Seconds before the next one: to decide which pixels get it.
    before: f64,
    /// Seconds of each sample of all pixels.
    sample: f64,
}

impl Expected {
    /// Expected seconds of `samples` samples.
    fn of(self, samples: u32) -> f64 {
        self.before + self.sample * f64::from(samples)
    }

    /// How many samples fit `seconds`.
    fn fitting(self, seconds: f64) -> u32 {
        ((seconds - self.before) / self.sample) as u32
    }
}

impl Renderer<'_> {
    /// Like [`Renderer::wants_samples`], but `false` if a decision on where samples go, which runs `denoiser`, is not
    /// expected to end within `seconds` and to leave time for a sample.
    ///
    /// # Errors
    /// As [`Renderer::wants_samples`].
    pub fn wants_samples_within(&mut self, denoiser: &Denoiser, seconds: f64) -> Result<bool> {
        if self.settings.image.noise.is_some() && self.is_decision_due() {
            let pixels = self.settings.image.crop_window().pixels();
            let sample = self.seconds_of_sample().unwrap_or(0.0);
            // The first decision takes about as long as a sample of all pixels, as in `ALLOCATED_SAMPLE`.
            let first = || denoiser.seconds(self.gpu, pixels).max(sample);
            let decision = self.sampling.seconds_to_decide.unwrap_or_else(first);
            // How many blocks have too large an error is not known before: all of them may.
            if decision + share_of_round(denoiser) * sample > seconds {
                return Ok(false);
            }
        }
        self.wants_samples(denoiser)
    }

    /// Like [`Renderer::render_batch`], limited to steps that are expected to end within `seconds`, by the times of
    /// earlier batches: fewer samples, and better indirect light only if it leaves time for samples that benefit from
    /// it. So the bits depend on the time. Returns `None` if not even one sample fits; the first one is always
    /// rendered.
    ///
    /// # Errors
    /// As [`Renderer::render_batch`].
    pub fn render_within(&mut self, seconds: f64) -> Result<Option<Progress>> {
        let start = Instant::now();
        if !self.fit_sample(seconds) {
            return Ok(None);
        }
        self.refine_within(seconds)?;
        let left = seconds - start.elapsed().as_secs_f64();
        if !self.fit_sample(left) {
            // Better indirect light took longer than expected.
            return Ok(None);
        }
        let limit = self.expected().map_or(1, |expected| expected.fitting(left));
        let spp = self.sampling.samples.saturating_add(limit / MARGIN_FOR_KERNELS).min(self.settings.image.spp);
        self.add_samples(limit, spp).map(Some)
    }

    /// Like [`Renderer::render_batch`], if the whole batch and the indirect light that is due are expected to end
    /// within `seconds`; otherwise returns `None`. So an image of a given number of samples has the same bits as
    /// without a limit. The first batch of a process is always rendered.
    ///
    /// # Errors
    /// As [`Renderer::render_batch`].
    pub fn render_batch_within(&mut self, seconds: f64) -> Result<Option<Progress>> {
        if let Some(expected) = self.expected() {
            let refinement = if self.may_refine() { self.seconds_to(self.next_stage()) } else { 0.0 };
            if refinement + expected.of(self.samples_of_next_batch()) > seconds {
                return Ok(None);
            }
        }
        self.render_batch().map(Some)
    }

    /// Whether one more sample is expected to end within `seconds`; the first one always has time. If only the decision
    /// on which pixels get it does not fit, the decision is left out: each pixel doubles its samples.
    fn fit_sample(&mut self, seconds: f64) -> bool {
        if self.expected().is_none_or(|expected| expected.of(1) <= seconds) {
            return true;
        }
        let fits_alone = self.is_allocation_due() && self.seconds_of_sample().is_some_and(|sample| sample <= seconds);
        if let Some(allocation) = self.sampling.allocation.as_mut().filter(|_| fits_alone) {
            allocation.double();
        }
        fits_alone
    }

    /// Expected times of the next samples; `None` before the first batch.
    fn expected(&self) -> Option<Expected> {
        let sample = self.seconds_of_sample()?;
        Some(match self.sampling.seconds_to_decide {
            _ if !self.is_allocation_due() => Expected { before: 0.0, sample },
            Some(before) => Expected { before, sample },
            None => Expected { before: sample, sample: ALLOCATED_SAMPLE * sample },
        })
    }

    /// Adds indirect light that leaves enough of `seconds`.
    fn refine_within(&mut self, seconds: f64) -> Result<()> {
        let start = Instant::now();
        self.refine(&mut |renderer, step| {
            let left = seconds - start.elapsed().as_secs_f64();
            let share = if step.leaves_more_error { DOMINANT_SHARE } else { REFINEMENT_SHARE };
            renderer.seconds_to(step.stage) <= share * left
        })
    }

    /// Expected seconds to advance to a stage.
    fn seconds_to(&self, stage: i32) -> f64 {
        let rays = |stage: i32| settings_of_stage(&self.settings, stage).gather_rays();
        let rays = rays(stage) - rays(self.view.stage);
        self.view.lighting.indirect.as_ref().map_or(0.0, |indirect| indirect.cost().of(rays))
    }
}
