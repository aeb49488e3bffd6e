//! The earlier methods that shadow photons are compared with: each has the error that it claims, no more and no less.

use glam::{DVec3, Vec3};
use penumbra::internal::scene::{LightKind, Scene};
use penumbra::{Camera, Image, Settings, Statistics, Technique};

use crate::meshes::{camera, cube, inside_out, scene, square, surface};
use crate::setup::{self, render, render_scene, scene_file};

/// Settings of direct light alone.
fn settings(technique: Technique, size: [u32; 2], spp: u32) -> Settings {
    setup::settings(technique, size, spp, 0)
}

/// A room with pillars under a square light and 48 point lights, the weakest of which have a thousandth of the power of
/// the strongest.
fn hall() -> (Scene, Camera) {
    let pillar = |i: u32| {
        let centre = DVec3::new(0.28 * f64::from(i % 3) - 0.28, -0.3, 0.25 * f64::from(i / 3) - 0.3);
        cube(centre, 0.06)
    };
    let lamp = |i: u32| {
        let (x, z) = (f64::from(i % 8) / 8.0 - 0.44, f64::from(i / 8) / 6.0 - 0.42);
        let intensity = 0.1 * 0.001f32.powf((i * 29 % 48) as f32 / 48.0);
        let position = DVec3::new(x, 0.35, z).as_vec3();
        LightKind::Point { position, intensity: Vec3::splat(intensity), range: f32::INFINITY }
    };
    let meshes = [
        (inside_out(cube(DVec3::ZERO, 0.5)), surface(0.7, 0.0)),
        ((0..9).flat_map(pillar).collect(), surface(0.5, 0.0)),
        (square(DVec3::new(0.0, 0.45, 0.0), DVec3::X * 0.1, DVec3::Z * 0.1), surface(0.0, 0.5)),
    ];
    let view = camera(DVec3::new(0.1, 0.2, 0.48), DVec3::new(-0.1, -0.5, -1.0), 1.3);
    (scene(&meshes, (0..48).map(lamp).collect()), view)
}

/// Ward's method keeps its promise: no sample deviates by more than the tolerance, with far fewer rays. At tolerance 0
/// it tests every light, and the image is that of `two-pass`.
#[test]
fn wards_error_is_within_its_tolerance() {
    let (mut scene, view) = hall();
    // Where the visibility of an area light is estimated, it has no sampling noise. Such lights are removed below.
    let of = |scene: &Scene, technique, shadow_tolerance| {
        let settings = settings(technique, [64, 48], 2).with(|s| s.ward.tolerance = shadow_tolerance);
        render_scene(scene.clone(), &view, &settings)
    };
    let off = |(a, _): &(Image, Statistics), (b, _): &(Image, Statistics)| {
        let [a, b] = [a, b].map(|image| image.channel("G").unwrap());
        a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs() / b.max(1e-9))).fold(0.0, f64::max)
    };
    let (all, none) = (of(&scene, Technique::TWO_PASS, 0.0), of(&scene, Technique::WARD_ADAPTIVE, 0.0));
    // The same samples are summed in different groups.
    assert!(off(&none, &all) < 1e-5, "tolerance 0: {} off", off(&none, &all));
    assert_eq!(none.1.rays.shadow, all.1.rays.shadow);
    // A light of which a point sees a small part: the first of its many light points bring nothing there.
    let many = |technique| {
        let settings = settings(technique, [64, 48], 2).with(|s| (s.ward.tolerance, s.shadow_rays.samples) = (0.0, 32));
        render_scene(scene.clone(), &view, &settings)
    };
    let off_many = off(&many(Technique::WARD_ADAPTIVE), &many(Technique::TWO_PASS));
    assert!(off_many < 1e-5, "tolerance 0 with 32 light points: {off_many} off");

    scene.lights.remove(0);
    scene.triangles.iter_mut().for_each(|triangle| triangle.light = penumbra::internal::scene::NO_LIGHT);
    scene.materials.iter_mut().for_each(|material| material.emissive = Vec3::ZERO);
    let all = of(&scene, Technique::TWO_PASS, 0.0);
    for tolerance in [0.02, 0.1, 0.3] {
        let some = of(&scene, Technique::WARD_ADAPTIVE, tolerance);
        let (off, rays) = (off(&some, &all), some.1.rays.shadow as f64 / all.1.rays.shadow as f64);
        println!("tolerance {tolerance}: {off} off at most, {rays} of the rays");
        // The result never exceeds the true light. The sort keys keep twelve bits of a potential, hence the factor.
        assert!(off < 1.001 * f64::from(tolerance), "tolerance {tolerance}: {off} off");
        assert!(
            off > 0.0 && rays < 0.8,
            "tolerance {tolerance}: {off} off, {rays} of the rays: the test is not sensitive"
        );
    }
}

