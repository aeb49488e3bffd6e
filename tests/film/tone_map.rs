//! Tone mapping against the formulas of its sources.

use penumbra::internal::render::film::View;

/// IEC 61966-2-1, in f64.
fn srgb(x: f64) -> f64 {
    if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Rounding of f32 powers and sums of a few terms of order 1.
const ROUNDING: f64 = 2e-6;

fn assert_near(found: [f32; 3], expected: [f64; 3], tolerance: f64) {
    for (found, expected) in found.into_iter().zip(expected) {
        assert!((f64::from(found) - expected).abs() <= tolerance, "{found} for {expected}");
    }
}

#[test]
fn neutral_subtracts_the_fresnel_part_and_keeps_base_colours() {
    // Under white light of irradiance pi, a surface reflects its base colour and the 4 % of dielectrics.
    for base in [[0.1, 0.3, 0.7], [0.05, 0.05, 0.05], [0.7, 0.2, 0.5]] {
        let colour = base.map(|x| x as f32 + 0.04);
        assert_near(View::Neutral.apply(colour), base.map(srgb), ROUNDING);
    }
    // Below 0.08 the offset is x - 6.25 x^2, so the minimum component becomes 6.25 x^2.
    let darkest = 6.25 * 0.04 * 0.04;
    let expected = [darkest, 0.5 - (0.04 - darkest), 0.3 - (0.04 - darkest)];
    assert_near(View::Neutral.apply([0.04, 0.5, 0.3]), expected.map(srgb), ROUNDING);
}

#[test]
fn neutral_compresses_highlights() {
    // Grey 2.04: peak 2 after the offset, 1 - 0.24^2 / (2 + 0.24 - 0.76).
    let peak = 1.0 - 0.24 * 0.24 / 1.48;
    assert_near(View::Neutral.apply([2.04; 3]), [srgb(peak); 3], ROUNDING);
    // Red of the same peak moves towards white by 1 - 1 / (0.15 (2 - peak) + 1). Its minimum component is 0.
    let white = 1.0 - 1.0 / (0.15 * (2.0 - peak) + 1.0);
    let red = [peak * (1.0 - white) + peak * white, peak * white, peak * white];
    assert_near(View::Neutral.apply([2.0, 0.0, 0.0]), red.map(srgb), ROUNDING);
}

#[test]
fn standard_and_raw_clip() {
    assert_near(View::Standard.apply([0.001, 0.18, 3.0]), [12.92 * 0.001, srgb(0.18), 1.0], ROUNDING);
    assert_eq!(View::Raw.apply([0.25, -1.0, 3.0]), [0.25, 0.0, 1.0]);
}

#[test]
fn agx_is_the_published_fit_along_greys() {
    // The matrices keep greys, up to their rounding to four digits, so only the curve changes a grey.
    for ev in [-6.0f64, -2.0, 0.0, 1.5, 3.0, 5.0] {
        let grey = 0.18 * ev.exp2();
        let x = (grey.log2() + 12.47393) / (4.026069 + 12.47393);
        let curve = 15.5 * x.powi(6) - 40.14 * x.powi(5) + 31.96 * x.powi(4) - 6.868 * x.powi(3)
            + 0.4298 * x.powi(2)
            + 0.1191 * x
            - 0.00232;
        // The two Rec.2020 matrices sum to one within 2e-4 a row; sRGB's slope is 12.92 at most.
        assert_near(View::Agx.apply([grey as f32; 3]), [srgb(curve.max(0.0).powf(2.2)); 3], 12.92 * 4e-4);
    }
}

#[test]
fn agx_maps_saturated_highlights_to_white_and_black_to_black() {
    assert_eq!(View::Agx.apply([0.0; 3]), [0.0; 3]);
    // AgX desaturates highlights, where clipping would leave pure blue.
    let blue = View::Agx.apply([0.0, 0.0, 1000.0]);
    assert!(blue[0] > 0.5 && blue[1] > 0.5, "{blue:?}");
}

#[test]
fn every_view_is_total_bounded_and_monotonic_along_greys() {
    let hostile = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 0.0, -0.0, 1e-45, 1.0];
    for view in View::ALL {
        for r in hostile {
            for g in hostile {
                for b in hostile {
                    let out = view.apply([r, g, b]);
                    assert!(out.iter().all(|x| (0.0..=1.0).contains(x)), "{view} of {r} {g} {b}: {out:?}");
                }
            }
        }
        let greys = (-200..100).map(|i| view.apply([(i as f32 / 10.0).exp2(); 3])[1]);
        assert!(greys.clone().zip(greys.skip(1)).all(|(a, b)| a <= b), "{view}");
    }
}

#[test]
fn views_parse_from_their_printed_names() {
    for view in View::ALL {
        assert_eq!(view.to_string().parse::<View>().unwrap(), view);
    }
    assert_eq!("filmic".parse::<View>().unwrap_err().exit_code(), 2);
}
