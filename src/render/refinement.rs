//! What is made anew as samples go on: the global map and the irradiance cache, in stages, and the caustic map of each
//! few samples.

use std::time::Instant;

use super::renderer::Renderer;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::light_transport::caustic_map::CausticMap;
use crate::light_transport::indirect_light::{IndirectLight, IndirectSetup};
use crate::light_transport::kernels::IndirectKernels;
use crate::light_transport::shared::Shared;
use crate::settings::Settings;

/// Samples a pixel from which on there are more photons and gather rays than at first: four times, and four times again
/// for each four times the samples. All points share these, so no number of samples would take their error away.
const REFINED: u32 = 32;

/// Maximum number of such steps: a million photon rays by default, and some thousand rays a record.
const MAX_STAGES: u32 = 2;

/// How often photons and gather rays have been multiplied once there are so many samples.
fn stage(samples: u32) -> u32 {
    ((samples / REFINED).checked_ilog2().map_or(0, |log| log / 2 + 1)).min(MAX_STAGES)
}

/// The settings of a stage. Those of stage 0 are the render's own.
fn refined(settings: &Settings, stage: u32) -> Settings {
    let more = |number: u32, most: u32| number.saturating_mul(1 << (2 * stage)).min(number.max(most));
    settings.clone().with(|s| {
        s.indirect.photons = more(settings.indirect.photons, Settings::MAX_PHOTONS);
        s.indirect.irradiance_cache.gather_rays =
            more(settings.indirect.irradiance_cache.gather_rays, Settings::MAX_GATHER_RAYS);
        // Other photons and other directions, far from the seeds that users count up.
        s.image.seed = settings.image.seed.wrapping_add(stage.wrapping_mul(0x9e37_79b9));
    })
}

impl Renderer<'_> {
    /// Makes photons and irradiance records anew, and more of them, once there are enough samples. The next batch does
    /// so too; call it apart to measure the time that either takes.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn refine(&mut self) -> Result<()> {
        let start = Instant::now();
        self.refine_for(self.samples)?;
        self.totals.time_render += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// As [`Renderer::refine`], as if there were that many samples.
    pub(super) fn refine_for(&mut self, samples: u32) -> Result<()> {
        let has_map = self.lighting.indirect.as_ref().is_some_and(IndirectLight::has_map);
        let stage = stage(samples);
        if !has_map || stage == self.stage {
            return Ok(());
        }
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
        let setup = IndirectSetup {
            shared: Shared { gpu, scene, gpu_scene, tile },
            kernels: &self.indirect_kernels,
            primary: &self.primary,
            camera: &CameraUniform::new(&self.camera, self.settings.image.width, self.settings.image.height),
            settings: &refined(&self.settings, stage),
        };
        self.lighting.indirect = Some(IndirectLight::new(&setup, &mut self.totals)?);
        self.stage = stage;
        Ok(())
    }

    /// Makes the caustic map of the next samples, unless they share that of the last.
    pub(super) fn trace_caustics(&mut self) -> Result<()> {
        let number = CausticMap::number_at(self.samples);
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
