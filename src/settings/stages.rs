//! The stages of a render: with more samples there are more photons of indirect light, and more gather rays.

use super::Settings;

/// The stage of the first sample, with a sixteenth of the photons and gather rays of the settings: its image comes two
/// to four times sooner (`scenes/crowd.glb`, 128 x 128 pixels: 0.12 s instead of 0.52).
const PREVIEW_STAGE: i32 = -4;

/// The stage with sixteen times the photons and gather rays of the settings: by default a million photons, and some
/// thousand rays.
pub(crate) const LAST_STAGE: i32 = 4;

/// Where no estimate decides, stage n > 0 begins at 2^n times this number of samples per pixel. So stage 1, the first
/// with more photons and gather rays than the settings have, begins at 24 samples. Photons and gather rays then double
/// whenever the samples do, and indirect light takes about the same share of the time however long the render is.
const SAMPLES_OF_SETTINGS: f64 = 12.0;

/// Whether indirect light may begin with few gather rays and grow. It does not if the user requested numbers, which
/// hold from the first sample; nor for a map that is shown, which fewer photons would blur; nor in a piece, which has
/// no preview; nor with `ImageSettings::noise`, because some pixels may get no samples after the first ones.
pub(crate) fn grows(settings: &Settings) -> bool {
    let Settings { indirect, image, technique, .. } = settings;
    let requested = indirect.photons.is_some() || indirect.irradiance_cache.gather_rays.is_some();
    !requested && !technique.shows_map() && image.piece.is_none() && image.noise.is_none()
}

/// The minimum stage of the samples that follow the first `samples`. With `is_estimated`, estimates alone decide on the
/// stages after the first.
pub(crate) fn stage(settings: &Settings, samples: u32, is_estimated: bool) -> i32 {
    let first = if grows(settings) && (is_estimated || samples == 0) { PREVIEW_STAGE } else { 0 };
    if is_estimated {
        return first;
    }
    // log2(0) is minus infinity, which `as` turns into `i32::MIN`.
    let doublings = (f64::from(samples) / SAMPLES_OF_SETTINGS).log2().floor() as i32;
    doublings.clamp(first, LAST_STAGE)
}

/// The settings of a stage: the photons of its map, and the gather rays of a record in all stages so far. Stage 0 has
/// the numbers of the settings.
pub(crate) fn settings_of_stage(settings: &Settings, stage: i32) -> Settings {
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

/// The settings of the first and of the last stage that a render may have. With `is_estimated`, estimates may lead to
/// any stage.
pub(crate) fn settings_of_stages(settings: &Settings, is_estimated: bool) -> [Settings; 2] {
    let first = stage(settings, 0, is_estimated);
    let last = match settings.image.spp {
        0..=1 => first,
        _ if is_estimated => LAST_STAGE,
        spp => stage(settings, spp - 1, false),
    };
    [first, last].map(|stage| settings_of_stage(settings, stage))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without estimates, photons and gather rays start at the numbers of the settings and double with the samples; the
    /// first sample has a sixteenth of them. With estimates, the minimum stays at the numbers of the first sample.
    #[test]
    fn rays_double_with_the_samples() {
        let plain = Settings::default();
        let rays = |settings: &Settings, samples: u32, is_estimated: bool| {
            let of_stage = settings_of_stage(settings, stage(settings, samples, is_estimated));
            [of_stage.gather_rays(), of_stage.flux_photons()]
        };
        for (samples, gather_rays) in
            [(0, 16), (1, 256), (23, 256), (24, 512), (48, 1024), (96, 2048), (192, 4096), (100_000, 4096)]
        {
            assert_eq!(rays(&plain, samples, false), [gather_rays, 256 * gather_rays], "{samples} samples");
            assert_eq!(rays(&plain, samples, true), [16, 4096], "{samples} samples");
        }
        let requested = plain.with(|s| s.indirect.irradiance_cache.gather_rays = Some(100));
        assert!(!grows(&requested));
        for (samples, gather_rays) in [(0, 128), (23, 128), (24, 256), (192, 2048)] {
            assert_eq!(rays(&requested, samples, false)[0], gather_rays, "{samples} samples");
        }
        let most = requested.with(|s| s.indirect.irradiance_cache.gather_rays = Some(Settings::MAX_GATHER_RAYS));
        assert_eq!(rays(&most, 192, false)[0], Settings::MAX_GATHER_RAYS);
    }
}
