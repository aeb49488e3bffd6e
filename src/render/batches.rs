//! The loop of a render: adds samples to all tiles, batch by batch. A batch has the same number of samples for each
//! pixel, except with adaptive sampling. Between batches the render learns from what the last one has counted.

use std::time::Instant;

use super::denoise::Denoiser;
use super::renderer::Renderer;
use super::sample_allocation::{EqualBlocks, SampleAllocation};
use super::tiles::TileFilm;
use crate::Result;
use crate::light_transport::audits::Precautions;
use crate::light_transport::second_pass::SecondPass;
use crate::light_transport::shared::{Shared, TILE_SAMPLES};
use crate::settings::SampleRange;
use crate::specialisation::features::Feature;
use crate::statistics::Counter;
use crate::techniques::implementation;

/// If more than this share of the points needs terms of direct light that no class decides (highlights, audits, light
/// points with shadow rays), all terms are added to all points at once; else these points are queued. In
/// `scenes/still_life.glb` the decided terms took 0.9 s, the others 2.2 s at nearly all points, and both at once 2.1 s.
const AT_ONCE_SHARE: f64 = 0.5;

/// The progress of a render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Samples per pixel so far.
    pub samples: u32,
    /// Rays of all types so far.
    pub rays: u64,
    /// Boundary and unknown points over all points so far.
    pub boundary_share: f64,
}

/// The samples of a batch.
struct NextSamples {
    first_sample: u32,
    /// Number of samples per pixel.
    count: u32,
    /// The share of the pixels that get samples.
    share: f64,
    /// The blocks that get samples, if not all pixels get as many.
    blocks: Vec<EqualBlocks>,
}

