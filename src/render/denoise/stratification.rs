//! Variances of the means of stratified samples.
//!
//! The samples of a pixel are points of one sequence that avoid each other, so the variance of their mean is less than
//! that of as many independent samples. How much less differs from scene to scene and from place to place. It is
//! estimated from the halves of the samples: the mean square of their difference in a region, over the value that
//! independent samples would give.

use rayon::prelude::*;

use super::mixture::of_regions;
use super::{Colour, Component, Light};

/// The part of the halves' ratio that remains for all samples, and for a half alone, where samples are stratified well
/// (a ratio near 0). Halves avoid each other too, so their difference has more noise than each of them. Measured with
/// references at 4 and 16 samples, in three scenes by two techniques: 0.43 to 0.82, and 0.69 to 0.96. The smallest
/// parts belong to the smallest ratios; the larger ones belong to ratios near 1, for which [`reduced`] keeps more of
/// the ratio.
const REST_OF_ALL: f32 = 0.5;
const REST_OF_HALF: f32 = 0.7;

/// For each pixel, the noise of its light over that of independent samples, from the `variance` of the mean of
/// independent samples and the difference of the halves' means. It is at most 1: larger values arise by chance, or,
/// much larger ones, from a firefly that only one half has.
pub fn ratios(size: [u32; 2], variance: &[Colour], halves: [&[Colour]; 2], half_samples: [u32; 2]) -> Vec<f32> {
    let [first, second] = half_samples.map(f64::from);
    // The variance of the halves' difference over that of the mean of all, if samples were independent.
    let share = (first + second) * (1.0 / first + 1.0 / second);
    let [a, b] = halves;
    let square = |(a, b): (&Colour, &Colour)| (0..3).map(|c| (f64::from(a[c]) - f64::from(b[c])).powi(2)).sum::<f64>();
    let found = of_regions(&a.par_iter().zip(b).map(square).collect::<Vec<_>>(), size);
    let expected = |variance: &Colour| share * variance.iter().map(|x| f64::from(*x)).sum::<f64>();
    let expected = of_regions(&variance.par_iter().map(expected).collect::<Vec<_>>(), size);
    let ratio = |(found, expected): (&f64, &f64)| (found / expected).clamp(0.0, 1.0) as f32;
    // 0 over 0 and values that are not finite count as independent samples.
    let known = |ratio: f32| if ratio.is_nan() { 1.0 } else { ratio };
    found.iter().zip(&expected).map(ratio).map(known).collect()
}

/// The light with the variances that stratified samples have, by the [`ratios`] of its components; of one half or of
/// all.
pub fn reduced(light: &Light, ratios: &[Vec<f32>], is_half: bool) -> Light {
    let rest = if is_half { REST_OF_HALF } else { REST_OF_ALL };
    // The more samples are like independent ones, the more of the ratio remains.
    let factor = |ratio: f32| ratio * (rest + (1.0 - rest) * ratio);
    let component = |(component, ratios): (&Component, &Vec<f32>)| {
        let scaled = |(variance, ratio): (&Colour, &f32)| variance.map(|x| x * factor(*ratio));
        let variance = component.variance.par_iter().zip(ratios).map(scaled).collect();
        Component { mean: component.mean.clone(), variance }
    };
    Light { components: light.components.iter().zip(ratios).map(component).collect() }
}
