//! Scenes that are large, small, far away, or cut into needles.

use glam::{DAffine3, DMat3, DVec3};
use penumbra::Technique;
use penumbra::internal::stress::oracle::difference;
use penumbra::internal::stress::placement::{ASPECT, OFFSET, SCALE, corner, room};
use penumbra::internal::stress::stage::{Part, inside_out};

use crate::setup::{assert_holds, assert_same, render, run, settings};

/// Every technique, scaled by powers of two: the same bits.
#[test]
fn powers_of_two_change_no_bit() {
    for technique in Technique::ALL {
        let settings = settings(technique, 24, 2, 4);
        let (reference, _) = render(&room(), &settings);
        assert!(reference.channel("G").unwrap().iter().any(|x| *x > 0.0), "{technique}: nothing is seen");
        for exponent in [-30, 30] {
            let (scaled, _) = render(&room().scaled(2f64.powi(exponent)), &settings);
            assert_same(&scaled, &reference, &format!("{technique}, 2^{exponent}"));
        }
    }
}

#[test]
fn other_scales_change_the_noise_alone() {
    assert_holds(&SCALE, "shadow-photons, powers of ten", &[1e-9, 1e9]);
}

/// 2^66 m is 7e19 m: its square is beyond f32, and so is the square of its inverse.
#[test]
fn squares_may_be_beyond_f32() {
    let settings = settings(Technique::ShadowPhotons, 24, 2, 4);
    let (reference, _) = render(&corner(), &settings);
    for exponent in [-66, 66] {
        let (scaled, _) = render(&corner().scaled(2f64.powi(exponent)), &settings);
        assert_same(&scaled, &reference, &format!("2^{exponent}"));
    }
}

/// As far as f32 carries the file's coordinates. Beyond that there is no scene left, and the measure says so.
#[test]
fn offsets_change_nothing() {
    assert_holds(&OFFSET, "in the node, which is f64", &[1e3, 1e8]);
    assert_holds(&OFFSET, "coordinates that f32 holds", &[1e3, 1e7]);
    assert_holds(&OFFSET, "any coordinates", &[1e4]);
    assert!(!run(&OFFSET, "coordinates that f32 holds", &[1e8])[0].holds(), "the test is blind");
}

#[test]
fn needles_are_as_good_as_any_triangle() {
    assert_holds(&ASPECT, "along the axes", &[1e3, 1e9]);
    assert_holds(&ASPECT, "tilted", &[1e3, 1e6]);
    assert_holds(&ASPECT, "shadow rays, tilted", &[1e3, 1e4]);
}

/// A scene that its nodes mirror is the scene, whether it was mirrored before or its matrices undo each other. Mirrored
/// triangles have their corners in another order, which rounds otherwise.
#[test]
fn mirrors_turn_nothing_inside_out() {
    let settings = settings(Technique::ShadowPhotons, 32, 1, 0);
    let (reference, _) = render(&room(), &settings);
    let mirror = DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)));
    let mut mirrored = room();
    for Part { triangles, places, .. } in &mut mirrored.parts {
        triangles.iter_mut().flatten().for_each(|corner| corner.x = -corner.x);
        *triangles = inside_out(std::mem::take(triangles));
        places[0] = mirror;
    }
    let (image, _) = render(&mirrored, &settings);
    let off = difference(&image, &reference);
    assert!(off < 1e-3, "mirrored: {off}");

    let mut twice = room();
    twice.parts.iter_mut().for_each(|part| part.places[0] = mirror * mirror);
    assert_same(&render(&twice, &settings).0, &reference, "mirrored twice");
}
