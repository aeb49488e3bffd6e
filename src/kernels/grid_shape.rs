//! Regular grids of cubic cells: of photons, of zones, and of the methods that classify cells.

use glam::{DVec3, UVec3, Vec3};
use kernel_kit::shared_struct;

use super::numbers::REACH_CELLS;
use crate::scene::Scene;

/// Photons in a cell of an evenly covered surface, as a share of k. Measured on the box: half of it doubles the cells
/// to be classified and the rows of a search, and decides no more points; twice decides 1 % fewer.
pub const PHOTONS_PER_CELL: f32 = 0.16;

/// Maximum number of cells of a map, all lights together: 28 bytes each, and 20 of them again where tables are
/// textures. The methods that classify cells by rays need 8 bytes each.
const MAX_CELLS: f64 = (1u32 << 22) as f64;

shared_struct! {
    /// The grid of one light; all lights have the same. Cells are cubes, x runs fastest.
    pub struct GridShape {
        /// Lower corner, in normalised space.
        pub origin: [f32; 3],
        /// Edge of a cell.
        pub cell: f32,
        /// Cells along each axis, at least 1.
        pub size: [u32; 3],
        /// 1 / `cell`.
        pub inverse_cell: f32,
    }
}

impl GridShape {
    /// A grid over `bounds` (lower and upper corner) for `photons` photons of one of `lights` lights on surfaces of
    /// area `area`, for queries of the nearest `nearest`.
    pub fn new(bounds: (Vec3, Vec3), area: f32, photons: u32, lights: u32, nearest: u32) -> GridShape {
        Self::with_photons_per_cell(PHOTONS_PER_CELL * nearest as f32, bounds, area, photons, lights)
    }

    /// As [`GridShape::new`], but a cell of an evenly covered surface holds `per_cell` photons, at least 1.
    pub fn with_photons_per_cell(
        per_cell: f32,
        bounds: (Vec3, Vec3),
        area: f32,
        photons: u32,
        lights: u32,
    ) -> GridShape {
        // With more cells than twice the number of photons, nearly all would be empty.
        let max_cells = (MAX_CELLS / f64::from(lights.max(1))).min(2.0 * f64::from(photons));
        Self::with_max_cells(per_cell, bounds, area, photons, max_cells)
    }

    /// As [`GridShape::with_photons_per_cell`], with at most `max_cells` cells.
    pub fn with_max_cells(per_cell: f32, bounds: (Vec3, Vec3), area: f32, photons: u32, max_cells: f64) -> GridShape {
        // A border keeps photons on the scene's hull away from the grid's faces. Around a single point it is wider than
        // rounding of positions, which are up to 1.
        let border = 1e-6f32.max((bounds.1 - bounds.0).max_element() * 1e-3);
        let (low, high) = (bounds.0 - border, bounds.1 + border);
        let extent = (high - low).as_dvec3();
        let per_cell = f64::from(per_cell.max(1.0));
        let mut cell = (f64::from(area) * per_cell / f64::from(photons.max(1))).sqrt();
        let max_cells = max_cells.max(1.0);
        // Surfaces may have no area. With 2,048 cells along a side at most, the loop ends within 400 steps.
        cell = cell.clamp(extent.max_element() / 2048.0, extent.max_element());
        let size = |cell: f64| (extent / cell).ceil().max(DVec3::ONE);
        while size(cell).element_product() > max_cells && cell < extent.max_element() {
            // A step removes about 6 % of the cells, and no more than that is lost.
            cell *= 1.02;
        }
        GridShape::of_cells(low, cell as f32, size(f64::from(cell as f32)))
    }

    /// A grid of `size` cells from the corner `origin` on.
    fn of_cells(origin: Vec3, cell: f32, size: DVec3) -> GridShape {
        let size = size.as_uvec3().max(UVec3::ONE).to_array();
        GridShape { origin: origin.to_array(), cell, size, inverse_cell: 1.0 / cell }
    }

    /// A grid over the scene with `cells` cells along its longest side, or fewer where there are many lights.
    pub fn over_scene(scene: &Scene, cells: u32) -> GridShape {
        let [low, high] = scene.bounds().unwrap_or([Vec3::ZERO; 2]);
        // Surfaces on the scene's hull lie inside cells, not on their faces.
        let border = 1e-3f32.max((high - low).max_element() * 1e-3);
        let (low, high) = ((low - border).as_dvec3(), (high + border).as_dvec3());
        let max_cells = MAX_CELLS / (scene.lights.len().max(1) as f64);
        let shape = |cells: u32| {
            let cell = (high - low).max_element() / f64::from(cells);
            // Slightly less, so that rounding adds no cell to the longest side.
            let size = ((high - low) / cell - 1e-6).ceil().max(DVec3::ONE);
            (cell, size)
        };
        let fits = |(_, size): &(f64, DVec3)| size.element_product() <= max_cells;
        let (cell, size) = (1..=cells).rev().map(shape).find(fits).unwrap_or(shape(1));
        GridShape::of_cells(low.as_vec3(), cell as f32, size)
    }

    /// Cells of one light.
    pub fn cells(&self) -> u32 {
        self.size.iter().product()
    }

    /// The largest search radius, in normalised space: points with fewer than k photons within it are unknown.
    pub fn reach(&self) -> f32 {
        REACH_CELLS as f32 * self.cell
    }
}
