//! Notes on an image: that it shows nothing of its scene, or that it is too dim for its variance.

use super::renderer::Renderer;
use crate::Image;
use crate::settings::{Aov, Denoise};
use crate::statistics::Counter;

/// Radiance of the brightest pixel below which squares are lost: 2^-55. The smallest step of a picture with eight bits
/// is then 1/256 of it, 2^-63, whose square is 2^-126. Devices may round smaller numbers to 0.
const DIM: f32 = 1.0 / (1u64 << 55) as f32;

impl Renderer<'_> {
    /// A note if `image`, an image of this render, shows nothing of the scene, or if its light is so dim that the
    /// variance of samples is lost.
    pub fn note_on(&self, image: &Image) -> Option<String> {
        self.note_on_nothing(image).or_else(|| self.note_on_dim_light(image))
    }

    /// There is no note for an empty scene or one without light, which import notes, nor for a part of an image, which
    /// may well be empty.
    fn note_on_nothing(&self, image: &Image) -> Option<String> {
        let is_zero = |name: &str| image.channel(name).is_some_and(|samples| samples.iter().all(|x| *x == 0.0));
        let Renderer { scene, camera, settings, .. } = self;
        if scene.is_empty() || settings.image.crop.is_some() {
            return None;
        }
        if is_zero("A") {
            let missed = || "the camera sees nothing: no ray from it has met a surface".into();
            return scene.clipped_away(camera).or_else(|| Some(missed()));
        }
        // Another note is on samples that were left out.
        if scene.lights.is_empty()
            || self.totals.get(Counter::NotFinite) > 0
            || !["R", "G", "B"].into_iter().all(is_zero)
        {
            return None;
        }
        let reason = if settings.light_scale == 0.0 { "`light_scale` is 0" } else { "no sample has found light" };
        Some(format!("the image is black: {reason}"))
    }

    fn note_on_dim_light(&self, image: &Image) -> Option<String> {
        let settings = &self.settings.image;
        if settings.denoise == Denoise::None && !settings.aovs.contains(&Aov::Variance) {
            return None;
        }
        let brightest = image.rgb().ok()?.into_iter().flatten().copied().fold(0.0, f32::max);
        (brightest > 0.0 && brightest < DIM).then(|| {
            "the light is so dim that squares of samples are rounded to 0: the channel variance is too small, and \
             denoisers leave noise; brighten the lights with `light_scale`"
                .into()
        })
    }
}
