//! Names of the library's settings in messages, translated to the flags that set them.

use std::borrow::Cow;

/// The library's name of a setting, and the flag. Longer names come before those that they contain.
const FLAGS: [(&str, &str); 45] = [
    ("`indirect.irradiance_cache.enabled` is false", "--no-cache"),
    ("`indirect.irradiance_cache.enabled`", "--no-cache"),
    ("`technique`", "--technique"),
    ("`image.width`", "--width"),
    ("`image.height`", "--height"),
    ("`image.crop`", "--crop"),
    ("`image.spp`", "--spp"),
    ("`image.sampling`", "--sampling"),
    ("`image.piece`", "--samples"),
    ("`image.noise`", "--noise"),
    ("`image.background`", "--background"),
    ("`image.seed`", "--seed"),
    ("`image.aovs`", "--aov"),
    ("`image.denoise`", "--denoise"),
    ("`oidn_library`", "--oidn or OIDN_LIBRARY"),
    ("`visibility_map.photons_per_light`", "--photons"),
    ("`visibility_map.nearest`", "--nearest"),
    ("`visibility_map.shadow_photons_per_ray`", "--shadow-photons-per-ray"),
    ("`visibility_map.dilate`", "--dilate"),
    ("`visibility_map.audit`", "--audit"),
    ("`visibility_map.paper_counting`", "--paper-counting"),
    ("`visibility_map.fine_cells`", "--no-fine-cells"),
    ("`shadow_rays.samples`", "--shadow-samples"),
    ("`light_sampling.strategy`", "--light-sampling"),
    ("`light_sampling.sampled_lights`", "--sampled-lights"),
    ("`indirect.max_bounces`", "--max-bounces"),
    ("`indirect.photons`", "--flux-photons"),
    ("`indirect.clamp`", "--clamp"),
    ("`indirect.irradiance_cache.accuracy`", "--accuracy"),
    ("`indirect.irradiance_cache.gather_rays`", "--gather-rays"),
    ("`cells.resolution`", "--cells"),
    ("`cells.rays_per_light`", "--cell-rays"),
    ("`light_buffer.resolution`", "--light-buffer-cells"),
    ("`ward.tolerance`", "--shadow-tolerance"),
    ("`light_scale`", "--light-scale"),
    ("`lenient` import", "--lenient"),
    ("`default_light`", "--default-light"),
    ("`time`", "--at"),
    ("`frames`", "--frames"),
    ("`environment_rotation`", "--environment-rotation"),
    ("`environment_strength`", "--environment-strength"),
    ("`budgets`", "--budgets"),
    ("`sweep`", "--sweep"),
    ("`reference_error`", "--reference-error"),
    ("`reference_time`", "--reference-time"),
];

/// `text` with flags in place of the names of settings.
pub fn with_flags(text: &str) -> Cow<'_, str> {
    let mut text = Cow::Borrowed(text);
    if text.contains('`') {
        text = Cow::Owned(FLAGS.iter().fold(text.into_owned(), |text, (name, flag)| text.replace(name, flag)));
    }
    let remedy = "install a Vulkan driver (Mesa's lavapipe is one that needs no GPU)";
    if text.contains(remedy) {
        let script = "run through scripts/with-vulkan, which installs the software device lavapipe";
        text = Cow::Owned(text.replace(remedy, script));
    }
    let remedy = "choose another device";
    if text.contains(remedy) && !text.contains("--device") {
        text = Cow::Owned(text.replace(remedy, "choose another device with --device"));
    }
    text
}

#[cfg(test)]
mod tests {
    use penumbra::settings::{LightSampling, SampleRange, Sampling};
    use penumbra::{Settings, Technique};

    use super::with_flags;

    #[test]
    fn every_error_of_settings_names_a_flag() {
        let new = Settings::builder;
        let piece = SampleRange { first: 8, end: 17 };
        let wrong = [
            (new().size(0, 1), "--width"),
            (new().size(1, 0), "--height"),
            (new().spp(0), "--spp"),
            (new().piece(piece), "--samples"),
            (new().piece(SampleRange { end: 9, ..piece }).sampling(Sampling::Adaptive), "--sampling"),
            (new().photons_per_light(0), "--photons"),
            (new().nearest(0), "--nearest"),
            (new().shadow_photons_per_ray(0), "--shadow-photons-per-ray"),
            (new().dilate(2), "--dilate"),
            (new().audit(2.0), "--audit"),
            (new().shadow_samples(0), "--shadow-samples"),
            (new().technique(Technique::PATH).light_sampling(LightSampling::All), "--light-sampling"),
            (new().sampled_lights(1), "--sampled-lights"),
            (new().indirect_photons(0), "--flux-photons"),
            (new().clamp(0.0), "--clamp"),
            (new().accuracy(0.0), "--accuracy"),
            (new().gather_rays(0), "--gather-rays"),
            (new().cells(0), "--cells"),
            (new().cell_rays(0), "--cell-rays"),
            (new().light_buffer_cells(0), "--light-buffer-cells"),
            (new().ward_tolerance(2.0), "--shadow-tolerance"),
            (new().light_scale(-1.0), "--light-scale"),
        ];
        for (builder, flag) in wrong {
            let message = builder.build().unwrap_err().to_string();
            let translated = with_flags(&message);
            assert!(translated.starts_with(&format!("{flag} ")), "{message}: {translated}");
        }
    }

    #[test]
    fn other_text_stays() {
        assert_eq!(with_flags("`nearest` of `x`.glb"), "`nearest` of `x`.glb");
        assert_eq!(with_flags("choose another device"), "choose another device with --device");
        assert_eq!(with_flags("choose another with --device"), "choose another with --device");
    }
}
