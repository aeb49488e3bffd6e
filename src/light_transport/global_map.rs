//! The global map: photons that carry flux (the "normal photons" of the paper), and irradiance computed from them in
//! advance at irradiance points (Christensen 1999).

use kernel_kit::{Frame, Gpu};

use super::shared::{Shared, count_flux_photons, extent};
use crate::Result;
use crate::kernels::GridShape;
use crate::passes::Tile;
use crate::passes::flux::{Flux, FluxPhotons, FluxSettings};
use crate::passes::grid::Grid;
use crate::passes::irradiance::{
    BoundShow, Irradiance, IrradianceMap, MAP_PHOTONS_PER_CELL, RAYS_PER_IRRADIANCE_POINT_RAY, Shell, ShownMap,
    irradiance_point_grid,
};
use crate::settings::Settings;
use crate::specialisation::features::Features;
use crate::specialisation::kernels::sorting_grid;
use crate::statistics::totals::Totals;
use crate::statistics::{Counter, Indirect};

/// The kernels of the global map, which make and show the caustic map as well.
pub(crate) struct GlobalMapKernels {
    pub flux: Flux,
    pub grid: Grid,
    pub irradiance: Irradiance,
}

impl GlobalMapKernels {
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<GlobalMapKernels> {
        let sorting = sorting_grid(features);
        let (flux, (grid, irradiance)) = rayon::join(
            || Flux::new(gpu, features, constants),
            || rayon::join(|| Grid::sorting_only(gpu, &sorting), || Irradiance::new(gpu, features, constants)),
        );
        Ok(GlobalMapKernels { flux: flux?, grid: grid?, irradiance: irradiance? })
    }
}

/// The global map as a render reads it.
pub(crate) struct GlobalMap {
    /// Irradiance at irradiance points, for paths and gathers.
    irradiance: Option<IrradianceMap>,
    /// The map shown at the points of a tile.
    show: Option<BoundShow>,
}

impl GlobalMap {
    /// The irradiance at which paths and gathers end.
    pub fn irradiance(&self) -> Option<&IrradianceMap> {
        self.irradiance.as_ref()
    }

    /// The map, if no buffers of a view are bound to it.
    pub fn without_view(self) -> Option<GlobalMap> {
        Some(self).filter(|map| map.show.is_none())
    }

    /// Bytes that it has on the device, if it is not shown.
    pub fn bytes(&self) -> u64 {
        self.irradiance.as_ref().map_or(0, |irradiance| irradiance.bytes)
    }

    /// Traces the photons, and sorts them. For `paths` also estimates the irradiance at irradiance points.
    pub fn new(
        shared: &Shared<'_>,
        kernels: &GlobalMapKernels,
        settings: &Settings,
        paths: bool,
        totals: &mut Totals,
    ) -> Result<GlobalMap> {
        let Shared { gpu, scene, gpu_scene, tile } = *shared;
        let shown = settings.technique.shows_map();
        // A look-up happens after one bounce.
        let max_bounces =
            if shown { settings.indirect.max_bounces } else { settings.indirect.max_bounces.saturating_sub(1) };
        let flux_photons = settings.flux_photons();
        // Maps of other numbers of photons are independent, as irradiance records have gather rays that end in several
        // of them. Users may count up their seeds, so others are far away.
        let seed = settings.image.seed.wrapping_add(flux_photons.wrapping_mul(0x9e37_79b9));
        let caustics = totals.indirect.caustics;
        let mut trace = |rays: u32, seed: u32| -> Result<FluxPhotons> {
            let flux = FluxSettings { rays, max_bounces, seed, caustics_only: false };
            let traced = kernels.flux.trace(gpu, gpu_scene, &gpu_scene.lights, flux)?;
            count_flux_photons(&traced, totals);
            Ok(traced)
        };
        let extent = extent(scene);
        let photons = trace(flux_photons, seed)?;
        let mut counts = Indirect {
            emitted: u64::from(photons.emitted),
            photons: u64::from(photons.count),
            clipped: photons.clipped,
            caustics,
            ..Indirect::default()
        };
        let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, extent.0, extent.1, photons.count, 1);
        let map = kernels.grid.sort(gpu, &photons.photons, photons.count, 1, shape)?;
        let mut irradiance = None;
        if paths {
            // Irradiance points are the positions of further photons, which lie where light arrives.
            let points = trace(flux_photons.div_ceil(RAYS_PER_IRRADIANCE_POINT_RAY), !seed)?;
            let shape = irradiance_point_grid(extent, points.count);
            let points = kernels.grid.sort(gpu, &points.photons, points.count, 1, shape)?;
            let precomputed = kernels.irradiance.precompute(gpu, gpu_scene, &map, points, photons.step)?;
            counts.points = u64::from(precomputed.points.count);
            totals.indirect_bytes += precomputed.bytes;
            totals.count(Counter::NotFiniteIrradiance, precomputed.not_finite);
            irradiance = Some(precomputed);
        }
        let mut show = None;
        if shown {
            totals.indirect_bytes += map.bytes;
            let unshadowed = if settings.technique.has_negative_photons() { scene.lights.len() as u32 } else { 0 };
            let shown = ShownMap { map: &map, step: photons.step, shrink: 1.0, unshadowed, shell: Shell::ALL };
            show = Some(kernels.irradiance.bind_show(gpu, tile, gpu_scene, &shown)?);
        }
        totals.indirect = counts;
        Ok(GlobalMap { irradiance, show })
    }

    /// Shows the map at the tile's points, if the technique does so.
    pub fn show(&self, frame: &mut Frame<'_>, tile: &Tile) {
        if let Some(show) = &self.show {
            show.record(frame, tile);
        }
    }
}
