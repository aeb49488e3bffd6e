//! Extreme numbers of pixels, samples, photons and panes.

use glam::DVec3;
use penumbra::internal::stress::density::{PHOTONS, SAMPLES};
use penumbra::internal::stress::materials::LAYERS;
use penumbra::internal::stress::placement::room;
use penumbra::internal::stress::stage::{Eye, Paint, Stage, View, square};
use penumbra::settings::Background;
use penumbra::{Aov, Settings, Technique};

use crate::setup::{assert_finite, assert_holds, mean_and_error, render, run, settings, with_variance};

/// One photon, or ten million in one grid cell, give a correct mean.
#[test]
fn one_photon_or_a_full_cell_is_enough() {
    assert_holds(&PHOTONS, "shadow-photons", &[1.0, 1e5, 1e7]);
    assert_holds(&PHOTONS, "visibility-estimate", &[1e4, 1e7]);
}

/// The mean of many equal samples is their value.
#[test]
fn sums_of_many_samples_are_exact() {
    assert_holds(&SAMPLES, "shadow-photons", &[1e4]);
}

/// A stack of panes transmits its share of the light, up to the loop budget of traversal.
#[test]
fn panes_transmit_their_share() {
    assert_holds(&LAYERS, "seen through", &[1.0, 1e4]);
    assert_holds(&LAYERS, "lit through, two-pass", &[1.0, 3000.0]);
    for series in ["lit through, shadow-photons", "lit through, path"] {
        assert_holds(&LAYERS, series, &[1.0, 1000.0]);
    }
    // Beyond the loop budget there is an error instead of an image.
    assert!(run(&LAYERS, "lit through, two-pass", &[1e4])[0].outcome.is_err());
}

/// Audits keep the mean of an image with slats that are thinner than a pixel and than the distance between photons.
#[test]
fn thin_slats_keep_their_shadow() {
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
        let settings = settings(technique, 32, 64, 0).with(|s| s.visibility_map.photons_per_light = Some(2048));
        mean_and_error(&render(&stage, &with_variance(settings)).0)
    };
    let (all, few, none) =
        (of(Technique::TWO_PASS, true), of(Technique::SHADOW_PHOTONS, true), of(Technique::TWO_PASS, false));
    println!("{all:?}, {few:?}, without slats {none:?}");
    let apart = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() / a.1.hypot(b.1);
    // By chance, 3.5 standard errors are exceeded once in 2,000 times.
    assert!(apart(all, few) < 3.5, "{all:?} and {few:?}");
    assert!(apart(all, none) > 3.5, "the slats make no difference: the test is not sensitive");
}

/// Images of one pixel and of the maximum width render; images without pixels or samples are refused.
#[test]
fn images_may_have_any_shape() {
    for [width, height] in [[1, 1], [Settings::MAX_SIDE, 1], [1, 4099]] {
        for technique in [Technique::PATH, Technique::SHADOW_PHOTONS] {
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
    let smallest = settings(Technique::PATH, 1, 1, 0);
    for empty in [
        smallest.clone().with(|s| s.image.width = 0),
        smallest.clone().with(|s| s.image.height = 0),
        smallest.clone().with(|s| s.image.spp = 0),
        smallest.clone().with(|s| s.image.aovs = vec![Aov::Albedo, Aov::Depth, Aov::Albedo]),
        smallest.clone().with(|s| s.image.background = Background::Colour([0.0, f32::NAN, 0.0])),
        smallest.clone().with(|s| s.image.background = Background::Colour([0.0, -1.0, 0.0])),
    ] {
        assert!(empty.check().is_err());
    }
    smallest.check().unwrap();
}
