//! The trial of visibility photons: whether they decide enough points to be asked further.

use std::time::Instant;

use super::renderer::Renderer;
use crate::Result;
use crate::light_transport::direct_light::DirectLightKernels;
use crate::light_transport::shared::Shared;
use crate::settings::Technique;
use crate::specialisation::Specialisation;
use crate::specialisation::features::Feature;
use crate::statistics::Points;

/// Samples per pixel after which photons must decide [`MIN_DECIDED`] of the points. The rays of one sample and of two
/// have classified the fine cells by then.
const TRIAL_SAMPLES: u32 = 4;

/// Share of points that photons must decide in the last samples of the trial, else all shadow rays are traced from then
/// on. It was 0.08 to 0.29 in models where 64 samples took 1.06 to 1.3 times as long as those of `two-pass`
/// (docs/decisions.md), and 0.46 to 1 in all other scenes that were measured, where they took 0.4 to 1.1 times as long.
const MIN_DECIDED: f64 = 0.35;

impl Renderer<'_> {
    /// Ends the trial after its last batch, before which pixels had `samples` and points had been `counted`. Photons
    /// stay if somebody asked for them.
    pub(super) fn end_trial(&mut self, samples: u32, counted: &Points) -> Result<()> {
        let is_on_trial = self.specialisation.features.has(Feature::FineCells)
            && self.settings.visibility_map.photons_per_light.is_none();
        if !is_on_trial || samples >= TRIAL_SAMPLES || self.samples < TRIAL_SAMPLES {
            return Ok(());
        }
        let Points { lit, shadowed, total, .. } = self.totals.points();
        let decided = (lit + shadowed - counted.lit - counted.shadowed) as f64;
        if decided < MIN_DECIDED * (total - counted.total) as f64 { self.leave_out_photons() } else { Ok(()) }
    }

    /// Traces all shadow rays from now on, with the kernels of `two-pass` for direct light.
    pub(super) fn leave_out_photons(&mut self) -> Result<()> {
        let start = Instant::now();
        let settings = self.settings.clone().with(|s| s.technique = Technique::TWO_PASS);
        let plain = Specialisation::new(&self.scene, Some(&self.camera), &settings);
        self.specialisation = plain.with_deferred_of(&self.specialisation);
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
        let features = &self.specialisation.features;
        let kernels = DirectLightKernels::new(gpu, features, &gpu_scene.constants(), &settings)?;
        let lighting = &mut self.lighting;
        (lighting.direct, lighting.visibility_map, lighting.fine_cells) = (None, None, None);
        let shared = Shared { gpu, scene, gpu_scene, tile };
        lighting.make_direct_light(&shared, kernels, self.tile_size.points, &settings)?;
        self.totals.time_compile += start.elapsed().as_secs_f64();
        self.has_left_out_photons = true;
        Ok(())
    }
}
