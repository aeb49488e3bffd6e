//! Pass `sample_lights`: the few of many lights that each point of a tile is lit by.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, bindings, shared_struct};

use super::grid::GridShape;
use super::zones::ZoneTable;
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/sample_lights.wgsl`.
    pub struct SampleLightsParameters {
        tile: Tile,
        zones: GridShape,
    }
}

bindings! {
    /// What the kernel reads, and the candidates that it writes.
    struct SampleLightsBindings {
        pub points: &Buffer,
        pub sampled_lights: &Buffer,
    }
}

/// The pass; see `shaders/sample_lights.wgsl`.
pub struct SampleLights {
    kernel: Kernel,
    lights_per_point: u32,
}

impl SampleLights {
    /// Compiles the kernel for `lights_per_point` candidates a point, at least 1. Where zones are `audited`, the last
    /// one is for lights that are not in the zone's list, and there must be 2.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        lights_per_point: u32,
        audited: bool,
    ) -> Result<SampleLights> {
        let own = [("lights_per_point", f64::from(lights_per_point)), ("zones_audited", f64::from(u8::from(audited)))];
        let constants = [constants, &own].concat();
        let kernel = kernel(gpu, "sample_lights", features, &constants, &[SampleLightsBindings::DECLARED])?;
        Ok(SampleLights { kernel, lights_per_point })
    }

    /// Candidates of a point.
    pub fn lights_per_point(&self) -> u32 {
        self.lights_per_point
    }

    /// Binds the pass. `sampled_lights` takes the light of each candidate and the bits of its weight, the inverse of
    /// the probability.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        sampled_lights: &Buffer,
        zones: Option<&ZoneTable>,
        scene: &dyn Bindings,
    ) -> Result<BoundSampleLights> {
        let own = SampleLightsBindings { points: &tile.points, sampled_lights };
        let mut sets: Vec<&dyn Bindings> = vec![&own, scene];
        sets.extend(zones.map(|zones| zones as &dyn Bindings));
        let kernel = self.kernel.bind(gpu, "sample_lights", &sets)?;
        Ok(BoundSampleLights { kernel, zones: zones.map(|zones| zones.shape).unwrap_or_default() })
    }
}

/// The pass, bound.
pub struct BoundSampleLights {
    kernel: BoundKernel,
    zones: GridShape,
}

impl BoundSampleLights {
    /// Samples the lights of all points of a tile.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        frame.run(&self.kernel, tile.point_count, &SampleLightsParameters { tile: *tile, zones: self.zones });
    }
}
