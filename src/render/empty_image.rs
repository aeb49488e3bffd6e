//! The note on an image that shows nothing of its scene.

use super::renderer::Renderer;
use crate::Image;

impl Renderer<'_> {
    /// A note if `image`, an image of this render, shows nothing of the scene. There is no note for an empty scene or
    /// one without light, which import notes, nor for a part of an image, which may well be empty.
    pub fn note_on(&self, image: &Image) -> Option<String> {
        let is_zero = |name: &str| image.channel(name).is_some_and(|samples| samples.iter().all(|x| *x == 0.0));
        let Renderer { scene, camera, settings, .. } = self;
        if scene.is_empty() || settings.image.crop.is_some() {
            return None;
        }
        if is_zero("A") {
            let missed = || "the camera sees nothing: no ray from it has met a surface".into();
            return scene.clipped_away(camera).or_else(|| Some(missed()));
        }
        let is_black = ["R", "G", "B"].into_iter().all(is_zero);
        (is_black && !scene.lights.is_empty()).then(|| "the image is black: no sample has found light".into())
    }
}
