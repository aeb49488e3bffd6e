//! What an image would cost by each technique that a user might choose, predicted from a few samples of small images.

use serde::Serialize;

use super::metrics::{RELMSE_FLOOR, mean_with_variance};
use super::run::Subject;
use crate::settings::{Aov, Denoise, Sampling, Settings};
use crate::{Image, Renderer, Result, Technique};

/// Pixels of the small images. Times are a constant plus a part in proportion to the pixels, so two sizes determine
/// both. Images much smaller than these have more irradiance records for a pixel than large ones.
const PIXELS: [f64; 2] = [6400.0, 25_600.0];

/// Samples of each small image after which photons have been emitted and their trial has ended. What comes before is
/// paid once.
const SET_UP: u32 = 8;

/// Samples of each small image in all. The last ones show what further samples cost, with the gather rays that records
/// get meanwhile.
const SAMPLES: u32 = 24;

/// The techniques among which `auto` and its trial of photons choose.
pub const TECHNIQUES: [Technique; 3] = [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS];

/// What an image would cost. Seconds are without the compilation of kernels. Predictions were within a third of the
/// time in 11 of 12 renders, and within a factor of 2.4 of the noise (docs/decisions.md, "Predicted costs").
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Prediction {
    /// How light is computed.
    pub technique: Technique,
    /// Seconds from the imported scene to the first sample.
    pub first_sample: f64,
    /// Seconds of each sample once photons have been emitted, if they pay off.
    pub sample: f64,
    /// Seconds of all samples that the settings request.
    pub all: f64,
    /// relMSE that the noise of the samples leaves in the raw image then. What samples share, such as the noise of
    /// irradiance records, is not in it. `None` for a single sample, whose variance is unknown.
    pub noise: Option<f64>,
}

/// Times of a small image, and its noise.
struct Measured {
    pixels: f64,
    first_sample: f64,
    /// Up to the end of [`SET_UP`] samples, or of all if there are fewer.
    set_up: f64,
    /// Of each further sample.
    sample: f64,
    /// relMSE of a single sample.
    noise: Option<f64>,
}

/// Predicts the cost of the image that the settings request by a technique. `None` if these settings do not fit it.
///
/// # Errors
/// As [`Renderer::new`](crate::Renderer::new) and [`Renderer::render_batch`](crate::Renderer::render_batch).
pub fn predict(subject: &Subject<'_>, technique: Technique) -> Result<Option<Prediction>> {
    let settings = subject.settings.clone().with(|s| {
        s.technique = technique;
        s.image.denoise = Denoise::None;
        s.image.sampling = Sampling::Uniform;
        (s.image.noise, s.image.piece, s.image.crop) = (None, None, None);
        s.image.aovs.retain(|aov| *aov != Aov::Variance);
        s.image.aovs.push(Aov::Variance);
    });
    // `path`, for one, cannot sample all lights at a vertex.
    if settings.check().is_err() {
        return Ok(None);
    }
    let pixels = subject.settings.image.crop_window().pixels() as f64;
    let [small, large] = PIXELS.map(|limit| of_pixels(&settings, limit.min(pixels)));
    // A piece has only some of the samples.
    let spp = subject.settings.image.range().count();
    let measured = [measure(subject, &small, spp)?, measure(subject, &large, spp)?];
    let of = |seconds: fn(&Measured) -> f64| extrapolated(measured.each_ref().map(|m| (m.pixels, seconds(m))), pixels);
    let (first_sample, sample) = (of(|m| m.first_sample), of(|m| m.sample));
    let further = spp.saturating_sub(SET_UP);
    let all = of(|m| m.set_up) + f64::from(further) * sample;
    let noise = measured[1].noise.map(|noise| noise / f64::from(spp));
    Ok(Some(Prediction { technique, first_sample, sample, all, noise }))
}

/// The settings with an image of about so many pixels, of the same aspect ratio.
fn of_pixels(settings: &Settings, pixels: f64) -> Settings {
    let [width, height] = [settings.image.width, settings.image.height].map(f64::from);
    let scale = (pixels / (width * height)).sqrt();
    let side = |length: f64| ((length * scale).round() as u32).max(1);
    settings.clone().with(|s| (s.image.width, s.image.height) = (side(width), side(height)))
}

/// Renders a few samples of an image, at most `spp`.
fn measure(subject: &Subject<'_>, settings: &Settings, spp: u32) -> Result<Measured> {
    let mut renderer = subject.renderer(settings)?;
    let seconds_after = |renderer: &mut Renderer<'_>, samples: u32| -> Result<f64> {
        while renderer.samples() < samples {
            renderer.render_up_to(samples - renderer.samples())?;
        }
        let time = renderer.statistics()?.time;
        Ok(time.bvh + time.render)
    };
    let [set_up_samples, samples] = [SET_UP, SAMPLES].map(|samples| samples.min(spp));
    let first_sample = seconds_after(&mut renderer, 1)?;
    let set_up = seconds_after(&mut renderer, set_up_samples)?;
    let all = seconds_after(&mut renderer, samples)?;
    // Without further samples, those before stand for them.
    let sample = match samples - set_up_samples {
        0 => (set_up - first_sample) / f64::from((samples - 1).max(1)),
        further => (all - set_up) / f64::from(further),
    };
    Ok(Measured {
        pixels: f64::from(settings.image.width) * f64::from(settings.image.height),
        first_sample,
        set_up,
        sample,
        noise: if samples > 1 { Some(noise(&renderer.image()?)? * f64::from(samples)) } else { None },
    })
}

/// relMSE by the image's own channel `variance`. [`Renderer::estimated_relmse`] compares halves of the samples, which
/// only renders with a denoiser or a limit of noise keep.
fn noise(image: &Image) -> Result<f64> {
    mean_with_variance(image, |value, variance| {
        let square = variance / (value * value + RELMSE_FLOOR);
        if square.is_finite() { square } else { 0.0 }
    })
}

/// The value at `pixels` on the line through two points. If noise in the times makes the line fall with the pixels, or
/// begin below 0, the times are taken as proportional to the pixels.
fn extrapolated([(x0, y0), (x1, y1)]: [(f64, f64); 2], pixels: f64) -> f64 {
    let slope = (y1 - y0) / (x1 - x0);
    if slope.is_finite() && slope >= 0.0 && y0 >= slope * x0 { y1 + slope * (pixels - x1) } else { y1 * pixels / x1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a line are extrapolated along it. A falling line, one that begins below 0, and a single size give
    /// times in proportion to the pixels.
    #[test]
    fn times_follow_a_line_from_a_constant() {
        assert_eq!(extrapolated([(1.0, 3.0), (2.0, 4.0)], 10.0), 12.0);
        assert_eq!(extrapolated([(1.0, 4.0), (2.0, 3.0)], 10.0), 15.0);
        assert_eq!(extrapolated([(1.0, 1.0), (2.0, 3.0)], 10.0), 15.0);
        assert_eq!(extrapolated([(5.0, 1.0), (5.0, 2.0)], 5.0), 2.0);
    }

    /// Small images have the aspect ratio of the large one, and a pixel at least.
    #[test]
    fn small_images_have_the_same_shape() {
        let sides = |width: u32, height: u32, pixels: f64| {
            let settings = Settings::default().with(|s| (s.image.width, s.image.height) = (width, height));
            let image = of_pixels(&settings, pixels).image;
            [image.width, image.height]
        };
        assert_eq!(sides(400, 100, 400.0), [40, 10]);
        assert_eq!(sides(100_000, 1, 400.0), [6325, 1]);
        assert_eq!(sides(3, 2, 6.0), [3, 2]);
    }
}
