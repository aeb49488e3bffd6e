//! A camera for scenes without one.

use glam::Vec3;

use super::camera::{Camera, Projection};
use super::description::Scene;
use super::triangle::NO_LIGHT;

/// Vertical field of view of [`Scene::frame_camera`] in degrees, as of a 50 mm lens on 36 mm film.
const FRAME_YFOV_DEGREES: f32 = 40.0;

impl Scene {
    /// A perspective camera in front of the scene and slightly above it. Its view contains every surface that emits no
    /// light (every surface, if all of them emit) in images that are not taller than wide.
    pub fn frame_camera(&self) -> Camera {
        let lit = (0..self.triangles.len()).filter(|&i| self.triangles[i].light == NO_LIGHT);
        let [lower, upper] = self
            .bounds_of(lit)
            .or_else(|| self.bounds())
            // An empty scene gets a box of about unit size.
            .unwrap_or([Vec3::splat(-1.0), Vec3::ONE]);
        let centre = 0.5 * (lower + upper);
        let radius = 0.5 * (upper - lower).length();
        let yfov = FRAME_YFOV_DEGREES.to_radians();
        let distance = radius / (0.5 * yfov).sin();
        let backward = Vec3::new(0.0, 0.35, 1.0).normalize();
        let up = (Vec3::Y - backward * backward.y).normalize();
        Camera {
            name: "framed".into(),
            position: centre + distance * backward,
            axes: [up.cross(backward), up, backward],
            projection: Projection::Perspective { yfov, aspect: None },
            near: 0.01 * radius,
            far: f32::INFINITY,
        }
    }
}
