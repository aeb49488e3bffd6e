//! Maps that a render makes again as samples are added: the global map and the irradiance cache in stages, and a
//! caustic map for every 8 samples. So the first image comes soon, and no error of the maps is left in a long render.

use std::time::Instant;

use super::renderer::Renderer;
use super::stages::{settings_of_stage, stage};
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::light_transport::caustic_map::CausticMap;
use crate::light_transport::indirect_light::{IndirectLight, IndirectSetup, MadeIndirect};
use crate::light_transport::kernels::IndirectKernels;
use crate::light_transport::shared::Shared;

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

    /// Makes the photons and irradiance records of a stage, unless they are in use.
    pub(super) fn refine_to(&mut self, stage: i32) -> Result<()> {
        if stage == self.stage {
            return Ok(());
        }
        let start = Instant::now();
        if self.has_other_views && self.stage == self.first_stage() {
            self.first_map = self.lighting.indirect.take().and_then(|indirect| indirect.into_made().map);
        }
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
        // Records are for the whole view.
        tile.sampled_pixels.iter().for_each(|sampled| sampled.set_all(gpu));
        let setup = IndirectSetup {
            shared: Shared { gpu, scene, gpu_scene, tile },
            kernels: &self.indirect_kernels,
            primary: &self.primary,
            camera: &CameraUniform::new(&self.camera, self.settings.image.width, self.settings.image.height),
            settings: &settings_of_stage(&self.settings, stage),
        };
        self.lighting.indirect = Some(IndirectLight::new(&setup, MadeIndirect::default(), &mut self.totals)?);
        self.stage = stage;
        self.totals.time_render += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// The stage of the first sample.
    pub(super) fn first_stage(&self) -> i32 {
        stage(&self.settings, self.settings.image.range().first)
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
