//! Extreme scales and offsets, needle-shaped triangles and mirrored nodes.

use glam::{DAffine3, DMat3, DVec3};
use penumbra::Technique;
use penumbra::internal::stress::oracle::difference;
use penumbra::internal::stress::placement::{ASPECT, OFFSET, SCALE, corner, room};
use penumbra::internal::stress::stage::{Part, inside_out};

use crate::setup::{assert_holds, assert_same, render, run, settings};

/// Scaling the scene by a power of two changes no bit, by any technique.
#[test]
fn powers_of_two_change_no_bit() {
    for technique in Technique::all() {
        let settings = settings(technique, 24, 2, 4);
        let (reference, _) = render(&room(), &settings);
        assert!(reference.channel("G").unwrap().iter().any(|x| *x > 0.0), "{technique}: the image is black");
        for exponent in [-30, 30] {
            let (scaled, _) = render(&room().scaled(2f64.powi(exponent)), &settings);
            assert_same(&scaled, &reference, &format!("{technique}, 2^{exponent}"));
        }
    }
}

/// Scaling by other factors changes the noise only.
#[test]
fn other_scales_change_the_noise_only() {
    assert_holds(&SCALE, "shadow-photons, powers of ten", &[1e-9, 1e9]);
}

/// Scenes whose squared size is beyond f32 render with the same bits. 2^66 m is 7e19 m; its square overflows, and that
/// of its inverse underflows.
#[test]
fn squared_sizes_may_be_beyond_f32() {
    let settings = settings(Technique::SHADOW_PHOTONS, 24, 2, 4);
    let (reference, _) = render(&corner(), &settings);
    for exponent in [-66, 66] {
        let (scaled, _) = render(&corner().scaled(2f64.powi(exponent)), &settings);
        assert_same(&scaled, &reference, &format!("2^{exponent}"));
    }
}

/// Moving the scene away from the origin changes nothing, as far as f32 represents the file's coordinates. Beyond that
/// no geometry is left, which the measure reports.
#[test]
fn offsets_change_nothing() {
    assert_holds(&OFFSET, "in the node, which is f64", &[1e3, 1e8]);
    assert_holds(&OFFSET, "coordinates that f32 holds", &[1e3, 1e7]);
    assert_holds(&OFFSET, "any coordinates", &[1e4]);
    assert!(!run(&OFFSET, "coordinates that f32 holds", &[1e8])[0].holds(), "the measure is not sensitive");
}

/// Needle-shaped triangles give the irradiance of a floor and stop no shadow rays that they should not.
#[test]
fn needles_are_as_accurate_as_other_triangles() {
    assert_holds(&ASPECT, "along the axes", &[1e3, 1e9]);
    assert_holds(&ASPECT, "tilted", &[1e3, 1e6]);
    assert_holds(&ASPECT, "shadow rays, tilted", &[1e3, 1e4]);
}

/// Mirroring nodes do not turn surfaces inside out. A scene mirrored in its file and again by its nodes is the
/// original, up to the rounding of another order of corners. Two mirrors in the same matrix change no bit.
#[test]
fn mirroring_nodes_keep_surfaces_outward() {
    let settings = settings(Technique::SHADOW_PHOTONS, 32, 1, 0);
    let (reference, _) = render(&room(), &settings);
    let mirror = DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)));
    let mut mirrored = room();
    for Part { triangles, instances, .. } in &mut mirrored.parts {
        triangles.iter_mut().flatten().for_each(|corner| corner.x = -corner.x);
        *triangles = inside_out(std::mem::take(triangles));
        instances[0] = mirror;
    }
    let (image, _) = render(&mirrored, &settings);
    let off = difference(&image, &reference);
    assert!(off < 1e-3, "mirrored: {off}");

    let mut twice = room();
    twice.parts.iter_mut().for_each(|part| part.instances[0] = mirror * mirror);
    assert_same(&render(&twice, &settings).0, &reference, "mirrored twice");
}
