//! The techniques that show the global map directly, by density estimation: `photon-map` and `negative-photons`.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use penumbra::internal::scene::{AlphaMode, LightKind, Material, Scene};
use penumbra::{Settings, Technique};

use crate::meshes::{camera, cube, scene, sphere, square, surface};
use crate::setup::{mean_and_error, render_scene};

const SHOWN: [Technique; 2] = [Technique::PHOTON_MAP, Technique::NEGATIVE_PHOTONS];

/// The mean of an image of direct light only.
fn mean(scene: Scene, view: &penumbra::Camera, technique: Technique, flux_photons: u32) -> f64 {
    let settings = Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = 48;
        s.image.height = 48;
        s.image.spp = 16;
        s.indirect.max_bounces = 0;
        s.indirect.photons = Some(flux_photons);
        s.image.aovs = vec![penumbra::Aov::Variance];
    });
    mean_and_error(&render_scene(scene, view, &settings).0, "G").0
}

/// Negative photons below a surface do not darken it. A cloth lies just above a table, with a block on it, and an unlit
/// board casts a shadow on both. The search discs are higher than the gap between cloth and table, so estimates on the
/// cloth include the table's negative photons. They balance because the table counts as lit too. The means of both
/// techniques agree within 2 % (65,536 rays, some ten thousand photons in view). They agree with shadow rays within 6
/// %, because light leaks across shadow edges within a disc (0.1 % with a million rays).
#[test]
fn hidden_layers_do_not_darken() {
    let lamp = square(DVec3::Y, DVec3::X * 0.02, DVec3::Z * 0.02);
    let cloth = square(DVec3::Y * 0.005, DVec3::X * 0.4, -DVec3::Z * 0.4);
    let board = square(DVec3::new(0.06, 0.7, 0.0), DVec3::X * 0.045, -DVec3::Z * 0.2);
    let meshes = |board_is_there: bool| {
        let mut meshes = vec![
            (lamp.clone(), surface(0.0, 500.0)),
            (square(DVec3::ZERO, DVec3::X, -DVec3::Z), surface(0.6, 0.0)),
            (cloth.clone(), Material { double_sided: true, ..surface(0.6, 0.0) }),
            (cube(DVec3::new(-0.2, 0.055, 0.1), 0.05), surface(0.6, 0.0)),
        ];
        meshes.extend(board_is_there.then(|| (board.clone(), Material { unlit: true, ..surface(0.0, 0.0) })));
        meshes
    };
    let view = camera(DVec3::new(0.0, 0.4, 0.9), DVec3::new(0.0, -0.45, -0.9), 0.6);
    let of = |board, technique| mean(scene(&meshes(board), Vec::new()), &view, technique, 65_536);
    let shaded = of(true, Technique::TWO_PASS);
    let without_board = of(false, Technique::TWO_PASS);
    assert!(without_board > 1.1 * shaded, "the board's shadow is too small to be detected: {without_board}, {shaded}");
    let [positive, negative] = SHOWN.map(|technique| of(true, technique));
    println!("{positive}, by negative energy {negative}, by shadow rays {shaded}");
    assert!((positive / shaded - 1.0).abs() < 0.06, "{positive}, by shadow rays {shaded}");
    assert!((negative / positive - 1.0).abs() < 0.02, "{positive}, by negative energy {negative}");
}

/// Density estimation on a smooth surface finds the photons, which lie on its flat triangles. The ball has smooth
/// normals and triangles that span 22 degrees, and is lit from the camera. Shading points are up to 2 % of the radius
/// above the triangles, more than the height of the discs of 60,000 photons. The means are those of shadow rays on the
/// smooth ball within 3 %: the area of the triangles is 4 % smaller than the ball's, and their outline as seen from the
/// light receives 1 % less.
#[test]
fn photons_are_found_below_smooth_surfaces() {
    let eye = DVec3::Z * 3.0;
    let ball = || {
        // The ball is seen from the light within 0.17.
        let light = LightKind::Spot {
            position: eye.as_vec3(),
            direction: glam::Vec3::NEG_Z,
            intensity: glam::Vec3::splat(5.0),
            cos_inner: 0.18f32.cos(),
            cos_outer: 0.2f32.cos(),
            range: f32::INFINITY,
        };
        let mut scene = scene(&[(sphere(DVec3::ZERO, 0.5, 8), surface(0.6, 0.0))], vec![light]);
        Arc::make_mut(&mut scene.vertices).iter_mut().for_each(|vertex| vertex.normal = vertex.position.normalize());
        scene
    };
    let view = camera(eye, DVec3::NEG_Z, 0.4);
    let expected = mean(ball(), &view, Technique::TWO_PASS, 65_536);
    // Two photon rays in three hit the ball.
    for technique in SHOWN {
        let found = mean(ball(), &view, technique, 1 << 17);
        println!("{technique}: {found}, by shadow rays {expected}");
        assert!((found / expected - 1.0).abs() < 0.03, "{technique}: {found}, by shadow rays {expected}");
    }
}

