//! Adaptive sampling: further samples go to the blocks of pixels where they reduce the error of the image by most,
//! until the error of every block is as small as requested.
//!
//! The error of a block is the mean relMSE of its pixels, estimated from two halves of their samples: of the raw image,
//! or of the denoised one if that is what the user gets.

use std::time::Instant;

use rayon::prelude::*;

use super::blocks::Blocks;
use super::denoise::{Colour, Denoiser, RELMSE_FLOOR};
use super::renderer::Renderer;
use super::tiles::first_half;
use crate::Result;
use crate::settings::{Denoise, ImageSettings};
use crate::statistics::totals::Totals;

/// At least this part of the blocks whose error is too large get samples together: estimates and dispatches take their
/// time however few the blocks are.
const ROUND_SHARE: f64 = 0.125;

/// As [`ROUND_SHARE`], where each estimate runs denoisers, which take as long as several samples of all pixels.
const DENOISED_SHARE: f64 = 0.5;

impl Renderer<'_> {
    /// Whether the render needs more samples than it has. With [`ImageSettings::noise`] it decides where they go,
    /// if no batch is under way, by the estimated error of what `denoiser` makes of the image.
    ///
    /// # Errors
    /// As [`Renderer::denoised_image`].
    pub fn wants_samples(&mut self, denoiser: &Denoiser) -> Result<bool> {
        let Some(noise) = self.settings.image.noise else { return Ok(self.samples < self.settings.image.range().count()) };
        let is_due = |blocks: &Blocks| blocks.is_complete() && self.samples > 1;
        if self.blocks.as_ref().is_some_and(is_due) {
            let start = Instant::now();
            let errors = self.squared_errors(denoiser)?;
            self.totals.time_render += start.elapsed().as_secs_f64();
            let share = if denoiser.choice() == Denoise::None { ROUND_SHARE } else { DENOISED_SHARE };
            let unaudited = unaudited(&self.totals, self.settings.visibility_map.audit, self.mean_samples());
            let ImageSettings { width, spp, .. } = self.settings.image;
            if let Some(blocks) = &mut self.blocks {
                let errors = blocks.errors(&errors, width);
                blocks.choose(&errors, noise - unaudited, spp, share);
            }
        }
        Ok(self.blocks.as_ref().is_some_and(|blocks| !blocks.is_complete()))
    }

    /// The expected relMSE of the raw image: half the squared difference of two halves of its samples, and an upper
    /// bound on the error of wrong classes that the audits have not met yet. It does not include the error of photon
    /// maps of indirect light, which all samples share. `None` after a single sample, and without
    /// [`ImageSettings::noise`] or a denoiser.
    ///
    /// # Errors
    /// As [`Renderer::image`].
    pub fn estimated_relmse(&self) -> Result<Option<f64>> {
        if self.samples < 2 || !self.settings.estimates_error() {
            return Ok(None);
        }
        let errors = self.squared_errors(&Denoiser::default())?;
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        Ok(Some(mean + unaudited(&self.totals, self.settings.visibility_map.audit, self.mean_samples())))
    }

    /// The estimated relative squared error of each pixel of what `denoiser` makes of the image.
    fn squared_errors(&self, denoiser: &Denoiser) -> Result<Vec<f64>> {
        let noisy = self.noisy()?;
        let relative = |colour: &Colour, square: &dyn Fn(usize) -> f64| {
            (0..3).map(|c| square(c) / (f64::from(colour[c]).powi(2) + RELMSE_FLOOR)).sum::<f64>() / 3.0
        };
        if denoiser.choice() != Denoise::None
            && let Some(denoised) = denoiser.denoise(self.gpu, &noisy)?
            && let Some(error) = denoised.error
        {
            let pixel = |(colour, error): (_, &f32)| relative(colour, &|_| f64::from(*error).powi(2));
            return Ok(denoised.colour.iter().zip(&error).map(pixel).collect());
        }
        let colour = noisy.all.colour();
        let Some([a, b]) = noisy.halves.map(|halves| halves.map(|half| half.colour())) else {
            return Ok(vec![f64::INFINITY; colour.len()]);
        };
        let medians = medians(&colour, self.settings.image.part().width as usize);
        let pixel = |pixel: usize| {
            let samples = self.samples_of(pixel);
            let part = f64::from(first_half(samples)) / f64::from(samples);
            // The variance of a mean over the mean squared difference of the means of its parts.
            let share = part * (1.0 - part);
            // Where both halves are bright, as at the edge of a lamp, the pixel is.
            let typical = [0, 1, 2].map(|c| medians[pixel][c].max(a[pixel][c].min(b[pixel][c])));
            relative(&typical, &|c| share * (f64::from(a[pixel][c]) - f64::from(b[pixel][c])).powi(2))
        };
        Ok((0..colour.len()).map(pixel).collect())
    }

    /// Samples of a pixel so far.
    pub(super) fn samples_of(&self, pixel: usize) -> u32 {
        let width = self.settings.image.part().width;
        self.blocks.as_ref().map_or(self.samples, |blocks| blocks.samples_of(pixel, width))
    }

    /// Mean number of samples of a pixel so far.
    pub fn mean_samples(&self) -> f64 {
        let part = self.settings.image.part();
        let pixels = part.width as usize * part.height as usize;
        let sum: u64 = (0..pixels).map(|pixel| u64::from(self.samples_of(pixel))).sum();
        sum as f64 / pixels as f64
    }
}

/// The median of each pixel and those around it, by channel. Relative to its own brightness, a firefly would have no
/// large error.
fn medians(colours: &[Colour], width: usize) -> Vec<Colour> {
    let height = colours.len() / width;
    let near = |i: usize, end: usize| i.saturating_sub(1)..(i + 2).min(end);
    let pixel = |pixel: usize| {
        let rows = near(pixel / width, height);
        let around: Vec<Colour> =
            rows.flat_map(|y| colours[y * width..][near(pixel % width, width)].iter().copied()).collect();
        [0, 1, 2].map(|c| {
            let mut values: Vec<f32> = around.iter().map(|colour| colour[c]).collect();
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        })
    };
    (0..colours.len()).into_par_iter().map(pixel).collect()
}

/// Wrong classes that no audit has met yet do not show in the samples. A point's estimate is c + (V - c) / p with
/// probability p, so the mean of n samples has a variance of at most |V - c| / (p n), and the audits bound the mean of
/// |V - c|.
fn unaudited(totals: &Totals, audit: f32, samples: f64) -> f64 {
    let points = totals.points();
    let decided = points.lit + points.shadowed;
    if decided == 0 { 0.0 } else { totals.audits().miss_bias_interval[1] / (f64::from(audit) * samples) }
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
        // Of an even number the upper one.
        assert_eq!(medians(&row, 4), [2.0, 2.0, 3.0, 4.0].map(|x| [x; 3]));
    }
}
