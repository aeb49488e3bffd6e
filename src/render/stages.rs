//! The stages of a render: with more samples there are more photons of indirect light, and more gather rays.

use crate::settings::Settings;

/// The stage of the first sample, with a sixteenth of the photons and gather rays of the settings: its image comes two
/// to four times sooner (`scenes/crowd.glb`, 128 x 128 pixels: 0.12 s instead of 0.52).
const PREVIEW_STAGE: i32 = -4;

/// Sixteen times the photons and gather rays of the settings: by default a million photons, and some thousand rays.
const LAST_STAGE: i32 = 4;

/// Samples per pixel from which on there are the photons and gather rays of the settings. Each time the samples double,
/// so do they: indirect light then takes about the same part of the time however long a render is. `scenes/box.glb` has
/// the least error at equal time with 8, `scenes/crowd.glb` and `scenes/sphere.glb` with 16.
const SAMPLES_OF_SETTINGS: f64 = 12.0;

/// The stage of the samples that follow the first `samples`. Numbers that the user requested hold from the first one
/// on, and so do the photons of a map that is shown, where fewer would blur the image. A piece shows no preview.
pub(super) fn stage(settings: &Settings, samples: u32) -> i32 {
    let indirect = &settings.indirect;
    let requested = indirect.photons.is_some() || indirect.irradiance_cache.gather_rays.is_some();
    let shown_early = !requested && !settings.technique.shows_map() && settings.image.piece.is_none();
    let first = if shown_early { PREVIEW_STAGE } else { 0 };
    // Minus infinity is the least integer.
    let doublings = (f64::from(samples) / SAMPLES_OF_SETTINGS).log2().floor() as i32;
    doublings.clamp(first, LAST_STAGE)
}

/// The settings of a stage: the photons of its map, and the gather rays of a record in all stages so far. Stage 0 has
/// those of the settings.
pub(super) fn settings_of_stage(settings: &Settings, stage: i32) -> Settings {
    let scaled = |number: u32, most: u32| {
        let scaled = f64::from(number) * 2f64.powi(stage);
        (scaled as u32).clamp(1, number.max(most))
    };
    // A power of two: each wave of rays is a part of a sequence that is stratified at powers of two.
    let gather_rays = settings.gather_rays().next_power_of_two();
    settings.clone().with(|s| {
        s.indirect.photons = Some(scaled(settings.flux_photons(), Settings::MAX_PHOTONS));
        s.indirect.irradiance_cache.gather_rays = Some(scaled(gather_rays, Settings::MAX_GATHER_RAYS));
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Photons and gather rays double with the samples, from a sixteenth of the settings' to sixteen times as many; or
    /// from what is requested on.
    #[test]
    fn rays_double_with_the_samples() {
        let plain = Settings::default();
        let rays = |settings: &Settings, samples: u32| {
            let of_stage = settings_of_stage(settings, stage(settings, samples));
            [of_stage.gather_rays(), of_stage.flux_photons()]
        };
        for (samples, gather_rays) in [
            (0, 16),
            (1, 16),
            (2, 32),
            (3, 64),
            (11, 128),
            (12, 256),
            (23, 256),
            (24, 512),
            (192, 4096),
            (100_000, 4096),
        ] {
            assert_eq!(rays(&plain, samples), [gather_rays, 256 * gather_rays], "{samples} samples");
        }
        let requested = plain.with(|s| s.indirect.irradiance_cache.gather_rays = Some(100));
        for (samples, gather_rays) in [(0, 128), (23, 128), (24, 256), (192, 2048)] {
            assert_eq!(rays(&requested, samples)[0], gather_rays, "{samples} samples");
        }
        let most = requested.with(|s| s.indirect.irradiance_cache.gather_rays = Some(Settings::MAX_GATHER_RAYS));
        assert_eq!(rays(&most, 192)[0], Settings::MAX_GATHER_RAYS);
    }
}
