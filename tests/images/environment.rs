//! Light from a panorama by every technique, against closed forms, a directional light and the path tracer.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DVec3, Vec3};
use penumbra::internal::scene::{LightKind, Material, Panorama, Specular};
use penumbra::{Aov, Scene, Settings, Technique};

use crate::meshes::{Corners, camera, cube, panorama, scene, square, surface};
use crate::setup::{mean_and_error, render_scene};

fn settings(technique: Technique, spp: u32) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = 40;
        s.image.height = 40;
        s.image.spp = spp;
        s.image.aovs = vec![Aov::Variance];
    })
}

fn under(meshes: &[(Vec<Corners>, Material)], panorama: &Panorama) -> Scene {
    let mut scene = scene(meshes, Vec::new());
    scene.set_environment(Arc::new(panorama.clone()), 0.0, 1.0).unwrap();
    scene
}

/// A floor with two cubes that nearly touch each other.
fn blocks(albedo: f32) -> Vec<(Vec<Corners>, Material)> {
    let [left, right] = [-0.16, 0.16].map(|x| cube(DVec3::new(x, 0.1501, 0.0), 0.15));
    let floor = square(DVec3::ZERO, DVec3::Z * 0.6, DVec3::X * 0.6);
    [floor, left, right].map(|mesh| (mesh, surface(albedo, 0.0))).into()
}

/// Relative error of the global map where it is shown directly, as in `indirect::photons_give_the_path_tracers_light`,
/// and of final gathering from it: half of the bound there.
fn tolerance(technique: Technique) -> f64 {
    match technique {
        technique if technique.is_path_tracing() => 0.0,
        technique if technique.shows_map() => 0.02,
        _ => 0.005,
    }
}

/// A convex Lambertian body of albedo a under uniform radiance L has radiance a L, and the background has L, by every
/// technique. The body receives none of the light that it reflects.
#[test]
fn convex_bodies_show_their_albedo() {
    let even = panorama(8, 4, |_| DVec3::new(1.5, 1.0, 0.5));
    let body = [(cube(DVec3::ZERO, 0.3), surface(0.6, 0.0))];
    let view = |sideways| camera(DVec3::new(0.1, 0.0, 0.8), DVec3::new(sideways, 0.0, -1.0), 0.4);
    for technique in Technique::all() {
        let (image, statistics) = render_scene(under(&body, &even), &view(0.0), &settings(technique, 16));
        assert!(image.channel("A").unwrap().iter().all(|alpha| *alpha == 1.0));
        for (channel, expected) in [("R", 0.9), ("G", 0.6), ("B", 0.3)] {
            let (mean, error) = mean_and_error(&image, channel);
            // Techniques that show the map have the map's error; the others have noise and rounding only.
            let shown = if technique.shows_map() { tolerance(technique) } else { 1e-5 };
            // By chance, 3.5 standard errors are exceeded once in 2,000 times.
            let off = |mean: f64| (mean - expected).abs() / (3.5 * error + shown * expected);
            assert!(off(mean) < 1.0, "{technique}, {channel}: {mean} +- {error}, not {expected}");
            assert!(off(1.05 * mean) > 1.0, "{technique}, {channel}: 5 % more would pass");
        }
        assert!(statistics.left_out.iter().any(|name| name == "visibility_map"), "{technique} has a visibility map");
        assert!(statistics.photons.is_empty() && statistics.not_finite == 0);
    }
    // The background, next to the body.
    let (image, _) = render_scene(under(&body, &even), &view(-2.0), &settings(Technique::SHADOW_PHOTONS, 1));
    // Interpolation between equal texels, and one sample: a few roundings in f32, each of 6e-8 of a number up to 1.5.
    let near =
        |channel: &str, expected: f32| image.channel(channel).unwrap().iter().all(|x| (x - expected).abs() < 1e-6);
    assert!(near("R", 1.5) && near("G", 1.0) && near("B", 0.5) && near("A", 1.0));
}

/// The white furnace: if all surfaces are white and the radiance of the sky is 1, it is 1 everywhere, even between the
/// blocks. The bound is 0.5 %. There are four times as many photons as by default, as the error of the default number
/// is 0.5 % by itself.
#[test]
fn white_furnaces_are_white() {
    let even = panorama(8, 4, |_| DVec3::ONE);
    let view = camera(DVec3::new(0.1, 0.4, 0.8), DVec3::new(-0.1, -0.4, -0.8), 0.8);
    for (technique, spp) in [(Technique::PATH, 64), (Technique::TWO_PASS, 32)] {
        let settings = settings(technique, spp).with(|s| s.indirect.photons = Some(1 << 18));
        let (image, _) = render_scene(under(&blocks(1.0), &even), &view, &settings);
        let (mean, error) = mean_and_error(&image, "G");
        println!("{technique}: {mean} +- {error}");
        assert!(error < 0.003 && (mean - 1.0).abs() < 0.005 + 3.0 * error, "{technique}: {mean} +- {error}");
    }
    // An albedo of 0.95 is detected.
    let (image, _) = render_scene(under(&blocks(0.95), &even), &view, &settings(Technique::PATH, 128));
    let (mean, error) = mean_and_error(&image, "G");
    assert!((mean - 1.0).abs() > 0.005 + 3.0 * error, "albedo 0.95: {mean} +- {error}");
}

