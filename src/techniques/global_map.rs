//! The global map: photons that carry flux, and the irradiance that they bring, precomputed.

use crate::Result;
use crate::gpu::{Binding, Bindings, Features, Gpu};
use crate::passes::flux::Flux;
use crate::passes::grid::{Grid, GridShape};
use crate::passes::irradiance::{Irradiance, IrradianceMap, MAP_PHOTONS_PER_CELL};
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
        let lights = &tables.lights;
        let traced =
            kernels.flux.trace(gpu, tables, lights, settings.flux_photons, max_bounces, settings.seed)?;
        let extent = extent(scene);
        let shape = GridShape::with_cells_of(MAP_PHOTONS_PER_CELL, extent.0, extent.1, traced.count, 1);
        let sorted = kernels.grid.sort(gpu, &traced.photons, traced.count, 1, shape)?;
        let map = kernels.irradiance.precompute(gpu, tables, &kernels.grid, &sorted, extent, traced.step)?;
        totals.photon_rays += traced.rays;
        totals.photon_bytes += map.bytes;
        Ok(GlobalMap(map))
    }
}
