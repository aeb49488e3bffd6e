//! The statistical denoiser: no learned weights, only estimates of the noise from the samples.

use kernel_kit::Gpu;
use rayon::prelude::*;

use super::stratification::{ratios, reduced};
use super::{Colour, Component, Filter, Filtered, Guides, Light, Noisy, on_all_cores};
use crate::passes::denoise::{Denoise, DenoiseParameters, PIXEL_VECTORS, REACH};
use crate::specialisation::device_features;
use crate::specialisation::features::Features;
use crate::{Error, Result};

/// Maximum number of pixels that the device filters at a time: 112 MiB of input, which fit the smallest storage binding
/// of Vulkan devices (128 MiB).
const BAND_PIXELS: u32 = 1 << 20;

/// Seconds of a processor core for a pixel and run: 2.8 s for the three runs of 512 x 512 pixels, the host's part
/// included; docs/experiments.md, "What the filter does", has the device's part.
const SECONDS_PER_PIXEL: f64 = 3.6e-6;

/// Pixels whose logarithms a thread adds: enough to be worth handing out.
const TYPICAL_CHUNK: usize = 1 << 14;

/// The statistical denoiser as one of several.
pub(super) struct Statistical;

impl Filter for Statistical {
    fn name(&self) -> &'static str {
        "statistical"
    }

    fn compilation(&self) -> fn(&Gpu) -> Result<()> {
        |gpu| StatisticalDenoiser::new(gpu).map(|_| ())
    }

    fn filter(&self, gpu: &Gpu, noisy: &Noisy) -> Result<Filtered> {
        StatisticalDenoiser::new(gpu)?.filter_noisy(noisy)
    }

    fn seconds_per_pixel(&self, gpu: &Gpu, runs: u32) -> f64 {
        // A GPU takes a small part of a sample's time.
        if gpu.is_software() { on_all_cores(f64::from(runs) * SECONDS_PER_PIXEL) } else { 0.0 }
    }
}

/// The denoiser, ready for images of any size.
pub struct StatisticalDenoiser<'g> {
    gpu: &'g Gpu,
    pass: Denoise,
}

