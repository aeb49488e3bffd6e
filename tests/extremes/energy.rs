//! Conservation of energy: furnaces, flux, reciprocity, mirrors, and indirect light through narrow gaps.

use std::f64::consts::PI;

use glam::DVec3;
use penumbra::internal::stress::materials::{ALBEDO, ROUGHNESS};
use penumbra::internal::stress::oracle::{green, mean, relative};
use penumbra::internal::stress::stage::{Eye, Paint, Stage, View, cube, inside_out, square};
use penumbra::{Settings, Technique};

use crate::setup::{assert_holds, mean_and_error, render, settings, with_variance};

/// A white furnace has radiance 1 everywhere, up to an albedo of 1.
#[test]
fn furnaces_are_white() {
    // At 0 nothing is absorbed.
    for technique in ["path", "shadow-photons"] {
        assert_holds(&ALBEDO, &format!("{technique}, objects under a bright sky"), &[0.5, 1e-3, 0.0]);
        assert_holds(&ALBEDO, &format!("{technique}, closed room"), &[0.5, 1e-2]);
    }
}

/// The corner of a furnace is as white as the rest, with the irradiance cache and with a final gather at each point.
/// Records near a corner must be neither too sparse nor too dense.
#[test]
fn furnace_corners_are_white() {
    const SIDE: u32 = 24;
    let towards = DVec3::new(-1.0, -1.0, -1.0);
    let eye = Eye { position: DVec3::splat(-0.3), towards, view: View::Perspective(0.8) };
    let stage = Stage::new(eye).with(inside_out(cube(DVec3::ZERO, 0.5)), Paint { radiance: 0.5, ..Paint::matte(0.5) });
    for cache in [true, false] {
        let (flux_photons, gather_rays) = (Settings::default().flux_photons(), Settings::default().gather_rays());
        let settings = settings(Technique::SHADOW_PHOTONS, SIDE, 32, 32).with(|s| {
            s.indirect.irradiance_cache.enabled = cache;
            s.indirect.photons = Some(flux_photons);
            s.indirect.irradiance_cache.gather_rays = Some(gather_rays);
        });
        let (image, _) = render(&stage, &settings);
        let pixels: Vec<f64> = green(&image).collect();
        let mean_within = |radius: u32| {
            let within = |i: u32| (SIDE / 2).abs_diff(i % SIDE) < radius && (SIDE / 2).abs_diff(i / SIDE) < radius;
            let selected: Vec<f64> = (0..).zip(&pixels).filter(|(i, _)| within(*i)).map(|(_, x)| *x).collect();
            selected.iter().sum::<f64>() / selected.len() as f64
        };
        let off = pixels.iter().map(|radiance| relative(*radiance, 1.0)).fold(0.0, f64::max);
        println!("cache {cache}: mean {}, in the corner {}, worst pixel {off}", mean_within(SIDE), mean_within(3));
        // Each irradiance point uses some dozen photons. One photon is a tenth of the indirect half of the light.
        assert!(relative(mean_within(SIDE), 1.0) < 0.01, "cache {cache}: {}", mean_within(SIDE));
        assert!(relative(mean_within(3), 1.0) < 0.03, "cache {cache}: {} in the corner", mean_within(3));
        assert!(off < 0.2, "cache {cache}: {off}");
    }
}

