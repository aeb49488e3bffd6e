//! Comparisons pass what is the same, and find the worst lane of what is not.

use kernel_kit::compare::{Mismatch, exact, must_catch, ulps, within, within_relative, within_ulps};

fn inputs(lane: usize) -> String {
    format!("input {lane}")
}

/// The error states how many lanes differ, and the index, both values and the inputs of the worst one. The inputs of
/// other lanes are not computed.
#[test]
fn the_worst_lane_is_told() {
    exact(&[1u32, 2, 3], &[1, 2, 3], inputs).unwrap();
    let only_the_worst = |lane| if lane == 2 { inputs(lane) } else { panic!("lane {lane} is not the worst") };
    let text = exact(&[1u32, 5, 9, u32::MAX], &[1, 4, 3, u32::MAX], only_the_worst).unwrap_err().to_string();
    assert_eq!(text, "2 of 4 lanes differ; the worst is lane 2: got 9, expected 3 (off by 6); inputs: input 2");
    let extremes = exact(&[i64::MIN, 0], &[i64::MAX, 1], inputs).unwrap_err();
    assert!(matches!(extremes, Mismatch::Values { lane: 0, differing: 2, .. }), "{extremes}");
    assert_eq!(exact(&[1u32], &[1, 2], inputs), Err(Mismatch::Lanes { got: 1, expected: 2 }));
    exact::<u32>(&[], &[], inputs).unwrap();
}

/// Steps between floats, over zero, denormals and the largest.
#[test]
fn steps_between_floats_are_counted() {
    let next = |value: f32| f32::from_bits(value.to_bits() + 1);
    assert_eq!(ulps(1.0, next(next(1.0))), Some(2));
    assert_eq!(ulps(0.0, -0.0), Some(0));
    assert_eq!(ulps(f32::from_bits(1), -f32::from_bits(1)), Some(2));
    assert_eq!(ulps(f32::MAX, -f32::MAX), Some(2 * 0x7f7f_ffff));
    assert_eq!(ulps(f32::NAN, -f32::NAN), Some(0));
    assert_eq!(ulps(f32::INFINITY, f32::INFINITY), Some(0));
    for pair in [(f32::INFINITY, f32::MAX), (f32::INFINITY, -f32::INFINITY), (f32::NAN, 0.0)] {
        assert_eq!(ulps(pair.0, pair.1), None);
    }
    within_ulps(&[1.0, -2.0], &[next(1.0), -next(2.0)], 1, inputs).unwrap();
    let text = within_ulps(&[1.0, f32::NAN], &[next(next(1.0)), 1.0], 1, inputs).unwrap_err().to_string();
    assert!(text.starts_with("2 of 2 lanes differ; the worst is lane 1: got NaN, expected 1.0"), "{text}");
}

/// The relative bound holds down to the floor. NaN equals only NaN, and an infinity equals only itself.
#[test]
fn relative_bounds_have_a_floor() {
    let compare = |got: &[f32], expected: &[f64]| within_relative(got, expected, 0.01, 0.001, inputs);
    compare(&[100.5, 0.0005, f32::NAN, f32::INFINITY], &[100.0, 0.0, f64::NAN, f64::INFINITY]).unwrap();
    let text = must_catch("too far", compare(&[102.0, 0.005], &[100.0, 0.0])).to_string();
    assert!(text.contains("worst is lane 1") && text.contains("input 1"), "{text}");
    for wrong in [(f32::NAN, 1.0), (1.0, f64::NAN), (f32::INFINITY, 1e300), (f32::INFINITY, f64::NEG_INFINITY)] {
        must_catch("not finite", compare(&[wrong.0], &[wrong.1]));
    }
    within(&[1.0, 2.0], &[1.5, 2.0], |lane| [0.5, 0.0][lane], inputs).unwrap();
    must_catch("no bound is left", within(&[1.0, 2.0], &[1.5, 2.1], |lane| [0.5, 0.0][lane], inputs));
}

/// A fault that a comparison passes fails the test that planted it.
#[test]
#[should_panic(expected = "the planted fault is not caught: none")]
fn faults_that_are_missed_fail() {
    must_catch("none", exact(&[1u32], &[1], inputs));
}
