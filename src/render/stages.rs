//! The stages of a render: with more samples there are more photons of indirect light, and more gather rays.

use crate::settings::Settings;

/// Samples per pixel from which on there are four times as many photons and gather rays; each time the samples increase
/// fourfold, so do they again. All samples share them, so more samples alone would not reduce their error.
const REFINED: u32 = 32;

/// A million photon rays, and some thousand rays per record by default.
const LAST_STAGE: i32 = 2;

/// The stage of the first sample: an image that comes two to four times sooner (`scenes/crowd.glb`, 128 x 128 pixels:
/// 0.12 s instead of 0.52) has at most a third more error. A second cheap stage gained nothing: with 64 rays until the
/// eighth sample the box had relMSE 1.8e-3 after 0.25 s, with 256 from the first on 1.2e-3 after 0.29 s.
const PREVIEW_STAGE: i32 = -2;

/// The stage of the samples that follow the first `samples`. Numbers that the user requested hold from the first one
/// on, and so do the photons of a map that is shown, where fewer would blur the image. A piece shows no preview.
pub(super) fn stage(settings: &Settings, samples: u32) -> i32 {
    let indirect = &settings.indirect;
    let requested = indirect.photons.is_some() || indirect.irradiance_cache.gather_rays.is_some();
    let shown_early = !requested && !settings.technique.shows_map() && settings.image.piece.is_none();
    if samples == 0 && shown_early {
        return PREVIEW_STAGE;
    }
    (samples / REFINED).checked_ilog2().map_or(0, |log| log as i32 / 2 + 1).min(LAST_STAGE)
}

/// The settings of a stage. Stage 0 has the settings of the render.
pub(super) fn settings_of_stage(settings: &Settings, stage: i32) -> Settings {
    let scaled = |number: u32, most: u32| {
        let scaled = f64::from(number) * 4f64.powi(stage);
        (scaled as u32).clamp(1, number.max(most))
    };
    settings.clone().with(|s| {
        s.indirect.photons = Some(scaled(settings.flux_photons(), Settings::MAX_PHOTONS));
        s.indirect.irradiance_cache.gather_rays = Some(scaled(settings.gather_rays(), Settings::MAX_GATHER_RAYS));
        // Other photons and directions; users may count up their seeds, so this one is far away.
        s.image.seed = settings.image.seed.wrapping_add((stage as u32).wrapping_mul(0x9e37_79b9));
    })
}
