//! Few and many: pixels, samples, photons, panes.

use glam::DVec3;
use penumbra::internal::stress::density::{PHOTONS, SAMPLES};
use penumbra::internal::stress::materials::LAYERS;
use penumbra::internal::stress::placement::room;
use penumbra::internal::stress::stage::{Eye, Paint, Stage, View, square};
use penumbra::{Settings, Technique};

use crate::setup::{assert_finite, assert_holds, mean_and_error, render, run, settings, with_variance};

#[test]
fn one_photon_or_a_cell_full_of_them() {
    assert_holds(&PHOTONS, "shadow-photons", &[1.0, 1e5, 1e7]);
    assert_holds(&PHOTONS, "visibility-estimate", &[1e4, 1e7]);
}

#[test]
fn many_samples_lose_nothing() {
    assert_holds(&SAMPLES, "shadow-photons", &[1e4]);
}

#[test]
fn panes_let_their_share_through() {
    assert_holds(&LAYERS, "seen through", &[1.0, 1e4]);
    assert_holds(&LAYERS, "lit through, two-pass", &[1.0, 3000.0]);
    for series in ["lit through, shadow-photons", "lit through, path"] {
        assert_holds(&LAYERS, series, &[1.0, 1000.0]);
    }
    // Beyond what loops may take there is an error, and no image.
    assert!(run(&LAYERS, "lit through, two-pass", &[1e4])[0].outcome.is_err());
}

/// Slats thinner than a pixel and than the distance of photons: audits keep the mean of the image that of all shadow rays.
#[test]
fn slats_are_not_missed() {
    let eye = Eye { position: DVec3::Y * 0.3, towards: -DVec3::Y, view: View::Orthographic(0.3) };
    let slat = |i: i32| {
        let centre = DVec3::Y * 0.5 + DVec3::X * (0.05 * f64::from(i));
        let (half, other) = (DVec3::Z * 0.5, DVec3::X * 0.003);
        [square(centre, half, other), square(centre, other, half)].concat()
    };
    let stage = Stage::new(eye)
        .with(square(DVec3::ZERO, DVec3::Z * 0.5, DVec3::X * 0.5), Paint::matte(0.5))
        .with((-8..=8).flat_map(slat).collect(), Paint::matte(0.5))
        .with(square(DVec3::Y, DVec3::X * 0.01, DVec3::Z * 0.01), Paint::lamp(100.0));
    let of = |technique, slats: bool| {
        let stage = if slats {
            stage.clone()
        } else {
            Stage { parts: [0, 2].map(|i| stage.parts[i].clone()).into(), ..stage.clone() }
        };
        let settings = settings(technique, 32, 64, 0).with(|s| s.visibility_map.photons_per_light = 2048);
        mean_and_error(&render(&stage, &with_variance(settings)).0)
    };
    let (all, few, none) =
        (of(Technique::TwoPass, true), of(Technique::ShadowPhotons, true), of(Technique::TwoPass, false));
    println!("{all:?}, {few:?}, without slats {none:?}");
    let apart = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() / a.1.hypot(b.1);
    assert!(apart(all, few) < 3.5, "{all:?} and {few:?}");
    assert!(apart(all, none) > 3.5, "the test does not see the slats");
}

/// The smallest image, and one as wide as can be; of no pixels or samples there is none.
#[test]
fn images_of_any_shape() {
    for [width, height] in [[1, 1], [Settings::MAX_SIDE, 1], [1, 4099]] {
        for technique in [Technique::Path, Technique::ShadowPhotons] {
            let settings = settings(technique, 1, 1, 1).with(|s| {
                s.image.width = width;
                s.image.height = height;
            });
            let (image, _) = render(&room(), &settings);
            assert_eq!((image.width, image.height), (width, height));
            assert_finite(&image);
            assert!(image.channel("A").unwrap().iter().all(|a| *a == 1.0), "{technique}: {width} x {height}");
        }
    }
    let least = settings(Technique::Path, 1, 1, 0);
    for none in [
        least.clone().with(|s| s.image.width = 0),
        least.clone().with(|s| s.image.height = 0),
        least.clone().with(|s| s.image.spp = 0),
    ] {
        assert!(none.check().is_err());
    }
    least.check().unwrap();
}
