//! The caustic map: photons that focusing surfaces alone have sent on, shown directly where they arrive (Jensen 1996). Samples
//! have maps of their own, with discs that shrink, so that both their noise and their blur go to nothing (Knaus and Zwicker
//! 2011, with their alpha of 2/3).

use glam::Vec3;

use crate::Result;
use crate::gpu::{Features, Frame, Gpu};
use crate::passes::Tile;
use crate::passes::flux::Flux;
use crate::passes::grid::{GridShape, Photon};
use crate::passes::irradiance::BoundShow;
use crate::settings::Settings;
use crate::statistics::Counter;

use super::TILE_SAMPLES;
use super::direct_light::Shared;
use super::global_map::GlobalMapKernels;
use crate::statistics::totals::Totals;

/// Rays of a caustic map for one of the global map: few of them meet a focusing surface first.
const RAYS_PER_FLUX_RAY: u32 = 4;

/// Cells of the grid, about: light is focused on little of what the grid spans.
const CELLS: u32 = 1 << 19;

pub(crate) struct CausticKernels {
    flux: Flux,
}

impl CausticKernels {
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<CausticKernels> {
        Ok(CausticKernels { flux: Flux::of_caustics(gpu, features, constants)? })
    }
}

/// The map of some samples, bound to a tile.
pub(crate) struct CausticMap {
    number: u32,
    /// None where no photon arrived.
    show: Option<BoundShow>,
}

impl CausticMap {
    /// Which map shows its light to samples from that one on.
    pub fn number_at(first_sample: u32) -> u32 {
        first_sample.div_ceil(TILE_SAMPLES)
    }

    /// Which map this is.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// Traces and sorts the photons of a map.
    pub fn new(
        shared: &Shared<'_>,
        kernels: &CausticKernels,
        map: &GlobalMapKernels,
        settings: &Settings,
        number: u32,
        totals: &mut Totals,
    ) -> Result<CausticMap> {
        let Shared { gpu, gpu_scene, tile, .. } = *shared;
        let rays = settings.indirect.photons.saturating_mul(RAYS_PER_FLUX_RAY);
        // Other photons for each map, far from the seeds that users count up.
        let seed = settings.image.seed.wrapping_add((number + 1).wrapping_mul(0x85eb_ca6b));
        let traced =
            kernels.flux.trace(gpu, gpu_scene, &gpu_scene.lights, rays, settings.indirect.max_bounces, seed)?;
        // A render that is taken up again traces the map of its next samples once more.
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
        let shape = GridShape::with_cells_of(1.0, bounds, extent.length_squared(), CELLS, 1);
        let sorted = map.grid.sort(gpu, &traced.photons, traced.count, 1, shape)?;
        // Knaus and Zwicker 2011, equation 20: the square of the radius falls as the power -1/3 of the maps so far.
        let shrink = f64::from(number + 1).powf(-1.0 / 6.0);
        let show = map.irradiance.bind_caustics(gpu, tile, gpu_scene, &sorted, traced.step, shrink)?;
        Ok(CausticMap { number, show: Some(show) })
    }

    /// Adds its light at the tile's points.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        if let Some(show) = &self.show {
            show.record(frame, tile);
        }
    }
}
