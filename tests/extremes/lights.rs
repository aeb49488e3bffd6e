//! Extreme lights: tiny, huge, touching surfaces, at grazing angles, and many.

use glam::{DAffine3, DVec3};
use penumbra::internal::stress::lights::{DISTANCE, LIGHTS, RADIANCE, RADIUS, RATIO};
use penumbra::internal::stress::oracle::{green, polygon_irradiance, reflected};
use penumbra::internal::stress::stage::{Eye, Paint, PointLight, Stage, View, cube, inside_out, outline, square};
use penumbra::{Aov, Technique};

use crate::setup::{assert_finite, assert_holds, brightest, mean_and_error, render, settings, with_variance};

/// A lamp of any size gives Lambert's irradiance.
#[test]
fn a_lamp_of_any_size_has_lamberts_irradiance() {
    assert_holds(&RADIUS, "shadow-photons", &[1e3, 10.0, 0.1, 1e-3, 1e-6, 1e-9]);
    assert_holds(&RADIUS, "shadow-photons, away from the middle", &[1e3, 1e-4]);
    assert_holds(&RADIUS, "two-pass", &[1e3, 1e-6, 1e-9]);
    assert_holds(&RADIUS, "path", &[1e3, 1e-6, 1e-9]);
}

/// A lamp that nearly touches a surface gives Lambert's irradiance.
#[test]
fn a_lamp_that_nearly_touches_has_lamberts_irradiance() {
    assert_holds(&DISTANCE, "under a square", &[1e-2, 1e-4]);
    assert_holds(&DISTANCE, "under a disc", &[1e-2, 1e-4]);
    assert_holds(&DISTANCE, "on a wall beside it", &[1e-4, 1e-7]);
    assert_holds(&DISTANCE, "path, under a square", &[1e-4, 1e-6]);
    assert_holds(&DISTANCE, "two-pass, under a square", &[1e-2, 1e-4, 1e-6]);
    assert_holds(&DISTANCE, "two-pass, under a square of 512 triangles", &[1e-2]);
}

/// The image is proportional to the radiance of all lights.
#[test]
fn images_are_proportional_to_radiance() {
    let two = 2f64.powi(40);
    for technique in ["path", "two-pass", "shadow-photons", "photon-map"] {
        assert_holds(&RADIANCE, technique, &[1.0 / two, two, 1e-12]);
    }
    assert_holds(&RADIANCE, "shadow-photons", &[1e12]);
    assert_holds(&RADIANCE, "photon-map", &[1e-1]);
}

/// A strong light does not change the image of another closed room.
#[test]
fn a_strong_light_does_not_change_another_room() {
    for technique in ["path", "two-pass"] {
        assert_holds(&RATIO, technique, &[1e12]);
    }
    assert_holds(&RATIO, "shadow-photons", &[1e4]);
}

/// A lamp split into many lights gives the light of the whole.
#[test]
fn many_lights_equal_the_whole_lamp() {
    assert_holds(&LIGHTS, "shadow-photons", &[9.0, 1024.0, 10_000.0, 99_856.0]);
    assert_holds(&LIGHTS, "path", &[1024.0, 99_856.0]);
}

/// Light at a grazing angle of 1e-6 rad gives the correct irradiance. It comes from a strip at the floor's edge, whose
/// height is two millionths of its distance.
#[test]
fn grazing_light_has_lamberts_irradiance() {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let strip = square(x + y * 1e-6, z * 0.5, y * 1e-6);
    let eye = Eye { position: y * 0.5, towards: -y, view: View::Orthographic(0.02) };
    let stage = Stage::new(eye)
        .with(square(DVec3::ZERO, z, x), Paint::matte(0.5))
        .with(strip.clone(), Paint { double_sided: true, ..Paint::lamp(1e6) });
    let expected = reflected(0.5, 1e6 * polygon_irradiance(&outline(&strip), DVec3::ZERO, y));
    for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        let (image, _) = render(&stage, &with_variance(settings(technique, 16, 16, 0)));
        let (mean, error) = mean_and_error(&image);
        println!("{technique}: {mean} +- {error}, expected {expected}");
        // Points classified by photons use the closed form, whose terms cancel here except for a billionth. Its error
        // is 1e-6 of the angle that the strip subtends, which is nearly 1.
        let closed = if technique == Technique::SHADOW_PHOTONS { reflected(0.5, 1e6 * 1e-6) } else { 0.0 };
        // By chance, 3.5 standard errors are exceeded once in 2,000 times.
        assert!((mean - expected).abs() < 3.5 * error + closed, "{technique}: {mean} +- {error} for {expected}");
        assert!(error < 0.02 * expected, "{technique}: too noisy to tell");
    }
}

