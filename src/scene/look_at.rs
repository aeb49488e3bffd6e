//! Cameras that a user places: a position, and a point to look at.

use glam::DVec3;

use super::camera::{Camera, Projection};
use super::description::Scene;

/// Distance of the near plane of a placed camera, as a share of the scene's size: less than the distance from which any
/// surface is viewed.
const NEAR: f32 = 1e-4;

/// If the sine of the angle between the view and the direction that is up is smaller, another direction takes its
/// place. It is far above rounding in double precision.
const STEEP: f64 = 1e-6;

/// How much a placed camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Extent {
    /// A perspective camera of this vertical field of view in degrees, more than 0 and less than 180.
    FieldOfView(f64),
    /// An orthographic camera that sees this height, more than 0, in the units of the file.
    Height(f64),
}

/// Vertical field of view in degrees of a camera that is not from the file. Blender's default is 39.6 along the longer
/// side of the image: a 50 mm lens and 36 mm of film.
pub(super) const DEFAULT_FOV: f64 = 40.0;

impl Default for Extent {
    fn default() -> Self {
        Extent::FieldOfView(DEFAULT_FOV)
    }
}

/// Position and target of a camera, in the file's world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookAt {
    /// The camera's position.
    pub from: DVec3,
    /// The point in the centre of the image.
    pub at: DVec3,
    /// The direction that is up in the image, of any length.
    pub up: DVec3,
    /// How much it sees.
    pub extent: Extent,
}

impl LookAt {
    /// An upright view: +Y is up.
    pub const fn upright(from: DVec3, at: DVec3, extent: Extent) -> LookAt {
        LookAt { from, at, up: DVec3::Y, extent }
    }

    /// The axes of the image, each of unit length: right, up and backward. If the view is along `up`, -Z is up in the
    /// image, or Y if the view is along Z. `None` if both positions are the same.
    pub fn axes(&self) -> Option<[DVec3; 3]> {
        let backward = (self.from - self.at).try_normalize()?;
        let ups = [self.up.normalize_or_zero(), DVec3::NEG_Z, DVec3::Y];
        let up = ups.into_iter().find(|up| up.cross(backward).length() > STEEP)?;
        let right = up.cross(backward).try_normalize()?;
        Some([right, backward.cross(right), backward])
    }
}

impl Scene {
    /// The camera of a placed view.
    ///
    /// # Errors
    /// What is wrong, if the view has no direction or the camera is too far away for a scene of this size.
    pub fn look_at(&self, view: &LookAt) -> Result<Camera, String> {
        let axes = view.axes().ok_or("the camera is at the position that it looks at, so it has no direction")?;
        let position = self.normalisation.apply(view.from);
        if !position.is_finite() {
            return Err("the camera is too far away for a scene of this size".to_owned());
        }
        let projection = match view.extent {
            Extent::FieldOfView(fov) => Projection::Perspective { yfov: fov.to_radians() as f32, aspect: None },
            Extent::Height(height) => {
                let half = (0.5 * height * self.normalisation.scale()) as f32;
                if !half.is_normal() {
                    return Err(format!("a height of {height} is out of range for a scene of this size"));
                }
                Projection::Orthographic { xmag: half, ymag: half }
            }
        };
        Ok(Camera {
            name: "placed".into(),
            position,
            axes: axes.map(|axis| axis.as_vec3()),
            projection,
            near: NEAR,
            far: f32::INFINITY,
            lens: None,
        })
    }
}
