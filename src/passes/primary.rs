//! Pass `primary`: traces camera rays to the points and surfaces that are visible.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, Resources, bindings};

use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::Features;

bindings! {
    /// Everything that the kernel reads and writes in every specialisation, except the scene.
    struct PrimaryBindings {
        pub points: &Buffer,
        pub surfaces: &Buffer,
        pub radiance_direct: &Buffer,
        pub counters: &Buffer,
    }
}

/// The pass; see `shaders/primary.wgsl`.
pub struct Primary(Kernel);

impl Primary {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Primary> {
        Ok(Primary(kernel(gpu, "primary", features, constants, &[PrimaryBindings::DECLARED])?))
    }

    /// Binds it to a tile's buffers and the scene.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(&self, gpu: &Gpu, tile: &TileBuffers, scene: &dyn Bindings) -> Result<BoundPrimary> {
        let own = PrimaryBindings {
            points: &tile.points,
            surfaces: &tile.surfaces,
            radiance_direct: &tile.radiance_direct,
            counters: &tile.counters,
        };
        let mut aovs = Resources::new();
        let optional = [
            ("albedo_samples", &tile.albedo_samples),
            ("normal_samples", &tile.normal_samples),
            ("position_samples", &tile.position_samples),
        ];
        for (name, buffer) in optional {
            if let Some(buffer) = buffer {
                aovs = aovs.with(name, buffer);
            }
        }
        Ok(BoundPrimary(self.0.bind(gpu, "primary", &[&own, &aovs, scene])?))
    }
}

/// The pass, bound.
pub struct BoundPrimary(BoundKernel);

impl BoundPrimary {
    /// Traces one camera ray for each point of the tile.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        frame.run(&self.0, tile.point_count, tile);
    }
}