/// Mean difference of two images' green channels, and its standard error: the noise of pixels is independent.
fn difference(a: &Image, b: &Image) -> (f64, f64) {
    let [a, b] = [a, b].map(|image| image.channel("G").unwrap());
    let n = a.len() as f64;
    let all = a.iter().zip(b).map(|(a, b)| f64::from(*a) - f64::from(*b));
    let mean = all.clone().sum::<f64>() / n;
    (mean, (all.map(|d| (d - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt())
}

/// Voxel tags are unbiased and visibility cells lose light. Tags that hold only where all neighbours agree keep the
/// mean of `two-pass` in both scenes of the paper, with at most a third of the rays; a loss of 0.1 % would be detected.
/// Cells are dark if none of their rays reached the light, so they lose light but never add any, and coarser cells lose
/// more.
#[test]
fn tags_are_unbiased_and_cells_darken() {
    for name in ["box.glb", "sphere.glb"] {
        let of = |technique, cells, cell_rays| {
            let settings = settings(technique, [96, 96], 32).with(|s| {
                s.cells.resolution = cells;
                s.cells.rays_per_light = cell_rays;
            });
            render(&scene_file(name), &settings)
        };
        let (cells, cell_rays) = (Settings::default().cells.resolution, Settings::default().cells.rays_per_light);
        let (all, counts) = of(Technique::TWO_PASS, cells, cell_rays);
        let (tagged, tests) = of(Technique::VOXEL_TAGS, cells, cell_rays);
        let mean = all.channel("G").unwrap().iter().map(|v| f64::from(*v)).sum::<f64>() / all.pixels() as f64;
        let (off, error) = difference(&tagged, &all);
        let rays = tests.rays.shadow as f64 / counts.rays.shadow as f64;
        println!("{name}: tags {off} +- {error} of {mean}, {rays} of the rays and {} of cells", tests.rays.cell);
        // Without a closed form for any light both use the same samples, and the difference is 0.
        // By chance, 3.5 standard errors are exceeded once in 2,000 times.
        assert!(off.abs() <= 3.5 * error, "{name}: {off} +- {error}");
        assert!(rays < 0.34 && tests.rays.cell > 0, "{name}: {rays} of the rays");
        assert!((off - 1e-3 * mean).abs() > 3.5 * error, "{name}: a thousandth would not be detected");

        // Numbers of pixels that are darker and brighter by more than their noise.
        let lost_and_gained = |dark: &Image| {
            [1.0, -1.0].map(|sign| {
                let pairs = all.channel("G").unwrap().iter().zip(dark.channel("G").unwrap());
                pairs.filter(|(all, dark)| sign * (*all - *dark) > 0.2 * all.max(**dark).max(0.01)).count()
            })
        };
        // With two rays from each large cell, all rays of some partly lit cells are occluded.
        let (coarse, fine) =
            (of(Technique::VISIBILITY_CELLS, 12, 2).0, of(Technique::VISIBILITY_CELLS, cells, cell_rays).0);
        let [[lost, gained], [less, _]] = [&coarse, &fine].map(lost_and_gained);
        println!("{name}: {lost} pixels darker, {gained} brighter; {less} of fine cells");
        assert!(lost > 10 && gained == 0 && less < lost, "{name}: {lost} pixels darker, {gained} brighter; {less}");
        assert!(difference(&coarse, &all).0 < 0.0);
    }
}

/// No point that the light buffer classifies lit is shadowed: the image equals that of `two-pass` within its standard
/// error, with fewer rays. A loss or gain of 0.1 % would be detected.
#[test]
fn light_buffers_are_unbiased() {
    let mut detected = 0;
    // In the still life nearly all rays lead to the two mesh lights, for which lists decide less than for point lights.
    for (name, max_rays) in [("box.glb", 0.7), ("sphere.glb", 0.7), ("still_life.glb", 0.9)] {
        let of = |technique| render(&scene_file(name), &settings(technique, [96, 96], 16));
        let ((all, counts), (buffered, tests)) = (of(Technique::TWO_PASS), of(Technique::LIGHT_BUFFER));
        let mean = all.channel("G").unwrap().iter().map(|v| f64::from(*v)).sum::<f64>() / all.pixels() as f64;
        let (off, error) = difference(&buffered, &all);
        let rays = tests.rays.shadow as f64 / counts.rays.shadow as f64;
        println!("{name}: {off} +- {error} of {mean}, {rays} of the rays");
        // As with voxel tags: without a closed form both use the same samples. Only roundings differ.
        // By chance, 3.5 standard errors are exceeded once in 2,000 times.
        assert!(off.abs() <= 3.5 * error + 1e-6 * mean, "{name}: {off} +- {error}");
        assert!(rays < max_rays && tests.points.lit > 0, "{name}: {rays} of the rays");
        detected += u32::from((1e-3 * mean - off.abs()) > 3.5 * error);
    }
    assert_eq!(detected, 3, "a thousandth would not be detected");
}

/// Where the list of a cell decides for point lights, nothing is left to chance: rays are traced at the edges of
/// shadows, and where more than one triangle hides the light.
#[test]
fn light_buffers_decide_for_point_lights() {
    let (scene, view) = hall();
    let of = |technique| render_scene(scene.clone(), &view, &settings(technique, [64, 48], 2));
    let ((all, counts), (buffered, tests)) = (of(Technique::TWO_PASS), of(Technique::LIGHT_BUFFER));
    let (off, error) = difference(&buffered, &all);
    let rays = tests.rays.shadow as f64 / counts.rays.shadow as f64;
    println!("{off} +- {error}, {rays} of the rays; {:?}", tests.points);
    // By chance, 3.5 standard errors are exceeded once in 2,000 times.
    assert!(off.abs() <= 3.5 * error, "{off} +- {error}");
    assert!(rays < 0.2 && tests.points.shadowed > 1000, "{rays} of the rays");
}
