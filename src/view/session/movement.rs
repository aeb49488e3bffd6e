//! Movements of the camera: each replaces it by one that the user placed.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use super::picture::Viewpoint;
use super::state::{Loaded, State};
use crate::Result;
use crate::scene::{Extent, Framing, LookAt, Scene};
use crate::view::navigation;
use crate::view::pick::pick;

/// The share of the distance to a point that remains after moving the camera towards it. However often
/// it moves, it does not pass the point.
pub(super) const NEARER: f64 = 0.5;

/// Depth of the camera's target if nothing is in the centre of its image: about the size of the scene.
const EMPTY_DEPTH: f32 = 1.0;

impl State {
    /// The scene, and the camera as a movable one; `None` without a scene.
    pub(super) fn view(&self) -> Result<Option<(Arc<Scene>, LookAt)>> {
        let Some(Loaded { scene, .. }) = self.scene.clone() else { return Ok(None) };
        if let Viewpoint::Placed(view) = self.eye.viewpoint {
            return Ok(Some((scene, view)));
        }
        let camera = self.camera(&scene)?;
        let scale = scene.normalisation.scale();
        let centre = pick(&scene, &camera, self.full_size(), [0.5, 0.5]);
        let depth = centre.map_or(EMPTY_DEPTH, |hit| (hit.depth * scale) as f32);
        let view = navigation::placed(&scene, &camera, depth);
        Ok(Some((scene, view)))
    }

    /// Replaces the camera by the result of `change`, unless that is `None`.
    pub(super) fn navigate(&mut self, change: impl FnOnce(&Scene, &LookAt) -> Option<LookAt>) -> Result<()> {
        let Some((scene, view)) = self.view()? else { return Ok(()) };
        let Some(changed) = change(&scene, &view) else { return Ok(()) };
        let rounded = navigation::rounded(&changed, scene.normalisation.scale());
        // A camera at its own target would have no direction.
        if rounded.axes().is_some() {
            (self.eye.viewpoint, self.eye.fov) = (Viewpoint::Placed(rounded), None);
            self.moved = Some(Instant::now());
        }
        Ok(())
    }
}

/// The whole scene from the side of `view`, for an image of this size.
pub(super) fn framed(scene: &Scene, view: &LookAt, [width, height]: [u32; 2]) -> Option<LookAt> {
    let [_, _, backward] = view.axes()?;
    let aspect = width as f32 / height as f32;
    let [lower, upper] = scene.bounds()?;
    let fov = match view.extent {
        Extent::FieldOfView(fov) if view.up == DVec3::Y => Some(fov as f32),
        _ => None,
    };
    let Some(fov) = fov else {
        let centre = scene.normalisation.undo(0.5 * (lower + upper));
        let radius = 0.5 * f64::from((upper - lower).length()) / scene.normalisation.scale();
        return navigation::around(view, centre, radius, aspect.into());
    };
    let framing = Framing {
        azimuth: backward.x.atan2(backward.z).to_degrees() as f32,
        elevation: backward.y.clamp(-1.0, 1.0).asin().to_degrees() as f32,
        aspect,
        fov,
    };
    let camera = scene.frame(&framing);
    let depth = (camera.position - 0.5 * (lower + upper)).dot(camera.axes[2]);
    Some(navigation::placed(scene, &camera, depth))
}
