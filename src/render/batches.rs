//! Adding samples, batch by batch.

use std::time::Instant;

use super::renderer::Renderer;
use crate::Result;
use crate::light_transport::second_pass::SecondPass;
use crate::light_transport::shared::Shared;
use crate::settings::{Denoise, Settings};
use crate::specialisation::features::Feature;
use crate::statistics::Counter;
use crate::techniques::implementation;

/// All terms of direct light are added at once to all points if more than this share of them has other terms than those
/// that classes tell; else these points are queued. Measured on the still life: 0.9 s for what classes tell, 2.2 s for
/// the rest at nearly all points, and 2.1 s for both at once.
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

impl Renderer<'_> {
    /// Renders one or more samples of every pixel, and no more than the settings request until these are complete.
    ///
    /// # Errors
    /// [`crate::Error::Computation`] if more than a thousandth of the rays exceeded the loop budget, and those of
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
        self.refine()?;
        let start = Instant::now();
        let layers = self.layers_of_batch(limit);
        if self.batches > 0 {
            self.repair_map()?;
        }
        self.trace_caustics()?;
        self.batches += 1;
        let sampled = self.totals.get(Counter::Sampled);
        for tile in 0..self.tiles.len() {
            self.render_tile(tile, layers)?;
        }
        self.samples += layers;
        self.take_snapshots()?;
        self.decide_on_shading(self.totals.get(Counter::Sampled) - sampled, layers);
        self.count_procedural_misses()?;
        self.totals.check()?;
        self.keep()?;
        self.totals.time_render += start.elapsed().as_secs_f64();
        let points = self.totals.points();
        Ok(Progress { samples: self.samples, rays: self.totals.rays().total, boundary_share: points.boundary_share })
    }

    /// Samples per pixel of the next batch.
    fn layers_of_batch(&self, limit: u32) -> u32 {
        let most = self.tile_size.layers.min(limit.max(1));
        let missing = self.settings.image.spp.saturating_sub(self.samples);
        let most = if missing > 0 { most.min(missing) } else { most };
        // Fine cells learn from each batch: the number of samples doubles, so that they learn early.
        let learning = self.specialisation.features.has(Feature::FineCells);
        let most = if learning { most.min(self.samples.max(1)) } else { most };
        // Denoisers compare halves that end at powers of two.
        let to_power = (self.samples + 1).next_power_of_two() - self.samples;
        if self.settings.image.denoise == Denoise::None { most } else { most.min(to_power) }
    }

    /// Keeps what denoisers need of the samples so far.
    fn take_snapshots(&self) -> Result<()> {
        if self.settings.image.denoise == Denoise::None || !self.samples.is_power_of_two() {
            return Ok(());
        }
        let mut frame = self.gpu.frame("film");
        self.tiles.iter().for_each(|tile| tile.take_snapshot(&mut frame, self.samples));
        Ok(frame.submit()?)
    }

    /// Decides how the next batch is shaded, by the number of points that pass `shade` sampled light for in this one of
    /// `layers` samples per pixel.
    fn decide_on_shading(&mut self, sampled: u64, layers: u32) {
        let chunks = self.lighting.direct.as_ref().map_or(0, |direct| direct.chunks().count());
        let Settings { image, .. } = &self.settings;
        let points = u64::from(image.width) * u64::from(image.height) * u64::from(layers) * chunks as u64;
        self.shade_at_once = sampled as f64 > AT_ONCE_SHARE * points as f64;
    }

    /// Classifies the fine cells by the shadow rays so far, and repairs the visibility map after the second batch, the
    /// fourth, the eighth, and so on: audits find most mistakes early, and sorting the map again takes a small part of
    /// a long render. There is no repair after one or two samples per pixel, which find few photons.
    fn repair_map(&mut self) -> Result<()> {
        let due = self.samples > 2 && self.batches.is_power_of_two();
        self.lighting.classify_fine_cells(self.gpu, self.samples)?;
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
        self.lighting.repair_map(&Shared { gpu, scene, gpu_scene, tile }, due, &mut self.totals)
    }

    /// Runs the technique's second pass for `layers` samples of each pixel of a tile.
    fn render_tile(&mut self, index: usize, layers: u32) -> Result<()> {
        let film = &self.tiles[index];
        let tile = film.tile(&self.settings, self.samples, layers);
        let mut frame = self.gpu.frame("sample");
        frame.clear(&self.buffers.counters);
        let mut second_pass = SecondPass {
            frame: &mut frame,
            tile: &tile,
            primary: &self.primary,
            lighting: &self.lighting,
            settings: &self.settings,
            planes: film.sample_planes().collect(),
            shade_at_once: self.shade_at_once,
            class_films: &film.classes,
        };
        (implementation(self.settings.technique).second_pass)(&mut second_pass);
        frame.submit()?;
        let counters: Vec<u32> = self.gpu.read(&self.buffers.counters, Counter::COUNT)?;
        self.totals.add(&counters, u64::from(tile.point_count));
        // Fine cells decide where the map does not.
        let features = &self.specialisation.features;
        if features.has(Feature::VisibilityMap) && !features.has(Feature::FineCells) {
            self.totals.add_mapped(&counters);
        }
        Ok(())
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