impl Renderer<'_> {
    /// Renders one or more samples of every pixel. The batch ends at the number of samples that the settings request,
    /// unless that is already reached; a piece then gets none. With
    /// [`ImageSettings::noise`](crate::settings::ImageSettings::noise) only pixels that need more samples get any,
    /// possibly none.
    ///
    /// # Errors
    /// [`crate::Error::Computation`] if more than a thousandth of the samples, of the gather rays or of the photons of
    /// indirect light exceeded the loop budget, and those of
    /// [`kernel_kit::Gpu::check`].
    pub fn render_batch(&mut self) -> Result<Progress> {
        self.render_up_to(u32::MAX)
    }

    /// As [`Renderer::render_batch`], with at most `limit` samples per pixel, but at least one: for callers with little
    /// time.
    ///
    /// # Errors
    /// As [`Renderer::render_batch`].
    pub fn render_up_to(&mut self, limit: u32) -> Result<Progress> {
        self.refine(&mut |_, _| true)?;
        self.add_samples(limit, self.settings.image.spp)
    }

    /// As [`Renderer::render_up_to`], but leaves indirect light as it is, for a render that is expected to end with
    /// `spp` samples per pixel.
    pub(super) fn add_samples(&mut self, limit: u32, spp: u32) -> Result<Progress> {
        // The file of a piece has the samples of its range, and no others.
        if self.piece_sums.is_some() && self.is_complete() {
            return Ok(self.progress());
        }
        self.begin_trial(spp)?;
        if self.sampling.allocation.is_some() && !self.wants_samples(&Denoiser::default())? {
            return Ok(self.progress());
        }
        self.allocate_samples()?;
        let begun = Instant::now();
        let NextSamples { first_sample, count, share, blocks } = self.next_samples(limit);
        if self.sampling.batches > 0 && self.piece_sums.is_none() {
            self.repair_map()?;
        }
        self.trace_caustics(first_sample)?;
        self.sampling.batches += 1;
        self.sampling.is_noise_estimated = false;
        if let Some(sums) = &mut self.piece_sums {
            sums.begin(SampleRange { first: first_sample, end: first_sample + count });
        }
        self.view.lighting.set_precautions(Precautions::after(&self.totals, &self.settings));
        let (samples, counted, sampled) =
            (self.sampling.samples, self.totals.points(), self.totals.get(Counter::Sampled));
        let decided = self.totals.decided_points();
        let mut points = 0;
        for tile in 0..self.view.tiles.len() {
            if self.sampling.allocation.is_none() {
                points += self.render_tile(tile, first_sample, count, None)?;
            }
            for equal in &blocks {
                points += self.render_tile(tile, equal.first_sample, equal.samples, Some(equal))?;
            }
        }
        if let Some(sums) = &mut self.piece_sums {
            sums.end();
        }
        self.sampling.samples = self.sampling.samples.max(first_sample + count - self.settings.image.range().first);
        if let Some(allocation) = &mut self.sampling.allocation {
            allocation.add(&blocks);
        }
        self.decide_on_shading(self.totals.get(Counter::Sampled) - sampled, points);
        self.totals.add_audits(&decided);
        self.count_procedural_misses()?;
        self.totals.check()?;
        self.totals.time_render += begun.elapsed().as_secs_f64();
        if samples == 0 {
            self.totals.time_first_sample = self.totals.time_render;
        }
        self.end_trial(samples, &counted)?;
        let start = Instant::now();
        self.back_up_if_due()?;
        self.totals.time_render += start.elapsed().as_secs_f64();
        self.sampling.seconds_per_sample = Some(begun.elapsed().as_secs_f64() / (f64::from(count) * share));
        Ok(self.progress())
    }

    /// The samples of the next batch, at most `limit` per pixel.
    fn next_samples(&self, limit: u32) -> NextSamples {
        let equal = self.blocks_of_batch();
        let first_sample = self.first_sample(equal.as_ref());
        let count = self.samples_of_batch(limit, first_sample, equal.as_ref());
        let share = self.share_of_pixels(equal.as_ref());
        let blocks = match (&self.sampling.allocation, equal) {
            (Some(_), Some(mut equal)) => {
                equal.samples = count;
                vec![equal]
            }
            (Some(allocation), None) => allocation.to_raise_mean(count, first_sample),
            (None, _) => Vec::new(),
        };
        NextSamples { first_sample, count, share, blocks }
    }

    /// The progress so far, with what a checkpoint had.
    pub fn progress(&self) -> Progress {
        let points = self.totals.points();
        Progress {
            samples: self.sampling.samples,
            rays: self.totals.rays().total,
            boundary_share: points.boundary_share,
        }
    }

    /// The blocks of the next batch, where blocks must reach a small error; `None` in adaptive sampling with a fixed
    /// budget.
    fn blocks_of_batch(&self) -> Option<EqualBlocks> {
        self.sampling
            .allocation
            .as_ref()
            .filter(|_| self.settings.image.noise.is_some())
            .and_then(SampleAllocation::next_equal)
    }

    /// The share of the pixels that are in the batch's blocks; without blocks all are.
    fn share_of_pixels(&self, blocks: Option<&EqualBlocks>) -> f64 {
        self.sampling.allocation.as_ref().zip(blocks).map_or(1.0, |(allocation, blocks)| allocation.share_of(blocks))
    }

    /// Expected seconds of one sample of each pixel of the next batch; `None` before the first batch.
    pub(super) fn seconds_of_sample(&self) -> Option<f64> {
        let share = || self.share_of_pixels(self.blocks_of_batch().as_ref());
        self.sampling.seconds_per_sample.map(|seconds| seconds * share())
    }

    /// The first sample of the next batch.
    fn first_sample(&self, blocks: Option<&EqualBlocks>) -> u32 {
        blocks.map_or(self.settings.image.range().first + self.sampling.samples, |blocks| blocks.first_sample)
    }

    /// Samples per pixel of the next batch, if no limit makes them fewer.
    pub(super) fn samples_of_next_batch(&self) -> u32 {
        let blocks = self.blocks_of_batch();
        self.samples_of_batch(u32::MAX, self.first_sample(blocks.as_ref()), blocks.as_ref())
    }

    /// Samples per pixel of the next batch, of pixels that have `samples`.
    fn samples_of_batch(&self, limit: u32, samples: u32, blocks: Option<&EqualBlocks>) -> u32 {
        let to_spp = self.settings.image.range().end.saturating_sub(samples);
        let missing = blocks.map_or(to_spp, |blocks| blocks.samples);
        let mut count = self.view.tile_size.samples.min(limit.max(1));
        if missing > 0 {
            count = count.min(missing);
        }
        // Fine cells learn from each batch: the number of samples doubles, so that they learn early. The first
        // sample is a preview, with few gather rays, and shows whether photons pay off.
        let features = &self.specialisation.features;
        let is_preview = self.view.stage < 0 && features.has(Feature::GlobalMap);
        if features.has(Feature::FineCells) || self.with_photons.is_some() || is_preview {
            count = count.min(samples.max(1));
        }
        // In a piece, new maps begin at fixed samples.
        if self.settings.image.piece.is_some() {
            count = count.min(TILE_SAMPLES - samples % TILE_SAMPLES);
        }
        // Errors are estimated from halves of the samples, which end at powers of two.
        if self.settings.estimates_error() {
            count = count.min(to_power_of_two(samples));
        }
        count
    }

    /// Decides how the next batch is shaded. In this one, pass `shade` sampled the light of `sampled` of `points`
    /// points, counted once for each chunk of lights.
    fn decide_on_shading(&mut self, sampled: u64, points: u64) {
        if self.piece_sums.is_some() {
            return;
        }
        let chunks = self.view.lighting.direct.as_ref().map_or(0, |direct| direct.chunks().count());
        self.sampling.shade_at_once = sampled as f64 > AT_ONCE_SHARE * (points * chunks as u64) as f64;
    }

    /// Classifies the fine cells by the shadow rays so far. Repairs the visibility map after 1, 2, 4, 8, ... batches,
    /// because audits find most mistakes early. Sorting the map again then takes a small part of a long render. There
    /// is no repair after one or two samples per pixel, whose audits find few mistakes.
    fn repair_map(&mut self) -> Result<()> {
        let due = self.sampling.samples > 2 && self.sampling.batches.is_power_of_two();
        self.view.lighting.classify_fine_cells(self.gpu, self.sampling.samples)?;
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.view.buffers);
        self.view.lighting.repair_map(&Shared { gpu, scene, gpu_scene, tile }, due, &mut self.totals)
    }

    /// Runs the technique's second pass for `count` samples of each pixel of a tile, or of those in `blocks`, as many
    /// at a time as fit. Returns the number of points.
    fn render_tile(
        &mut self,
        index: usize,
        first_sample: u32,
        count: u32,
        blocks: Option<&EqualBlocks>,
    ) -> Result<u64> {
        let film = &self.view.tiles[index];
        let (_, pixel_count) = self.list_pixels(film, blocks);
        let (mut points, mut sample) = (0, first_sample);
        while pixel_count > 0 && sample < first_sample + count {
            let fit = (self.view.tile_size.points / pixel_count).max(1).min(first_sample + count - sample);
            // The film takes snapshots at powers of two.
            let fit = if blocks.is_some() { fit.min(to_power_of_two(sample)) } else { fit };
            points += self.render_samples(index, pixel_count, sample, fit)?;
            sample += fit;
        }
        Ok(points)
    }

    /// As [`Renderer::render_tile`], for `count` samples of the listed pixels, which fit.
    fn render_samples(&mut self, index: usize, pixel_count: u32, first_sample: u32, count: u32) -> Result<u64> {
        let film = &self.view.tiles[index];
        let tile = film.tile(&self.settings, pixel_count, first_sample, count);
        let mut frame = self.gpu.frame("sample");
        frame.clear(&self.view.buffers.counters);
        let mut second_pass = SecondPass {
            frame: &mut frame,
            tile: &tile,
            primary: &self.view.primary,
            lighting: &self.view.lighting,
            settings: &self.settings,
            // The samples of a piece are summed on the host instead.
            planes: film.sample_planes().filter(|_| self.piece_sums.is_none()).collect(),
            shade_at_once: self.sampling.shade_at_once,
            class_films: &film.classes,
        };
        (implementation(self.settings.technique).second_pass)(&mut second_pass);
        film.take_snapshot(&mut frame, &tile, first_sample + count);
        frame.submit()?;
        if let Some(sums) = &mut self.piece_sums {
            let first_pixel = film.rows().start as usize * self.settings.image.crop_window().width as usize;
            let left_out = sums.add(self.gpu, &self.view.buffers, first_pixel, &tile)?;
            self.totals.count(Counter::NotFinite, left_out);
        }
        let counters: Vec<u32> = self.gpu.read(&self.view.buffers.counters, Counter::COUNT)?;
        self.totals.add(&counters, u64::from(tile.point_count));
        // Fine cells decide where the map does not.
        let features = &self.specialisation.features;
        if features.has(Feature::VisibilityMap) && !features.has(Feature::FineCells) {
            self.totals.add_mapped(&counters, self.scene.lights.len(), self.scene.environment().is_some());
        }
        Ok(u64::from(tile.point_count))
    }

    /// Lists the pixels of `blocks` in a tile for the kernels, if not all pixels get samples. Returns the list, and how
    /// many pixels get samples.
    pub(super) fn list_pixels(&self, film: &TileFilm, blocks: Option<&EqualBlocks>) -> (Option<Vec<u32>>, u32) {
        let width = self.settings.image.crop_window().width;
        let (Some(allocation), Some(blocks), Some(sampled)) =
            (&self.sampling.allocation, blocks, &self.view.buffers.sampled_pixels)
        else {
            return (None, film.rows().len() as u32 * width);
        };
        let pixels = blocks.pixels(allocation, film.rows(), width);
        sampled.set(self.gpu, &pixels, film.rows().len() * width as usize);
        let count = pixels.len() as u32;
        (Some(pixels), count)
    }

    /// Adds the kernels' counts for procedural objects since the last batch.
    fn count_procedural_misses(&mut self) -> Result<()> {
        if !self.specialisation.features.has(Feature::Procedurals) {
            return Ok(());
        }
        let misses = &self.gpu_scene.procedural_misses;
        let counters = [Counter::ProceduralOverruns, Counter::ProceduralInvalid];
        for (counter, more) in counters.into_iter().zip(self.gpu.read::<u32>(misses, 2)?) {
            self.totals.count(counter, more.into());
        }
        self.gpu.write(misses, &[0u32; 2]);
        Ok(())
    }
}

/// Samples that are missing to the next power of two.
fn to_power_of_two(samples: u32) -> u32 {
    (samples + 1).next_power_of_two() - samples
}
