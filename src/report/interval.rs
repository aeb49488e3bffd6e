//! Numbers with the interval that holds the truth with a probability of 95 %.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::statistics::wilson;

/// An estimate and its 95 % interval.
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
    /// The mean of independent values, at least two: Student's interval.
    pub fn of_mean(values: &[f64]) -> Interval {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
        Interval::around(mean, (squares / (n * (n - 1.0))).sqrt(), values.len() - 1)
    }

    /// As [`Interval::of_mean`] of the logarithms, where there are: of positive values that differ by factors.
    pub fn of_geometric_mean(values: &[f64]) -> Interval {
        if values.iter().any(|x| *x <= 0.0) {
            return Interval::of_mean(values);
        }
        Interval::of_mean(&values.iter().map(|x| x.ln()).collect::<Vec<_>>()).map(f64::exp)
    }

    /// What `estimate` makes of `count` independent things, at least three, all but the one that it is told to leave
    /// out: the jackknife's interval.
    pub fn jackknife(count: usize, estimate: impl Fn(Option<usize>) -> f64) -> Interval {
        let n = count as f64;
        let without: Vec<f64> = (0..count).map(|i| estimate(Some(i))).collect();
        let mean = without.iter().sum::<f64>() / n;
        let squares: f64 = without.iter().map(|x| (x - mean).powi(2)).sum();
        Interval::around(estimate(None), (squares * (n - 1.0) / n).sqrt(), count - 1)
    }

    /// A share, `part` of `whole` that were looked at: Wilson's score interval.
    pub fn of_share(part: u64, whole: u64) -> Interval {
        let (centre, half) = wilson(part, whole);
        Interval {
            value: if whole == 0 { 0.0 } else { part as f64 / whole as f64 },
            low: if part == 0 { 0.0 } else { centre - half },
            high: if part == whole { 1.0 } else { centre + half },
        }
    }

    /// An estimate with a standard error that `freedom` degrees of freedom say.
    fn around(value: f64, standard_error: f64, freedom: usize) -> Interval {
        // Only a location that is not finite or a scale or freedom of 0 is refused.
        let quantile = StudentsT::new(0.0, 1.0, freedom as f64).map_or(f64::NAN, |t| t.inverse_cdf(0.975));
        Interval { value, low: value - quantile * standard_error, high: value + quantile * standard_error }
    }

    /// The interval of a function that rises throughout.
    pub fn map(self, rising: impl Fn(f64) -> f64) -> Interval {
        Interval { value: rising(self.value), low: rising(self.low), high: rising(self.high) }
    }

    /// `x` lies within.
    pub fn holds(&self, x: f64) -> bool {
        (self.low..=self.high).contains(&x)
    }
}
