//! A renderer, and the inputs that it was made for.

use super::picture::Eye;
use super::state::Origin;
use crate::render::photons::{NearestPhotons, SurfacePoint, VisibilityPhoton};
use crate::scene::Camera;
use crate::settings::Settings;
use crate::{Renderer, Result};

/// The inputs that a renderer was made for. The camera may change, and while it moves so may the size.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Subject {
    pub origin: Origin,
    pub settings: Settings,
    pub has_lens: bool,
}

impl Subject {
    /// Whether they differ in the size of the picture alone.
    pub fn is_resized(&self, other: &Subject) -> bool {
        let mut settings = other.settings.clone();
        (settings.image.width, settings.image.height) = (self.settings.image.width, self.settings.image.height);
        *self == Subject { settings, ..other.clone() }
    }
}

/// The renderer of a picture.
pub(super) struct Render<'g> {
    pub renderer: Renderer<'g>,
    pub subject: Subject,
    pub eye: Eye,
    pub camera: Camera,
    pub size: [u32; 2],
    /// It is shown only while the camera moves, or before the picture.
    pub is_preview: bool,
    /// It is the first picture.
    pub is_first: bool,
    pub photons: Option<Vec<VisibilityPhoton>>,
    /// A denoiser has failed: the picture stays raw.
    pub is_raw: bool,
}

impl Render<'_> {
    /// Begins the picture of another view.
    pub fn set_view(&mut self, eye: &Eye, camera: Camera, size: [u32; 2], is_preview: bool) -> Result<()> {
        if is_preview {
            self.renderer.preview(&camera, size)?;
        } else {
            self.renderer.set_view(&camera, size)?;
            // The renderer may have emitted other photons.
            self.photons = None;
        }
        (self.eye, self.camera, self.size) = (eye.clone(), camera, size);
        (self.is_preview, self.is_first) = (is_preview, false);
        Ok(())
    }

    /// The photons of the visibility map, if there is one yet.
    pub fn photons(&mut self) -> Result<&[VisibilityPhoton]> {
        if self.photons.is_none() {
            self.photons = self.renderer.visibility_photons()?;
        }
        Ok(self.photons.as_deref().unwrap_or_default())
    }

    /// The point that is lit at a point of the image, from 0 to 1 each way.
    pub fn point(&self, at: [f32; 2]) -> Result<Option<SurfacePoint>> {
        let index = |x: f32, side: u32| ((x * side as f32) as u32).min(side - 1);
        self.renderer.surface_point([index(at[0], self.size[0]), index(at[1], self.size[1])])
    }

    /// The photons that decide a point for a light.
    pub fn nearest(&mut self, point: SurfacePoint, light: usize) -> Result<Option<NearestPhotons>> {
        self.photons()?;
        let photons = self.photons.as_deref().unwrap_or_default();
        Ok(self.renderer.nearest_photons(photons, point, light as u32))
    }
}
