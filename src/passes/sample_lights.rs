//! Pass `choose`: the few of many lights that each point of a tile asks.

use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources};
use crate::{Result, shared_struct};

use super::grid::GridShape;
use super::zones::ZoneTable;
use super::{Tile, TileBuffers, kernel};

shared_struct! {
    /// Immediates of the pass; see `shaders/choose.wgsl`.
    pub struct SampleLightsParameters {
        tile: Tile,
        zones: GridShape,
    }
}

/// The light of a slot that has none: fewer were chosen than there is room for.
pub const NO_LIGHT: u32 = u32::MAX;

/// The pass; see `shaders/choose.wgsl`.
pub struct SampleLights {
    kernel: Kernel,
    /// Slots of a point.
    chosen: u32,
}

impl SampleLights {
    /// Compiles the kernel, for `chosen` slots a point, at least 1; where zones are `audited` the last of them is for lights that
    /// are not in the zone's list, and there must be 2.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        chosen: u32,
        audited: bool,
    ) -> Result<SampleLights> {
        let mut constants = constants.to_vec();
        constants.extend([("chosen", f64::from(chosen)), ("zones_audited", f64::from(u8::from(audited)))]);
        let kernel = kernel(gpu, "sample_lights", features, &constants, &["points", "sampled_lights"])?;
        Ok(SampleLights { kernel, chosen })
    }

    /// Slots of a point.
    pub fn slots(&self) -> u32 {
        self.chosen
    }

    /// Binds it. Of each slot `sampled_lights` takes the light and the bits of what it stands for.
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
        let own = Resources::new().with("points", &tile.points).with("sampled_lights", sampled_lights);
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
    /// Chooses the lights of all points of a tile.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        frame.run(&self.kernel, tile.point_count, &SampleLightsParameters { tile: *tile, zones: self.zones });
    }
}
