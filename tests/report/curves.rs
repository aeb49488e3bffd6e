//! Curves that are powers of time, of which everything is known.

use penumbra::internal::report::curve::{Comparison, Curve, ratio};

/// `error` at 1 s, and in inverse proportion to time until 100 s.
fn inverse(error: f64) -> Curve {
    Curve::new([1.0, 10.0, 100.0].map(|time| (time, error / time)))
}

#[track_caller]
fn assert_near(found: Option<f64>, expected: f64) {
    let found = found.unwrap();
    // Logarithms and powers of numbers below 1000 lose a few units in the last place.
    assert!((found / expected - 1.0).abs() < 1e-13, "{found}, not {expected}");
}

#[test]
fn powers_of_time_are_followed_between_images() {
    let curve = inverse(1.0);
    assert_near(curve.error_at(20.0), 0.05);
    assert_near(curve.error_at(1.0), 1.0);
    assert_near(curve.error_at(100.0), 0.01);
    assert_near(curve.time_at(0.05), 20.0);
    assert_near(curve.slope(), -1.0);
    let (time, error) = curve.last();
    assert_near(Some(time), 100.0);
    assert_near(Some(error), 0.01);
}

#[test]
fn nothing_is_said_of_times_and_errors_that_were_not_seen() {
    let curve = inverse(1.0);
    assert_eq!(curve.error_at(0.9), None);
    assert_eq!(curve.error_at(101.0), None);
    assert_eq!(curve.time_at(0.009), None);
    assert_eq!(Curve::new([(1.0, 1.0)]).slope(), None);
    // As small from the first image on.
    assert_near(curve.time_at(2.0), 1.0);
}

#[test]
fn ratios_are_those_of_errors_at_a_time_and_of_times_to_an_error() {
    // The error of the second is three times as large at any time, so it takes three times as long to any error.
    let [ours, theirs] = [1.0, 3.0].map(|error| [1.0, 1.1, 0.9].map(|run| inverse(error * run)));
    let comparison = Comparison::new(&ours, &theirs);
    let (error_ratio, time_ratio) = (comparison.error_ratio.unwrap(), comparison.time_ratio.unwrap());
    assert_near(Some(comparison.time), 100.0);
    assert_near(Some(error_ratio.value), 1.0 / 3.0);
    // The largest of the last errors.
    assert_near(Some(comparison.error), 0.033);
    assert_near(Some(time_ratio.value), 1.0 / 3.0);
    // Runs that differ alike leave no doubt about their ratio.
    assert!(error_ratio.high - error_ratio.low < 1e-12);
    assert!(ratio(&ours, &theirs, |curve| curve.error_at(1000.0)).is_none());
}
