//! All light: direct light by photons or shadow rays, the rest by paths, against the path tracer and an independent one.

use std::sync::Arc;

use glam::{DVec3, Vec3, Vec4};
use penumbra::internal::scene::{LightKind, Material};
use penumbra::{Aov, Image, Settings, Technique};

use crate::meshes::{camera, cube, inside_out, panorama, scene, square, surface};
use crate::setup::{deviation, mean_and_error, reference_file, render, render_scene, scene_file};

fn settings(technique: Technique, size: [u32; 2], spp: u32, max_bounces: u32) -> Settings {
    let [width, height] = size;
    Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = width;
        s.image.height = height;
        s.image.spp = spp;
        s.indirect.max_bounces = max_bounces;
        s.image.aovs = vec![Aov::Variance];
    })
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

/// Glass, lacquer, brushed and polished metal, with caustics from a map of their own: the mean is the path tracer's within 1 %,
/// for what the records' interpolation may be off, and so is the caustic of the glass ball within a tenth, most of it the noise of
/// paths that must meet the light by chance.
#[test]
fn glass_and_metal_are_the_path_tracers() {
    let of = |technique, spp| render(&scene_file("materials.glb"), &settings(technique, [64, 64], spp, 64));
    let (paths, (photons, statistics)) = (of(Technique::Path, 512).0, of(Technique::ShadowPhotons, 48));
    assert!(statistics.indirect.caustics > 1000, "{:?}", statistics.indirect);
    let share = |image: &Image, rows: std::ops::Range<usize>, columns: std::ops::Range<usize>| {
        let samples = image.channel("G").unwrap();
        rows.flat_map(|y| columns.clone().map(move |x| f64::from(samples[y * 64 + x]))).sum::<f64>()
    };
    for channel in ["R", "G", "B"] {
        let (a, b) = (mean_and_error(&paths, channel), mean_and_error(&photons, channel));
        let off = (a.0 - b.0).abs();
        assert!(off < 0.01 * a.0 + 3.5 * a.1.hypot(b.1), "{channel}: {a:?} and {b:?}");
    }
    // The floor below the glass ball.
    let caustic = |image| share(image, 54..59, 40..48);
    let (there, here) = (caustic(&paths), caustic(&photons));
    println!("caustic: {there} by paths, {here} by photons");
    assert!((there - here).abs() < 0.1 * there, "caustic: {there} by paths, {here} by photons");
}

/// What clear glass without a volume lets pass of the light that it does not reflect.
const TINT: f32 = 0.9;

fn glass() -> Material {
    Material {
        base_colour: Vec4::new(TINT, TINT, TINT, 1.0),
        transmission: 1.0,
        roughness: 0.0,
        specular: 1.0,
        double_sided: true,
        ..surface(0.0, 0.0)
    }
}

/// Behind a pane photons decide what is lit as they do before it: the direct light that is seen through it is that without it
/// less what the pane reflects and absorbs, pixel by pixel the same shadows, and no more points ask for shadow rays.
#[test]
fn photons_light_what_is_seen_through_glass() {
    let floor = (square(DVec3::ZERO, DVec3::X, -DVec3::Z), surface(0.5, 0.0));
    let block = (cube(DVec3::new(0.1, 0.05, 0.0), 0.05), surface(0.5, 0.0));
    let lamp = (square(DVec3::new(0.3, 0.5, 0.0), DVec3::X * 0.05, DVec3::Z * 0.05), surface(0.0, 50.0));
    let pane = (square(DVec3::new(0.0, 0.6, 0.0), DVec3::X * 0.2, -DVec3::Z * 0.2), glass());
    let view = camera(DVec3::Y * 0.8, DVec3::NEG_Y, 0.6);
    let of = |meshes: &[_]| {
        let settings = settings(Technique::ShadowPhotons, [32, 32], 64, 4).with(|s| s.image.aovs = vec![Aov::Direct]);
        let (image, statistics) = render_scene(scene(meshes, Vec::new()), &view, &settings);
        (image.channel("direct.G").unwrap().to_vec(), statistics.points)
    };
    let (open, points) = of(&[floor.clone(), block.clone(), lamp.clone()]);
    let (behind, points_behind) = of(&[floor, block, lamp, pane]);
    // Less than 17 degrees off the normal Schlick's term is 0.04.
    let passed = f64::from(TINT) * 0.96;
    let ratio = |off: f64| {
        let sum = |pixels: &[f32]| pixels.iter().map(|v| f64::from(*v)).sum::<f64>();
        (sum(&behind) / (sum(&open) * passed * off) - 1.0).abs()
    };
    println!("off by {}, {points:?}, {points_behind:?}", ratio(1.0));
    // One sample in twenty is reflected by the pane: 0.2 / sqrt(64 * 1024) is 0.1 %.
    assert!(ratio(1.0) < 0.005 && ratio(1.02) > 0.005, "{}", ratio(1.0));
    let dark = |pixels: &[f32]| pixels.iter().map(|v| *v == 0.0).collect::<Vec<bool>>();
    let differing = dark(&open).iter().zip(dark(&behind)).filter(|(a, b)| **a != *b).count();
    assert!(
        dark(&open).contains(&true) && differing <= 8,
        "{differing} pixels are dark with the pane or without it alone"
    );
    assert!(points_behind.boundary_share < 1.5 * points.boundary_share + 0.02, "{points:?} {points_behind:?}");
}

