//! Estimates with their 95 % confidence intervals.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::statistics::wilson;

/// An estimate and its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    /// Student's interval for the mean of at least two independent values.
    pub fn of_mean(values: &[f64]) -> Interval {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
        Interval::around(mean, (squares / (n * (n - 1.0))).sqrt(), values.len() - 1)
    }

    /// [`Interval::of_mean`] of the logarithms, for positive values that differ by factors. Falls back to the values
    /// themselves if one of them is not positive.
    pub fn of_geometric_mean(values: &[f64]) -> Interval {
        if values.iter().any(|x| *x <= 0.0) {
            return Interval::of_mean(values);
        }
        Interval::of_mean(&values.iter().map(|x| x.ln()).collect::<Vec<_>>()).map(f64::exp)
    }

    /// The jackknife's interval for a statistic of `count` independent items, at least three. `estimate` computes the
    /// statistic, without the item whose index it is given.
    pub fn jackknife(count: usize, estimate: impl Fn(Option<usize>) -> f64) -> Interval {
        let n = count as f64;
        let without: Vec<f64> = (0..count).map(|i| estimate(Some(i))).collect();
        let mean = without.iter().sum::<f64>() / n;
        let squares: f64 = without.iter().map(|x| (x - mean).powi(2)).sum();
        Interval::around(estimate(None), (squares * (n - 1.0) / n).sqrt(), count - 1)
    }

    /// Wilson's score interval for the share `part` / `whole`.
    pub fn of_share(part: u64, whole: u64) -> Interval {
        let (centre, half) = wilson(part, whole);
        Interval {
            value: if whole == 0 { 0.0 } else { part as f64 / whole as f64 },
            low: if part == 0 { 0.0 } else { centre - half },
            high: if part == whole { 1.0 } else { centre + half },
        }
    }

    /// Student's interval around an estimate whose standard error has this many degrees of freedom.
    fn around(value: f64, standard_error: f64, degrees_of_freedom: usize) -> Interval {
        // Fails only for 0 degrees of freedom.
        let quantile = StudentsT::new(0.0, 1.0, degrees_of_freedom as f64).map_or(f64::NAN, |t| t.inverse_cdf(0.975));
        Interval { value, low: value - quantile * standard_error, high: value + quantile * standard_error }
    }

    /// The interval of a monotonically increasing function of the estimate.
    pub fn map(self, increasing: impl Fn(f64) -> f64) -> Interval {
        Interval { value: increasing(self.value), low: increasing(self.low), high: increasing(self.high) }
    }

    /// Whether the interval contains `x`.
    pub fn holds(&self, x: f64) -> bool {
        (self.low..=self.high).contains(&x)
    }
}
