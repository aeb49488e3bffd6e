//! Adaptive sampling: further samples go to the blocks of pixels where they reduce the error of the image by most,
//! until the error of every block is as small as requested.
//!
//! The error of a block is the mean relMSE of its pixels, estimated from two halves of their samples: of the raw image,
//! or of the denoised one if that is what the user gets.

use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use super::denoise::{Colour, Denoiser, relative};
use super::noisy::add_background;
use super::output::Film;
use super::picture::{behind, colour_of};
use super::renderer::Renderer;
use super::sample_allocation::{PixelErrors, SampleAllocation};
use super::tiles::first_half;
use crate::Result;
use crate::passes::film::{Plane, Sum};
use crate::settings::{Denoise, ImageSettings};
use crate::specialisation::features::Feature;

/// Minimum share of the blocks with too large an error that get samples together. Estimates and dispatches take the
/// same time for a few blocks as for many.
const ROUND_SHARE: f64 = 0.125;

/// Like [`ROUND_SHARE`], if each estimate runs denoisers, which take as long as several samples of all pixels.
const DENOISED_SHARE: f64 = 0.5;

/// Minimum share of the blocks with too large an error that get samples together, if each estimate runs `denoiser`.
pub(super) fn share_of_round(denoiser: &Denoiser) -> f64 {
    if denoiser.choice() == Denoise::None { ROUND_SHARE } else { DENOISED_SHARE }
}