/// A thin pane lies between a floor and a small lamp: what the floor gets, all of it from the caustic map, is the irradiance in
/// closed form less what the pane reflects, by Schlick's formula with glTF's 0.04.
#[test]
fn a_pane_lets_through_what_it_does_not_reflect() {
    let half = 0.02;
    let lamp = square(DVec3::Y * 0.8, DVec3::X * half, DVec3::Z * half);
    let floor = square(DVec3::ZERO, DVec3::X, -DVec3::Z);
    let pane = square(DVec3::Y * 0.4, DVec3::X, -DVec3::Z);
    let albedo = 0.5;
    let radiance = 200.0;
    // From below the pane, onto a piece of the floor below the lamp.
    let view = camera(DVec3::new(0.0, 0.3, 0.0), DVec3::NEG_Y, 0.6);
    let meshes = [(lamp, surface(0.0, radiance)), (floor, surface(albedo, 0.0)), (pane, glass())];
    let mut settings = settings(Technique::ShadowPhotons, [16, 16], 64, 2);
    settings.image.aovs.push(Aov::Direct);
    let (image, statistics) = render_scene(scene(&meshes, Vec::new()), &view, &settings);
    assert!(statistics.indirect.caustics > 1000, "{:?}", statistics.indirect);
    let direct = image.channel("direct.G").unwrap();
    assert!(direct.iter().all(|v| *v == 0.0), "the pane is in the way of shadow rays");
    // Radiance that the floor reflects, over the pixels, by midpoints. The lamp is small against its distance: its middle stands
    // for it, 1e-3 off.
    let area = (2.0 * half).powi(2);
    let mut expected = 0.0;
    let tangent = 0.3f64.tan();
    for y in 0..16 {
        for x in 0..16 {
            let at = |i: i32| 0.3 * tangent * ((f64::from(i) + 0.5) / 8.0 - 1.0);
            let away = DVec3::new(at(x), 0.8, at(y));
            let cosine = 0.8 / away.length();
            let irradiance = f64::from(radiance) * area * cosine.powi(2) / away.length_squared();
            let passed = 1.0 - (0.04 + 0.96 * (1.0 - cosine).powi(5));
            expected += irradiance * passed * f64::from(TINT) * f64::from(albedo) / std::f64::consts::PI / 256.0;
        }
    }
    let (mean, _) = mean_and_error(&image, "G");
    // Of light that the floor and the pane send to and fro two bounces are a few in a thousand. Half a million photons, of which
    // one in forty falls on the pixels' floor, and discs that reach no edge: 1 % and some.
    println!("{mean}, expected {expected}");
    assert!((mean / expected - 1.0).abs() < 0.03, "{mean}, expected {expected}");
}

/// A room under a skylight, a thin pane that stops shadow rays and the photons of the visibility map. The sun's patch on the floor, all
/// of it from the caustic map, is the closed form: what falls on the floor less what the pane reflects, by Schlick's formula. Under a
/// panorama the room is the path tracer's, whose rays come by the sky through the pane.
#[test]
fn a_skylight_lets_in_sun_and_sky() {
    let room = |albedo: f32| {
        // All but the top.
        let walls: Vec<_> =
            inside_out(cube(DVec3::ZERO, 0.5)).into_iter().filter(|t| t.iter().any(|c| c.y < 0.4)).collect();
        let pane = square(DVec3::Y * 0.5, DVec3::X * 0.5, DVec3::NEG_Z * 0.5);
        [(walls, surface(albedo, 0.0)), (pane, glass())]
    };
    let albedo = 0.5;
    let towards = DVec3::new(0.3, 1.0, 0.1).normalize();
    let irradiance = 4.0;
    let sun = LightKind::Directional { direction: -towards.as_vec3(), irradiance: Vec3::splat(irradiance) };
    // Onto a piece of the floor that the sun falls on through the pane, which is its light's one bounce.
    let below = camera(DVec3::Y * -0.2, DVec3::NEG_Y, 0.6);
    let once = settings(Technique::ShadowPhotons, [16, 16], 64, 1);
    let (image, _) = render_scene(scene(&room(albedo), vec![sun]), &below, &once);
    let passed = 1.0 - (0.04 + 0.96 * (1.0 - towards.y).powi(5));
    let expected = f64::from(irradiance * TINT * albedo) * towards.y * passed / std::f64::consts::PI;
    let (mean, _) = mean_and_error(&image, "G");
    println!("sun: {mean}, expected {expected}");
    // As in the test above.
    assert!((mean / expected - 1.0).abs() < 0.03, "{mean}, expected {expected}");

    let sky = panorama(64, 32, |d| DVec3::new(0.5, 0.6, 0.8) * (1.0 + d.y));
    let view = camera(DVec3::new(0.3, 0.0, 0.45), DVec3::new(-0.5, -0.3, -1.0), 1.2);
    let of = |technique, spp| {
        let mut scene = scene(&room(0.6), Vec::new());
        scene.set_environment(Arc::new(sky.clone()), 0.0, 1.0).unwrap();
        mean_and_error(&render_scene(scene, &view, &settings(technique, [32, 32], spp, 64)).0, "G")
    };
    let (paths, photons) = (of(Technique::Path, 512), of(Technique::ShadowPhotons, 48));
    let off = |mean: f64| (mean - paths.0).abs() / (3.5 * photons.1.hypot(paths.1) + 0.01 * paths.0);
    println!("sky: {photons:?}, paths {paths:?}");
    assert!(off(photons.0) < 1.0, "{photons:?}, paths {paths:?}");
    assert!(off(0.9 * photons.0) > 1.0, "a tenth less would pass");
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
        let settings = settings(technique, [64, 64], spp, 64).with(|s| s.indirect.irradiance_cache.enabled = cache);
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
        let mut settings =
            settings(Technique::ShadowPhotons, [48, 48], 4, 64).with(|s| s.indirect.irradiance_cache.enabled = cache);
        settings.image.aovs = vec![Aov::Indirect];
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
