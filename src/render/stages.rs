//! The stages of a render: with more samples there are more photons of indirect light, and more gather rays.

use crate::settings::Settings;

/// Samples per pixel from which on there are four times as many photons and gather rays; each time the samples increase
/// fourfold, so do they again. All samples share photons and records, so more samples alone would not reduce their
/// error.
const REFINED: u32 = 32;

/// Maximum number of such steps, which is a million photon rays and some thousand rays per record by default.
const MAX_STAGES: u32 = 2;

/// The number of such steps for a number of samples.
pub(super) fn stage(samples: u32) -> u32 {
    ((samples / REFINED).checked_ilog2().map_or(0, |log| log / 2 + 1)).min(MAX_STAGES)
}

/// The settings of a stage. Stage 0 has the settings of the render.
pub(super) fn refined(settings: &Settings, stage: u32) -> Settings {
    let more = |number: u32, most: u32| number.saturating_mul(1 << (2 * stage)).min(number.max(most));
    settings.clone().with(|s| {
        s.indirect.photons = more(settings.indirect.photons, Settings::MAX_PHOTONS);
        s.indirect.irradiance_cache.gather_rays =
            more(settings.indirect.irradiance_cache.gather_rays, Settings::MAX_GATHER_RAYS);
        // Other photons and directions; users may count up their seeds, so this one is far away.
        s.image.seed = settings.image.seed.wrapping_add(stage.wrapping_mul(0x9e37_79b9));
    })
}