impl Renderer<'_> {
    /// Whether the render needs more samples than it has. With [`ImageSettings::noise`] it decides where they go, if no
    /// batch is under way, by the estimated error of the image that `denoiser` returns.
    ///
    /// # Errors
    /// As [`Renderer::denoised_image`].
    pub fn wants_samples(&mut self, denoiser: &Denoiser) -> Result<bool> {
        let Some(noise) = self.settings.image.noise else {
            return Ok(self.sampling.samples < self.settings.image.range().count());
        };
        if self.is_decision_due() {
            let start = Instant::now();
            let errors = self.squared_errors(denoiser)?;
            let seconds = start.elapsed().as_secs_f64();
            self.totals.time_render += seconds;
            self.sampling.seconds_to_decide = Some(seconds);
            self.sampling.is_noise_estimated = true;
            let share = share_of_round(denoiser);
            let unaudited = self.unaudited();
            let ImageSettings { spp, .. } = self.settings.image;
            let width = self.settings.image.crop_window().width;
            if let Some(allocation) = &mut self.sampling.allocation {
                let errors = allocation.errors(&errors, width);
                allocation.select_blocks(&errors, noise - unaudited, spp, share);
            }
        }
        Ok(self.sampling.allocation.as_ref().is_some_and(|allocation| !allocation.is_complete()))
    }

    /// Whether the render has all its samples, as far as that is known without an estimate of the noise.
    pub fn is_complete(&self) -> bool {
        match &self.sampling.allocation {
            Some(allocation) if self.settings.image.noise.is_some() => {
                self.is_noise_known() || allocation.has_all(self.settings.image.spp)
            }
            _ => self.sampling.samples >= self.settings.image.range().count(),
        }
    }

    /// A note if [`ImageSettings::noise`] was not reached, because samples or time ended the render.
    pub fn note_on_noise(&self) -> Option<String> {
        let noise = self.settings.image.noise?;
        let allocation = self.sampling.allocation.as_ref()?;
        let [above, all] = allocation.above();
        if above > 0 {
            let rest = "were above it when they were last estimated";
            return Some(format!("a noise of {noise:e} was not reached everywhere: {above} of {all} blocks {rest}"));
        }
        // A single sample shows no noise.
        let rest = match self.sampling.samples {
            0 | 1 => "the image has too few samples for an estimate",
            _ if !self.is_noise_known() => "the render ended before an estimate",
            _ => return None,
        };
        Some(format!("whether a noise of {noise:e} was reached is not known: {rest}"))
    }

    /// The expected relMSE of the raw image: by the squared difference of two halves of its samples (a quarter of it
    /// for equal halves), plus an upper bound on the error of wrong classes that the audits have not met yet. It does
    /// not include the error of photon maps of indirect light, which all samples share. `None` after a single sample,
    /// and for equal numbers of samples without [`ImageSettings::noise`] or a denoiser.
    ///
    /// # Errors
    /// As [`Renderer::image`].
    pub fn estimated_relmse(&self) -> Result<Option<f64>> {
        if self.sampling.samples < 2 || !self.settings.estimates_error() {
            return Ok(None);
        }
        let errors = self.squared_errors(&Denoiser::default())?;
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        Ok(Some(mean + self.unaudited()))
    }

    /// Wrong classes that no audit has met yet do not show in the samples. A point's estimate is c + (V - c) / p with
    /// probability p, so the mean of n samples has a variance of at most |V - c| / (p n), and the audits bound the mean
    /// of |V - c|. Without audits there is no such bound, and the result is 0.
    fn unaudited(&self) -> f64 {
        let (points, audits) = (self.totals.points(), self.totals.audits());
        let are_audited = audits.audited > 0 || self.specialisation.features.has(Feature::Audit);
        if points.lit + points.shadowed == 0 || !are_audited {
            return 0.0;
        }
        audits.miss_bias_interval[1] / (f64::from(self.settings.visibility_map.audit) * self.mean_samples())
    }

    /// The estimated relative squared error of each pixel of what `denoiser` makes of the image.
    fn squared_errors(&self, denoiser: &Denoiser) -> Result<Vec<f64>> {
        if denoiser.choice() != Denoise::None
            && let Some(mut denoised) = denoiser.denoise(self.gpu, &self.noisy()?)?
        {
            add_background(&mut denoised, &Film::of(self), self.settings.image.background)?;
            if let Some(error) = &denoised.error {
                let pixel = |(colour, error): (_, &Colour)| relative(colour, |c| f64::from(error[c]).powi(2));
                return Ok(denoised.colour.iter().zip(error).map(pixel).collect());
            }
        }
        self.raw_errors()
    }

    /// The estimated relative squared error of each pixel of the raw image, which has two samples or more.
    fn raw_errors(&self) -> Result<Vec<f64>> {
        let width = self.settings.image.crop_window().width as usize;
        let samples: Vec<u32> = self.samples_of_all().collect();
        let background = colour_of(self.settings.image.background);
        let mut colours = Vec::new();
        for tile in &self.view.tiles {
            let samples = &samples[colours.len()..][..tile.rows().len() * width];
            let planes = [Some(&tile.direct), tile.indirect.as_ref()];
            let components = planes.into_iter().flatten().zip(&tile.components).map(|(plane, component)| {
                let [even, odd] = &component.snapshots;
                Ok([plane.state(self.gpu)?, even.state(self.gpu)?, odd.state(self.gpu)?])
            });
            let components = components.collect::<Result<Vec<_>>>()?;
            let pixel = |(pixel, samples): (usize, &u32)| colours_of(&components, background, pixel, *samples);
            colours.par_extend(samples.par_iter().enumerate().map(pixel));
        }
        let whole: Vec<Colour> = colours.par_iter().map(|[whole, ..]| *whole).collect();
        let medians = medians(&whole, width);
        let pixel = |(pixel, [_, a, b]): (usize, &[Colour; 3])| {
            let samples = samples[pixel];
            let first = f64::from(first_half(samples)) / f64::from(samples);
            // The variance of the mean, over the mean squared difference of the means of both halves.
            let share = first * (1.0 - first);
            // Where both halves are bright, as at the edge of a lamp, the pixel is.
            let typical = [0, 1, 2].map(|c| medians[pixel][c].max(a[c].min(b[c])));
            relative(&typical, |c| share * (f64::from(a[c]) - f64::from(b[c])).powi(2))
        };
        Ok(colours.par_iter().enumerate().map(pixel).collect())
    }

    /// Whether the pixels have all samples of the last decision, and their noise was estimated since.
    fn is_noise_known(&self) -> bool {
        self.sampling.is_noise_estimated && self.sampling.allocation.as_ref().is_some_and(SampleAllocation::is_complete)
    }

    /// Whether the pixels have all samples of the last decision, and enough of them to estimate their noise.
    pub(super) fn is_decision_due(&self) -> bool {
        self.sampling.samples > 1 && self.sampling.allocation.as_ref().is_some_and(SampleAllocation::is_complete)
    }

    /// Whether a decision is due on which pixels get more samples, in adaptive sampling with a fixed budget.
    pub(super) fn is_allocation_due(&self) -> bool {
        self.settings.image.allocates_samples() && self.is_decision_due()
    }

    /// Decides which pixels get samples until the mean is twice as large as now, unless this is decided already.
    pub(super) fn allocate_samples(&mut self) -> Result<()> {
        if !self.is_allocation_due() {
            return Ok(());
        }
        let start = Instant::now();
        let errors = match self.sampling.errors.take().filter(|errors| errors.samples == self.sampling.samples) {
            Some(errors) => errors.of_pixels,
            None => self.raw_errors()?,
        };
        let mean = self.sampling.samples.saturating_mul(2);
        if let Some(allocation) = &mut self.sampling.allocation {
            allocation.allocate_samples(&errors, mean);
        }
        let seconds = start.elapsed().as_secs_f64();
        self.totals.time_render += seconds;
        self.sampling.seconds_to_decide = Some(seconds);
        Ok(())
    }

    /// The relMSE of the raw image by the error that its samples do not share, if noise decides which pixels get
    /// samples.
    pub(super) fn noise_of_samples(&mut self) -> Result<Option<f64>> {
        if !self.settings.image.allocates_samples() || self.sampling.samples < 2 {
            return Ok(None);
        }
        let of_pixels = self.raw_errors()?;
        // A single firefly counts as one wrong pixel.
        let mean = of_pixels.iter().map(|error| error.min(1.0)).sum::<f64>() / of_pixels.len() as f64;
        self.sampling.errors = Some(PixelErrors { samples: self.sampling.samples, of_pixels });
        Ok(Some(mean))
    }

    /// Samples of a pixel so far.
    pub(super) fn samples_of(&self, pixel: usize) -> u32 {
        let width = self.settings.image.crop_window().width;
        self.sampling
            .allocation
            .as_ref()
            .map_or(self.sampling.samples, |allocation| allocation.samples_of(pixel, width))
    }

    /// Mean number of samples of a pixel so far.
    pub fn mean_samples(&self) -> f64 {
        let sum: u64 = self.samples_of_all().map(u64::from).sum();
        sum as f64 / self.samples_of_all().len() as f64
    }

    /// Samples of each pixel so far.
    fn samples_of_all(&self) -> impl ExactSizeIterator<Item = u32> {
        (0..self.settings.image.crop_window().pixels() as usize).map(|pixel| self.samples_of(pixel))
    }
}

