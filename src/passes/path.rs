//! Pass `path`: a path tracer with next-event estimation, multiple importance sampling and Russian roulette. It renders
//! the reference, and traces indirect light for the other techniques.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, bindings, shared_struct};

use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::{Feature, Features};

shared_struct! {
    /// Immediates of the pass; see `shaders/path.wgsl`.
    pub struct PathParameters {
        /// The tile.
        pub tile: Tile,
        /// Maximum number of bounces of indirect light; 0 gives direct light alone.
        pub max_bounces: u32,
        /// Light points per light in pass `shade`, where that pass runs.
        pub light_samples: u32,
        /// Upper limit of each component of the indirect light of a path.
        pub max_indirect: f32,
        /// 1 where the points are hits of gather rays, 0 where they are points of the tile.
        pub from_hits: u32,
        /// Paths of each point, whose mean is its light.
        pub paths_per_point: u32,
        /// Number of this path of each point, from 0.
        pub path_number: u32,
    }
}

bindings! {
    /// Everything that the kernel reads and writes except the scene, the global map and the queue of the irradiance
    /// cache.
    struct PathBindings {
        pub radiance_direct: &Buffer,
        pub radiance_indirect: &Buffer,
        pub counters: &Buffer,
    }
}

shared_struct! {
    /// A hit of a gather ray from which pass `path` continues; see `shaders/lib/gather_hit.wgsl`.
    pub struct GatherHit {
        transmittance: [f32; 3],
        spread: f32,
        widest: f32,
        view: u32,
        seed: u32,
        number: u32,
    }
}

bindings! {
    /// A [`PathQueue`], as the kernel reads it.
    pub struct PathQueueBindings {
        /// Number of queued points.
        pub path_count: &Buffer,
        /// Their indices.
        pub path_points: &Buffer,
    }
}

bindings! {
    /// Hits of gather rays as the kernel reads them, apart from their points and surfaces.
    pub struct HitBindings {
        /// [`GatherHit`]s, by index of the ray.
        pub gather_hits: &Buffer,
    }
}

bindings! {
    /// The arguments of a dispatch over the points that the pass queues itself.
    struct ArgumentBindings {
        pub path_arguments: &Buffer,
    }
}

/// A queue of points from which paths continue.
#[derive(Clone)]
pub struct PathQueue {
    /// Number of queued points.
    pub count: Buffer,
    /// Their indices.
    pub points: Buffer,
    /// Arguments of a dispatch over them.
    pub arguments: Buffer,
}

impl PathQueue {
    /// A queue with room for `points` points, which the pass `pass` fills.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, pass: &str, points: u32) -> Result<PathQueue> {
        let words = |name: &str, count: u32| gpu.buffer::<u32>(&format!("penumbra/{pass}/{name}"), count as usize);
        Ok(PathQueue {
            count: words("path_count", 1)?,
            points: words("path_points", points)?,
            arguments: words("path_arguments", 3)?,
        })
    }

    /// The queue, as the kernel reads it.
    pub fn bindings(&self) -> PathQueueBindings<'_> {
        PathQueueBindings { path_count: &self.count, path_points: &self.points }
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
        let mut own = vec![PathBindings::DECLARED];
        own.extend(features.has(Feature::Highlights).then_some(ArgumentBindings::DECLARED));
        own.extend(features.has(Feature::IrradianceCache).then_some(HitBindings::DECLARED));
        Ok(Path(kernel(gpu, "path", features, constants, &own)?))
    }

    /// Binds it to a tile's buffers, which must have one for indirect light, to the scene, and to the global map where
    /// the kernel reads it.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(&self, gpu: &Gpu, tile: &TileBuffers, scene: &[&dyn Bindings]) -> Result<BoundPath> {
        let own = PathBindings::of(tile)?;
        let mut sets: Vec<&dyn Bindings> = vec![&own, tile];
        sets.extend(scene);
        Ok(BoundPath(self.0.bind(gpu, "path", &sets)?))
    }

    /// Binds it to hits of gather rays: `gathered` has the radiance and the distance of each ray, and the paths add
    /// what they find. `hits` has the queue of the rays that paths continue, their points, surfaces and
    /// [`GatherHit`]s.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind_at_hits(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        gathered: &Buffer,
        hits: &dyn Bindings,
        scene: &[&dyn Bindings],
    ) -> Result<BoundPath> {
        let TileBuffers { radiance_direct, counters, .. } = tile;
        let own = PathBindings { radiance_direct, radiance_indirect: gathered, counters };
        let mut sets: Vec<&dyn Bindings> = vec![&own, hits, tile];
        sets.extend(scene);
        let mut bound = self.0.bind(gpu, "path", &sets)?;
        bound.label = "gather/path".to_owned();
        Ok(BoundPath(bound))
    }

    /// As [`Path::bind`], with [`Feature::Highlights`]: `queue` gets the points with rays that may hit a light.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind_highlights(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        queue: &PathQueue,
        scene: &dyn Bindings,
    ) -> Result<BoundHighlights> {
        let own = PathBindings::of(tile)?;
        let queued = queue.bindings();
        let arguments = ArgumentBindings { path_arguments: &queue.arguments };
        let bind = |entry| self.0.bind(gpu, entry, &[&own, tile, &queued, &arguments, scene]);
        Ok(BoundHighlights {
            queue_highlights: bind("queue_highlights")?,
            arrange_highlights: bind("arrange_highlights")?,
            path: BoundPath(bind("path")?),
        })
    }
}

impl PathBindings<'_> {
    fn of(tile: &TileBuffers) -> Result<PathBindings<'_>> {
        Ok(PathBindings {
            radiance_direct: &tile.radiance_direct,
            radiance_indirect: tile.required_indirect("path")?,
            counters: &tile.counters,
        })
    }
}

/// The pass, bound with its own queue.
pub struct BoundHighlights {
    queue_highlights: BoundKernel,
    arrange_highlights: BoundKernel,
    path: BoundPath,
}

impl BoundHighlights {
    /// Queues the points of the tile with rays that may hit a light, and traces the rays.
    pub fn record(&self, frame: &mut Frame<'_>, queue: &PathQueue, parameters: &PathParameters) {
        frame.clear(&queue.count);
        frame.run(&self.queue_highlights, parameters.tile.point_count, parameters);
        frame.run(&self.arrange_highlights, 1, parameters);
        self.path.record_queued(frame, &queue.arguments, parameters);
    }
}

/// The pass, bound.
pub struct BoundPath(BoundKernel);

impl BoundPath {
    /// Traces one path from each point that `primary` stored in the tile's buffers.
    pub fn record(&self, frame: &mut Frame<'_>, parameters: &PathParameters) {
        frame.run(&self.0, parameters.tile.point_count, parameters);
    }

    /// Traces the paths of each point of a queue, dispatched by the indirect `arguments`.
    pub fn record_queued(&self, frame: &mut Frame<'_>, arguments: &Buffer, parameters: &PathParameters) {
        for path_number in 0..parameters.paths_per_point {
            frame.run_indirect(&self.0, arguments, 0, &PathParameters { path_number, ..*parameters });
        }
    }
}
