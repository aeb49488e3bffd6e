//! The visibility of each light from each cell of a grid, estimated by rays before the first sample, for the techniques
//! `visibility-cells` and `voxel-tags`.
//!
//! Rays start on the surfaces in a cell, not anywhere in its volume as in the original: half of the volume of a cell on
//! a floor is below the floor, and rays from there show nothing about its points.

use glam::DVec3;
use kernel_kit::Frame;
use rayon::prelude::*;

use super::direct_light::DirectLight;
use super::shared::Shared;
use crate::Result;
use crate::kernels::GridShape;
use crate::passes::Tile;
use crate::passes::cells::{BoundCells, CellGrid, CellPoint, CellTable, Cells, DISPATCH_RAYS};
use crate::passes::classify::Chunk;
use crate::random::Random;
use crate::scene::Scene;
use crate::settings::Settings;
use crate::statistics::totals::Totals;

/// The class words of all cells, bound to a tile whose points take the words of their cells.
pub(crate) struct CellVisibility {
    /// Owns the bound buffers.
    _table: CellTable,
    bound: BoundCells,
}

impl CellVisibility {
    /// Traces the rays of all cells, and binds the classes of direct light.
    pub fn new(
        shared: &Shared<'_>,
        kernel: &Cells,
        direct: &DirectLight,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<CellVisibility> {
        let Shared { gpu, scene, gpu_scene, tile } = *shared;
        let shape = GridShape::over_scene(scene, settings.cells.resolution);
        let surfaces = Surfaces::new(scene, &shape);
        let (rays, seed) = (settings.cells.rays_per_light, settings.image.seed);
        let grid = CellGrid { shape, lights: scene.lights.len() as u32, rays, seed };
        let table = kernel.trace(gpu, gpu_scene, &grid, surfaces.points(rays, seed))?;
        totals.cell_rays += table.rays;
        totals.photon_bytes += table.bytes;
        let bound = kernel.bind(gpu, tile, &table, &direct.classify_buffers().classes, gpu_scene)?;
        Ok(CellVisibility { _table: table, bound })
    }

    /// Gives the tile's points the classes of their cells.
    pub fn classify(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound.record(frame, tile, chunk);
    }
}

/// A triangle that lies in one cell: a part of a triangle of the scene.
struct CellTriangle {
    cell: u32,
    triangle: u32,
    corners: [DVec3; 3],
}

impl CellTriangle {
    /// Twice the area: only ratios of areas are used.
    fn area(&self) -> f64 {
        let [a, b, c] = self.corners;
        (b - a).cross(c - a).length()
    }
}

/// The surfaces of a scene, cut by cell.
struct Surfaces(Vec<CellTriangle>);

impl Surfaces {
    fn new(scene: &Scene, shape: &GridShape) -> Surfaces {
        let triangles = (0..scene.triangles.len()).into_par_iter();
        let mut parts: Vec<CellTriangle> = triangles.flat_map_iter(|i| clip_to_cells(scene, shape, i)).collect();
        parts.par_sort_by_key(|part| (part.cell, part.triangle));
        Surfaces(parts)
    }

    /// `rays` points in each cell that has some surface, stratified by area, cell by cell. Each list has the
    /// points of whole cells, for a dispatch.
    fn points(&self, rays: u32, seed: u32) -> impl Iterator<Item = Vec<CellPoint>> {
        let cells: Vec<&[CellTriangle]> = self.0.chunk_by(|a, b| a.cell == b.cell).collect();
        let of_dispatch = (DISPATCH_RAYS / rays) as usize;
        let lists: Vec<Vec<&[CellTriangle]>> = cells.chunks(of_dispatch).map(<[_]>::to_vec).collect();
        lists
            .into_iter()
            .map(move |cells| cells.into_par_iter().flat_map_iter(|parts| points_of_cell(parts, rays, seed)).collect())
    }
}

fn points_of_cell(parts: &[CellTriangle], rays: u32, seed: u32) -> impl Iterator<Item = CellPoint> {
    let mut random = Random(u64::from(seed) << 32 | u64::from(parts[0].cell));
    let total: f64 = parts.iter().map(CellTriangle::area).sum();
    let (mut next, mut below) = (0, parts[0].area());
    (0..rays).map(move |ray| {
        let at = total * (f64::from(ray) + random.uniform()) / f64::from(rays);
        while below < at && next + 1 < parts.len() {
            next += 1;
            below += parts[next].area();
        }
        let CellTriangle { corners: [a, b, c], triangle, .. } = parts[next];
        let (root, v) = (random.uniform().sqrt(), random.uniform());
        let position = a + (b - a) * (root * (1.0 - v)) + (c - a) * (root * v);
        CellPoint { position: position.as_vec3().to_array(), triangle }
    })
}

/// The parts of a triangle by cell. It is cut into slabs along x, these into columns along y, and these along z.
fn clip_to_cells(scene: &Scene, shape: &GridShape, triangle: usize) -> Vec<CellTriangle> {
    let mut found = Vec::new();
    let corners = scene.triangle_positions(triangle).map(|p| p.as_dvec3());
    slabs(&corners, shape, 0, &mut |x, slab| {
        slabs(slab, shape, 1, &mut |y, column| {
            slabs(column, shape, 2, &mut |z, part| {
                let cell = (z * shape.size[1] + y) * shape.size[0] + x;
                let fans = (2..part.len()).map(|i| [part[0], part[i - 1], part[i]]);
                let triangles = fans.map(|corners| CellTriangle { cell, triangle: triangle as u32, corners });
                found.extend(triangles.filter(|part| part.area() > 0.0));
            });
        });
    });
    found
}

/// Cuts a convex polygon at the grid's planes across an axis, and calls `each` with every part that is not empty.
fn slabs(polygon: &[DVec3], shape: &GridShape, axis: usize, each: &mut dyn FnMut(u32, &[DVec3])) {
    let (origin, cell) = (f64::from(shape.origin[axis]), f64::from(shape.cell));
    let last = shape.size[axis] - 1;
    let index = |x: f64| (((x - origin) / cell).max(0.0) as u32).min(last);
    let coordinates = || polygon.iter().map(|p| p[axis]);
    let first = index(coordinates().fold(f64::INFINITY, f64::min));
    let end = index(coordinates().fold(f64::NEG_INFINITY, f64::max));
    for slab in first..=end {
        let mut part = polygon.to_vec();
        if slab > first {
            part = clipped(&part, axis, origin + cell * f64::from(slab), 1.0);
        }
        if slab < end {
            part = clipped(&part, axis, origin + cell * f64::from(slab + 1), -1.0);
        }
        if part.len() > 2 {
            each(slab, &part);
        }
    }
}

/// The part of a convex polygon on the side `sign` of a plane across an axis (Sutherland and Hodgman).
fn clipped(polygon: &[DVec3], axis: usize, plane: f64, sign: f64) -> Vec<DVec3> {
    let mut part = Vec::with_capacity(polygon.len() + 1);
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (of_a, of_b) = (sign * (a[axis] - plane), sign * (b[axis] - plane));
        if of_a >= 0.0 {
            part.push(a);
        }
        if (of_a > 0.0 && of_b < 0.0) || (of_a < 0.0 && of_b > 0.0) {
            part.push(a + (b - a) * (of_a / (of_a - of_b)));
        }
    }
    part
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;