/// A point light that lies exactly in a ceiling, as lamps in exported scenes do, lights the floor by I cos / r^2 at any
/// slope of the ceiling; and photons carry as much as shadow rays find.
#[test]
fn a_point_light_in_a_ceiling_lights_the_floor() {
    const SIDE: u32 = 16;
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let eye = Eye { position: y * 0.8, towards: -y, view: View::Orthographic(0.4) };
    let both = |centre, a, b| [square(centre, a, b), square(centre, b, a)].concat();
    let level = Stage {
        lights: vec![PointLight { position: y, intensity: 2.0 }],
        ..Stage::new(eye).with(square(DVec3::ZERO, z, x), Paint::matte(0.5)).with(both(y, x, z), Paint::matte(0.5))
    };
    let axis = DVec3::new(1.0, 2.0, 3.0).normalize();
    let sloped = level.clone().transformed(DAffine3::from_axis_angle(axis, 0.7));
    for (stage, technique) in [&level, &sloped].into_iter().flat_map(|s| Technique::all().map(move |t| (s, t))) {
        let (image, _) = render(stage, &settings(technique, SIDE, 1, 0));
        let expected = |i: u32| {
            let (origin, _) = eye.ray([i % SIDE, i / SIDE], SIDE);
            let r2 = origin.x * origin.x + origin.z * origin.z + 1.0;
            reflected(0.5, 2.0 / (r2 * r2.sqrt()))
        };
        let expected: Vec<f64> = (0..SIDE * SIDE).map(expected).collect();
        let found: Vec<f64> = green(&image).collect();
        // A map of photons has noise: 2 % of the mean are three standard errors of 20,000 photons in the view.
        let mean = found.iter().sum::<f64>() / expected.iter().sum::<f64>();
        assert!((mean - 1.0).abs() < 0.02, "{technique}: {mean} of the light");
        if !technique.shows_map() {
            let off = found.iter().zip(&expected).map(|(found, expected)| (found / expected - 1.0).abs());
            // Rounding of positions.
            assert!(off.fold(0.0, f64::max) < 1e-4, "{technique}: {found:?}, not {expected:?}");
        }
    }
}

/// A lamp may lie on the floor or pierce it: radiance above the floor is finite, and a lamp on the floor gives no light
/// below it.
#[test]
fn lamps_may_touch_and_pierce_surfaces() {
    let view = |height: f64| Eye {
        position: DVec3::new(0.3, height, 0.35),
        towards: DVec3::new(-0.5, -height, -0.55),
        view: View::Perspective(1.0),
    };
    let floor =
        [square(DVec3::ZERO, DVec3::Z * 0.5, DVec3::X * 0.5), square(DVec3::ZERO, DVec3::X * 0.5, DVec3::Z * 0.5)];
    let lying = square(DVec3::ZERO, DVec3::Z * 0.1, DVec3::X * 0.1);
    let sunk = cube(DVec3::Y * 0.05, 0.1);
    for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        for (name, lamp) in [("lying", &lying), ("sunk", &sunk)] {
            let stage = |eye: Eye| {
                Stage::new(eye)
                    .with(inside_out(cube(DVec3::ZERO, 0.5)), Paint::matte(0.5))
                    .with(floor.concat(), Paint::matte(0.5))
            };
            let lit = stage(view(0.3)).with(lamp.clone(), Paint::lamp(1.0));
            let (image, statistics) = render(&lit, &settings(technique, 24, 4, 4));
            assert_finite(&image);
            assert_eq!(statistics.not_finite, 0, "{technique}, {name}");
            assert!(brightest(&image) > 0.0, "{technique}, {name}: the image is black");
            // The cube reaches through the floor, so there is light below it.
            if name == "lying" {
                let below = stage(view(-0.3)).with(lamp.clone(), Paint::lamp(1.0));
                let (image, _) = render(&below, &settings(technique, 24, 4, 4));
                assert_eq!(brightest(&image), 0.0, "{technique}: light below the floor");
            }
        }
    }
}

/// The penumbra of an edge halfway between a square lamp and the floor is as wide as the lamp, and visibility is linear
/// across it.
#[test]
fn penumbrae_are_linear_and_as_wide_as_the_lamp() {
    const SIDE: u32 = 48;
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let half = 0.1;
    let eye = Eye { position: y * 0.4, towards: -y, view: View::Orthographic(0.2) };
    let stage = Stage::new(eye)
        .with(square(DVec3::ZERO, z, x), Paint::matte(0.5))
        // The occluder covers x > 0 at half the lamp's height.
        .with(
            [square(x * 0.5 + y * 0.5, z, x * 0.5), square(x * 0.5 + y * 0.5, x * 0.5, z)].concat(),
            Paint::matte(0.5),
        )
        .with(square(y, x * half, z * half), Paint::lamp(1.0));
    for technique in [Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        let settings = settings(technique, SIDE, 1, 0).with(|s| {
            s.image.aovs = vec![Aov::Shadow];
            s.shadow_rays.samples = 256;
        });
        let (image, _) = render(&stage, &settings);
        let visibility = image.channel("shadow.light 0.visibility").unwrap();
        // The camera's up axis is x.
        for row in 0..SIDE {
            let of_row = &visibility[(row * SIDE) as usize..][..SIDE as usize];
            let visible = of_row.iter().map(|v| f64::from(*v)).sum::<f64>() / f64::from(SIDE);
            let (origin, _) = eye.ray([0, row], SIDE);
            // The lamp's edges bound the penumbra at -half and half.
            let expected = ((half - origin.x) / (2.0 * half)).clamp(0.0, 1.0);
            // The tolerance covers 256 light points in 16 columns, and penumbra points at the rims classified lit or
            // shadowed.
            assert!((visible - expected).abs() < 0.02, "{technique}, row {row}: {visible} for {expected}");
        }
    }
}
