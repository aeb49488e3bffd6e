//! The earlier methods that shadow photons are compared with: each is as right, and as wrong, as it says.

use glam::{DVec3, Vec3};
use penumbra::internal::scene::{LightKind, Scene};
use penumbra::{Aov, Camera, Image, Settings, Statistics, Technique};

use crate::meshes::{camera, cube, inside_out, scene, square, surface};
use crate::setup::{render, render_scene, scene_file};

fn settings(technique: Technique, size: [u32; 2], spp: u32) -> Settings {
    let [width, height] = size;
    Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = width;
        s.image.height = height;
        s.image.spp = spp;
        s.indirect.max_bounces = 0;
        s.image.aovs = vec![Aov::Variance];
    })
}

/// A room with pillars under 48 point lights, from bright ones to some of a thousandth of their power, and a square one.
fn hall() -> (Scene, Camera) {
    let pillar = |i: u32| {
        let place = DVec3::new(0.28 * f64::from(i % 3) - 0.28, -0.3, 0.25 * f64::from(i / 3) - 0.3);
        cube(place, 0.06)
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

/// Without a tolerance Ward's method tests every light, and the image is `two-pass`'s. With one, no sample is off by more
/// than that share of it, from many fewer rays; the method's promise, which half the tolerance does not keep.
#[test]
fn wards_error_is_within_its_tolerance() {
    let (mut scene, view) = hall();
    // A light with a surface has its noise taken out where it is guessed: not the same samples.
    let of = |scene: &Scene, technique, shadow_tolerance| {
        let settings = settings(technique, [64, 48], 2).with(|s| s.ward.tolerance = shadow_tolerance);
        render_scene(scene.clone(), &view, &settings)
    };
    let off = |(a, _): &(Image, Statistics), (b, _): &(Image, Statistics)| {
        let [a, b] = [a, b].map(|image| image.channel("G").unwrap());
        a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs() / b.max(1e-9))).fold(0.0, f64::max)
    };
    let (all, none) = (of(&scene, Technique::TwoPass, 0.0), of(&scene, Technique::WardAdaptive, 0.0));
    // Sums of the same samples, in other groups.
    assert!(off(&none, &all) < 1e-5, "tolerance 0: {} off", off(&none, &all));
    assert_eq!(none.1.rays.shadow, all.1.rays.shadow);

    scene.lights.remove(0);
    scene.triangles.iter_mut().for_each(|triangle| triangle.light = penumbra::internal::scene::NO_LIGHT);
    scene.materials.iter_mut().for_each(|material| material.emissive = Vec3::ZERO);
    let all = of(&scene, Technique::TwoPass, 0.0);
    for tolerance in [0.02, 0.1, 0.3] {
        let some = of(&scene, Technique::WardAdaptive, tolerance);
        let (off, rays) = (off(&some, &all), some.1.rays.shadow as f64 / all.1.rays.shadow as f64);
        println!("tolerance {tolerance}: {off} off at most, {rays} of the rays");
        // What is found is never more than the true light; keys keep twelve bits of a potential.
        assert!(off < 1.001 * f64::from(tolerance), "tolerance {tolerance}: {off} off");
        assert!(off > 0.0 && rays < 0.8, "tolerance {tolerance}: {off} off, {rays} of the rays: no test");
    }
}

/// Mean difference of two images' greens, and its standard error: pixels differ by noise of their own.
fn difference(a: &Image, b: &Image) -> (f64, f64) {
    let [a, b] = [a, b].map(|image| image.channel("G").unwrap());
    let n = a.len() as f64;
    let all = a.iter().zip(b).map(|(a, b)| f64::from(*a) - f64::from(*b));
    let mean = all.clone().sum::<f64>() / n;
    (mean, (all.map(|d| (d - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt())
}

/// Tags that stand where their neighbours agree leave the mean of `two-pass` as it is, in both scenes of the paper, with a
/// third of the rays at most; a thousandth of the light would be missed. Cells that are dark where no ray saw the light lose
/// some of it and gain none, and the more the coarser they are.
#[test]
fn tags_do_not_bias_and_cells_darken() {
    for name in ["box.glb", "sphere.glb"] {
        let of = |technique, cells, cell_rays| {
            let settings = settings(technique, [96, 96], 32).with(|s| {
                s.cells.resolution = cells;
                s.cells.rays_per_light = cell_rays;
            });
            render(&scene_file(name), &settings)
        };
        let (cells, cell_rays) = (Settings::default().cells.resolution, Settings::default().cells.rays_per_light);
        let (all, counts) = of(Technique::TwoPass, cells, cell_rays);
        let (tagged, tests) = of(Technique::VoxelTags, cells, cell_rays);
        let mean = all.channel("G").unwrap().iter().map(|v| f64::from(*v)).sum::<f64>() / all.pixels() as f64;
        let (off, error) = difference(&tagged, &all);
        let rays = tests.rays.shadow as f64 / counts.rays.shadow as f64;
        println!("{name}: tags {off} +- {error} of {mean}, {rays} of the rays and {} of cells", tests.rays.cell);
        // Where no light has a closed form both are of the same samples, and nothing differs at all.
        assert!(off.abs() <= 3.5 * error, "{name}: {off} +- {error}");
        assert!(rays < 0.34 && tests.rays.cell > 0, "{name}: {rays} of the rays");
        assert!((off - 1e-3 * mean).abs() > 3.5 * error, "{name}: a thousandth is not seen");

        // Of a pixel past what noise does to it.
        let lost_and_gained = |dark: &Image| {
            [1.0, -1.0].map(|sign| {
                let pairs = all.channel("G").unwrap().iter().zip(dark.channel("G").unwrap());
                pairs.filter(|(all, dark)| sign * (*all - *dark) > 0.2 * all.max(**dark).max(0.01)).count()
            })
        };
        // Two rays from each of a few large cells: some that are partly lit see nothing.
        let (coarse, fine) =
            (of(Technique::VisibilityCells, 12, 2).0, of(Technique::VisibilityCells, cells, cell_rays).0);
        let [[lost, gained], [less, _]] = [&coarse, &fine].map(lost_and_gained);
        println!("{name}: {lost} pixels darker, {gained} brighter; {less} of fine cells");
        assert!(lost > 10 && gained == 0 && less < lost, "{name}: {lost} pixels darker, {gained} brighter; {less}");
        assert!(difference(&coarse, &all).0 < 0.0);
    }
}
