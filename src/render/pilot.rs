//! The pilot: after the first sample of each pixel, the visibility map is left out if it does not pay.

use std::time::Instant;

use super::renderer::Renderer;
use crate::Result;
use crate::light_transport::kernels::DirectKernels;
use crate::light_transport::shared::Shared;

impl Renderer<'_> {
    /// Leaves the visibility map out if it did not pay for the first samples.
    pub(super) fn end_pilot(&mut self) -> Result<()> {
        match self.specialisation.of_pilot(&self.settings, self.mapped_boundary_share()) {
            Some(reason) => self.leave_map_out(&reason),
            None => Ok(()),
        }
    }

    /// Boundary and unknown points over all, for the lights that have photons. The environment has none: all its points
    /// are unknown.
    fn mapped_boundary_share(&self) -> f64 {
        let points = self.totals.points();
        let lights = self.scene.lights.len() as u64;
        let others = lights - self.scene.placed_lights().len() as u64;
        // Every light has the same number of points, including dark ones.
        let unmapped = others * (points.total + points.dark) / lights.max(1);
        let undecided = points.boundary + points.unknown - unmapped;
        undecided as f64 / (points.total - unmapped).max(1) as f64
    }

    /// Continues without the visibility map.
    pub(super) fn leave_map_out(&mut self, reason: &str) -> Result<()> {
        self.specialisation.leave_map_out(reason);
        self.notes.push(format!(
            "the visibility map is left out: {reason}; more `visibility_map.photons_per_light` may help"
        ));
        let start = Instant::now();
        let features = &self.specialisation.features;
        let mut kernels = DirectKernels::new(self.gpu, features, &self.gpu_scene.constants(), &self.settings)?;
        self.gpu.compile_ahead(&self.gpu_scene)?;
        self.totals.time_compile += start.elapsed().as_secs_f64();
        self.lighting.visibility_map = None;
        if let Some(kernels) = kernels.direct_light.take() {
            let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
            let shared = Shared { gpu, scene, gpu_scene, tile };
            self.lighting.make_direct_light(&shared, kernels, self.tile_size.points, &self.settings)?;
        }
        Ok(())
    }
}
