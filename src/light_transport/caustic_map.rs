//! The caustic map: photons that only focusing surfaces have scattered, shown directly where they arrive (Jensen 1996).
//! Every 8 samples have a new map with smaller discs, so that both noise and blur vanish (Knaus and Zwicker 2011, with
//! their alpha of 2/3).

use glam::Vec3;
use kernel_kit::{Buffer, Frame};

use super::global_map::GlobalMapKernels;
use super::shared::{Shared, TILE_SAMPLES, count_flux_photons};
use crate::Result;
use crate::kernels::GridShape;
use crate::passes::Tile;
use crate::passes::flux::FluxSettings;
use crate::passes::grid::Photon;
use crate::passes::irradiance::{BoundShow, Shell, ShownMap};
use crate::settings::Settings;
use crate::statistics::totals::Totals;

/// Rays of a caustic map for each ray of the global map. More, because few of them hit a focusing surface first.
/// Other factors were not compared.
const RAYS_PER_FLUX_RAY: u32 = 4;

/// Photons in a cell if all lay evenly in a square around them: 1 / pi. A disc has the radius of a cell, so a photon
/// that is alone in its disc is about as bright as all photons would be if spread evenly. (In the first sample of
/// `scenes/still_life.glb` it was 470 times as bright with cells of a 2^19th of the square, whatever the number of
/// photons.) Where a cell has more than k / pi = 20 photons, 64 times the mean, discs are smaller.
const PHOTONS_PER_CELL: f32 = 0.32;

/// Maximum number of cells in that square. The grid then has at most twice as many in all, which take 28 MiB.
const MAX_CELLS: u32 = 1 << 19;

/// Share of a cube's photons that determines the next cube within it, and the factor by which that cube is wider than
/// the space around these photons. At its faces the density has fallen, so the larger discs beyond them spread little
/// light. Other values were not compared.
const DENSE_SHARE: f64 = 0.8;
const MARGIN: f32 = 1.5;

/// Minimum ratio of the sides of cubes within each other. On a plane, photons are then at least 60 times as dense in
/// the inner one as around it, and the cells of its grid a quarter as wide.
const MIN_RATIO: f32 = 4.0;

/// Maximum number of cubes within each other. With six, the narrowest is at most a 4,096th of all photons' width.
/// Each has a grid of its own, and a dispatch over all points of a tile.
const MAX_CUBES: usize = 6;

/// The map of 8 samples, bound to a tile.
pub(crate) struct CausticMap {
    number: u32,
    /// One for each of its grids; none if no photon was stored.
    shows: Vec<BoundShow>,
}

impl CausticMap {
    /// Number of the map for a batch of samples from `first_sample` on. The first batches of 1, 1, 2 and 4 samples
    /// share a map, so that each map has as many samples as the others.
    pub fn number_at(first_sample: u32) -> u32 {
        first_sample / TILE_SAMPLES
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
        // Each map has other photons. Their seeds are far from those of users, who count up from one.
        let seed = settings.image.seed.wrapping_add((number + 1).wrapping_mul(0x85eb_ca6b));
        let flux = FluxSettings { rays, max_bounces: settings.indirect.max_bounces, seed, caustics_only: true };
        let traced = kernels.flux.trace(gpu, gpu_scene, &gpu_scene.lights, flux)?;
        // A resumed render traces the map of its next samples once more.
        if number >= totals.caustic_maps {
            totals.caustic_maps = number + 1;
            totals.indirect.caustics += u64::from(traced.count);
            count_flux_photons(&traced, totals);
        }
        if traced.count == 0 {
            return Ok(CausticMap { number, shows: Vec::new() });
        }
        let photons: Vec<Photon> = gpu.read(&traced.photons, traced.count as usize)?;
        // Knaus and Zwicker 2011, equation 20: the square of the radius falls as the power -1/3 of the maps so far.
        let shrink = f64::from(number + 1).powf(-1.0 / 6.0);
        let bind = |photons: &Buffer, shape: GridShape, count: u32, shell: Shell| -> Result<BoundShow> {
            let sorted = kernels.grid.sort(gpu, photons, count, 1, shape)?;
            let shown = ShownMap { map: &sorted, step: traced.step, shrink, unshadowed: 0, shell };
            kernels.irradiance.bind_caustics(gpu, tile, gpu_scene, &shown)
        };
        let mut shows = Vec::new();
        let (dense, rest) = dense_shells(&photons, shrink);
        for DenseShell { shell, shape, within } in dense {
            let uploaded = gpu.upload("penumbra/caustics/photons", &within)?;
            shows.push(bind(&uploaded, shape, within.len() as u32, shell)?);
        }
        shows.push(bind(&traced.photons, grid(&photons, shrink), traced.count, rest)?);
        Ok(CausticMap { number, shows })
    }

    /// Adds its light at the tile's points.
    pub fn show(&self, frame: &mut Frame<'_>, tile: &Tile) {
        self.shows.iter().for_each(|show| show.record(frame, tile));
    }
}

/// The grid over photons, at least one, of a map whose discs are shrunk by `shrink`.
fn grid(photons: &[Photon], shrink: f64) -> GridShape {
    let corner = Vec3::splat(f32::INFINITY);
    let positions = photons.iter().map(|photon| Vec3::from(photon.position));
    let bounds = positions.fold((corner, -corner), |(low, high), p| (low.min(p), high.max(p)));
    let extent = bounds.1 - bounds.0;
    let cells = photons.len() as f64 / (f64::from(PHOTONS_PER_CELL) * shrink * shrink);
    let cells = (cells as u32).clamp(1, MAX_CELLS);
    GridShape::with_photons_per_cell(1.0, bounds, extent.length_squared(), cells, 1)
}