/// A horizontal plane has the irradiance of the sky above it and nothing from the ground below. Under a radiance of
/// cos^n of the angle from the zenith the irradiance is 2 pi / (n + 2), so the radiance for albedo a is 2 a / (n + 2).
#[test]
fn planes_have_the_skys_irradiance() {
    let view = camera(DVec3::new(0.0, 0.5, 0.0), -DVec3::Y, 0.5);
    let floor = [(square(DVec3::ZERO, DVec3::Z * 0.6, DVec3::X * 0.6), surface(0.5, 0.0))];
    for n in [1, 4] {
        let sky = panorama(256, 128, |d| DVec3::splat(if d.y > 0.0 { d.y.powi(n) } else { 7.0 }));
        for technique in [Technique::PATH, Technique::TWO_PASS] {
            let (image, _) = render_scene(under(&floor, &sky), &view, &settings(technique, 64));
            let (mean, error) = mean_and_error(&image, "G");
            let expected = 1.0 / f64::from(n + 2);
            // Interpolation at the horizon mixes sky and ground over half a row: pi / 256 of 7, at cosines of as much
            // again over 4. Interpolation between the other rows adds 0.01 %.
            let tolerance = 7.0 * (PI / 128.0f64).powi(2) / 8.0 + 2e-4 * expected;
            // By chance, 3.5 standard errors are exceeded once in 2,000 times.
            let off = |mean: f64| (mean - expected).abs() / (3.5 * error + tolerance);
            assert!(off(mean) < 1.0, "{technique}, n {n}: {mean} +- {error}, not {expected}");
            assert!(off(1.05 * mean) > 1.0, "{technique}, n {n}: 5 % more would pass");
        }
    }
}

/// One bright texel acts as a sun: it gives the light and shadows of a directional light of the same irradiance.
#[test]
fn a_sun_in_the_panorama_equals_a_directional_light() {
    const SIZE: [u32; 2] = [512, 256];
    let (column, row) = (100, 70);
    let mut sky = panorama(SIZE[0], SIZE[1], |_| DVec3::ZERO);
    sky.texels[(row * SIZE[0] + column) as usize] = [5000.0; 3];
    let (azimuth, below) =
        ((f64::from(column) + 0.5) / f64::from(SIZE[0]) * TAU - PI, (f64::from(row) + 0.5) / f64::from(SIZE[1]) * PI);
    let towards = DVec3::new(below.sin() * azimuth.cos(), below.cos(), below.sin() * azimuth.sin());
    // Interpolation turns the texel into a tent, whose integral is that of one texel. The sine over its height changes
    // that by (pi / 256)^2 / 12.
    let irradiance = 5000.0 * TAU / f64::from(SIZE[0]) * PI / f64::from(SIZE[1]) * below.sin();
    let light = LightKind::Directional { direction: -towards.as_vec3(), irradiance: Vec3::splat(irradiance as f32) };
    let view = camera(DVec3::new(0.1, 0.5, 0.8), DVec3::new(-0.1, -0.5, -0.8), 0.9);
    let directional = || scene(&blocks(0.7), vec![light.clone()]);
    let (by_light, _) = render_scene(directional(), &view, &settings(Technique::TWO_PASS, 64));
    let expected = mean_and_error(&by_light, "G");
    // The background is black in both renders: the sun is outside the view.
    for technique in [Technique::PATH, Technique::TWO_PASS] {
        let (by_sky, _) = render_scene(under(&blocks(0.7), &sky), &view, &settings(technique, 64));
        let (mean, error) = mean_and_error(&by_sky, "G");
        // 0.5 % is for final gathering, which renders the directional light too, as in `tolerance`.
        // By chance, 3.5 standard errors are exceeded once in 2,000 times.
        let off = |mean: f64| (mean - expected.0).abs() / (3.5 * error.hypot(expected.1) + 0.005 * expected.0);
        println!("{technique}: {mean} +- {error}, directional {expected:?}");
        assert!(off(mean) < 1.0, "{technique}: {mean} +- {error}, directional {expected:?}");
        assert!(off(1.05 * mean) > 1.0, "{technique}: 5 % more would pass");
    }
}

