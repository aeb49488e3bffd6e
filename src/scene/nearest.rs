//! The nearest surface along a ray, for what is asked about one ray: a picked pixel, or the focus of a lens.

use std::ops::RangeInclusive;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::description::Scene;
use super::instance::SharedMesh;
use super::triangle::Vertex;
use crate::procedural::box_corners;

/// A surface that a ray meets.
pub struct Nearest {
    /// The multiple of the ray's direction at which it does.
    pub depth: f64,
    /// Index of its material.
    pub material: u32,
    /// Unit normal of the triangle, to either side; none of an object that is a function, or of a triangle of no area.
    pub normal: Option<DVec3>,
}

impl Scene {
    /// The first surface that a ray meets at a multiple of `way` in `range`, in normalised space. Textures let no ray
    /// pass, and objects that are functions are met at their boxes.
    pub fn nearest(&self, origin: DVec3, way: DVec3, range: &RangeInclusive<f64>) -> Option<Nearest> {
        let met = |index: usize, place: &dyn Fn(Vec3) -> Vec3| {
            let corners = self.triangle_positions(index).map(|corner| place(corner).as_dvec3());
            let depth = triangle_depth(corners, origin, way).filter(|depth| range.contains(depth))?;
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a).try_normalize();
            Some(Nearest { depth, material: self.triangles[index].material, normal })
        };
        let flat = (0..self.flat_triangles()).into_par_iter().filter_map(|index| met(index, &|corner| corner));
        let around = |mesh: &SharedMesh| corners_around(&self.vertices[mesh.vertices.clone()]);
        let boxes: Vec<_> = self.shared_meshes.par_iter().map(around).collect();
        let instances = self.instances.par_iter().filter(|instance| {
            let corners = boxes[instance.mesh].map(|corner| instance.apply(corner));
            box_depths(&corners, origin, way).is_some_and(|[_, leave]| leave >= 0.0)
        });
        let of_instances = instances.flat_map_iter(|instance| {
            let triangles = self.shared_meshes[instance.mesh].triangles.clone();
            triangles.filter_map(move |index| met(index, &|corner| instance.apply(corner)))
        });
        let objects = self.procedurals.par_iter().filter_map(|object| {
            let [enter, _] = box_depths(&object.corners(), origin, way)?;
            range.contains(&enter).then_some(Nearest { depth: enter, material: object.material, normal: None })
        });
        flat.chain(of_instances).chain(objects).min_by(|a, b| a.depth.total_cmp(&b.depth))
    }
}

/// The corners of the box around vertices.
fn corners_around(vertices: &[Vertex]) -> [Vec3; 8] {
    let positions = || vertices.iter().map(|vertex| vertex.position);
    let ends = [positions().fold(Vec3::MAX, Vec3::min), positions().fold(Vec3::MIN, Vec3::max)];
    box_corners(ends.map(|end| end.as_dvec3())).map(|corner| corner.as_vec3())
}

/// The multiples of `way` at which a ray enters and leaves the box around the corners of another box.
fn box_depths(corners: &[Vec3; 8], origin: DVec3, way: DVec3) -> Option<[f64; 2]> {
    let lower = corners.iter().copied().reduce(Vec3::min)?.as_dvec3() - origin;
    let upper = corners.iter().copied().reduce(Vec3::max)?.as_dvec3() - origin;
    let (a, b) = (lower / way, upper / way);
    let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
    (enter <= leave).then_some([enter, leave])
}

/// The multiple of `way` at which a ray meets a triangle, from either side.
fn triangle_depth([a, b, c]: [DVec3; 3], origin: DVec3, way: DVec3) -> Option<f64> {
    let (a, b, c) = (a - origin, b - origin, c - origin);
    let normal = (b - a).cross(c - a);
    let depth = a.dot(normal) / way.dot(normal);
    let at = depth * way;
    let inside = |p: DVec3, q: DVec3| (q - p).cross(at - p).dot(normal) >= 0.0;
    (depth.is_finite() && inside(a, b) && inside(b, c) && inside(c, a)).then_some(depth)
}
