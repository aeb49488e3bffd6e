//! path: a path tracer with next-event estimation, multiple importance sampling and Russian roulette: the reference, and
//! the indirect light of the other techniques.

use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources};
use crate::{Result, shared_struct};

use super::{Tile, TileBuffers, kernel};

shared_struct! {
    /// Immediates of the pass; see `shaders/path.wgsl`.
    pub struct PathParameters {
        /// The tile.
        pub tile: Tile,
        /// Most bounces of indirect light: 0 for direct light alone.
        pub max_bounces: u32,
        /// Light points that `shade` takes of each light, where it does.
        pub light_samples: u32,
    }
}

/// Invocations of a workgroup, as the kernel declares it: what a queue of points is dispatched by.
pub const GROUP: u32 = 64;

/// The pass; see `shaders/path.wgsl`.
pub struct Path(Kernel);

impl Path {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Path> {
        let own = ["points", "surfaces", "radiance_direct", "radiance_indirect", "counters"];
        Ok(Path(kernel(gpu, "path", features, constants, &own)?))
    }

    /// Binds it to a tile's buffers, which must have one for indirect light, the scene, and the global
    /// map where the kernel asks it.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(&self, gpu: &Gpu, tile: &TileBuffers, scene: &[&dyn Bindings]) -> Result<BoundPath> {
        let mut own = Resources::new()
            .with("points", &tile.points)
            .with("surfaces", &tile.surfaces)
            .with("radiance_direct", &tile.radiance_direct)
            .with("counters", &tile.counters);
        if let Some(indirect) = &tile.radiance_indirect {
            own = own.with("radiance_indirect", indirect);
        }
        let mut sets: Vec<&dyn Bindings> = vec![&own];
        sets.extend(scene);
        Ok(BoundPath(self.0.bind(gpu, "path", &sets)?))
    }
}

/// The pass, bound.
pub struct BoundPath(BoundKernel);

impl BoundPath {
    /// One path from each point that `primary` left in the tile's buffers.
    pub fn record(&self, frame: &mut Frame<'_>, parameters: &PathParameters) {
        frame.run(&self.0, parameters.tile.point_count, parameters);
    }

    /// One path from each point of a queue, whose dispatch has those arguments.
    pub fn record_queued(&self, frame: &mut Frame<'_>, arguments: &Buffer, parameters: &PathParameters) {
        frame.run_indirect(&self.0, arguments, 0, parameters);
    }
}
