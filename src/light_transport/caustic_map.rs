//! The caustic map: photons that only focusing surfaces have scattered, shown directly where they arrive (Jensen 1996).
//! Every 8 samples have a new map with smaller discs, so that both noise and blur vanish (Knaus and Zwicker 2011, with
//! their alpha of 2/3).

use glam::Vec3;
use kernel_kit::Frame;

use super::global_map::GlobalMapKernels;
use super::shared::{Shared, TILE_SAMPLES};
use crate::Result;
use crate::kernels::GridShape;
use crate::passes::Tile;
use crate::passes::flux::FluxSettings;
use crate::passes::grid::Photon;
use crate::passes::irradiance::{BoundShow, ShownMap};
use crate::settings::Settings;
use crate::statistics::Counter;
use crate::statistics::totals::Totals;

/// Rays of a caustic map for each ray of the global map. More, because few of them hit a focusing surface first.
const RAYS_PER_FLUX_RAY: u32 = 4;

/// Photons in a cell if all lay evenly in a square around them. The radius of a disc is a cell at most, and smaller
/// where a cell has more than k / pi = 20 photons: from 64 times the mean density on. A photon alone is about as bright
/// as all of them would be if spread evenly. (In the first sample of `scenes/still_life.glb` it was 470 times as bright
/// with cells of a 2^19th of the square, whatever the number of photons.)
const PHOTONS_PER_CELL: f32 = 0.32;

/// Maximum number of cells in that square.
const MAX_CELLS: u32 = 1 << 19;

/// The map of 8 samples, bound to a tile.
pub(crate) struct CausticMap {
    number: u32,
    /// `None` if no photon was stored.
    show: Option<BoundShow>,
}

impl CausticMap {
    /// Number of the map for samples from `first_sample` on. In a piece it must not depend on where batches begin.
    pub fn number_at(first_sample: u32, settings: &Settings) -> u32 {
        match settings.image.piece {
            Some(_) => first_sample / TILE_SAMPLES,
            None => first_sample.div_ceil(TILE_SAMPLES),
        }
    }

    /// Number of this map.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// Traces and sorts the photons of a map.
    pub fn new(
        shared: &Shared<'_>,
        kernels: &GlobalMapKernels,
        settings: &Settings,
        number: u32,
        totals: &mut Totals,
    ) -> Result<CausticMap> {
        let Shared { gpu, gpu_scene, tile, .. } = *shared;
        let rays = settings.flux_photons().saturating_mul(RAYS_PER_FLUX_RAY);
        // Other photons for each map, far from the seeds that users count up.
        let seed = settings.image.seed.wrapping_add((number + 1).wrapping_mul(0x85eb_ca6b));
        let flux = FluxSettings { rays, max_bounces: settings.indirect.max_bounces, seed, caustics_only: true };
        let traced = kernels.flux.trace(gpu, gpu_scene, &gpu_scene.lights, flux)?;
        // A resumed render traces the map of its next samples once more.
        if number >= totals.caustic_maps {
            totals.caustic_maps = number + 1;
            totals.photon_rays += traced.rays;
            totals.indirect.caustics += u64::from(traced.count);
            totals.count(Counter::Overrun, traced.overruns);
            totals.count(Counter::NotFiniteFlux, traced.not_finite);
        }
        if traced.count == 0 {
            return Ok(CausticMap { number, show: None });
        }
        let photons: Vec<Photon> = gpu.read(&traced.photons, traced.count as usize)?;
        let positions = photons.iter().map(|photon| Vec3::from(photon.position));
        let corner = Vec3::splat(f32::INFINITY);
        let bounds = positions.fold((corner, -corner), |(low, high), p| (low.min(p), high.max(p)));
        let extent = bounds.1 - bounds.0;
        // Knaus and Zwicker 2011, equation 20: the square of the radius falls as the power -1/3 of the maps so far.
        let shrink = f64::from(number + 1).powf(-1.0 / 6.0);
        let cells = f64::from(traced.count) / (f64::from(PHOTONS_PER_CELL) * shrink * shrink);
        let cells = (cells as u32).clamp(1, MAX_CELLS);
        let shape = GridShape::with_photons_per_cell(1.0, bounds, extent.length_squared(), cells, 1);
        let sorted = kernels.grid.sort(gpu, &traced.photons, traced.count, 1, shape)?;
        let shown = ShownMap { map: &sorted, step: traced.step, shrink, unshadowed: 0 };
        let show = kernels.irradiance.bind_caustics(gpu, tile, gpu_scene, &shown)?;
        Ok(CausticMap { number, show: Some(show) })
    }

    /// Adds its light at the tile's points.
    pub fn show(&self, frame: &mut Frame<'_>, tile: &Tile) {
        if let Some(show) = &self.show {
            show.record(frame, tile);
        }
    }
}
