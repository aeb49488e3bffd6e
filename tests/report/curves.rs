//! Curves that are powers of time, for which all results are known.

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

/// Between two images a curve is interpolated as a power of time.
#[test]
fn curves_are_interpolated_as_powers_of_time() {
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

/// Curves are not extrapolated: times and errors outside the measured range give `None`.
#[test]
fn curves_are_not_extrapolated() {
    let curve = inverse(1.0);
    assert_eq!(curve.error_at(0.9), None);
    assert_eq!(curve.error_at(101.0), None);
    assert_eq!(curve.time_at(0.009), None);
    assert_eq!(Curve::new([(1.0, 1.0)]).slope(), None);
    // The first image already has a smaller error.
    assert_near(curve.time_at(2.0), 1.0);
}

/// A comparison gives the ratio of errors at the last common time and of times to the smallest common error.
#[test]
fn comparisons_give_ratios_of_errors_and_of_times() {
    // The second error is three times as large at any time, so its time to any error is three times as long.
    let [ours, theirs] = [1.0, 3.0].map(|error| [1.0, 1.1, 0.9].map(|run| inverse(error * run)));
    let comparison = Comparison::new(&ours, &theirs);
    let (error_ratio, time_ratio) = (comparison.error_ratio.unwrap(), comparison.time_ratio.unwrap());
    assert_near(Some(comparison.time), 100.0);
    assert_near(Some(error_ratio.value), 1.0 / 3.0);
    // The largest of the final errors.
    assert_near(Some(comparison.error), 0.033);
    assert_near(Some(time_ratio.value), 1.0 / 3.0);
    // Both techniques vary alike from run to run, so the ratio has no uncertainty.
    // Roundings of logarithms in f64, as above, times the quantile of Student's t for few runs.
    assert!(error_ratio.high - error_ratio.low < 1e-12);
    assert!(ratio(&ours, &theirs, |curve| curve.error_at(1000.0)).is_none());
}
