//! The light sampler: gives each point a few of many lights, by light zones if there are photons for them ("divide the
//! scene into zones according to the light sources").

use kernel_kit::{Buffer, Frame, Gpu};

use super::shared::{Shared, count_visibility_photons, extent};
use crate::Result;
use crate::passes::Tile;
use crate::passes::grid::Grid;
use crate::passes::photons::Photons;
use crate::passes::sample_lights::{BoundSampleLights, SampleLights};
use crate::passes::zones::{ZoneTable, Zones, zone_shape};
use crate::settings::Settings;
use crate::specialisation::features::{Feature, Features};
use crate::specialisation::kernels::{photons_of_zones, sorting_grid};
use crate::statistics::totals::Totals;

/// Number of rays of all lights together for zones. With a thousand lamps, the error by light sampling is 3.1e-3 with
/// the 1,048 rays of each light, and 5.0e-3 with a quarter of them (docs/experiments.md, "Many lights").
const ZONE_RAYS: u32 = 1 << 20;

/// Maximum number of rays of a light, and of shadow photons of a ray. Their product must be below 2^16: a zone counts
/// the shadow photons of a light in half a word.
const RAYS_PER_LIGHT: u32 = 6553;
const SHADOW_PHOTONS: u32 = 10;

pub(crate) struct LightSamplerKernels {
    sample_lights: SampleLights,
    zones: Option<ZoneKernels>,
}

struct ZoneKernels {
    photons: Photons,
    grid: Grid,
    zones: Zones,
}

impl LightSamplerKernels {
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        settings: &Settings,
    ) -> Result<LightSamplerKernels> {
        let audited = settings.visibility_map.audit > 0.0;
        let (sample_lights, zones) = rayon::join(
            || SampleLights::new(gpu, features, constants, settings.light_sampling.sampled_lights, audited),
            || features.has(Feature::Zones).then(|| ZoneKernels::new(gpu, features, constants, settings)).transpose(),
        );
        Ok(LightSamplerKernels { sample_lights: sample_lights?, zones: zones? })
    }
}

impl ZoneKernels {
    fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)], settings: &Settings) -> Result<ZoneKernels> {
        let (tagged, sorting) = (photons_of_zones(features), sorting_grid(features));
        let per_ray = settings.visibility_map.shadow_photons_per_ray.min(SHADOW_PHOTONS);
        let (photons, (grid, zones)) = rayon::join(
            || Photons::new(gpu, &tagged, constants, per_ray),
            || rayon::join(|| Grid::sorting_only(gpu, &sorting), || Zones::new(gpu, &sorting)),
        );
        Ok(ZoneKernels { photons: photons?, grid: grid?, zones: zones? })
    }
}

/// The sampled lights of the points of a tile.
pub(crate) struct LightSampler {
    bound: BoundSampleLights,
    lights: u32,
    sampled_lights: Buffer,
    /// Owns the bound buffers.
    _zones: Option<ZoneTable>,
}

impl LightSampler {
    /// Traces the photons for the zones, and makes the buffer for the sampled lights of `points` points.
    pub fn new(
        shared: &Shared<'_>,
        kernels: LightSamplerKernels,
        points: u32,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<LightSampler> {
        let LightSamplerKernels { sample_lights, zones } = kernels;
        let Shared { gpu, gpu_scene, tile, .. } = *shared;
        let lights = sample_lights.lights_per_point();
        let zones = zones.map(|zones| zone_table(shared, &zones, settings, totals)).transpose()?;
        let count = points as usize * lights as usize;
        let sampled_lights = gpu.buffer::<[u32; 2]>("penumbra/sample_lights/sampled_lights", count)?;
        let bound = sample_lights.bind(gpu, tile, &sampled_lights, zones.as_ref(), gpu_scene)?;
        Ok(LightSampler { bound, lights, sampled_lights, _zones: zones })
    }

    /// Number of lights that each point samples.
    pub fn lights(&self) -> u32 {
        self.lights
    }

    /// Samples the lights of all points of a tile.
    pub fn sample(&self, frame: &mut Frame<'_>, tile: &Tile) {
        self.bound.record(frame, tile);
    }

    /// The sampled lights, as the passes after the sampler read them.
    pub fn sampled_lights(&self) -> &Buffer {
        &self.sampled_lights
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        self.sampled_lights.bytes
    }
}

fn zone_table(
    shared: &Shared<'_>,
    kernels: &ZoneKernels,
    settings: &Settings,
    totals: &mut Totals,
) -> Result<ZoneTable> {
    let Shared { gpu, scene, gpu_scene, .. } = *shared;
    let lights = scene.placed_lights().len() as u32;
    let rays = settings.photons_per_light().min(ZONE_RAYS / lights).clamp(1, RAYS_PER_LIGHT);
    let traced = kernels.photons.trace(gpu, gpu_scene, lights, rays, settings.image.seed, 0)?;
    count_visibility_photons(scene, &traced, totals);
    let (bounds, area) = extent(scene);
    let shape = zone_shape(bounds, area, traced.count, lights);
    // The photons are sorted by zone only.
    let sorted = kernels.grid.sort(gpu, &traced.photons, traced.count, 1, shape)?;
    let powers: Vec<f64> = gpu_scene.lights.lights[..lights as usize].iter().map(|light| light.power).collect();
    let table = kernels.zones.list(gpu, &sorted, &powers, scene.environment().is_some())?;
    totals.photon_bytes += table.bytes;
    Ok(table)
}
