//! Bounding spheres.

use glam::Vec3;
use rayon::prelude::*;

use crate::bvh::Aabb;

/// A sphere around the points, centred in their box; of radius 0 where there is no point.
pub(super) fn bounding_sphere(points: impl Iterator<Item = Vec3> + Clone) -> (Vec3, f32) {
    let bounds = Aabb::of(points.clone());
    sphere_in(bounds, |centre| points.map(|p| distance(p, centre)).fold(0.0, f64::max))
}

/// As [`bounding_sphere`], by all threads: for the points of a scene.
pub(super) fn bounding_sphere_of_scene(points: impl ParallelIterator<Item = Vec3> + Clone) -> (Vec3, f32) {
    let bounds = points.clone().fold(Aabb::default, |all, p| all.extended(p)).reduce(Aabb::default, |a, b| a.union(&b));
    sphere_in(bounds, |centre| points.map(|p| distance(p, centre)).reduce(|| 0.0, f64::max))
}

fn distance(point: Vec3, centre: Vec3) -> f64 {
    point.as_dvec3().distance(centre.as_dvec3())
}

/// The sphere about the centre of a box, with the radius for that centre.
fn sphere_in(bounds: Aabb, radius: impl FnOnce(Vec3) -> f64) -> (Vec3, f32) {
    if bounds == Aabb::EMPTY {
        return (Vec3::ZERO, 0.0);
    }
    let centre = (bounds.min + bounds.max) / 2.0;
    // Rounded up, so that no point is outside.
    (centre, (radius(centre) as f32).next_up())
}
