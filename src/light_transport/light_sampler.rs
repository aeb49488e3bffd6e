//! A few of many lights: which each point asks, by light zones where there are photons to tell them.

use crate::Result;
use crate::gpu::{Buffer, Features, Gpu, Resources};
use crate::gpu_scene::GpuScene;
use crate::passes::TileBuffers;
use crate::passes::grid::Grid;
use crate::passes::photons::Photons;
use crate::passes::sample_lights::{BoundSampleLights, SampleLights};
use crate::passes::zones::{ZoneTable, Zones, zone_shape};
use crate::scene::Scene;
use crate::settings::Settings;
use crate::statistics::Counter;

use super::visibility_map::{by_light, extent};
use crate::statistics::totals::Totals;

/// Rays of all lights together that tell zones.
const ZONE_RAYS: u32 = 1 << 20;

/// Most rays of a light, and shadow photons of a ray: their product is what half a word counts.
const RAYS_PER_LIGHT: u32 = 6553;
const SHADOW_PHOTONS: u32 = 10;

pub(crate) struct LightSamplerKernels {
    choose: SampleLights,
    zones: Option<ZoneKernels>,
}

struct ZoneKernels {
    photons: Photons,
    grid: Grid,
    zones: Zones,
}

impl LightSamplerKernels {
    /// Those that the features ask for.
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        settings: &Settings,
    ) -> Result<Option<LightSamplerKernels>> {
        if !features.has("light_sampling") {
            return Ok(None);
        }
        let tagged = features.clone().with("light_tags", true);
        let per_ray = settings.visibility_map.shadow_photons_per_ray.min(SHADOW_PHOTONS);
        let zones = || {
            let kernels = || -> Result<ZoneKernels> {
                let (photons, (grid, zones)) = rayon::join(
                    || Photons::new(gpu, &tagged, constants, per_ray),
                    || rayon::join(|| Grid::sorting_only(gpu, features), || Zones::new(gpu, features)),
                );
                Ok(ZoneKernels { photons: photons?, grid: grid?, zones: zones? })
            };
            features.has("zones").then(kernels).transpose()
        };
        let audited = settings.visibility_map.audit > 0.0;
        let (choose, zones) = rayon::join(
            || SampleLights::new(gpu, features, constants, settings.light_sampling.sampled_lights, audited),
            zones,
        );
        Ok(Some(LightSamplerKernels { choose: choose?, zones: zones? }))
    }
}

/// The lights that the points of a tile ask.
pub(crate) struct LightSampler {
    choose: SampleLights,
    zones: Option<ZoneTable>,
    chosen: Buffer,
}

impl LightSampler {
    /// Traces the photons that tell the zones, and makes room for the lights of `points` points.
    pub fn new(
        gpu: &Gpu,
        kernels: LightSamplerKernels,
        scene: &Scene,
        gpu_scene: &GpuScene,
        points: u32,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<LightSampler> {
        let LightSamplerKernels { choose, zones } = kernels;
        let slots = points as usize * choose.slots() as usize;
        Ok(LightSampler {
            choose,
            zones: zones.map(|zones| zone_table(gpu, &zones, scene, gpu_scene, settings, totals)).transpose()?,
            chosen: gpu.buffer::<[u32; 2]>("penumbra/sample_lights/sampled_lights", slots)?,
        })
    }

    /// Lights that each point asks.
    pub fn slots(&self) -> u32 {
        self.choose.slots()
    }

    pub fn bind(&self, gpu: &Gpu, tile: &TileBuffers, gpu_scene: &GpuScene) -> Result<BoundSampleLights> {
        self.choose.bind(gpu, tile, &self.chosen, self.zones.as_ref(), gpu_scene)
    }

    /// What was chosen, as the other passes read it.
    pub fn resources(&self) -> Resources<'_> {
        Resources::new().with("sampled_lights", &self.chosen)
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        self.chosen.bytes
    }
}

fn zone_table(
    gpu: &Gpu,
    kernels: &ZoneKernels,
    scene: &Scene,
    gpu_scene: &GpuScene,
    settings: &Settings,
    totals: &mut Totals,
) -> Result<ZoneTable> {
    let lights = scene.placed_lights().len() as u32;
    let rays = settings.visibility_map.photons_per_light.min(ZONE_RAYS / lights).clamp(1, RAYS_PER_LIGHT);
    let traced = kernels.photons.trace(gpu, gpu_scene, lights, rays, settings.image.seed, 0)?;
    totals.photon_rays += traced.emitted.iter().map(|n| u64::from(*n)).sum::<u64>();
    totals.count(Counter::Overrun, traced.overruns);
    totals.photons = by_light(scene, &traced);
    let (bounds, area) = extent(scene);
    let shape = zone_shape(bounds, area, traced.count, lights);
    // The keys of the sort are zones alone.
    let sorted = kernels.grid.sort(gpu, &traced.photons, traced.count, 1, shape)?;
    let powers: Vec<f64> = gpu_scene.lights.lights[..lights as usize].iter().map(|light| light.power).collect();
    let table = kernels.zones.list(gpu, &sorted, &powers, scene.environment().is_some())?;
    totals.photon_bytes += table.bytes;
    Ok(table)
}
