//! The environment of a scene.

use std::sync::Arc;

use super::description::Scene;
use super::light::{Light, LightKind};
use super::panorama::Panorama;
use crate::{Error, Result};

/// Maximum radiance of a texel, strength included. Divided by the minimum density of the sampling table it must not
/// overflow.
const MAX_RADIANCE: f32 = 1e30;

/// Beginning of notes on a file without lights; with an environment there is light.
pub(super) const NO_LIGHT_NOTE: &str = "no light in the file";

impl Scene {
    /// Sets the environment of the scene and replaces an existing one. The panorama is rotated by `rotation` degrees
    /// about +Y, counter-clockwise as seen from above like a node, and its radiance is multiplied by `strength`.
    ///
    /// # Errors
    /// [`Error::Usage`] if the rotation is not finite, or if the strength is negative or makes the radiance overflow.
    pub fn set_environment(&mut self, panorama: Arc<Panorama>, rotation: f64, strength: f32) -> Result<()> {
        if !rotation.is_finite() {
            return Err(Error::Usage(format!("`environment_rotation` is {rotation}; it must be finite")));
        }
        if !(strength >= 0.0 && panorama.brightest() * strength <= MAX_RADIANCE) {
            let problem = format!("it must be at least 0, and no texel may exceed {MAX_RADIANCE:e}");
            return Err(Error::Usage(format!("`environment_strength` is {strength}; {problem}")));
        }
        let turn = (rotation / 360.0).rem_euclid(1.0) as f32;
        self.lights.truncate(self.placed_lights().len());
        let kind = LightKind::Environment { panorama, turn, strength };
        self.lights.push(Light { name: "environment".into(), kind });
        self.notes.retain(|note| !note.starts_with(NO_LIGHT_NOTE));
        Ok(())
    }

    /// All lights except the environment, which is the last one. Only these have visibility photons.
    pub fn placed_lights(&self) -> &[Light] {
        match self.lights.split_last() {
            Some((Light { kind: LightKind::Environment { .. }, .. }, others)) => others,
            _ => &self.lights,
        }
    }

    /// The panorama of the environment, if there is one.
    pub fn environment(&self) -> Option<&Panorama> {
        self.lights.last().and_then(|light| match &light.kind {
            LightKind::Environment { panorama, .. } => Some(panorama.as_ref()),
            _ => None,
        })
    }
}
