//! The global map: photons that carry flux (the "normal photons" of the paper), and irradiance computed from them in
//! advance at irradiance points (Christensen 1999).

use kernel_kit::{Frame, Gpu};

use super::shared::{Shared, count_flux_photons, extent};
use crate::Result;
use crate::kernels::GridShape;
use crate::passes::Tile;
use crate::passes::flux::{Flux, FluxPhotons, FluxSettings};
use crate::passes::grid::{Grid, SortedPhotons};
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

    /// Bytes of the irradiance on the device. The photons of a shown map are not counted.
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
        let extent = extent(shared.scene);
        let flux = flux_settings(settings);
        let photons = trace(shared, kernels, flux, totals)?;
        totals.indirect = Indirect {
            emitted: u64::from(photons.emitted),
            photons: u64::from(photons.count),
            clipped: photons.clipped,
            caustics: totals.indirect.caustics,
            ..Indirect::default()
        };
        let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, extent.0, extent.1, photons.count, 1);
        let map = kernels.grid.sort(shared.gpu, &photons.photons, photons.count, 1, shape)?;
        let irradiance =
            paths.then(|| precompute_irradiance(shared, kernels, flux, &map, photons.step, totals)).transpose()?;
        let shown = settings.technique.shows_map();
        let show = shown.then(|| bind_show(shared, kernels, settings, &map, photons.step, totals)).transpose()?;
        Ok(GlobalMap { irradiance, show })
    }

    /// Shows the map at the tile's points, if the technique does so.
    pub fn show(&self, frame: &mut Frame<'_>, tile: &Tile) {
        if let Some(show) = &self.show {
            show.record(frame, tile);
        }
    }
}

/// How the photons of the map are traced.
fn flux_settings(settings: &Settings) -> FluxSettings {
    let indirect = &settings.indirect;
    // Paths and gather rays make one bounce before they look the map up. If the map is shown, its photons make all.
    let max_bounces =
        if settings.technique.shows_map() { indirect.max_bounces } else { indirect.max_bounces.saturating_sub(1) };
    let rays = settings.flux_photons();
    // The gather rays of an irradiance record end in several maps, whose numbers of photons differ. A seed for each
    // number makes these maps independent. The factor keeps the seeds far from those of users who count theirs up.
    let seed = settings.image.seed.wrapping_add(rays.wrapping_mul(0x9e37_79b9));
    FluxSettings { rays, max_bounces, seed, caustics_only: false }
}

/// Traces photons, and counts them.
fn trace(
    shared: &Shared<'_>,
    kernels: &GlobalMapKernels,
    flux: FluxSettings,
    totals: &mut Totals,
) -> Result<FluxPhotons> {
    let Shared { gpu, gpu_scene, .. } = *shared;
    let traced = kernels.flux.trace(gpu, gpu_scene, &gpu_scene.lights, flux)?;
    count_flux_photons(&traced, totals);
    Ok(traced)
}

/// Estimates the irradiance at irradiance points from the sorted photons `map`, which were traced with the settings
/// `flux`. Irradiance points are the positions of further photons, which lie where light arrives.
fn precompute_irradiance(
    shared: &Shared<'_>,
    kernels: &GlobalMapKernels,
    flux: FluxSettings,
    map: &SortedPhotons,
    step: f64,
    totals: &mut Totals,
) -> Result<IrradianceMap> {
    let Shared { gpu, scene, gpu_scene, .. } = *shared;
    let rays = flux.rays.div_ceil(RAYS_PER_IRRADIANCE_POINT_RAY);
    let points = trace(shared, kernels, FluxSettings { rays, seed: !flux.seed, ..flux }, totals)?;
    let shape = irradiance_point_grid(extent(scene), points.count);
    let points = kernels.grid.sort(gpu, &points.photons, points.count, 1, shape)?;
    let precomputed = kernels.irradiance.precompute(gpu, gpu_scene, map, points, step)?;
    totals.indirect.points = u64::from(precomputed.points.count);
    totals.indirect_bytes += precomputed.bytes;
    totals.count(Counter::NotFiniteIrradiance, precomputed.not_finite);
    Ok(precomputed)
}

/// Binds the pass that shows the map at the points of a tile.
fn bind_show(
    shared: &Shared<'_>,
    kernels: &GlobalMapKernels,
    settings: &Settings,
    map: &SortedPhotons,
    step: f64,
    totals: &mut Totals,
) -> Result<BoundShow> {
    let Shared { gpu, scene, gpu_scene, tile } = *shared;
    totals.indirect_bytes += map.bytes;
    let unshadowed = if settings.technique.has_negative_photons() { scene.lights.len() as u32 } else { 0 };
    let shown = ShownMap { map, step, shrink: 1.0, unshadowed, shell: Shell::ALL };
    kernels.irradiance.bind_show(gpu, tile, gpu_scene, &shown)
}
