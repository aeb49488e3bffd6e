//! Pass `film`: compensated sums of the samples of each pixel.

use glam::{DVec4, Vec4};
use kernel_kit::{BoundKernel, Buffer, Frame, Gpu, Kernel, bindings, shared_struct};

use super::{Tile, kernel};
use crate::Result;
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/film.wgsl`.
    pub struct FilmParameters {
        /// Number of pixels that get samples.
        pub pixel_count: u32,
        /// Number of samples of each pixel to sum.
        pub samples_per_pixel: u32,
        /// Index of the first of all among the samples.
        pub first_point: u32,
        /// For corrections, the number of samples of a pixel that change; 0 where the square of the change is already
        /// counted.
        pub earlier_samples: u32,
    }
}

bindings! {
    /// Everything that the kernel reads and writes.
    struct FilmBindings {
        pub samples: &Buffer,
        pub other_samples: &Buffer,
        pub sums: &Buffer,
        pub compensations: &Buffer,
        pub counters: &Buffer,
        pub sampled_pixels: Option<&Buffer>,
    }
}

/// Inputs of planes besides the samples.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// One word for each [`crate::statistics::Counter`].
    pub counters: &'a Buffer,
    /// The pixels that get samples, where some get more than others.
    pub sampled_pixels: Option<&'a Buffer>,
}

/// A change that is added to each sample that pixels have.
#[derive(Clone, Copy)]
pub struct Change<'a> {
    /// A vector for each of the pixels.
    pub change: &'a Buffer,
    /// The pixels that change.
    pub pixel_count: u32,
    /// Samples of each pixel so far.
    pub earlier_samples: u32,
    /// The other inputs of the pass.
    pub inputs: Inputs<'a>,
}

/// The pass; see `shaders/film.wgsl`.
pub struct Film(Kernel);

/// The sums of one quantity over the samples of a tile's pixels.
pub struct Plane {
    sums: Buffer,
    compensations: Buffer,
    bound: BoundKernel,
    pixels: u32,
}

/// The sum of a pixel's samples.
#[derive(Clone, Copy, Debug)]
pub struct Sum {
    /// The sum.
    pub total: DVec4,
    /// The number of samples in it: those that were finite.
    pub kept: f64,
}

impl Sum {
    /// The mean; 0 of no samples.
    pub fn mean(&self) -> DVec4 {
        if self.kept > 0.0 { self.total / self.kept } else { DVec4::ZERO }
    }

    /// The samples that are not in `part`.
    pub fn without(&self, part: &Sum) -> Sum {
        Sum { total: self.total - part.total, kept: self.kept - part.kept }
    }
}

/// The variance of the mean of `count` samples, from their mean and that of their squares; 0 for a single sample, whose
/// variance is unknown.
pub fn variance_of_mean(mean: DVec4, of_squares: DVec4, count: f64) -> DVec4 {
    if count > 1.0 { ((of_squares - mean * mean) / (count - 1.0)).max(DVec4::ZERO) } else { DVec4::ZERO }
}

impl Film {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features) -> Result<Film> {
        Ok(Film(kernel(gpu, "film", features, &[], &[FilmBindings::DECLARED])?))
    }

    /// An empty plane of `pixels` pixels that sums `samples`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`] and [`Kernel::bind`].
    pub fn plane(&self, gpu: &Gpu, pixels: u32, samples: &Buffer, inputs: Inputs<'_>) -> Result<Plane> {
        self.any_plane(gpu, pixels, "accumulate", [samples, samples], inputs)
    }

    /// An empty plane that sums the squares of the whole radiance, which is the sum of two components.
    ///
    /// # Errors
    /// As [`Film::plane`].
    pub fn plane_of_squares(
        &self,
        gpu: &Gpu,
        pixels: u32,
        components: [&Buffer; 2],
        inputs: Inputs<'_>,
    ) -> Result<Plane> {
        self.any_plane(gpu, pixels, "accumulate_squares", components, inputs)
    }

    /// An empty plane that takes over the sums of another one each time it is recorded.
    ///
    /// # Errors
    /// As [`Film::plane`].
    pub fn snapshot(&self, gpu: &Gpu, of: &Plane, inputs: Inputs<'_>) -> Result<Plane> {
        self.any_plane(gpu, of.pixels, "take_snapshot", [&of.sums, &of.compensations], inputs)
    }

    /// Changes samples that a plane has summed.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn correct(&self, gpu: &Gpu, frame: &mut Frame<'_>, plane: &Plane, change: &Change<'_>) -> Result<()> {
        self.run_correction(gpu, frame, plane, "correct", (change.change, change.earlier_samples), change)
    }

    /// Changes samples whose squares a plane has summed. Those samples are sums of components, whose own planes are
    /// `components`; these must not be corrected yet.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn correct_squares(
        &self,
        gpu: &Gpu,
        frame: &mut Frame<'_>,
        plane: &Plane,
        components: &[&Plane],
        change: &Change<'_>,
    ) -> Result<()> {
        for (i, component) in components.iter().enumerate() {
            // The square of the change itself counts once.
            let earlier_samples = if i == 0 { change.earlier_samples } else { 0 };
            self.run_correction(gpu, frame, plane, "correct_squares", (&component.sums, earlier_samples), change)?;
        }
        Ok(())
    }

    fn run_correction(
        &self,
        gpu: &Gpu,
        frame: &mut Frame<'_>,
        Plane { sums, compensations, .. }: &Plane,
        entry: &str,
        (other_samples, earlier_samples): (&Buffer, u32),
        Change { change: samples, pixel_count, inputs, .. }: &Change<'_>,
    ) -> Result<()> {
        let Inputs { counters, sampled_pixels } = *inputs;
        let own = FilmBindings { samples, other_samples, sums, compensations, counters, sampled_pixels };
        let (pixel_count, samples_per_pixel) = (*pixel_count, 1);
        let parameters = FilmParameters { pixel_count, samples_per_pixel, first_point: 0, earlier_samples };
        frame.run(&self.0.bind(gpu, entry, &[&own])?, pixel_count, &parameters);
        Ok(())
    }

    fn any_plane(
        &self,
        gpu: &Gpu,
        pixels: u32,
        entry: &str,
        [samples, other_samples]: [&Buffer; 2],
        Inputs { counters, sampled_pixels }: Inputs<'_>,
    ) -> Result<Plane> {
        let own_sums = gpu.buffer::<[f32; 4]>("penumbra/film/sums", pixels as usize)?;
        let own_compensations = gpu.buffer::<[f32; 4]>("penumbra/film/compensations", pixels as usize)?;
        let (sums, compensations) = (&own_sums, &own_compensations);
        let own = FilmBindings { samples, other_samples, sums, compensations, counters, sampled_pixels };
        let bound = self.0.bind(gpu, entry, &[&own])?;
        Ok(Plane { sums: own_sums, compensations: own_compensations, bound, pixels })
    }
}

