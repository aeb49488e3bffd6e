//! What the program decides before a render: which denoisers fit its time, and which technique fits its scene.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use kernel_kit::Gpu;
use penumbra::internal::techniques::auto::Choice;
use penumbra::{Denoiser, Settings};

use super::arguments::Arguments;
use super::inputs::Subject;
use super::notes::Notes;
use super::times::Times;
use crate::cli::first_samples::FirstSamples;

/// Largest share of `--time` for denoising. A filter removes as much error as many times the samples would, and most of
/// all where samples are few.
const DENOISED_SHARE: f64 = 0.5;

/// Leaves out the denoisers that would take too much of `--time`, unless the user selects them. Returns the time that
/// remains for samples, if it is limited.
pub fn fit_denoiser(
    arguments: &Arguments,
    gpu: &Gpu,
    settings: &Settings,
    denoiser: &mut Denoiser,
    notes: &mut Notes,
) -> Option<Duration> {
    let pixels = settings.image.crop_window().pixels();
    if let Some(time) = arguments.time.filter(|_| arguments.denoise.is_none() && arguments.settings.noise.is_none())
        && denoiser.fit(gpu, pixels, DENOISED_SHARE * time.as_secs_f64())
    {
        let rest = denoiser.names().next().map_or("the image stays raw".to_owned(), |name| {
            format!("{name} alone removes noise, and its error is not estimated")
        });
        notes.say(&[format!("denoising would take too much of --time {}: {rest}", time.as_secs_f64())]);
    }
    let denoising = Duration::from_secs_f64(denoiser.seconds(gpu, pixels));
    arguments.time.map(|time| time.saturating_sub(denoising))
}

/// Chooses the technique and the distribution of samples where the user does not. `driver_compiles` is set once the
/// driver compiles a kernel. Returns the first sample, if its time will show how fast the machine is.
pub fn choose_technique(
    arguments: &Arguments,
    gpu: &Gpu,
    subject: &mut Subject,
    times: &Times,
    driver_compiles: Arc<AtomicBool>,
    notes: &mut Notes,
) -> Option<FirstSample> {
    if !arguments.settings.is_automatic() {
        return None;
    }
    let Subject { scene, camera, settings } = subject;
    let earlier = FirstSamples::of(gpu);
    // A sequence recognises its complete frames by their settings, so these must not depend on a clock.
    let is_sequence = arguments.sequence.first().is_some();
    let (elapsed, slowness) =
        if is_sequence { (0.0, 1.0) } else { (times.started.elapsed().as_secs_f64(), earlier.slowness()) };
    // With a checkpoint, an image has the same bits whatever its time, so that it can be resumed.
    let limited = times.sampling.filter(|_| arguments.checkpoint.is_none());
    let within = limited.map(|time| time.as_secs_f64() - elapsed);
    let choice = Choice::new(gpu, scene, camera, settings, within, slowness);
    let Choice { technique, reason, sampling, first_sample: expected } = choice;
    // A sequence first skips the frames that are complete, which takes time.
    let expected = expected.filter(|_| !is_sequence);
    let first_sample =
        expected.map(|expected| FirstSample { expected, earlier, begun: Instant::now(), driver_compiles });
    settings.technique = technique;
    if arguments.settings.leaves_sampling() {
        settings.image.sampling = sampling;
    }
    if let Some(reason) = reason {
        notes.say(&[format!("using --technique {technique}, because {reason}")]);
    }
    first_sample
}

/// A first sample, whose time shows how fast the machine is.
pub struct FirstSample {
    /// Seconds.
    expected: f64,
    /// The ratios of actual to expected time of earlier renders.
    earlier: FirstSamples,
    begun: Instant,
    /// Set if the driver has compiled kernels since.
    driver_compiles: Arc<AtomicBool>,
}

impl FirstSample {
    /// The ratios of earlier renders, and that of this one: the time of its first sample over the expected time. `None`
    /// if that time contains the compilation of kernels by the driver.
    pub fn ratio(self) -> Option<(FirstSamples, f64)> {
        let ratio = self.begun.elapsed().as_secs_f64() / self.expected;
        (!self.driver_compiles.load(Ordering::Relaxed)).then_some((self.earlier, ratio))
    }
}
