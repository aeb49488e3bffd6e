//! primary: camera rays to points and surfaces.

use crate::Result;
use crate::gpu::{Bindings, BoundKernel, Features, Frame, Gpu, Kernel, Resources};

use super::{Tile, TileBuffers, kernel};

/// The pass; see `shaders/primary.wgsl`.
pub struct Primary(Kernel);

impl Primary {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Primary> {
        let own = ["points", "surfaces", "radiance_direct", "counters"];
        Ok(Primary(kernel(gpu, "primary", features, constants, &own)?))
    }

    /// Binds it to a tile's buffers and the scene.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(&self, gpu: &Gpu, tile: &TileBuffers, scene: &dyn Bindings) -> Result<BoundPrimary> {
        let mut own = Resources::new()
            .with("points", &tile.points)
            .with("surfaces", &tile.surfaces)
            .with("radiance_direct", &tile.radiance_direct)
            .with("counters", &tile.counters);
        let optional = [
            ("albedo_samples", &tile.albedo_samples),
            ("normal_samples", &tile.normal_samples),
            ("position_samples", &tile.position_samples),
        ];
        for (name, buffer) in optional {
            if let Some(buffer) = buffer {
                own = own.with(name, buffer);
            }
        }
        Ok(BoundPrimary(self.0.bind(gpu, "primary", &[&own, scene])?))
    }
}

/// The pass, bound.
pub struct BoundPrimary(BoundKernel);

impl BoundPrimary {
    /// One camera ray for each point of the tile.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        frame.run(&self.0, tile.point_count, tile);
    }
}
