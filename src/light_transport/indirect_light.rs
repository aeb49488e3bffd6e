//! Indirect light of the two-pass method: a final gather from the global map, interpolated between the records of the
//! irradiance cache, and paths for the light that neither of them holds. In techniques without separate direct light,
//! map and paths compute all light.

use std::collections::BTreeMap;
use std::time::Instant;

use kernel_kit::{Bindings, Frame};

use super::global_map::GlobalMap;
use super::irradiance_cache::{Filling, IrradianceCache, Records};
use super::kernels::IndirectKernels;
use super::shared::Shared;
use crate::Result;
use crate::gpu_scene::{CameraUniform, GpuScene};
use crate::passes::Tile;
use crate::passes::cache::BoundCache;
use crate::passes::path::{BoundHighlights, BoundPath, Path, PathParameters, PathQueue};
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

/// Parts of indirect light that another view of the same scene left. If a part is `None`, it is made.
#[derive(Default)]
pub(crate) struct MadeIndirect {
    pub map: Option<GlobalMap>,
    pub records: Option<Records>,
}

/// The passes of indirect light whose time grows with the photons and gather rays of a stage.
const RAY_PASSES: [&str; 4] = ["flux/", "grid/", "irradiance/", "gather/"];

/// Measured time of a stage of indirect light: a part that grows with the rays, and the rest.
#[derive(Clone, Copy, Default)]
pub(crate) struct IndirectCost {
    /// Of a gather ray of a record, with the photons that go with it.
    seconds_per_ray: f64,
    /// Of a stage, however many rays it adds.
    seconds_per_stage: f64,
}

impl IndirectCost {
    /// Derived from a stage that added `rays` gather rays per record and took `seconds` in all; `before` and `after`
    /// are the times of passes when it began and ended. If the device has no timestamps, all of the time counts as that
    /// of rays. Predictions for more rays are then too large.
    pub fn new(seconds: f64, rays: u32, before: &BTreeMap<String, f64>, after: &BTreeMap<String, f64>) -> IndirectCost {
        let is_of_rays = |name: &str| RAY_PASSES.iter().any(|pass| name.starts_with(pass));
        let sum = |times: &BTreeMap<String, f64>| -> f64 {
            times.iter().filter(|(name, _)| is_of_rays(name)).map(|(_, seconds)| seconds).sum()
        };
        let of_rays = if after.is_empty() { seconds } else { (sum(after) - sum(before)).clamp(0.0, seconds) };
        IndirectCost { seconds_per_ray: of_rays / f64::from(rays.max(1)), seconds_per_stage: seconds - of_rays }
    }

    /// The expected seconds of a stage that adds `rays` gather rays per record.
    pub fn of(self, rays: u32) -> f64 {
        self.seconds_per_ray * f64::from(rays) + self.seconds_per_stage
    }
}

/// Paths of a point that no record covers. Its neighbours have the light of many gather rays, so that a single path
/// would have most of the noise of the image: with 16 samples, `scenes/uplight.glb` has 0.53 times the error with four,
/// and `scenes/box.glb` 0.88 times, in 1.0 times the time (docs/decisions.md, "Paths where no record reaches").
const PATHS_WITHOUT_RECORD: u32 = 4;

pub(crate) struct IndirectLight {
    /// The cost of the last stage.
    cost: IndirectCost,
    /// The map in which paths and gather rays end, or which is shown directly.
    map: Option<GlobalMap>,
    /// The cache of the diffuse part.
    cache: Option<IrradianceCache>,
    /// Paths, for all light or for the light that map and cache leave out: from all points, or from those of each queue
    /// of the cache ([`CacheBuffers::queues`](crate::passes::cache::CacheBuffers::queues)).
    paths: Vec<BoundPath>,
    /// Single rays that may hit a light, in place of paths, and their queue.
    highlights: Option<(BoundHighlights, PathQueue)>,
}

impl IndirectLight {
    /// Makes the global map, unless `made` has one, and fills the irradiance cache. A part without kernels is left out.
    pub fn new(setup: &IndirectSetup<'_>, made: MadeIndirect, totals: &mut Totals) -> Result<IndirectLight> {
        let MadeIndirect { map, records } = made;
        let cost = IndirectCost::default();
        let mut light = IndirectLight { cost, map, cache: None, paths: Vec::new(), highlights: None };
        light.begin_stage(setup, records, 0, totals)?;
        Ok(light)
    }

    /// Makes a new global map with other photons. Then adds gather rays that end in it to the irradiance records, until
    /// each has the number of the settings; so far each has `earlier`. Returns the previous irradiance cache, if there
    /// is one.
    pub fn add_rays(
        &mut self,
        setup: &IndirectSetup<'_>,
        earlier: u32,
        totals: &mut Totals,
    ) -> Result<Option<BoundCache>> {
        // The previous map is released first, so that the device need not hold both.
        self.map = None;
        self.begin_stage(setup, None, earlier, totals)
    }

