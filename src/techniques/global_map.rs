//! The global map: photons that carry flux, and the irradiance that they bring, precomputed.

use crate::Result;
use crate::gpu::{Binding, Bindings, Features, Gpu};
use crate::passes::flux::{Flux, FluxPhotons};
use crate::passes::grid::{Grid, GridShape};
use crate::passes::irradiance::{Irradiance, IrradianceMap, MAP_PHOTONS_PER_CELL, RAYS_PER_PLACE_RAY, place_grid};
use crate::scene::Scene;
use crate::settings::Settings;
use crate::tables::SceneTables;

use super::totals::Totals;
use super::visibility_map::extent;

pub(super) struct GlobalMapKernels {
    flux: Flux,
    grid: Grid,
    irradiance: Irradiance,
}

impl GlobalMapKernels {
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<GlobalMapKernels> {
        let (flux, (grid, irradiance)) = rayon::join(
            || Flux::new(gpu, features, constants),
            || rayon::join(|| Grid::sorting_only(gpu, features), || Irradiance::new(gpu, features, constants)),
        );
        Ok(GlobalMapKernels { flux: flux?, grid: grid?, irradiance: irradiance? })
    }
}

pub(super) struct GlobalMap(IrradianceMap);

impl Bindings for GlobalMap {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        self.0.get(name)
    }
}

impl GlobalMap {
    /// Traces the photons, sorts them, and estimates the irradiance at some.
    pub fn new(
        gpu: &Gpu,
        kernels: &GlobalMapKernels,
        scene: &Scene,
        tables: &SceneTables,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<GlobalMap> {
        // What a look-up tells is seen after one bounce.
        let max_bounces = settings.max_bounces.saturating_sub(1);
        let Settings { flux_photons, seed, .. } = *settings;
        let mut trace = |rays: u32, seed: u32| -> Result<FluxPhotons> {
            let traced = kernels.flux.trace(gpu, tables, &tables.lights, rays, max_bounces, seed)?;
            totals.photon_rays += traced.rays;
            Ok(traced)
        };
        let photons = trace(flux_photons, seed)?;
        let places = trace(flux_photons.div_ceil(RAYS_PER_PLACE_RAY), !seed)?;
        let extent = extent(scene);
        let shape = GridShape::with_cells_of(MAP_PHOTONS_PER_CELL, extent.0, extent.1, photons.count, 1);
        let map = kernels.grid.sort(gpu, &photons.photons, photons.count, 1, shape)?;
        let shape = place_grid(extent, places.count);
        let places = kernels.grid.sort(gpu, &places.photons, places.count, 1, shape)?;
        let map = kernels.irradiance.precompute(gpu, tables, &map, places, photons.step)?;
        totals.photon_bytes += map.bytes;
        Ok(GlobalMap(map))
    }
}
