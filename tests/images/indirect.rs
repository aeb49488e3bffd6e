//! All light: direct light by photons or shadow rays, the rest by paths, against the path tracer and an independent one.

use penumbra::{Aov, Image, Settings, Technique};

use crate::setup::{deviation, mean_and_error, reference_file, render, scene_file};

fn settings(technique: Technique, size: [u32; 2], spp: u32, max_bounces: u32) -> Settings {
    let [width, height] = size;
    Settings { technique, width, height, spp, max_bounces, aovs: vec![Aov::Variance], ..Settings::default() }
}

/// The still life has what can go wrong between the two passes: glossy and textured surfaces, masks, lights of four
/// kinds. Its mean is the path tracer's within three and a half standard errors (nine comparisons, 0.4 % that one of them
/// fails by chance): for direct light alone, highlights included, for one bounce, and for all.
#[test]
fn a_scene_of_everything_is_that_of_the_path_tracer() {
    for max_bounces in [0, 1, 64] {
        let of = |technique| render(&scene_file("still_life.glb"), &settings(technique, [96, 72], 128, max_bounces)).0;
        let (paths, photons) = (of(Technique::Path), of(Technique::ShadowPhotons));
        for channel in ["R", "G", "B"] {
            let (a, b) = (mean_and_error(&paths, channel), mean_and_error(&photons, channel));
            let off = deviation(a, b);
            assert!(off < 3.5, "{max_bounces} bounces, {channel}: {a:?} and {b:?}, {off} standard errors");
            // The test would see three percent.
            let (mean, error) = b;
            assert!(deviation(a, (1.03 * mean, error)) > 3.5, "{max_bounces} bounces, {channel}: too noisy to tell");
        }
    }
}

/// The independent renderer's box with all bounces: the mean within 0.3 % and the standard error.
#[test]
fn the_box_is_the_references() {
    let (Some(scene), Some(file)) = (reference_file("box.glb"), reference_file("box-gi.exr")) else { return };
    let reference = Image::read(&file).unwrap();
    let (image, statistics) = render(&scene, &settings(Technique::ShadowPhotons, [256, 256], 16, 64));
    assert!(statistics.rays.bounce > 0 && statistics.rays.shadow > 0, "{:?}", statistics.rays);
    for channel in ["R", "G", "B"] {
        let samples = reference.channel(channel).unwrap();
        let expected = samples.iter().map(|v| f64::from(*v)).sum::<f64>() / samples.len() as f64;
        let (mean, error) = mean_and_error(&image, channel);
        let off = (mean - expected).abs();
        assert!(off < 3e-3 * expected + 3.0 * error, "{channel}: {mean} +- {error}, expected {expected}");
    }
}