/// Every technique gives the path tracer's mean, with all bounces and for direct light only. The scene has a sky with a
/// sun, a lamp, and blocks, one of them of rough metal. The lamp has a visibility map; the environment has no photons
/// in it.
#[test]
fn every_technique_gives_the_path_tracers_light() {
    let sky = panorama(64, 32, |d| {
        let sun = if d.dot(DVec3::new(-0.5, 0.6, 0.5).normalize()) > 0.99 { 40.0 } else { 0.0 };
        DVec3::new(0.5, 0.6, 0.8) * (1.0 + d.y) + sun
    });
    let mut meshes = blocks(0.7);
    meshes[1].1 = Material { metallic: 1.0, roughness: 0.4, specular: Specular::with_factor(1.0), ..surface(0.9, 0.0) };
    meshes.push((square(DVec3::new(0.3, 0.4, 0.3), DVec3::X * 0.05, DVec3::Z * 0.05), surface(0.0, 20.0)));
    let view = camera(DVec3::new(0.1, 0.5, 0.8), DVec3::new(-0.1, -0.5, -0.8), 0.9);
    for max_bounces in [0, 64] {
        let of = |technique, spp| {
            let settings = settings(technique, spp).with(|s| s.indirect.max_bounces = max_bounces);
            render_scene(under(&meshes, &sky), &view, &settings)
        };
        let paths = mean_and_error(&of(Technique::PATH, 128).0, "G");
        for technique in Technique::all() {
            // `visibility-estimate` blurs visibility, so it is biased by design.
            if [Technique::PATH, Technique::VISIBILITY_ESTIMATE].contains(&technique) {
                continue;
            }
            let (image, statistics) = of(technique, 32);
            let (mean, error) = mean_and_error(&image, "G");
            println!("{technique}, {max_bounces} bounces: {mean} +- {error}, paths {paths:?}");
            let tolerance = if max_bounces == 0 && !technique.shows_map() { 0.0 } else { tolerance(technique) };
            // By chance, 3.5 standard errors are exceeded once in 2,000 times.
            let off = |mean: f64| (mean - paths.0).abs() / (3.5 * error.hypot(paths.1) + tolerance * paths.0);
            assert!(off(mean) < 1.0, "{technique}, {max_bounces} bounces: {mean} +- {error}, paths {paths:?}");
            assert!(off(1.1 * mean) > 1.0, "{technique}, {max_bounces} bounces: 10 % more would pass");
            let mapped = statistics.kept.iter().any(|name| name == "visibility_map");
            assert_eq!(mapped, technique == Technique::SHADOW_PHOTONS);
            assert_eq!(statistics.photons.len(), usize::from(mapped), "photons of the environment");
        }
    }
}

/// Photons do not classify points for the environment: all of them are unknown. The lamp's classes are the same as
/// without the environment, and the environment's visibility comes from rays.
#[test]
fn photons_do_not_classify_the_environment() {
    let mut meshes = blocks(0.7);
    meshes.push((square(DVec3::new(0.3, 0.4, 0.3), DVec3::X * 0.05, DVec3::Z * 0.05), surface(0.0, 20.0)));
    let view = camera(DVec3::new(0.1, 0.5, 0.8), DVec3::new(-0.1, -0.5, -0.8), 0.9);
    let settings = settings(Technique::SHADOW_PHOTONS, 4).with(|s| {
        s.image.aovs = vec![Aov::Shadow];
        s.indirect.max_bounces = 0;
    });
    let (image, _) = render_scene(under(&meshes, &panorama(8, 4, |_| DVec3::ONE)), &view, &settings);
    let classes = image.channel("shadow.environment.class").unwrap();
    let surfaces = image.channel("shadow..class").unwrap();
    assert!(classes.iter().filter(|class| **class == 4.0).count() > 500, "no point is classified for the environment");
    for (of_sky, of_lamp) in classes.iter().zip(surfaces) {
        assert!(*of_sky == 4.0 || (*of_sky == 0.0 && *of_lamp == 0.0), "classes {of_sky} and {of_lamp}");
    }
    let decided = surfaces.iter().filter(|class| [1.0, 2.0].contains(*class)).count();
    assert!(decided > 300, "{decided} points are lit or shadowed");
    let visibility = image.channel("shadow.environment.visibility").unwrap();
    assert!(visibility.contains(&1.0) && visibility.iter().any(|v| *v > 0.0 && *v < 0.9));
    let lamp = scene(&meshes, Vec::new());
    let (alone, _) = render_scene(lamp, &view, &settings);
    let same = alone.channel("shadow..class").unwrap().iter().zip(surfaces).filter(|(a, b)| a == b).count();
    assert!(same == surfaces.len(), "{same} of {} classes of the lamp are as without the environment", surfaces.len());
}
