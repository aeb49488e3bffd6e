//! What a render adds to indirect light as samples are added: in stages a new global map and more rays of the irradiance
//! records, and a caustic map for every 8 samples. So the first image comes soon, and no error of the maps is left in a
//! long render.

use std::time::Instant;

use super::renderer::Renderer;
use super::stages::{settings_of_stage, stage};
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::light_transport::caustic_map::CausticMap;
use crate::light_transport::indirect_light::{IndirectLight, IndirectSetup};
use crate::light_transport::kernels::IndirectKernels;
use crate::light_transport::shared::Shared;
use crate::passes::cache::BoundCache;
use crate::passes::film::Change;

impl Renderer<'_> {
    /// The stage for the next sample, if there is time for it.
    pub(super) fn due_stage(&self) -> i32 {
        self.stage_for(self.settings.image.range().first + self.samples)
    }

    /// That of the samples that follow the first `samples`.
    pub(super) fn stage_for(&self, samples: u32) -> i32 {
        let has_map = self.lighting.indirect.as_ref().is_some_and(IndirectLight::has_map);
        if has_map { stage(&self.settings, samples) } else { self.stage }
    }

    /// Goes on to a stage by way of those before it, unless it is reached already. The samples so far then have the
    /// indirect light of the stage too.
    pub(super) fn refine_to(&mut self, stage: i32) -> Result<()> {
        let start = Instant::now();
        let mut before = None;
        while self.stage < stage {
            let earlier = self.add_rays()?;
            before = before.or(earlier);
        }
        if let Some(before) = before.filter(|_| self.samples > 0 && self.piece_sums.is_none()) {
            self.correct_samples(&before)?;
        }
        self.totals.time_render += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Goes on to the next stage. Returns the irradiance cache of the last one.
    fn add_rays(&mut self) -> Result<Option<BoundCache>> {
        let Some(indirect) = &mut self.lighting.indirect else { return Ok(None) };
        if self.has_other_views && self.stage == stage(&self.settings, 0) {
            self.first_map = indirect.take_map();
        }
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
        // Records are for the whole view.
        tile.sampled_pixels.iter().for_each(|sampled| sampled.set_all(gpu));
        let earlier = settings_of_stage(&self.settings, self.stage).gather_rays();
        let setup = IndirectSetup {
            shared: Shared { gpu, scene, gpu_scene, tile },
            kernels: &self.indirect_kernels,
            primary: &self.primary,
            camera: &CameraUniform::new(&self.camera, self.settings.image.width, self.settings.image.height),
            settings: &settings_of_stage(&self.settings, self.stage + 1),
        };
        let before = indirect.add_rays(&setup, earlier, &mut self.totals)?;
        self.stage += 1;
        Ok(before)
    }

    /// Adds the difference of the irradiance records to those `before` to all samples so far. Within a pixel it hardly
    /// changes, and one sample of each tells it; if not, samples with fewer rays would be a part of the image for good.
    fn correct_samples(&mut self, before: &BoundCache) -> Result<()> {
        let (Some(indirect), Some(change)) = (&self.lighting.indirect, &self.buffers.radiance_indirect) else {
            return Ok(());
        };
        for film in &self.tiles {
            for batch in self.blocks.as_ref().map_or(vec![None], |blocks| blocks.by_samples().map(Some).collect()) {
                let samples = batch.as_ref().map_or(self.samples, |batch| batch.first_sample);
                let pixel_count = self.list_pixels(film, batch.as_ref());
                if pixel_count == 0 || samples == 0 {
                    continue;
                }
                let tile = film.tile(&self.settings, pixel_count, samples, 1);
                let mut frame = self.gpu.frame("correction");
                frame.clear(&self.buffers.counters);
                self.primary.record(&mut frame, &tile);
                indirect.change(&mut frame, before, &tile);
                let inputs = self.buffers.film_inputs();
                let change = Change { change, pixel_count, earlier_samples: samples, inputs };
                film.correct(self.gpu, &self.film, &mut frame, change)?;
                frame.submit()?;
                self.totals.gather_rays += u64::from(pixel_count);
            }
        }
        Ok(())
    }

    /// The stage of the first sample.
    pub(super) fn first_stage(&self) -> i32 {
        stage(&self.settings, 0)
    }

    /// Makes the caustic map of the samples from `first_sample` on, unless they share the last one.
    pub(super) fn trace_caustics(&mut self, first_sample: u32) -> Result<()> {
        let number = CausticMap::number_at(first_sample, &self.settings);
        let IndirectKernels { global_map: Some(map), caustics: Some(kernels), .. } = &self.indirect_kernels else {
            return Ok(());
        };
        if self.lighting.caustics.as_ref().is_none_or(|caustics| caustics.number() != number) {
            let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
            let shared = Shared { gpu, scene, gpu_scene, tile };
            let traced = CausticMap::new(&shared, kernels, map, &self.settings, number, &mut self.totals)?;
            self.lighting.caustics = Some(traced);
        }
        Ok(())
    }
}
