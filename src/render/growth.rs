//! How indirect light grows with the samples: when irradiance records get more gather rays. The errors of records and
//! samples are estimated, and their costs are measured by counted rays, so that the same render makes the same
//! decisions.

use super::denoise::RELMSE_FLOOR;

/// Squared error of the mean of samples, over the estimate from the difference of their parts. That estimate takes
/// samples for independent. But they are points of one low-discrepancy sequence, which avoid each other, so their parts
/// differ by more than the mean errs. It was 0.31 / 0.72 = 0.43 in the crowd with 4 samples, and 0.55 / 0.67 = 0.82 in
/// the sphere by `path` with 16 (docs/decisions.md, "Denoising").
pub(super) const VARIANCE_RATIO: f64 = 0.5;

/// The state at the last decision on gather rays: the image then, and the estimate of their error.
#[derive(Clone)]
pub(super) struct Growth {
    /// Samples of each pixel.
    pub samples: u32,
    /// Mean light of each pixel, and of its channels.
    pub means: Vec<f32>,
    /// relMSE of each pixel due to the limited number of gather rays, by [`errors_of_rays`]; `None` before any were
    /// added.
    pub errors: Option<Vec<f32>>,
}

impl Growth {
    /// relMSE of the image due to the limited number of gather rays.
    pub fn error(&self) -> Option<f64> {
        self.errors.as_deref().map(mean_error)
    }

    /// Whether it is time to decide again, with `samples` samples of each pixel: an estimate needs twice as many.
    pub fn is_due(&self, samples: u32) -> bool {
        samples >= 2 * self.samples
    }

    /// The estimated relMSE of the image of `samples` samples with these means, except for errors that all samples
    /// share: the difference from the image of fewer samples is the noise of both.
    pub fn noise(&self, means: &[f32], samples: u32) -> f64 {
        let changes = means.iter().zip(&self.means).map(|(now, before)| relative_square(now - before, *now));
        let fewer = f64::from(self.samples);
        VARIANCE_RATIO * mean(changes) * fewer / (f64::from(samples) - fewer)
    }
}

/// The relMSE of each pixel due to gather rays after their number rose by `factor`, which changed the `means` by
/// `changes`. The squared error of filtered records falls in inverse proportion to the rays (docs/decisions.md,
/// "Filtered records"), so doubling them removes as much error as it leaves.
pub(super) fn errors_of_rays(changes: &[f32], means: &[f32], factor: f64) -> Vec<f32> {
    let error = |(change, mean): (&f32, &f32)| (relative_square(*change, *mean) / (factor - 1.0)) as f32;
    changes.iter().zip(means).map(error).collect()
}

/// The mean of the pixels' errors.
pub(super) fn mean_error(errors: &[f32]) -> f64 {
    mean(errors.iter().copied().map(f64::from))
}

/// Whether `factor` times as many gather rays reduce the error by more than further samples do. The errors e of gather
/// rays and s of samples fall in inverse proportion to the times t and u spent on them. For a given t + u, e + s is
/// smallest where q = (e / s) / (t / u) is 1. The step divides q by `factor` squared, and the samples until the next
/// decision, which double, multiply it by 4. With the threshold of half of `factor`, q goes to 1 / q: as far below 1 as
/// it was above.
pub(super) fn wants_rays(error: f64, noise: f64, gather_rays: u64, other_rays: u64, factor: f64) -> bool {
    error * other_rays as f64 > 0.5 * factor * noise * gather_rays as f64
}

/// A single firefly counts as one wrong pixel, not as the error of the whole image.
fn relative_square(change: f32, mean: f32) -> f64 {
    (f64::from(change).powi(2) / (f64::from(mean).powi(2) + RELMSE_FLOOR)).min(1.0)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0u64), |(sum, count), value| (sum + value, count + 1));
    sum / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// The noise is that of the mean of all samples, earlier ones included, times VARIANCE_RATIO: samples of a sequence
    /// have less noise than the independent samples of this test.
    #[test]
    fn noise_is_that_of_all_samples() {
        let mut random = Random(1);
        // Samples of mean 4 and variance 1/12, of 20,000 pixels.
        let mut sum = |samples: u32| (0..samples).map(|_| 3.5 + random.uniform()).sum::<f64>();
        for (fewer, samples) in [(1, 2), (4, 8), (3, 8)] {
            let sums: Vec<[f64; 2]> = (0..20_000).map(|_| [sum(fewer), sum(samples - fewer)]).collect();
            let before = sums.iter().map(|[a, _]| (a / f64::from(fewer)) as f32).collect();
            let now: Vec<f32> = sums.iter().map(|[a, b]| ((a + b) / f64::from(samples)) as f32).collect();
            let growth = Growth { samples: fewer, means: before, errors: None };
            let expected = VARIANCE_RATIO / 12.0 / 16.0 / f64::from(samples);
            let found = growth.noise(&now, samples) / expected;
            // Squares of 20,000 pixels: a standard error of 1 %.
            assert!((found - 1.0).abs() < 0.05, "{fewer} of {samples}: {found}");
            assert!(!growth.is_due(2 * fewer - 1) && growth.is_due(2 * fewer));
        }
    }

    /// A change by an infinite amount counts as one wrong pixel of four.
    #[test]
    fn a_firefly_is_one_pixel() {
        let errors = errors_of_rays(&[f32::INFINITY, 0.0, 0.0, 0.0], &[1.0, 1.0, 0.0, 5.0], 2.0);
        assert_eq!((errors.as_slice(), mean_error(&errors)), ([1.0, 0.0, 0.0, 0.0].as_slice(), 0.25));
    }

    /// If a mean is taken over more numbers, the change predicts the squared error that is left.
    #[test]
    fn the_error_left_is_that_of_the_mean() {
        for (fewer, all) in [(16, 32), (16, 64), (8, 64)] {
            // The variance of the mean of all, and that of the difference, for numbers of variance 1.
            let (left, change) = (1.0 / f64::from(all), 1.0 / f64::from(fewer) - 1.0 / f64::from(all));
            // The change of a bright pixel, of which the floor is a small part.
            let errors = errors_of_rays(&[change.sqrt() as f32], &[100.0], f64::from(all) / f64::from(fewer));
            let found = mean_error(&errors);
            assert!((found * 1e4 / left - 1.0).abs() < 1e-5, "{fewer} of {all}: {found}, not {left}");
        }
    }

    /// Rays are wanted while their share of the error is above their share of the cost, and never without error.
    #[test]
    fn shares_of_error_and_cost_are_balanced() {
        let wants = |error: f64, gather_rays: u64| wants_rays(error, 1e-3, gather_rays, 100, 2.0);
        assert!(wants(2e-3, 100) && !wants(0.5e-3, 100) && !wants(2e-3, 300) && wants(0.5e-3, 10));
        assert!(!wants(0.0, 0) && !wants_rays(0.0, 0.0, 10, 10, 2.0));
        // A larger step is to come later.
        assert!(wants_rays(1.5e-3, 1e-3, 100, 100, 2.0) && !wants_rays(1.5e-3, 1e-3, 100, 100, 4.0));
        assert!(wants_rays(2.5e-3, 1e-3, 100, 100, 4.0));
    }
}
