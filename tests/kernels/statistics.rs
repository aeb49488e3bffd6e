//! Statistical tests of samples, at a significance level that holds for a whole family of tests.

/// Probability that a correct sampler fails at least one test of a family. Seeds are fixed, so a test that passed once
/// always passes.
const SIGNIFICANCE: f64 = 1e-3;

/// Checks counts against their expectation by Pearson's chi-square. Cells with an expectation below 5 are pooled.
/// `family` is the number of tests that share the significance level (Sidak).
pub fn chi_square(observed: &[u64], expected: &[f64], family: u32) -> Result<(), String> {
    assert_eq!(observed.len(), expected.len());
    let (mut statistic, mut cells, mut rest) = (0.0, 0u32, (0.0, 0.0));
    let mut order: Vec<usize> = (0..observed.len()).collect();
    order.sort_by(|&i, &j| expected[i].total_cmp(&expected[j]));
    for i in order {
        let (o, e) = (observed[i] as f64, expected[i]);
        if e == 0.0 && o > 0.0 {
            return Err(format!("{o} samples in cell {i}, which should have none"));
        }
        rest = (rest.0 + o, rest.1 + e);
        if rest.1 >= 5.0 {
            statistic += (rest.0 - rest.1).powi(2) / rest.1;
            cells += 1;
            rest = (0.0, 0.0);
        }
    }
    assert!(cells > 3, "{cells} cells are too few for a test");
    // Wilson and Hilferty: the cube root is normal to three digits at these degrees of freedom.
    let k = f64::from(cells - 1);
    let z = ((statistic / k).cbrt() - (1.0 - 2.0 / (9.0 * k))) / (2.0 / (9.0 * k)).sqrt();
    let limit = normal_quantile(1.0 - significance(family));
    if z > limit {
        Err(format!("chi-square {statistic:.1} over {k} degrees of freedom: z {z:.1} > {limit:.1}"))
    } else {
        Ok(())
    }
}

/// Checks a mean of independent samples against its expectation, two-sided; `error` is the mean's standard error.
pub fn z_test(mean: f64, error: f64, expected: f64, family: u32) -> Result<(), String> {
    let limit = normal_quantile(1.0 - significance(family) / 2.0);
    let z = (mean - expected) / error;
    if z.abs() <= limit {
        Ok(())
    } else {
        Err(format!("mean {mean} +- {error}, expected {expected}: z {z:.1} > {limit:.1}"))
    }
}

/// Mean and its standard error.
pub fn mean_and_error(samples: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = samples.clone().count() as f64;
    let mean = samples.clone().sum::<f64>() / n;
    let variance = samples.map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

fn significance(family: u32) -> f64 {
    1.0 - (1.0 - SIGNIFICANCE).powf(1.0 / f64::from(family))
}

/// Quantile of the standard normal distribution, by bisection of its integral.
fn normal_quantile(p: f64) -> f64 {
    let below = |x: f64| {
        // Simpson's rule over [0, x]: exact to 1e-12 with steps this fine.
        let steps = 2000;
        let h = x / f64::from(steps);
        let density = |t: f64| (-t * t / 2.0).exp() / (2.0 * std::f64::consts::PI).sqrt();
        let inner: f64 = (1..steps).map(|i| density(h * f64::from(i)) * if i % 2 == 1 { 4.0 } else { 2.0 }).sum();
        0.5 + h / 3.0 * (density(0.0) + density(x) + inner)
    };
    let (mut low, mut high) = (0.0, 12.0);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if below(middle) < p { low = middle } else { high = middle }
    }
    low
}

/// The tests distinguish a fair die from a loaded one.
#[test]
fn a_loaded_die_is_found() {
    // The quantile from a table has six decimals.
    assert!((normal_quantile(0.975) - 1.959964).abs() < 1e-5);
    let expected = [1000.0; 6];
    chi_square(&[990, 1013, 1007, 980, 1020, 990], &expected, 1).unwrap();
    assert!(chi_square(&[900, 1013, 1007, 980, 960, 1140], &expected, 1).is_err());
    z_test(1.02, 0.01, 1.0, 1).unwrap();
    assert!(z_test(1.04, 0.01, 1.0, 1).is_err());
}
