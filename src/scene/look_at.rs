//! Cameras that a user places: a position, and what it looks at.

use glam::DVec3;

use super::camera::{Camera, Projection};
use super::description::Scene;

/// Share of the scene's size nearer than which a placed camera sees nothing: less than any surface is looked at from.
const NEAR: f32 = 1e-4;

/// Sine of the angle to the vertical below which the direction of view has no upright image of its own.
const STEEP: f64 = 1e-6;

/// Where a camera is, and where it looks, in the file's world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookAt {
    /// The camera's position.
    pub from: DVec3,
    /// What is in the centre of the image.
    pub at: DVec3,
    /// Vertical field of view in degrees, more than 0 and less than 180.
    pub fov: f64,
}

impl LookAt {
    /// Vertical field of view in degrees, if none is stated: as of a 50 mm lens on 36 mm film.
    pub const FOV: f64 = 40.0;

    /// The axes of the image, each of unit length: right, up and backward. +Y is up in the image; -Z, if the view is
    /// along Y. None if both positions are the same.
    pub fn axes(&self) -> Option<[DVec3; 3]> {
        let backward = (self.from - self.at).try_normalize()?;
        let up = if DVec3::Y.cross(backward).length() > STEEP { DVec3::Y } else { DVec3::NEG_Z };
        let right = up.cross(backward).try_normalize()?;
        Some([right, backward.cross(right), backward])
    }
}

impl Scene {
    /// The perspective camera of a placed view.
    ///
    /// # Errors
    /// What is wrong, if the view has no direction or the camera is too far away for a scene of this size.
    pub fn look_at(&self, view: &LookAt) -> Result<Camera, String> {
        let axes = view.axes().ok_or("the camera is at the position that it looks at, so it has no direction")?;
        let position = self.normalisation.apply(view.from);
        if !position.is_finite() {
            return Err("the camera is too far away for a scene of this size".to_owned());
        }
        Ok(Camera {
            name: "placed".into(),
            position,
            axes: axes.map(|axis| axis.as_vec3()),
            projection: Projection::Perspective { yfov: view.fov.to_radians() as f32, aspect: None },
            near: NEAR,
            far: f32::INFINITY,
            lens: None,
        })
    }
}