/// The colours of a pixel by all of its samples and by two halves, from the states of the planes of each
/// component of the light: its sum and the two snapshots. The first component has the coverage, which says how much of
/// a `background` they show.
fn colours_of(components: &[[Vec<u32>; 3]], background: Option<DVec3>, pixel: usize, samples: u32) -> [Colour; 3] {
    let half = first_half(samples);
    let mut colours = [[0.0; 3]; 3];
    for (component, [whole, even, odd]) in components.iter().enumerate() {
        let background = background.filter(|_| component == 0);
        let whole = Plane::sum_of(whole, pixel, samples);
        let first = Plane::sum_of(if half.ilog2().is_multiple_of(2) { even } else { odd }, pixel, half);
        // A pixel without finite samples in one half does not show its error: it counts as exact.
        let of_half = |half: Sum| if half.kept > 0.0 { half } else { whole };
        for (colour, sum) in colours.iter_mut().zip([whole, of_half(first), of_half(whole.without(&first))]) {
            let mean = sum.mean();
            let behind = background.map_or(DVec3::ZERO, |background| behind(background, &sum));
            *colour = [0, 1, 2].map(|c| colour[c] + (mean[c] + behind[c]) as f32);
        }
    }
    colours
}

/// The median of each pixel and those around it, by channel. Relative to its own brightness, a firefly would have no
/// large error.
fn medians(colours: &[Colour], width: usize) -> Vec<Colour> {
    let height = colours.len() / width;
    let near = |i: usize, end: usize| i.saturating_sub(1)..(i + 2).min(end);
    let pixel = |pixel: usize| {
        let rows = near(pixel / width, height);
        let mut values = [[f32::INFINITY; 3]; 9];
        let mut count = 0;
        for colour in rows.flat_map(|y| &colours[y * width..][near(pixel % width, width)]) {
            values[count] = *colour;
            count += 1;
        }
        // Beyond the edges of the image, as many infinities below as above; of an even number the upper one of two.
        values[count..].iter_mut().take(4 - count / 2).for_each(|missing| *missing = [f32::NEG_INFINITY; 3]);
        median_of_nine(values)
    };
    (0..colours.len()).into_par_iter().map(pixel).collect()
}

/// The median of nine, by channel (Paeth 1990).
fn median_of_nine(mut values: [Colour; 9]) -> Colour {
    const ORDERED: [(usize, usize); 19] = [
        (1, 2),
        (4, 5),
        (7, 8),
        (0, 1),
        (3, 4),
        (6, 7),
        (1, 2),
        (4, 5),
        (7, 8),
        (0, 3),
        (5, 8),
        (4, 7),
        (3, 6),
        (1, 4),
        (2, 5),
        (4, 7),
        (4, 2),
        (6, 4),
        (4, 2),
    ];
    for (lower, upper) in ORDERED {
        let (a, b) = (values[lower], values[upper]);
        values[lower] = [0, 1, 2].map(|c| a[c].min(b[c]));
        values[upper] = [0, 1, 2].map(|c| a[c].max(b[c]));
    }
    values[4]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A firefly does not count as typical, and neither do pixels beyond the image.
    #[test]
    fn medians_know_no_fireflies() {
        let mut colours = vec![[1.0, 2.0, 3.0]; 12];
        colours[5][1] = 1e6;
        colours[0][2] = 4.0;
        let expected = vec![[1.0, 2.0, 3.0]; 12];
        assert_eq!(medians(&colours, 4), expected);
        let row: Vec<Colour> = (1u8..5).map(|x| [f32::from(x); 3]).collect();
        // For an even count, the upper one of the two in the middle.
        assert_eq!(medians(&row, 4), [2.0, 2.0, 3.0, 4.0].map(|x| [x; 3]));
    }

    /// Nine values, zeros and ones in all ways, which is enough for a network of minima and maxima (Knuth's zero-one
    /// principle).
    #[test]
    fn the_median_of_nine_is_the_fifth() {
        for bits in 0..1u32 << 9 {
            let values = std::array::from_fn(|i| [(bits >> i & 1) as f32, 1.0 - (bits >> i & 1) as f32, 0.5]);
            let expected = f32::from(u8::from(bits.count_ones() >= 5));
            assert_eq!(median_of_nine(values), [expected, 1.0 - expected, 0.5], "{bits:b}");
        }
    }
}
