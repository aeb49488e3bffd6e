//! Intervals against published quantiles.

use penumbra::internal::report::interval::Interval;

#[track_caller]
fn assert_near(interval: Interval, expected: [f64; 3], tolerance: f64) {
    let found = [interval.value, interval.low, interval.high];
    let near = found.iter().zip(&expected).all(|(found, expected)| (found - expected).abs() <= tolerance);
    assert!(near, "{found:?}, not {expected:?}");
}

/// The interval of a mean is Student's.
#[test]
fn a_mean_has_students_interval() {
    // The standard deviation of the 5 values is sqrt(2.5); the tabulated t for 4 degrees of freedom is 2.776.
    let half = 2.776 * (2.5f64 / 5.0).sqrt();
    // The table has three decimals.
    assert_near(Interval::of_mean(&[1.0, 2.0, 3.0, 4.0, 5.0]), [3.0, 3.0 - half, 3.0 + half], 5e-4);
    assert_near(Interval::of_mean(&[7.0, 7.0, 7.0]), [7.0; 3], 0.0);
}

/// The interval of a geometric mean is Student's for the logarithms.
#[test]
fn a_geometric_mean_has_an_interval_of_factors() {
    let interval = Interval::of_geometric_mean(&[0.1, 10.0, 1.0]);
    // The decimal logarithms are -1, 0 and 1: standard error 1 / sqrt(3), t 4.303 for 2 degrees of freedom.
    let factor = 10f64.powf(4.303 / 3f64.sqrt());
    // The table has three decimals.
    assert_near(interval.map(f64::log10), [0.0, -factor.log10(), factor.log10()], 5e-4);
    assert_eq!(Interval::of_geometric_mean(&[0.0, 1.0]), Interval::of_mean(&[0.0, 1.0]));
}

/// The interval of a share is Wilson's.
#[test]
fn a_share_has_wilsons_interval() {
    // Newcombe (1998), table I, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for (part, whole, low, high) in
        [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]
    {
        // The table has four decimals.
        assert_near(Interval::of_share(part, whole), [part as f64 / whole as f64, low, high], 5e-5);
    }
    assert_near(Interval::of_share(20, 20), [1.0, 1.0 - 0.1611, 1.0], 5e-5);
}

/// The jackknife's interval of a mean equals Student's.
#[test]
fn the_jackknife_of_a_mean_is_students_interval() {
    let values = [3.0, 1.0, 4.0, 1.0, 5.0];
    let jackknife = Interval::jackknife(values.len(), |without| {
        let kept: Vec<f64> = (0..values.len()).filter(|i| Some(*i) != without).map(|i| values[i]).collect();
        kept.iter().sum::<f64>() / kept.len() as f64
    });
    let student = Interval::of_mean(&values);
    // Rounding errors of some ten operations in f64.
    assert_near(jackknife, [student.value, student.low, student.high], 1e-13);
}
