//! Pass `primary`: traces camera rays, and stores the points and surfaces that they hit.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, KernelTable, bindings};

use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::Features;

bindings! {
    /// Everything that the kernel reads and writes except the scene.
    struct PrimaryBindings {
        pub points: &Buffer,
        pub surfaces: &Buffer,
        pub radiance_direct: &Buffer,
        pub counters: &Buffer,
        /// See [`TileBuffers::albedo_samples`].
        pub albedo_samples: Option<&Buffer>,
        /// See [`TileBuffers::normal_samples`].
        pub normal_samples: Option<&Buffer>,
        /// See [`TileBuffers::position_samples`].
        pub position_samples: Option<&Buffer>,
        /// See [`TileBuffers::guides`].
        pub guide_samples: Option<&Buffer>,
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
            points: &tile.points.buffer,
            surfaces: &tile.surfaces.buffer,
            radiance_direct: &tile.radiance_direct,
            counters: &tile.counters,
            albedo_samples: tile.albedo_samples.as_ref(),
            normal_samples: tile.normal_samples.as_ref(),
            position_samples: tile.position_samples.as_ref(),
            guide_samples: tile.guides.as_ref().map(|guides| &guides.all),
        };
        let kernel = self.0.bind(gpu, "primary", &[&own, scene, tile])?;
        Ok(BoundPrimary {
            kernel,
            points: tile.points.clone(),
            surfaces: tile.surfaces.clone(),
            surface_vectors: tile.surface_vectors,
        })
    }
}

/// The pass, bound.
pub struct BoundPrimary {
    kernel: BoundKernel,
    points: KernelTable,
    surfaces: KernelTable,
    /// Vectors of a point's surface.
    surface_vectors: u32,
}

impl BoundPrimary {
    /// Traces one camera ray for each point of the tile, and publishes points and surfaces.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        frame.run(&self.kernel, tile.point_count, tile);
        frame.publish(&self.points, tile.point_count);
        frame.publish(&self.surfaces, tile.point_count * self.surface_vectors);
    }
}