/// The edges of a furnace are as white as its walls where the centres of pixels lie exactly on them: in a square image
/// along the axis of a cube, the diagonals show edges. From a record that rounding puts on the other side of a wall,
/// half of the gather rays leave the furnace.
#[test]
fn furnace_edges_through_the_centres_of_pixels_are_white() {
    const SIDE: u32 = 24;
    let eye = Eye { position: DVec3::Z * 0.45, towards: -DVec3::Z, view: View::Perspective(1.2) };
    let stage = Stage::new(eye).with(inside_out(cube(DVec3::ZERO, 0.5)), Paint { radiance: 0.2, ..Paint::matte(0.8) });
    for gather_rays in [64, 1024] {
        let settings = settings(Technique::TWO_PASS, SIDE, 16, 64)
            .with(|s| s.indirect.irradiance_cache.gather_rays = Some(gather_rays));
        let (image, _) = render(&stage, &settings);
        let pixels: Vec<f64> = green(&image).collect();
        let is_on_diagonal = |i: u32| i % SIDE == i / SIDE || i % SIDE + i / SIDE == SIDE - 1;
        let mean_of = |wanted: bool| {
            let selected: Vec<f64> =
                (0..).zip(&pixels).filter(|(i, _)| is_on_diagonal(*i) == wanted).map(|(_, x)| *x).collect();
            selected.iter().sum::<f64>() / selected.len() as f64
        };
        let (edges, walls) = (mean_of(true), mean_of(false));
        println!("{gather_rays} gather rays: {edges} on edges, {walls} on walls");
        // The error of the global map is everywhere. The gather rays of records leave less than 0.3 %.
        assert!(relative(edges, walls) < 0.01, "{gather_rays} gather rays: {edges} on edges, {walls} on walls");
    }
}

/// A metal reflects the albedo of its microfacets at any roughness, up to a mirror.
#[test]
fn metals_become_mirrors() {
    for technique in ["path", "shadow-photons"] {
        assert_holds(&ROUGHNESS, technique, &[1.0, 0.1, 1e-3, 1e-5]);
    }
}

/// The walls of a closed room receive the whole flux of a lamp as direct light.
#[test]
fn walls_receive_what_lamps_emit() {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let half = 0.1;
    // Each wall is seen from just in front of it. The lamp faces downwards, so the ceiling receives nothing.
    let walls = [x, -x, -y, z, -z];
    for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        let flux = |wall: DVec3| {
            let eye = Eye { position: wall * 0.499, towards: wall, view: View::Orthographic(0.5) };
            let stage = Stage::new(eye)
                .with(inside_out(cube(DVec3::ZERO, 0.5)), Paint::matte(0.5))
                .with(square(y * 0.45 + x * 0.1, x * half, z * half), Paint::lamp(1.0));
            // Radiance is albedo / pi times the irradiance, and the area of a wall is 1.
            mean(&render(&stage, &settings(technique, 24, 16, 0)).0) * PI / 0.5
        };
        let arrived: f64 = walls.into_iter().map(flux).sum();
        let emitted = PI * (2.0 * half).powi(2);
        println!("{technique}: {arrived} of {emitted}");
        // Points are evenly distributed over 576 pixels. The brightest parts of the walls, next to the lamp, are as
        // small as the lamp.
        assert!(relative(arrived, emitted) < 5e-3, "{technique}: {arrived} of {emitted}");
    }
}

/// Reciprocity: the flux from one square to another, past an occluder, is the same in both directions.
#[test]
fn flux_is_the_same_both_ways() {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let below = square(DVec3::ZERO, z * 0.5, x * 0.5);
    let above = square(y + x * 0.2, x * 0.2, z * 0.2);
    let shade = [square(y * 0.4, z * 0.15, x * 0.15), square(y * 0.4, x * 0.15, z * 0.15)].concat();
    for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        // Mean irradiance of the receiver times its area.
        let flux = |lamp: &Vec<_>, receiver: &Vec<_>, eye: Eye, area: f64| {
            let stage = Stage::new(eye)
                .with(receiver.clone(), Paint::matte(0.5))
                .with(shade.clone(), Paint::matte(0.0))
                .with(lamp.clone(), Paint::lamp(1.0));
            let (image, _) = render(&stage, &with_variance(settings(technique, 24, 64, 0)));
            let (mean, error) = mean_and_error(&image);
            [mean * area * PI / 0.5, error * area * PI / 0.5]
        };
        let up = Eye { position: y * 0.9 + x * 0.2, towards: y, view: View::Orthographic(0.2) };
        let down = Eye { position: y * 0.1, towards: -y, view: View::Orthographic(0.5) };
        let [a, error_a] = flux(&above, &below, down, 1.0);
        let [b, error_b] = flux(&below, &above, up, 0.16);
        let off = (a - b).abs();
        println!("{technique}: {a} +- {error_a} and {b} +- {error_b}");
        // The variance assumes independent samples; that of stratified samples is smaller.
        assert!(off < 3.0 * error_a.hypot(error_b), "{technique}: {a} and {b}");
        assert!(error_a.hypot(error_b) < 0.01 * a, "{technique}: too noisy to tell");
    }
}