impl<'g> StatisticalDenoiser<'g> {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// As [`kernel_kit::Kernel::new`].
    pub fn new(gpu: &'g Gpu) -> Result<StatisticalDenoiser<'g>> {
        Ok(StatisticalDenoiser { gpu, pass: Denoise::new(gpu, &device_features(gpu, Features::default()))? })
    }

    /// Filters the light of all samples, and that of the halves, from whose difference the variances are estimated.
    ///
    /// # Errors
    /// As [`StatisticalDenoiser::filter`].
    pub fn filter_noisy(&self, noisy: &Noisy) -> Result<Filtered> {
        let filter = |light: &Light, samples| self.filter(noisy.size, samples, light, &noisy.guides);
        let (all, samples) = (&noisy.all, noisy.half_samples.iter().sum());
        let Some(halves) = &noisy.halves else { return Ok(Filtered { all: filter(all, samples)?, halves: None }) };
        let of_component = |(index, whole): (usize, &Component)| {
            let means = halves.each_ref().map(|half| half.components[index].mean.as_slice());
            ratios(noisy.size, &whole.variance, means, noisy.half_samples)
        };
        let ratios: Vec<Vec<f32>> = all.components.iter().enumerate().map(of_component).collect();
        let half = |half: usize| filter(&reduced(&halves[half], &ratios, true), noisy.half_samples[half]);
        let all = filter(&reduced(all, &ratios, false), samples)?;
        Ok(Filtered { all, halves: Some([half(0)?, half(1)?]) })
    }

    /// Filters direct and indirect light, each of `samples` samples a pixel, and adds them. A pixel whose light is not
    /// finite, or more than 1e10 times the typical light, keeps its own.
    ///
    /// # Errors
    /// [`Error::Computation`] if an array does not have `width` times `height` pixels, and those of
    /// [`Denoise::filter`].
    pub fn filter(
        &self,
        [width, height]: [u32; 2],
        samples: u32,
        light: &Light,
        guides: &Guides,
    ) -> Result<Vec<Colour>> {
        let count = width as usize * height as usize;
        let none = Component { mean: vec![[0.0; 3]; count], variance: vec![[0.0; 3]; count] };
        let [direct, indirect] = [0, 1].map(|index| light.components.get(index).unwrap_or(&none));
        let Guides { albedo, normal, position } = guides;
        let arrays = [&direct.mean, &direct.variance, &indirect.mean, &indirect.variance, albedo, normal, position];
        if let Some(wrong) = arrays.iter().find(|array| array.len() != count) {
            let problem = format!("an array of {} pixels for an image of {width} x {height}", wrong.len());
            return Err(Error::Computation { kernel: "denoise".to_owned(), problem });
        }
        let raw = |i: usize| [0, 1, 2].map(|c| direct.mean[i][c] + indirect.mean[i][c]);
        if count == 0 || samples == 0 {
            return Ok((0..count).map(raw).collect());
        }
        let scale = 1.0 / typical(&(0..count).into_par_iter().map(raw).collect::<Vec<_>>());
        let factors = [scale, scale * scale, scale, scale * scale, 1.0, 1.0, 1.0];
        let mut filtered = Vec::with_capacity(count);
        let mut first = 0;
        while first < height {
            let band = Band::new(width, height, first);
            let pixels = (band.from * width) as usize..(band.to * width) as usize;
            let vector = |i: usize| -> [[f32; 4]; PIXEL_VECTORS] {
                std::array::from_fn(|k| {
                    let [x, y, z] = arrays[k][i].map(|value| value * factors[k]);
                    [x, y, z, 0.0]
                })
            };
            let vectors: Vec<[[f32; 4]; PIXEL_VECTORS]> = pixels.into_par_iter().map(vector).collect();
            let image = DenoiseParameters { width, height: band.to - band.from, samples };
            let result = self.pass.filter(self.gpu, &image, vectors.as_flattened())?;
            let own = ((first - band.from) * width) as usize..((band.end - band.from) * width) as usize;
            let start = filtered.len();
            let pixel = |(i, [r, g, b, is_filtered]): (usize, &[f32; 4])| {
                if *is_filtered > 0.5 { [r, g, b].map(|value| value / scale) } else { raw(start + i) }
            };
            filtered.par_extend(result[own].par_iter().enumerate().map(pixel));
            first = band.end;
        }
        Ok(filtered)
    }
}

/// Rows that the device filters together.
#[derive(Debug, PartialEq, Eq)]
struct Band {
    /// End of the rows whose result is used.
    end: u32,
    /// The rows that the device gets, which include those that the result depends on.
    from: u32,
    to: u32,
}

impl Band {
    /// The band whose result begins at row `first`.
    fn new(width: u32, height: u32, first: u32) -> Band {
        let from = first.saturating_sub(REACH);
        let to = height.min(from + (BAND_PIXELS / width).max(3 * REACH));
        let end = if to == height { height } else { to - REACH };
        Band { end, from, to }
    }
}

/// The geometric mean of the positive values, rounded to a power of two, by which images in any unit are scaled to
/// about 1; 1 if there are no positive values.
pub(super) fn typical(colours: &[Colour]) -> f32 {
    let of_chunk = |colours: &[Colour]| {
        let positive = colours.iter().flatten().filter(|value| value.is_normal() && **value > 0.0);
        positive.fold((0.0, 0u32), |(sum, count), value| (sum + f64::from(value.log2()), count + 1))
    };
    // The sums of the chunks are added in order, so that the result does not depend on the threads.
    let chunks: Vec<(f64, u32)> = colours.par_chunks(TYPICAL_CHUNK).map(of_chunk).collect();
    let (sum, count) = chunks.iter().fold((0.0, 0), |(sum, count), chunk| (sum + chunk.0, count + chunk.1));
    // The squares of the factor and of its inverse stay finite.
    if count == 0 { 1.0 } else { (sum / f64::from(count)).clamp(-60.0, 60.0).round().exp2() as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bands cover all rows once, and have every row that their results depend on.
    #[test]
    fn bands_have_what_they_need() {
        for (width, height) in [(1, 1), (512, 512), (4096, 2160), (16_384, 300), (1 << 20, 100)] {
            let mut first = 0;
            while first < height {
                let band = Band::new(width, height, first);
                assert!(band.end > first, "{width} x {height}: no progress at {first}");
                assert!(band.from == 0 || band.from + REACH <= first, "{width} x {height}: {band:?}");
                assert!(band.to == height || band.end + REACH <= band.to, "{width} x {height}: {band:?}");
                first = band.end;
            }
            assert_eq!(first, height);
        }
    }

    /// The unit of light is a power of two near its geometric mean, and blind to black, negative and invalid values.
    #[test]
    fn typical_light_is_a_power_of_two() {
        assert_eq!(typical(&[]), 1.0);
        assert_eq!(typical(&[[0.0, -1.0, f32::NAN]]), 1.0);
        assert_eq!(typical(&[[1e-3, 1e-3, f32::INFINITY]]), 2f32.powi(-10));
        assert_eq!(typical(&[[f32::MAX; 3]]), 2f32.powi(60));
    }
}
