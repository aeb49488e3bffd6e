//! Maps that a render makes again as samples are added: the global map and the irradiance cache in stages, and a
//! caustic map for every 8 samples. So the first image comes soon, and no error of the maps is left in a long render.

use std::time::Instant;

use super::renderer::Renderer;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::light_transport::caustic_map::CausticMap;
use crate::light_transport::indirect_light::{IndirectLight, IndirectSetup};
use crate::light_transport::kernels::IndirectKernels;
use crate::light_transport::shared::Shared;
use crate::settings::Settings;

/// Samples per pixel from which on there are four times as many photons and gather rays; each time the samples increase
/// fourfold, so do they again. All samples share them, so more samples alone would not reduce their error.
const REFINED: u32 = 32;

/// 4 million photon rays, and [`Settings::MAX_GATHER_RAYS`] by default.
const LAST_STAGE: i32 = 3;

/// The stage of the first sample: an image that comes two to four times sooner (`scenes/crowd.glb`, 128 x 128 pixels: 0.12
/// s instead of 0.52) has at most a third more error. A second cheap stage gained nothing: with 64 rays until the eighth
/// sample the box had 1.8e-3 after 0.25 s, with 256 from the second on 1.2e-3 after 0.29 s.
const PREVIEW_STAGE: i32 = -2;

/// The stage of the samples that follow the first `samples`. Numbers that the user requested hold from the first one on,
/// and so do the photons of a map that is shown, where fewer would blur the image. A piece shows no preview.
pub(super) fn stage(settings: &Settings, samples: u32) -> i32 {
    let indirect = &settings.indirect;
    let requested = indirect.photons.is_some() || indirect.irradiance_cache.gather_rays.is_some();
    let shown_early = !requested && !settings.technique.shows_map() && settings.image.piece.is_none();
    if samples == 0 && shown_early {
        return PREVIEW_STAGE;
    }
    (samples / REFINED).checked_ilog2().map_or(0, |log| log as i32 / 2 + 1).min(LAST_STAGE)
}

/// The settings of a stage. Stage 0 has the settings of the render.
pub(super) fn settings_of_stage(settings: &Settings, stage: i32) -> Settings {
    let scaled = |number: u32, most: u32| {
        let scaled = f64::from(number) * 4f64.powi(stage);
        (scaled as u32).clamp(1, number.max(most))
    };
    settings.clone().with(|s| {
        s.indirect.photons = Some(scaled(settings.flux_photons(), Settings::MAX_PHOTONS));
        s.indirect.irradiance_cache.gather_rays = Some(scaled(settings.gather_rays(), Settings::MAX_GATHER_RAYS));
        // Other photons and directions; users may count up their seeds, so this one is far away.
        s.image.seed = settings.image.seed.wrapping_add((stage as u32).wrapping_mul(0x9e37_79b9));
    })
}

impl Renderer<'_> {
    /// Makes new and more photons and irradiance records, once there are enough samples. The next batch does this by
    /// itself; call it separately to measure its time.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn refine(&mut self) -> Result<()> {
        let start = Instant::now();
        self.refine_for(self.settings.image.range().first + self.samples)?;
        self.totals.time_render += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// As [`Renderer::refine`], for that number of samples.
    pub(super) fn refine_for(&mut self, samples: u32) -> Result<()> {
        let has_map = self.lighting.indirect.as_ref().is_some_and(IndirectLight::has_map);
        let stage = stage(&self.settings, samples);
        if !has_map || stage == self.stage {
            return Ok(());
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
        self.lighting.indirect = Some(IndirectLight::new(&setup, &mut self.totals)?);
        self.stage = stage;
        Ok(())
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