/// A part of space around dense photons that has a grid of its own.
struct DenseShell {
    shell: Shell,
    shape: GridShape,
    /// The photons that estimates in the shell may need.
    within: Vec<Photon>,
}

/// The shells of dense photons, the innermost first, and the shell around them, which all photons serve.
fn dense_shells(photons: &[Photon], shrink: f64) -> (Vec<DenseShell>, Shell) {
    let (centre, cubes) = dense_cubes(photons);
    let mut inner = Shell::ALL.inner;
    let mut shells = Vec::new();
    // From the innermost cube outwards, because a shell begins where the one within it ends.
    for half in cubes.into_iter().rev() {
        let is_within = |photon: &&Photon| distance(photon, centre) <= half;
        let within: Vec<Photon> = photons.iter().filter(is_within).copied().collect();
        let shape = grid(&within, shrink);
        // An estimate reads its own cell and those around it, so up to here the photons in the cube are all it needs.
        let outer = half - 2.0 * shape.cell;
        if outer > inner.max(0.0) {
            shells.push(DenseShell { shell: Shell { centre: centre.into(), inner, outer }, shape, within });
            inner = outer;
        }
    }
    (shells, Shell { centre: centre.into(), inner, ..Shell::ALL })
}

/// Half of the side of the cube about `centre` that has the photon on its surface.
fn distance(photon: &Photon, centre: Vec3) -> f32 {
    (Vec3::from(photon.position) - centre).abs().max_element()
}

/// Cubes within which photons, at least one, are far denser than around: their centre, and half of their sides, the
/// widest first. A single grid over a glass on a wide plain would have cells wider than the glass and blur its caustic.
fn dense_cubes(photons: &[Photon]) -> (Vec3, Vec<f32>) {
    let median = |axis: usize| {
        let mut positions: Vec<f32> = photons.iter().map(|photon| photon.position[axis]).collect();
        let middle = positions.len() / 2;
        *positions.select_nth_unstable_by(middle, f32::total_cmp).1
    };
    let centre = Vec3::from([0, 1, 2].map(median));
    let mut distances: Vec<f32> = photons.iter().map(|photon| distance(photon, centre)).collect();
    let mut half = distances.iter().copied().fold(0.0, f32::max);
    let mut cubes = Vec::new();
    while cubes.len() < MAX_CUBES {
        let dense = (DENSE_SHARE * (distances.len() - 1) as f64) as usize;
        let inner = MARGIN * *distances.select_nth_unstable_by(dense, f32::total_cmp).1;
        if inner == 0.0 || MIN_RATIO * inner > half {
            break;
        }
        half = inner;
        cubes.push(half);
        distances.retain(|distance| *distance <= half);
    }
    (centre, cubes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// `count` photons on a horizontal square, `half` of its side from `centre`.
    fn square(random: &mut Random, centre: Vec3, half: f64, count: usize) -> Vec<Photon> {
        let mut across = || (half * (2.0 * random.uniform() - 1.0)) as f32;
        let position = |_| (centre + Vec3::new(across(), 0.0, across())).to_array();
        (0..count).map(position).map(|position| Photon { position, word: 0 }).collect()
    }

    #[test]
    fn even_photons_have_no_dense_cubes() {
        let mut random = Random(1);
        for count in [1, 2, 3, 1000] {
            assert_eq!(dense_cubes(&square(&mut random, Vec3::X, 0.5, count)).1, [0.0; 0], "{count} photons");
        }
        // No cube is narrower than a point.
        let twins = vec![Photon { position: [0.1, 0.2, 0.3], word: 0 }; 100];
        assert_eq!(dense_cubes(&twins), (Vec3::new(0.1, 0.2, 0.3), Vec::new()));
    }

    /// Spots within spots, each a tenth as wide, with a share of the photons that leaves little around them.
    #[test]
    fn dense_cubes_enclose_the_spots() {
        let mut random = Random(2);
        let centre = Vec3::new(0.3, -0.1, 0.2);
        let halves = [0.5, 0.05, 0.005];
        let spots = halves.iter().zip([100, 1000, 10_000]);
        let photons: Vec<Photon> = spots.flat_map(|(half, n)| square(&mut random, centre, *half, n)).collect();
        let (found, cubes) = dense_cubes(&photons);
        // Nine tenths of the photons are in the smallest spot: the median is within a hundredth of its width.
        assert!((found - centre).abs().max_element() < 1e-4, "{found}");
        assert_eq!(cubes.len(), 1, "{cubes:?}: four fifths are in the smallest spot");
        // A cube reaches beyond the photons that make it dense.
        let dense = 0.005 * (0.8f32 * 1.11).sqrt();
        assert!((cubes[0] / (MARGIN * dense) - 1.0).abs() < 0.05, "{cubes:?}");
        // Without a dense spot in the middle, the next one is found.
        let (_, wider) = dense_cubes(&photons[..1100]);
        assert!(wider.len() == 1 && wider[0] > 0.05 && wider[0] < 0.08, "{wider:?}");
    }
}