/// A scene of black surfaces leaves out indirect light: no bounces, no gather rays, no photon maps, no irradiance
/// cache.
#[test]
fn black_surfaces_leave_indirect_light_out() {
    let eye = Eye { position: DVec3::Y * 0.4, towards: -DVec3::Y, view: View::Orthographic(0.4) };
    let stage = |albedo: f64| {
        Stage::new(eye)
            .with(inside_out(cube(DVec3::ZERO, 0.5)), Paint::matte(albedo))
            .with(square(DVec3::Y * 0.45, DVec3::X * 0.1, DVec3::Z * 0.1), Paint::lamp(1.0))
    };
    let settings = settings(Technique::SHADOW_PHOTONS, 16, 2, 8);
    let (_, black) = render(&stage(0.0), &settings);
    assert_eq!((black.rays.bounce, black.rays.gather, black.indirect.photons), (0, 0, 0), "{:?}", black.rays);
    for part in ["indirect", "global_map", "irradiance_cache"] {
        assert!(black.left_out.iter().any(|name| name == part), "{part}: {:?}", black.left_out);
    }
    let (_, grey) = render(&stage(0.5), &settings);
    assert!(
        grey.indirect.photons > 0 && grey.rays.gather > 0,
        "grey surfaces have no indirect light: the test is not sensitive"
    );
}

/// Indirect light through a slit matches the path tracer's. The slit joins two rooms; the lamp is in the other one.
#[test]
fn light_passes_through_a_slit() {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let eye = Eye {
        position: DVec3::new(0.9, 0.2, 0.3),
        towards: DVec3::new(-0.6, -0.5, -0.8),
        view: View::Perspective(1.2),
    };
    let slit = 0.02;
    let part = |from: f64, to: f64| {
        let middle = y * (0.5 * (from + to));
        let half = y * (0.5 * (to - from));
        [square(middle + x * 0.01, half, z * 0.5), square(middle - x * 0.01, z * 0.5, half)].concat()
    };
    let rooms = inside_out(
        cube(DVec3::ZERO, 0.5).into_iter().map(|corners| corners.map(|c| c * DVec3::new(2.0, 1.0, 1.0))).collect(),
    );
    let stage = Stage::new(eye)
        .with(rooms, Paint::matte(0.7))
        .with([part(-0.5, -slit), part(slit, 0.5)].concat(), Paint::matte(0.7))
        .with(square(DVec3::new(-0.4, 0.45, 0.0), x * 0.2, z * 0.2), Paint::lamp(10.0));
    let of = |technique, spp| {
        let settings = settings(technique, 24, spp, 16).with(|s| {
            s.indirect.photons = Some(1 << 16);
            s.indirect.irradiance_cache.gather_rays = Some(256);
        });
        mean_and_error(&render(&stage, &with_variance(settings)).0)
    };
    let (paths, photons) = (of(Technique::PATH, 512), of(Technique::SHADOW_PHOTONS, 16));
    println!("{paths:?}, {photons:?}");
    let (off, error) = ((paths.0 - photons.0).abs(), paths.1.hypot(photons.1));
    // One photon in a hundred passes the slit. All points share their error of a few percent.
    // By chance, 3.5 standard errors are exceeded once in 2,000 times.
    assert!(off < 3.5 * error + 0.05 * paths.0, "{photons:?}, paths {paths:?}");
    assert!(3.5 * error < 0.15 * paths.0, "too noisy to tell");
}
