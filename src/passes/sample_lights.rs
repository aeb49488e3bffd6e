//! Pass `sample_lights`: samples, for each point of a tile, a few of many lights.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, bindings, shared_struct};

use super::zones::ZoneTable;
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::kernels::GridShape;
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/sample_lights.wgsl`.
    pub struct SampleLightsParameters {
        zones: GridShape,
        tile: Tile,
    }
}

bindings! {
    /// The candidates that the kernel writes.
    struct SampleLightsBindings {
        pub sampled_lights: &Buffer,
    }
}

bindings! {
    /// The sampled lights, as the passes after this one read them.
    pub struct SampledLightBindings {
        /// For each candidate, the light, and 1 over the probability with which it was sampled; `None` if points use
        /// all lights.
        pub sampled_lights: Option<&Buffer>,
    }
}

/// The pass; see `shaders/sample_lights.wgsl`.
pub struct SampleLights {
    kernel: Kernel,
    lights_per_point: u32,
}

impl SampleLights {
    /// Compiles the kernel for `lights_per_point` candidates per point, at least 1. Where zones are `audited`, the last
    /// candidate samples a light that is not in the zone's list, and at least 2 candidates are needed.
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

    /// Binds the pass. It writes to `sampled_lights` the light of each candidate and the bits of its weight, the
    /// inverse of the probability.
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
        let own = SampleLightsBindings { sampled_lights };
        let lists = zones.map(ZoneTable::bindings);
        let mut sets: Vec<&dyn Bindings> = vec![&own, tile, scene];
        sets.extend(lists.as_ref().map(|lists| lists as &dyn Bindings));
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
        frame.run(&self.kernel, tile.point_count, &SampleLightsParameters { zones: self.zones, tile: *tile });
    }
}
