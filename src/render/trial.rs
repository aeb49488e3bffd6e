//! The trial of visibility photons: whether they are emitted, and whether they decide enough points to be kept.

use std::mem;
use std::time::Instant;

use kernel_kit::Gpu;

use super::checkpoint::Header;
use super::photon_benefit::{TRIAL_SAMPLES, decide_enough, is_on_trial, problem_of_photons, without_photons};
use super::renderer::Renderer;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::light_transport::direct_light::DirectLightKernels;
use crate::light_transport::first_pass::{FirstPass, MadeMaps};
use crate::light_transport::kernels::DirectKernels;
use crate::light_transport::shared::Shared;
use crate::light_transport::visibility_map::VisibilityMap;
use crate::specialisation::features::Feature;
use crate::statistics::Points;

impl Renderer<'_> {
    /// After the first sample, which traces all shadow rays, decides whether photons pay off in a render that is
    /// expected to end with `spp` samples per pixel, and emits them if so. If only time is lacking, the decision waits,
    /// as there may be more of it later.
    pub(super) fn begin_trial(&mut self, spp: u32) -> Result<()> {
        if self.sampling.samples == 0 || self.with_photons.is_none() {
            return Ok(());
        }
        let problem = |spp: u32| problem_of_photons(&self.totals, self.sampling.samples, spp);
        let problem_of_all = problem(self.settings.image.spp);
        if problem(spp).is_none() {
            return self.make_photons();
        }
        if problem_of_all.is_some() {
            self.with_photons = None;
        }
        let reason = problem_of_all.unwrap_or("few samples fit in the time");
        self.specialisation.explain(Feature::VisibilityMap, reason);
        Ok(())
    }

    /// A function that compiles the kernels of photons, if these may be emitted after the first sample, for a device
    /// that keeps kernels ([`keep_kernels`](Gpu::keep_kernels)). Called on another thread while the first sample is
    /// rendered, it saves later samples the wait. Its errors are those of [`kernel_kit::Kernel::new`].
    pub fn later_kernels(&self) -> Option<impl FnOnce(&Gpu) -> Result<()> + Send + use<>> {
        let features = self.with_photons.as_ref()?.features.clone();
        let (constants, settings) = (self.gpu_scene.constants(), self.settings.clone());
        Some(move |gpu: &Gpu| DirectKernels::new(gpu, &features, &constants, &settings).map(|_| ()))
    }

    /// Emits the visibility photons that are on trial. They classify points from the next sample on.
    fn make_photons(&mut self) -> Result<()> {
        let Some(specialisation) = self.with_photons.clone() else { return Ok(()) };
        let start = Instant::now();
        let (gpu, scene, gpu_scene, tile, settings) =
            (self.gpu, &self.scene, &self.gpu_scene, &self.view.buffers, &self.settings);
        let direct_kernels = DirectKernels::new(gpu, &specialisation.features, &gpu_scene.constants(), settings)?;
        gpu.compile_ahead(gpu_scene)?;
        self.totals.time_compile += start.elapsed().as_secs_f64();
        let start = Instant::now();
        let mut first_pass = FirstPass {
            shared: Shared { gpu, scene, gpu_scene, tile },
            direct_kernels,
            indirect_kernels: &self.view.indirect_kernels,
            primary: &self.view.primary,
            camera: &self.camera,
            camera_uniform: &CameraUniform::new(&self.camera, settings.image.width, settings.image.height),
            settings,
            indirect_settings: settings,
            points: self.view.tile_size.points,
            totals: &mut self.totals,
            made: MadeMaps::default(),
            lighting: mem::take(&mut self.view.lighting),
        };
        let bytes = first_pass.lighting.frame_bytes();
        // The old buffers are dropped first, so that the device need not hold both.
        first_pass.lighting.direct = None;
        let steps = [FirstPass::make_visibility_map, FirstPass::make_fine_cells, FirstPass::make_direct_light];
        let made = steps.into_iter().try_for_each(|step| step(&mut first_pass));
        self.view.lighting = first_pass.lighting;
        // After an error `with_photons` stays set, so the next batch tries again.
        made?;
        gpu.wait("photons")?;
        self.totals.frame_bytes += self.view.lighting.frame_bytes().saturating_sub(bytes);
        self.totals.time_render += start.elapsed().as_secs_f64();
        (self.specialisation, self.with_photons) = (specialisation, None);
        self.sampling.samples_without_photons = self.sampling.samples;
        // It is not known yet how many points photons leave to shadow rays.
        self.sampling.shade_at_once = false;
        Ok(())
    }

    /// Restores the trial of the render that wrote a checkpoint.
    pub(super) fn restore_trial(&mut self, from: &Header) -> Result<()> {
        if from.has_visibility_map {
            return self.make_photons();
        }
        if !from.may_have_photons && self.with_photons.take().is_some() {
            self.specialisation.explain(Feature::VisibilityMap, "photons did not pay off in the first samples");
        }
        Ok(())
    }

    /// Ends the trial after its last batch. Before that batch pixels had `samples` samples, and `counted` points were
    /// classified.
    pub(super) fn end_trial(&mut self, samples: u32, counted: &Points) -> Result<()> {
        // Where time was lacking after the first sample, photons came later. Their trial is as long.
        let without = self.sampling.samples_without_photons;
        let last = TRIAL_SAMPLES - 1 + without;
        let ends = samples < last && self.sampling.samples >= last;
        if !ends || !is_on_trial(&self.specialisation, &self.settings) {
            return Ok(());
        }
        let is_allocated = self.settings.image.allocates_samples();
        if decide_enough(counted, [without, samples], &self.totals.points(), is_allocated) {
            Ok(())
        } else {
            self.leave_out_photons()
        }
    }

    /// Traces all shadow rays from now on.
    fn leave_out_photons(&mut self) -> Result<()> {
        let start = Instant::now();
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.view.buffers);
        let reason = "its photons decided few points";
        self.specialisation = without_photons(&self.specialisation, scene, &self.camera, &self.settings, reason);
        let features = &self.specialisation.features;
        let kernels = DirectLightKernels::new(gpu, features, &gpu_scene.constants(), &self.settings)?;
        let lighting = &mut self.view.lighting;
        let (frame_bytes, map) = (lighting.frame_bytes(), &lighting.visibility_map);
        self.totals.photon_bytes -= map.as_ref().map_or(0, VisibilityMap::bytes).min(self.totals.photon_bytes);
        (lighting.direct, lighting.visibility_map, lighting.fine_cells) = (None, None, None);
        let shared = Shared { gpu, scene, gpu_scene, tile };
        lighting.make_direct_light(&shared, kernels, self.view.tile_size.points, &self.settings)?;
        self.totals.frame_bytes = (self.totals.frame_bytes + lighting.frame_bytes()).saturating_sub(frame_bytes);
        self.totals.time_compile += start.elapsed().as_secs_f64();
        Ok(())
    }
}