impl Plane {
    /// Bytes of a pixel on the device.
    pub const PIXEL_BYTES: u64 = 2 * size_of::<[f32; 4]>() as u64;

    /// Adds the samples of the tile's points.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        self.record_from(frame, tile, 0);
    }

    /// Adds the samples of the tile's points; the first one has the index `first_point` among the samples.
    pub fn record_from(&self, frame: &mut Frame<'_>, tile: &Tile, first_point: u32) {
        let Tile { pixel_count, samples_per_pixel, .. } = *tile;
        let parameters = FilmParameters { pixel_count, samples_per_pixel, first_point, earlier_samples: 0 };
        frame.run(&self.bound, tile.pixel_count, &parameters);
    }

    /// The mean of each pixel's samples, without those that were not finite. `samples` returns how many samples of a
    /// pixel were recorded.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn means(&self, gpu: &Gpu, samples: &dyn Fn(usize) -> u32) -> Result<Vec<DVec4>> {
        Ok(Plane::sums_of(&self.state(gpu)?, samples).iter().map(Sum::mean).collect())
    }

    /// The sums of a state that [`Plane::state`] returned. `samples` returns how many samples of a pixel were recorded.
    pub fn sums_of(state: &[u32], samples: &dyn Fn(usize) -> u32) -> Vec<Sum> {
        (0..state.len() / 8).map(|pixel| Plane::sum_of(state, pixel, samples(pixel))).collect()
    }

    /// The sum of one pixel in a state that [`Plane::state`] returned, if `samples` samples of it were recorded.
    pub fn sum_of(state: &[u32], pixel: usize, samples: u32) -> Sum {
        let (sums, compensations) = state.split_at(state.len() / 2);
        let vectors = bytemuck::cast_slice::<u32, [f32; 4]>;
        let (sum, lost) = (vectors(sums)[pixel], vectors(compensations)[pixel]);
        Sum {
            // w of the compensations is the number of samples that were left out. w of the sums has no compensation: it
            // is a sum of zeros and ones, and exact, except for the depth. The mean of equal depths has a relative
            // error of up to 4e-5 at 4,096 samples, and of 8e-4 at 65,536 (the same sum, evaluated in f32).
            total: Vec4::from_array(sum).as_dvec4() + Vec4::from_array(lost).truncate().extend(0.0).as_dvec4(),
            kept: f64::from(samples) - f64::from(lost[3]),
        }
    }

    /// The state of the plane as words: sums, then compensations.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn state(&self, gpu: &Gpu) -> Result<Vec<u32>> {
        let mut words: Vec<u32> = gpu.read(&self.sums, self.state_words() / 2)?;
        words.extend(gpu.read::<u32>(&self.compensations, self.state_words() / 2)?);
        Ok(words)
    }

    /// Number of words of [`Plane::state`].
    pub fn state_words(&self) -> usize {
        (self.bytes() / 4) as usize
    }

    /// Restores a state that [`Plane::state`] returned.
    pub fn restore(&self, gpu: &Gpu, state: &[u32]) {
        let (sums, compensations) = state.split_at(self.state_words() / 2);
        gpu.write(&self.sums, sums);
        gpu.write(&self.compensations, compensations);
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        u64::from(self.pixels) * Self::PIXEL_BYTES
    }
}
