//! Pass `path`: a path tracer with next-event estimation, multiple importance sampling and Russian roulette. It renders
//! the reference, and traces indirect light for the other techniques.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, bindings, shared_struct};

use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/path.wgsl`.
    pub struct PathParameters {
        /// The tile.
        pub tile: Tile,
        /// Maximum number of bounces of indirect light; 0 gives direct light alone.
        pub max_bounces: u32,
        /// Light points per light in pass `shade`, where that pass runs.
        pub light_samples: u32,
    }
}

bindings! {
    /// Everything that the kernel reads and writes except the scene, the global map and the queue of the irradiance
    /// cache.
    struct PathBindings {
        pub points: &Buffer,
        pub surfaces: &Buffer,
        pub radiance_direct: &Buffer,
        pub radiance_indirect: &Buffer,
        pub counters: &Buffer,
    }
}

/// The pass; see `shaders/path.wgsl`.
pub struct Path(Kernel);

impl Path {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Path> {
        Ok(Path(kernel(gpu, "path", features, constants, &[PathBindings::DECLARED])?))
    }

    /// Binds it to a tile's buffers, which must have one for indirect light, to the scene, and to the global map where
    /// the kernel reads it.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(&self, gpu: &Gpu, tile: &TileBuffers, scene: &[&dyn Bindings]) -> Result<BoundPath> {
        let own = PathBindings {
            points: &tile.points,
            surfaces: &tile.surfaces,
            radiance_direct: &tile.radiance_direct,
            radiance_indirect: tile.required_indirect("path")?,
            counters: &tile.counters,
        };
        let mut sets: Vec<&dyn Bindings> = vec![&own];
        sets.extend(scene);
        Ok(BoundPath(self.0.bind(gpu, "path", &sets)?))
    }
}

/// The pass, bound.
pub struct BoundPath(BoundKernel);

impl BoundPath {
    /// Traces one path from each point that `primary` stored in the tile's buffers.
    pub fn record(&self, frame: &mut Frame<'_>, parameters: &PathParameters) {
        frame.run(&self.0, parameters.tile.point_count, parameters);
    }

    /// Traces one path from each point of a queue, dispatched by the indirect `arguments`.
    pub fn record_queued(&self, frame: &mut Frame<'_>, arguments: &Buffer, parameters: &PathParameters) {
        frame.run_indirect(&self.0, arguments, 0, parameters);
    }
}
