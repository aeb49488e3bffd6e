//! The environment of a scene: a panorama infinitely far away.

use std::sync::Arc;

use super::description::Scene;
use super::light::{Light, LightKind};
use super::panorama::Panorama;
use crate::{Error, Result};

/// Most radiance of a texel, strength included: its quotient by the least density that the sampling table has is a float.
const MOST_RADIANCE: f32 = 1e30;

impl Scene {
    /// Puts the scene into a panorama, in place of one that it may have: turned by `rotation` degrees about +Y,
    /// counter-clockwise seen from above as a node would be, its radiance multiplied by `strength`.
    ///
    /// # Errors
    /// [`Error::Usage`] where the rotation is not finite, or the strength negative or so large that radiance overflows.
    pub fn set_environment(&mut self, panorama: Arc<Panorama>, rotation: f64, strength: f32) -> Result<()> {
        if !rotation.is_finite() {
            return Err(Error::Usage(format!("--environment-rotation is {rotation}; it must be finite")));
        }
        if !(strength >= 0.0 && panorama.brightest() * strength <= MOST_RADIANCE) {
            let problem = format!("it must be 0 or more, and bring no texel above {MOST_RADIANCE:e}");
            return Err(Error::Usage(format!("--environment-strength is {strength}; {problem}")));
        }
        let turn = (rotation / 360.0).rem_euclid(1.0) as f32;
        self.lights.truncate(self.placed_lights().len());
        let kind = LightKind::Environment { panorama, turn, strength };
        self.lights.push(Light { name: "environment".into(), kind });
        Ok(())
    }

    /// The lights of which photons can tell lit points from shadowed ones: all but the environment, which is the last.
    pub fn placed_lights(&self) -> &[Light] {
        match self.lights.split_last() {
            Some((Light { kind: LightKind::Environment { .. }, .. }, others)) => others,
            _ => &self.lights,
        }
    }

    /// The panorama around the scene, where there is one.
    pub fn environment(&self) -> Option<&Panorama> {
        self.lights.last().and_then(|light| match &light.kind {
            LightKind::Environment { panorama, .. } => Some(panorama.as_ref()),
            _ => None,
        })
    }
}