/// With negative photons, irradiance is that of triangles. A shading normal that is bent by an angle gets a part of it:
/// (1 + cos) / 2 of light that is the same from everywhere, as a part of the sky is below its horizon. The floor of a
/// room that glows divides it in two; no photon is stored, so the tolerance of 0.1 % is for rounding alone.
#[test]
fn bent_normals_get_their_share_of_even_light() {
    const ALBEDO: f32 = 0.6;
    const RADIANCE: f32 = 2.0;
    let glow = Material { double_sided: true, ..surface(0.0, RADIANCE) };
    // Bent by 50 degrees, so that the floor is no part of a smooth surface.
    let bent = DVec3::new(50f64.to_radians().sin(), 50f64.to_radians().cos(), 0.0);
    let floor = square(DVec3::ZERO, DVec3::X, -DVec3::Z);
    let mut scene = scene(&[(floor, surface(ALBEDO, 0.0)), (cube(DVec3::ZERO, 1.0), glow)], Vec::new());
    for triangle in scene.triangles.iter().filter(|triangle| triangle.material == 0) {
        for vertex in triangle.vertices {
            Arc::make_mut(&mut scene.vertices)[vertex as usize].normal = bent.as_vec3();
        }
    }
    let found = mean(scene, &camera(DVec3::Y * 0.9, DVec3::NEG_Y, 0.3), Technique::NEGATIVE_PHOTONS, 1 << 18);
    let expected = f64::from(ALBEDO * RADIANCE) * (0.5 + 0.5 * bent.y);
    println!("{found}, in closed form {expected}");
    assert!((found / expected - 1.0).abs() < 1e-3, "{found}, in closed form {expected}");
}

/// A blended square shows its share of the light, whatever axis it lies across: alpha times that of an opaque one. The
/// probes that measure the area of a disc pass the square at random, each point's on its own. When all points with the
/// same x coordinate had the same random numbers, a square across X showed 0.7 to 1.4 times its light.
#[test]
fn blended_surfaces_show_their_share_of_the_map() {
    let (height, angle, intensity, albedo) = (1.0, 0.5f32, 3.0, 0.6);
    // The irradiance of a light without a size, over what the camera sees from 0.9.
    let seen = 0.9 * f64::from(angle / 2.0).tan();
    const SIDE: i32 = 64;
    let at = |i: i32| seen * (2.0 * (f64::from(i) + 0.5) / f64::from(SIDE) - 1.0);
    let irradiance = |x: f64, y: f64| intensity * height / (x * x + y * y + height * height).powf(1.5);
    let sum: f64 = (0..SIDE * SIDE).map(|i| irradiance(at(i % SIDE), at(i / SIDE))).sum();
    let expected = albedo / PI * sum / f64::from(SIDE * SIDE);
    for (normal, edge) in [(DVec3::X, DVec3::Y), (DVec3::Y, DVec3::Z), (DVec3::Z, DVec3::X)] {
        for alpha in [0.25, 0.5, 0.8] {
            let material = surface(albedo as f32, 0.0);
            let base_colour = material.base_colour.truncate().extend(alpha);
            let blended = Material { alpha: AlphaMode::Blend, base_colour, ..material };
            let position = (height * normal).as_vec3();
            let intensity = Vec3::splat(intensity as f32);
            let light = LightKind::Point { position, intensity, range: f32::INFINITY };
            let scene = scene(&[(square(DVec3::ZERO, edge, normal.cross(edge)), blended)], vec![light]);
            let found = mean(scene, &camera(0.9 * normal, -normal, angle), Technique::PHOTON_MAP, 1 << 17);
            let share = found / (f64::from(alpha) * expected);
            println!("across {normal}, alpha {alpha}: {share}");
            // At alpha 0.25, all 16 probes pass one disc in a hundred, three thousand photons are in view, and 9,000
            // camera rays stop: 1 % less light, and 2 % of noise.
            assert!((share - 1.0).abs() < 0.06, "across {normal}, alpha {alpha}: {share}");
        }
    }
}