    /// Makes the parts of a stage, which has the photons and gather rays of the settings: the global map, if there is
    /// none; the irradiance cache, which begins with `records`, or more rays for it; and the paths that end in both.
    /// Returns the previous irradiance cache, if there is one.
    fn begin_stage(
        &mut self,
        setup: &IndirectSetup<'_>,
        records: Option<Records>,
        earlier: u32,
        totals: &mut Totals,
    ) -> Result<Option<BoundCache>> {
        let IndirectSetup { shared, kernels, primary, camera, settings } = *setup;
        let IndirectKernels { global_map, cache, path, features, .. } = kernels;
        let Shared { gpu, gpu_scene, tile, .. } = shared;
        let (start, times) = (Instant::now(), gpu.pass_times()?);
        totals.indirect_bytes = self.map.as_ref().map_or(0, GlobalMap::bytes);
        self.map = match (global_map, self.map.take()) {
            (Some(_), Some(made)) => Some(made),
            (Some(kernels), None) => Some(GlobalMap::new(&shared, kernels, settings, path.is_some(), totals)?),
            (None, _) => None,
        };
        let scene = with_irradiance(gpu_scene, self.map.as_ref());
        let mut before = None;
        if let (Some(kernels), Some(path)) = (cache, path) {
            let scene = &scene;
            let filling = Filling { gpu, kernels, path, features, tile, primary, scene, camera, settings };
            match &mut self.cache {
                Some(cache) => before = Some(cache.add_rays(&filling, totals)?),
                None => self.cache = Some(IrradianceCache::new(&filling, records, totals)?),
            }
        }
        if let Some(path) = path {
            if !features.has(Feature::Highlights) {
                self.paths = bind_paths(path, &shared, &scene, self.cache.as_ref())?;
            } else if self.highlights.is_none() {
                // These rays end in no map, so they stay bound from stage to stage.
                let queue = PathQueue::new(gpu, "path", tile.capacity())?;
                self.highlights = Some((path.bind_highlights(gpu, tile, &queue, gpu_scene)?, queue));
            }
        }
        gpu.wait("indirect light")?;
        let rays = settings.gather_rays().saturating_sub(earlier);
        self.cost = IndirectCost::new(start.elapsed().as_secs_f64(), rays, &times, &gpu.pass_times()?);
        Ok(before)
    }

    /// Writes what the irradiance records change of the indirect light at the tile's points, compared with those
    /// `before`.
    pub fn change(&self, frame: &mut Frame<'_>, before: &BoundCache, tile: &Tile) {
        if let Some(cache) = &self.cache {
            cache.change(frame, before, tile);
        }
    }

    /// The global map, if another view can use it.
    pub fn take_map(&mut self) -> Option<GlobalMap> {
        self.map.take().and_then(GlobalMap::without_view)
    }

    /// The cost of the last stage, by which that of the next one is predicted.
    pub fn cost(&self) -> IndirectCost {
        self.cost
    }

    /// Whether there is a global map, which more photons would refine.
    pub fn has_map(&self) -> bool {
        self.map.is_some()
    }

    /// Whether there are irradiance records, which more gather rays would refine.
    pub fn has_records(&self) -> bool {
        self.cache.is_some() && self.map.is_some()
    }

    /// The parts that another view can use.
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

    /// Traces a path from each point; or, if there is a cache, from each queued point, and several where no record
    /// reaches; or the single rays that may hit a light.
    pub fn trace_paths(&self, frame: &mut Frame<'_>, parameters: &PathParameters) {
        if let Some((highlights, queue)) = &self.highlights {
            highlights.record(frame, queue, parameters);
        }
        let Some(buffers) = self.cache.as_ref().map(IrradianceCache::buffers) else {
            return self.paths.iter().for_each(|path| path.record(frame, parameters));
        };
        let queues = [(&buffers.paths, 1), (&buffers.uncovered, PATHS_WITHOUT_RECORD)];
        for (path, (queue, paths_per_point)) in self.paths.iter().zip(queues) {
            path.record_queued(frame, &queue.arguments, &PathParameters { paths_per_point, ..*parameters });
        }
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        let queue = self.highlights.as_ref().map_or(0, |(_, queue)| queue.points.bytes);
        self.cache.as_ref().map_or(0, IrradianceCache::frame_bytes) + queue
    }
}

/// The bindings of the scene and, if there is one, of the global map.
fn with_irradiance<'a>(gpu_scene: &'a GpuScene, map: Option<&'a GlobalMap>) -> Vec<&'a dyn Bindings> {
    let irradiance = map.and_then(GlobalMap::irradiance).map(|irradiance| irradiance as &dyn Bindings);
    std::iter::once(gpu_scene as &dyn Bindings).chain(irradiance).collect()
}

/// Paths from each queue of the cache, or from all points if there is none.
fn bind_paths(
    path: &Path,
    Shared { gpu, tile, .. }: &Shared<'_>,
    scene: &[&dyn Bindings],
    cache: Option<&IrradianceCache>,
) -> Result<Vec<BoundPath>> {
    let Some(cache) = cache else { return Ok(vec![path.bind(gpu, tile, scene)?]) };
    let of_queue = |queue| {
        let sets: Vec<&dyn Bindings> = scene.iter().copied().chain([&queue as &dyn Bindings]).collect();
        path.bind(gpu, tile, &sets)
    };
    cache.buffers().queues().into_iter().map(of_queue).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Passes of rays grow with the rays, the others are the same in all stages.
    #[test]
    fn costs_are_those_of_rays_and_of_stages() {
        let times = |gather: f64, cache: f64| {
            BTreeMap::from([("gather/path".to_owned(), gather), ("cache/request".to_owned(), cache)])
        };
        let cost = IndirectCost::new(1.0, 16, &times(1.0, 1.0), &times(1.25, 3.0));
        assert_eq!(cost.of(16), 1.0);
        assert_eq!(cost.of(64), 0.75 + 4.0 * 0.25);
        let unknown = IndirectCost::new(1.0, 16, &BTreeMap::new(), &BTreeMap::new());
        assert_eq!(unknown.of(64), 4.0);
    }
}