    use super::*;
    use crate::scene::{NO_LIGHT, Triangle, Vertex};

    /// Triangles across a grid are cut into parts that lie in their cells, and lose no area; points lie on the
    /// triangle, in their cell, the given number in each, and spread over it by area.
    #[test]
    fn triangles_are_cut_at_cells() {
        let mut random = Random(7);
        let mut point = || Vec3::from_array(std::array::from_fn(|_| random.uniform() as f32 * 2.0 - 1.0));
        let mut scene = Scene::default();
        for i in 0..40 {
            let corners = [point(), point(), point()];
            Arc::make_mut(&mut scene.vertices).extend(corners.map(|position| Vertex { position, ..Vertex::default() }));
            scene.triangles.push(Triangle { vertices: [3 * i, 3 * i + 1, 3 * i + 2], material: 0, light: NO_LIGHT });
        }
        let shape = GridShape::over_scene(&scene, 7);
        let cell_of = |p: DVec3| {
            let at = (p - Vec3::from(shape.origin).as_dvec3()) / f64::from(shape.cell);
            (at, [at.x, at.y, at.z].map(|x| x.floor() as u32))
        };
        for i in 0..scene.triangles.len() {
            let [a, b, c] = scene.triangle_positions(i).map(|p| p.as_dvec3());
            let parts = clip_to_cells(&scene, &shape, i);
            let area: f64 = parts.iter().map(CellTriangle::area).sum();
            let whole = (b - a).cross(c - a).length();
            assert!((area - whole).abs() < 1e-9 * whole, "triangle {i}: {area} of {whole}");
            for part in &parts {
                let middle = (part.corners[0] + part.corners[1] + part.corners[2]) / 3.0;
                let [x, y, z] = cell_of(middle).1;
                assert_eq!(part.cell, (z * shape.size[1] + y) * shape.size[0] + x);
                for corner in part.corners {
                    let (at, _) = cell_of(corner);
                    let from = (at - DVec3::new(f64::from(x), f64::from(y), f64::from(z)) - 0.5).abs().max_element();
                    assert!(from < 0.5 + 1e-5, "a corner {from} from the middle of its cell");
                }
            }
        }
        let rays = 16;
        let points: Vec<_> = Surfaces::new(&scene, &shape).points(rays, 1).flatten().collect();
        assert!(points.len() > 1000);
        for points in points.chunks(rays as usize) {
            let cells: Vec<_> = points.iter().map(|p| cell_of(Vec3::from(p.position).as_dvec3()).1).collect();
            // Rounding to f32 moves points over the faces between cells, a few in a million.
            assert!(cells.iter().filter(|cell| **cell != cells[0]).count() <= 1);
            for point in points {
                let [a, b, c] = scene.triangle_positions(point.triangle as usize).map(|p| p.as_dvec3());
                let normal = (b - a).cross(c - a).normalize();
                let off = normal.dot(Vec3::from(point.position).as_dvec3() - a).abs();
                assert!(off < 1e-6, "a point {off} off its triangle");
            }
        }

        // All in one cell: stratification gives each triangle rays in proportion to its area, to within one at either
        // end. The mean of its points is its centroid, within five standard errors of independent points.
        let rays = 4000;
        let surfaces = Surfaces::new(&scene, &GridShape::over_scene(&scene, 1));
        let total: f64 = surfaces.0.iter().map(CellTriangle::area).sum();
        let points: Vec<_> = surfaces.points(rays, 1).flatten().collect();
        assert_eq!((surfaces.0.len(), points.len()), (scene.triangles.len(), rays as usize));
        for part in &surfaces.0 {
            let own = points.iter().filter(|point| point.triangle == part.triangle);
            let count = own.clone().count() as f64;
            assert!((count - f64::from(rays) * part.area() / total).abs() <= 2.0, "{count} points");
            let sum: DVec3 = own.map(|point| Vec3::from(point.position).as_dvec3()).sum();
            let [a, b, c] = part.corners;
            let size = (b - a).length().max((c - a).length());
            let off = (sum / count - (a + b + c) / 3.0).length();
            assert!(off < 5.0 * size / count.sqrt(), "the middle is {off} off");
        }
    }
}
