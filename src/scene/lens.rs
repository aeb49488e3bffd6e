//! The lens of a camera: its iris, and where it is in focus.

use glam::Vec3;

use super::camera::{Camera, Lens, Projection};
use super::description::Scene;
use super::nearest::SurfaceSearch;

/// Height of a camera's film in metres: that of 35 mm film, to which f-numbers and focal lengths of cameras without a
/// stated film refer.
const FILM_HEIGHT: f64 = 0.024;

/// Maximum number of blades of an iris. With this many, no eye sees that the blur is not round.
pub const MAX_BLADES: u32 = 64;

/// Maximum of an iris's radius and of a focus distance, in units of the scene's size. Kernels divide them by the cosine
/// of a camera ray and square the result in f32, which ends at 2^128. At this distance a lens is in focus at infinity.
const MAX_LENGTH: f64 = (1u64 << 50) as f64;

/// Minimum of a focus distance over the camera's distance from the centre of the scene. f32 rounds positions to 2^-24
/// of the latter, so that a nearer point may move by a sixteenth of its distance or more.
const MIN_SHARE: f64 = 1.0 / (1u64 << 20) as f64;

/// Distance at which a lens is in focus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Focus {
    /// The nearest surface in the centre of the image.
    Auto,
    /// Along the viewing direction, in metres.
    Distance(f64),
}

/// The iris of a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iris {
    /// The f-number: focal length over diameter. More than 0.
    pub f_number: f64,
    /// Blades, 3 to [`MAX_BLADES`], which make it a regular polygon. 0: it is round.
    pub blades: u32,
}

impl Scene {
    /// Opens the iris of a perspective camera, whose film is 24 mm high. glTF's unit is the metre.
    ///
    /// # Errors
    /// What is wrong, if the camera is orthographic, a number is out of range, or nothing is in the centre of the
    /// image.
    pub fn open_iris(&self, camera: &mut Camera, iris: Iris, focus: Focus) -> Result<(), String> {
        let is_positive = |x: f64| x.is_finite() && x > 0.0;
        if !is_positive(iris.f_number) {
            return Err(format!("an f-number must be a finite number, more than 0, not {}", iris.f_number));
        }
        if let Focus::Distance(metres) = focus
            && !is_positive(metres)
        {
            return Err(format!("a focus distance must be a finite number, more than 0, not {metres}"));
        }
        if iris.blades != 0 && !(3..=MAX_BLADES).contains(&iris.blades) {
            return Err(format!("an iris must have no blades or from 3 to {MAX_BLADES}, not {}", iris.blades));
        }
        let Projection::Perspective { yfov, .. } = camera.projection else {
            return Err(format!("camera \"{}\" is orthographic, which has no iris", camera.name));
        };
        let focal_length = 0.5 * FILM_HEIGHT / (0.5 * f64::from(yfov)).tan();
        let scale = self.normalisation.scale();
        let distance = match focus {
            Focus::Distance(metres) => metres * scale,
            Focus::Auto => {
                let [position, ahead] = [camera.position, -camera.axes[2]].map(Vec3::as_dvec3);
                let range = f64::from(camera.near)..=f64::from(camera.far);
                let nearest = SurfaceSearch::new(self).nearest(position, ahead, &range);
                nearest.ok_or("nothing is in the centre of the image to focus on")?.depth
            }
        };
        // At the centre of the scene, squares of the minimum still are numbers in f32.
        let min = (f64::from(camera.position.length()) * MIN_SHARE).max(1.0 / MAX_LENGTH);
        if !(min..=MAX_LENGTH).contains(&distance) {
            let [min, max, metres] = [min, MAX_LENGTH, distance].map(|length| length / scale);
            return Err(format!(
                "a focus distance must be from {min:.1e} to {max:.1e} m in this scene, not {metres:?}"
            ));
        }
        let radius = 0.5 * focal_length / iris.f_number * scale;
        if radius > MAX_LENGTH {
            let min = 0.5 * focal_length / MAX_LENGTH * scale;
            return Err(format!("an f-number must be at least {min:.1e} in this scene, not {:?}", iris.f_number));
        }
        camera.lens = Some(Lens { radius: radius as f32, distance: distance as f32, blades: iris.blades });
        Ok(())
    }
}
