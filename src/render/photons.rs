//! The photons of the visibility map, for those who want to see them.

use glam::Vec3;

use super::renderer::Renderer;
use crate::Result;
use crate::kernels::photon_word;

/// A photon of the visibility map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibilityPhoton {
    /// Position, in normalised space.
    pub position: Vec3,
    /// Index of its light.
    pub light: u32,
    /// Whether it is a shadow photon, and not an illumination photon.
    pub is_shadow: bool,
}

impl Renderer<'_> {
    /// The photons of the visibility map, in any order; none for techniques without one.
    ///
    /// # Errors
    /// As [`kernel_kit::Gpu::read`].
    pub fn visibility_photons(&self) -> Result<Vec<VisibilityPhoton>> {
        let Some(map) = &self.lighting.visibility_map else { return Ok(Vec::new()) };
        let photons = map.photons(self.gpu)?.into_iter().map(|photon| VisibilityPhoton {
            position: photon.position.into(),
            light: photon.light(),
            is_shadow: photon.word & photon_word::SHADOW != 0,
        });
        Ok(photons.collect())
    }
}
