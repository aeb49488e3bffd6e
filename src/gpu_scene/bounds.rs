//! Bounding spheres.

use glam::Vec3;

/// A sphere around the points, centred in their box; of radius 0 where there is no point.
pub(super) fn bounding_sphere(points: impl Iterator<Item = Vec3> + Clone) -> (Vec3, f32) {
    let (low, high) = points
        .clone()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), point| (low.min(point), high.max(point)));
    if low.x > high.x {
        return (Vec3::ZERO, 0.0);
    }
    let centre = (low + high) / 2.0;
    let radius = points.map(|point| point.as_dvec3().distance(centre.as_dvec3())).fold(0.0, f64::max);
    // Rounded up, so that no point is outside.
    (centre, (radius as f32).next_up())
}
