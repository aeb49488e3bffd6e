//! Ratios of the noise of stratified samples to that of independent ones, on synthetic halves whose noise is known.

use penumbra::internal::render::denoise::stratification::{ratios, reduced};
use penumbra::internal::render::denoise::{Colour, Component, Light};

use crate::random::{Random, RandomInput as _};

const SIZE: [u32; 2] = [90, 70];

const PIXELS: usize = 90 * 70;

/// A half of a grey image, with normal noise of the variance that `variance` gives to a column.
fn half(random: &mut Random, variance: &dyn Fn(usize) -> f64) -> Vec<Colour> {
    let pixel = |i: usize| [0; 3].map(|_| (1.0 + variance(i % SIZE[0] as usize).sqrt() * random.normal()) as f32);
    (0..PIXELS).map(pixel).collect()
}

fn is_near(found: f32, expected: f32) -> bool {
    // A region has 400 pixels of three channels and more: a standard error of less than a twentieth.
    found > 0.8 * expected && found < 1.2 * expected
}

/// Halves of 2 and of 3 samples, independent on the left, with a fifth of the variance on the right.
#[test]
fn the_halves_tell_the_noise_of_each_region() {
    let mut random = Random(31);
    let share = |x: usize| if x < 45 { 1.0 } else { 0.2 };
    let (first, second) = (half(&mut random, &|x| share(x) / 2.0), half(&mut random, &|x| share(x) / 3.0));
    let variance = vec![[1.0 / 5.0; 3]; PIXELS];
    let found = ratios(SIZE, &variance, [&first, &second], [2, 3]);
    let at = |x: usize| found[35 * SIZE[0] as usize + x];
    // Regions reach 20 pixels far. Chance may take the ratio below 1, which it never exceeds.
    assert!(is_near(at(10), 1.0) && found.iter().all(|ratio| *ratio <= 1.0), "{}", at(10));
    assert!(is_near(at(80), 0.2), "{}", at(80));
    // It must matter how many samples a half has, and that halves do not share their noise.
    assert!(!is_near(ratios(SIZE, &variance, [&first, &second], [1, 4])[35 * SIZE[0] as usize + 80], 0.2));
    assert!(ratios(SIZE, &variance, [&first, &first], [2, 3]).iter().all(|ratio| *ratio == 0.0));
}

/// Variances shrink by the ratio, and by more if it is small; variances of all samples shrink more than those of a
/// half.
#[test]
fn variances_shrink_by_the_ratios() {
    let component = Component { mean: vec![[3.0; 3]; 3], variance: vec![[2.0, 4.0, 8.0]; 3] };
    let light = Light { components: vec![component] };
    for (is_half, factors) in [(false, [0.0, 0.375, 1.0]), (true, [0.0, 0.425, 1.0])] {
        let found = reduced(&light, &[vec![0.0, 0.5, 1.0]], is_half);
        assert_eq!(found.components[0].mean, light.components[0].mean);
        for (variance, factor) in found.components[0].variance.iter().zip(factors) {
            let expected = [2.0, 4.0, 8.0].map(|x: f32| x * factor);
            // Roundings of three products.
            assert!((0..3).all(|c| (variance[c] - expected[c]).abs() < 1e-5), "{variance:?} for {expected:?}");
        }
    }
}

/// Without noise, or with values that are not finite, the ratio is unknown, and variances stay as they are.
#[test]
fn light_without_noise_or_without_bounds_has_a_ratio() {
    for (variance, first, second) in
        [(0.0, 1.0, 1.0), (f32::INFINITY, f32::INFINITY, 1.0), (f32::NAN, 1.0, 1.0), (f32::MAX, f32::MAX, f32::MIN)]
    {
        let image = |value: f32| vec![[value; 3]; 6];
        let found = ratios([3, 2], &image(variance), [&image(first), &image(second)], [1, 1]);
        assert!(found.iter().all(|ratio| *ratio == 1.0), "{variance}: {found:?}");
    }
}
