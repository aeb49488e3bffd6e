//! Rendering of stages and checks of stress families.

use penumbra::internal::stress::{self, Family, Stage};
use penumbra::{Aov, Image, Settings, Statistics, Technique};

pub use crate::device::gpu;

/// Renders a stage.
pub fn render(stage: &Stage, settings: &Settings) -> (Image, Statistics) {
    stress::render(gpu(), stage, settings).unwrap_or_else(|e| panic!("{e}"))
}

/// Settings of a small square image.
pub fn settings(technique: Technique, side: u32, spp: u32, max_bounces: u32) -> Settings {
    stress::settings(technique, side, spp, max_bounces)
}

/// The settings with the variance channels.
pub fn with_variance(settings: Settings) -> Settings {
    settings.with(|s| s.image.aovs = vec![Aov::Variance])
}

/// Asserts that a series stays within its bound at these values.
pub fn assert_holds(family: &Family, series: &str, values: &[f64]) {
    for reading in run(family, series, values) {
        assert!(reading.holds(), "{}, {series}: {reading:?}", family.name);
    }
}

/// Measures a series at these values.
pub fn run(family: &Family, series: &str, values: &[f64]) -> Vec<stress::Reading> {
    let found = family.series(series).unwrap_or_else(|| panic!("{}: there is no series '{series}'", family.name));
    found.run(gpu(), values, |reading| println!("{}, {series}: {reading:?}", family.name)).unwrap()
}

/// Asserts that every sample of every channel is finite.
pub fn assert_finite(image: &Image) {
    for channel in &image.channels {
        assert!(channel.samples.iter().all(|x| x.is_finite()), "{} is not finite", channel.name);
    }
}

/// The largest absolute value of the colour channels; NaN counts as larger.
pub fn brightest(image: &Image) -> f32 {
    let colours = image.rgb().unwrap();
    colours.into_iter().flatten().fold(0.0, |max, x| if x.abs() > max || x.is_nan() { x.abs() } else { max })
}

/// Asserts that two images are the same, bit by bit.
pub fn assert_same(image: &Image, other: &Image, what: &str) {
    let bits = |image: &Image| -> Vec<(String, Vec<u32>)> {
        let of = |samples: &[f32]| samples.iter().map(|x| x.to_bits()).collect();
        image.channels.iter().map(|channel| (channel.name.clone(), of(&channel.samples))).collect()
    };
    for ((name, a), (_, b)) in bits(image).into_iter().zip(bits(other)) {
        let off = a.iter().zip(&b).filter(|(a, b)| a != b).count();
        assert!(off == 0, "{what}: {off} pixels of {name} differ");
    }
}

/// Mean of the green channel, and the standard error of that mean from the channel `variance.G`.
pub fn mean_and_error(image: &Image) -> (f64, f64) {
    let mean = |name: &str| {
        let samples = image.channel(name).unwrap();
        samples.iter().map(|x| f64::from(*x)).sum::<f64>() / samples.len() as f64
    };
    (mean("G"), (mean("variance.G") / image.pixels() as f64).sqrt())
}
