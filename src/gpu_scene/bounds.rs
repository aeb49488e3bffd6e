//! Centres of triangles, and bounding spheres.

use glam::{DVec3, DVec4, Vec3};
use rayon::prelude::*;

use crate::bvh::Aabb;

/// The centre of area of a light's triangles. It lies in the plane of a light that lies in one plane, and within a
/// convex light. The centre of its box may lie outside of both: that of a corner cut off a cube lies in the air before
/// the cut. From positions that such a centre hides, potentials (`mesh_potential`) and views (`ConvexLamp`) would never
/// sample the light.
pub(super) fn centre_of_area(triangles: &[[Vec3; 3]]) -> Vec3 {
    let weighted = |triangle: &[Vec3; 3]| {
        let centroid = triangle.iter().map(|corner| corner.as_dvec3()).sum::<DVec3>() / 3.0;
        centroid.extend(1.0) * area(triangle)
    };
    let sum: DVec4 = triangles.iter().map(weighted).sum();
    (sum.truncate() / sum.w).as_vec3()
}

/// The area of a triangle.
pub(super) fn area([a, b, c]: &[Vec3; 3]) -> f64 {
    (*b - *a).as_dvec3().cross((*c - *a).as_dvec3()).length() / 2.0
}

/// The smallest sphere about `centre` that holds the points.
pub(super) fn sphere_about(centre: Vec3, points: impl Iterator<Item = Vec3>) -> (Vec3, f32) {
    (centre, rounded_up(points.map(|p| distance(p, centre)).fold(0.0, f64::max)))
}

/// A sphere around the points of a scene, centred in their box; of radius 0 where there is no point.
pub(super) fn bounding_sphere_of_scene(points: impl ParallelIterator<Item = Vec3> + Clone) -> (Vec3, f32) {
    let bounds = points.clone().fold(Aabb::default, |all, p| all.extended(p)).reduce(Aabb::default, |a, b| a.union(&b));
    if bounds == Aabb::EMPTY {
        return (Vec3::ZERO, 0.0);
    }
    let centre = (bounds.min + bounds.max) / 2.0;
    (centre, rounded_up(points.map(|p| distance(p, centre)).reduce(|| 0.0, f64::max)))
}

fn distance(point: Vec3, centre: Vec3) -> f64 {
    point.as_dvec3().distance(centre.as_dvec3())
}

/// So that no point is outside.
fn rounded_up(radius: f64) -> f32 {
    (radius as f32).next_up()
}
