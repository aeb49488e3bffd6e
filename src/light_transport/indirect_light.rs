//! Indirect light: the global map, the irradiance cache, and paths for the light that neither of them holds. In
//! techniques without separate direct light these compute all light.

use kernel_kit::{Bindings, Frame};

use super::global_map::GlobalMap;
use super::irradiance_cache::{Filling, IrradianceCache, Records};
use super::kernels::IndirectKernels;
use super::shared::Shared;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::passes::Tile;
use crate::passes::path::{BoundHighlights, BoundPath, HighlightQueue, PathParameters};
use crate::passes::primary::BoundPrimary;
use crate::settings::Settings;
use crate::specialisation::features::Feature;
use crate::statistics::totals::Totals;

/// The inputs of indirect light.
pub(crate) struct IndirectSetup<'a> {
    pub shared: Shared<'a>,
    pub kernels: &'a IndirectKernels,
    pub primary: &'a BoundPrimary,
    pub camera: &'a CameraUniform,
    pub settings: &'a Settings,
}

/// What is made of it already, for another view of the same scene. A part that is none is made.
#[derive(Default)]
pub(crate) struct MadeIndirect {
    pub map: Option<GlobalMap>,
    pub records: Option<Records>,
}

pub(crate) struct IndirectLight {
    /// The map in which paths and gather rays end, or which is shown directly.
    map: Option<GlobalMap>,
    /// The cache of the diffuse part.
    cache: Option<IrradianceCache>,
    /// Paths: for all light, or for the light that map and cache leave out.
    path: Option<BoundPath>,
    /// Single rays that may hit a light, in place of paths, and their queue.
    highlights: Option<(BoundHighlights, HighlightQueue)>,
}

impl IndirectLight {
    /// Traces the flux photons, sorts them into the global map unless there is one, and fills the irradiance cache. A
    /// part without kernels is left out.
    pub fn new(setup: &IndirectSetup<'_>, made: MadeIndirect, totals: &mut Totals) -> Result<IndirectLight> {
        let MadeIndirect { map: made, records } = made;
        let IndirectSetup { shared, kernels, primary, camera, settings } = *setup;
        let IndirectKernels { global_map, cache, path, features, .. } = kernels;
        let Shared { gpu, gpu_scene, tile, .. } = shared;
        totals.indirect_bytes = made.as_ref().map_or(0, GlobalMap::bytes);
        let paths = path.is_some();
        let map = match (global_map, made) {
            (Some(_), Some(made)) => Some(made),
            (Some(kernels), None) => Some(GlobalMap::new(&shared, kernels, settings, paths, totals)?),
            (None, _) => None,
        };
        let mut scene: Vec<&dyn Bindings> = vec![gpu_scene];
        scene.extend(map.as_ref().and_then(GlobalMap::irradiance).map(|irradiance| irradiance as &dyn Bindings));
        let filling = |kernels| Filling { gpu, kernels, features, tile, primary, scene: &scene, camera, settings };
        let cache = match cache {
            Some(kernels) => Some(IrradianceCache::new(&filling(kernels), records, totals)?),
            None => None,
        };
        let queue = cache.as_ref().map(|cache| cache.buffers().path_queue());
        let mut sets = scene.clone();
        sets.extend(queue.as_ref().map(|queue| queue as &dyn Bindings));
        let (path, highlights) = match path {
            Some(path) if features.has(Feature::Highlights) => {
                let queue = HighlightQueue::new(gpu, tile.capacity())?;
                (None, Some((path.bind_highlights(gpu, tile, &queue, gpu_scene)?, queue)))
            }
            Some(path) => (Some(path.bind(gpu, tile, &sets)?), None),
            None => (None, None),
        };
        Ok(IndirectLight { map, cache, path, highlights })
    }

    /// Whether there is a global map, which more photons would refine.
    pub fn has_map(&self) -> bool {
        self.map.is_some()
    }

    /// What another view can use.
    pub fn into_made(self) -> MadeIndirect {
        let map = self.map.and_then(GlobalMap::without_view);
        MadeIndirect { map, records: self.cache.map(IrradianceCache::into_records) }
    }

    /// Shows the global map at the tile's points, if the technique does so.
    pub fn show_map(&self, frame: &mut Frame<'_>, tile: &Tile) {
        if let Some(map) = &self.map {
            map.show(frame, tile);
        }
    }

    /// If there is a cache, lights the tile's points by irradiance records, and queues the points that no record
    /// covers.
    pub fn interpolate_irradiance(&self, frame: &mut Frame<'_>, tile: &Tile) {
        if let Some(cache) = &self.cache {
            cache.interpolate(frame, tile);
        }
    }

    /// Traces a path from each point, or from each queued point if there is a cache; or the single rays that may hit a
    /// light.
    pub fn trace_paths(&self, frame: &mut Frame<'_>, parameters: &PathParameters) {
        if let Some((highlights, queue)) = &self.highlights {
            highlights.record(frame, queue, parameters);
        }
        match (&self.path, &self.cache) {
            (Some(path), Some(cache)) => path.record_queued(frame, &cache.buffers().path_arguments, parameters),
            (Some(path), None) => path.record(frame, parameters),
            (None, _) => {}
        }
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        let queue = self.highlights.as_ref().map_or(0, |(_, queue)| queue.path_points.bytes);
        self.cache.as_ref().map_or(0, IrradianceCache::frame_bytes) + queue
    }
}
