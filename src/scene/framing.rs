//! The camera of a scene whose file has none.

use glam::Vec3;

use super::camera::{Camera, Projection};
use super::description::Scene;
use super::triangle::NO_LIGHT;

/// Vertical field of view of [`Scene::frame_camera`] in degrees: that of a 50 mm lens on a camera
/// for 36 mm film.
const FRAME_YFOV_DEGREES: f32 = 40.0;

impl Scene {
    /// A perspective camera before the scene and a little above it, whose view holds all of what
    /// emits no light (all of the scene where everything does), for images that are no taller
    /// than wide.
    pub fn frame_camera(&self) -> Camera {
        let lit = (0..self.triangles.len()).filter(|&i| self.triangles[i].light == NO_LIGHT);
        let [lower, upper] = self
            .bounds_of(lit)
            .or_else(|| self.bounds())
            // An empty scene is as good as any: unit size.
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
