//! All light: direct light by photons or shadow rays, the rest by paths, against the path tracer and an independent one.

use glam::DVec3;
use penumbra::{Aov, Image, Settings, Technique};

use crate::meshes::{camera, cube, inside_out, scene, square, surface};
use crate::setup::{deviation, mean_and_error, reference_file, render, render_scene, scene_file};

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

/// A closed room with a cube in it and a square light under its ceiling: the mean is the path tracer's with the irradiance cache and
/// without it, with the map shown directly, and with all lit and shadow photons of negative energy. One percent is what 65,536
/// rays of photons, whose irradiance all points share, may be off, and first-order interpolation between records; two where what
/// is seen is the map itself, of which some ten thousand photons are in view.
#[test]
fn photons_bring_the_path_tracers_light() {
    let lamp = square(DVec3::new(0.1, 0.45, 0.0), DVec3::X * 0.15, DVec3::Z * 0.15);
    let meshes = [
        (inside_out(cube(DVec3::ZERO, 0.5)), surface(0.7, 0.0)),
        (cube(DVec3::new(-0.2, -0.3501, -0.1), 0.15), surface(0.5, 0.0)),
        (lamp, surface(0.0, 5.0)),
    ];
    let view = camera(DVec3::new(0.3, 0.0, 0.45), DVec3::new(-0.5, -0.3, -1.0), 1.2);
    let of = |technique, cache, spp| {
        let settings = Settings { cache, ..settings(technique, [64, 64], spp, 64) };
        mean_and_error(&render_scene(scene(&meshes, Vec::new()), &view, &settings).0, "G")
    };
    let paths = of(Technique::Path, false, 256);
    for (technique, cache, spp, tolerance) in [
        (Technique::ShadowPhotons, true, 32, 0.01),
        (Technique::ShadowPhotons, false, 32, 0.01),
        (Technique::PhotonMap, false, 8, 0.02),
        (Technique::NegativePhotons, false, 8, 0.02),
    ] {
        let (mean, error) = of(technique, cache, spp);
        let off = |mean: f64| (mean - paths.0).abs() / (3.5 * error.hypot(paths.1) + tolerance * paths.0);
        println!("{technique}, cache {cache}: {mean} +- {error}, paths {paths:?}");
        assert!(off(mean) < 1.0, "{technique}, cache {cache}: {mean} +- {error}, paths {paths:?}");
        assert!(off((1.0 + 4.0 * tolerance) * mean) > 1.0, "{technique}, cache {cache}: four times as much would pass");
    }
}

/// A room is divided by a wall 1e-5 thick, and the light is on the other side of it: none comes through, by records or by
/// paths. Without the wall there is some.
#[test]
fn no_light_leaks_through_thin_walls() {
    let lamp = square(DVec3::new(-0.25, 0.45, 0.0), DVec3::X * 0.1, DVec3::Z * 0.1);
    let side = |x: f64, facing: f64| square(DVec3::X * x, DVec3::Y * 0.5 * facing, DVec3::Z * 0.5);
    let wall = [side(-0.5e-5, -1.0), side(0.5e-5, 1.0)].concat();
    let room = (inside_out(cube(DVec3::ZERO, 0.5)), surface(0.7, 0.0));
    let view = camera(DVec3::new(0.45, 0.1, 0.4), DVec3::new(-1.0, -0.4, -0.9), 1.3);
    let of = |walled: bool, cache| {
        let mut meshes = vec![room.clone(), (lamp.clone(), surface(0.0, 5.0))];
        meshes.extend(walled.then(|| (wall.clone(), surface(0.7, 0.0))));
        let mut settings = Settings { cache, ..settings(Technique::ShadowPhotons, [48, 48], 4, 64) };
        settings.aovs = vec![Aov::Indirect];
        let (image, _) = render_scene(scene(&meshes, Vec::new()), &view, &settings);
        let light = image.channel("indirect.G").unwrap();
        light.iter().map(|v| f64::from(*v)).sum::<f64>() / light.len() as f64
    };
    for cache in [true, false] {
        let (open, behind) = (of(false, cache), of(true, cache));
        println!("cache {cache}: {behind} behind the wall, {open} without it");
        assert!(open > 0.01, "no wall, and no light: the test sees nothing");
        assert_eq!(behind, 0.0, "cache {cache}: {} of the light without the wall", behind / open);
    }
}
