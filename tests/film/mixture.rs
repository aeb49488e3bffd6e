//! The mixture of a raw image and denoised ones, on made-up images whose errors are known.

use penumbra::internal::render::denoise::Colour;
use penumbra::internal::render::denoise::mixture::{FilteredImages, Mixed, Raw, alone, mix};

use crate::random::{Random, RandomInput as _};

const SIZE: [u32; 2] = [97, 83];

/// The true image: constant, and bright enough that the floor of relative errors does not matter.
const TRUTH: f32 = 2.0;

/// Samples whose noise is that of independent ones.
static INDEPENDENT: [f32; pixels(SIZE)] = [1.0; pixels(SIZE)];

/// Standard deviation of a half's noise.
const NOISE: f64 = 0.3;

/// An image in three versions: of all samples, and of both halves.
#[derive(Clone)]
struct Versions {
    all: Vec<Colour>,
    halves: [Vec<Colour>; 2],
}

impl Versions {
    fn of(all: Colour, pixels: usize) -> Versions {
        Versions { all: vec![all; pixels], halves: [vec![all; pixels], vec![all; pixels]] }
    }

    /// An image offset by `offset`, with noise of standard deviation `noise` in each half, and the mean of both halves.
    fn noisy(offset: f64, noise: f64, seed: u64) -> Versions {
        let mut random = Random(seed);
        let mut half = || -> Vec<Colour> {
            let pixel = || [0, 1, 2].map(|_| (f64::from(TRUTH) + offset + noise * random.normal()) as f32);
            std::iter::repeat_with(pixel).take(pixels(SIZE)).collect()
        };
        let [a, b] = [half(), half()];
        Versions { all: mean(&a, &b), halves: [a, b] }
    }

    /// The true image with two kinds of noise in its halves: opposite noise of standard deviation `NOISE`, and noise
    /// that is the same in both, with `shared` times the variance.
    fn avoiding(shared: f32, seed: u64) -> Versions {
        let [both, opposite] = [seed, seed + 1].map(|seed| Versions::noisy(0.0, NOISE, seed).halves);
        let half = |sign: f32| -> Vec<Colour> {
            let pixel = |(x, y): (&Colour, &Colour)| {
                [0, 1, 2].map(|c| TRUTH + shared.sqrt() * (x[c] - TRUTH) + sign * (y[c] - TRUTH))
            };
            both[0].iter().zip(&opposite[0]).map(pixel).collect()
        };
        let [a, b] = [half(1.0), half(-1.0)];
        Versions { all: mean(&a, &b), halves: [a, b] }
    }

    fn filtered(&self) -> FilteredImages<'_> {
        FilteredImages { all: &self.all, halves: self.halves.each_ref().map(Vec::as_slice) }
    }
}

fn mean(a: &[Colour], b: &[Colour]) -> Vec<Colour> {
    a.iter().zip(b).map(|(a, b)| [0, 1, 2].map(|c| (a[c] + b[c]) / 2.0)).collect()
}

const fn pixels([width, height]: [u32; 2]) -> usize {
    width as usize * height as usize
}

fn raw(versions: &Versions, size: [u32; 2]) -> Raw<'_> {
    let halves = versions.halves.each_ref().map(Vec::as_slice);
    Raw { size, all: &versions.all, halves, half_samples: [8, 8], ratios: &INDEPENDENT[..pixels(size)] }
}

/// The mixture of images of [`SIZE`].
fn mixture(own: &Versions, denoised: &[&Versions]) -> Mixed {
    let filtered: Vec<FilteredImages> = denoised.iter().map(|versions| versions.filtered()).collect();
    mix(&raw(own, SIZE), &filtered)
}

/// Mean squared error against the truth.
fn error(image: &[Colour]) -> f64 {
    let square = |x: &f32| (f64::from(*x) - f64::from(TRUTH)).powi(2);
    image.iter().flatten().map(square).sum::<f64>() / (3 * image.len()) as f64
}

/// Mean of the estimated squared errors.
fn estimate(mixed: &Mixed) -> f64 {
    mixed.error.iter().flatten().map(|x| f64::from(*x).powi(2)).sum::<f64>() / (3 * mixed.error.len()) as f64
}

/// The estimates are averages over 400 pixels and more, in three channels. Ratios of noise in them are within 1.2.
fn is_near(found: f64, expected: f64) -> bool {
    found < 1.2 * expected && found > expected / 1.2
}

/// Halves that avoid each other do not make a biased filter look better than it is. The weight that is best for all
/// samples follows from the variances, which are known.
#[test]
fn halves_that_avoid_each_other_do_not_flatter_filters() {
    // The correlation of the halves' noise is (0.6 - 1) / (0.6 + 1).
    const CORRELATION: f64 = -0.25;
    let own = Versions::avoiding(0.6, 16);
    let variance = 1.6 * NOISE * NOISE;
    let bias = (variance / 2.0).sqrt();
    let biased = Versions::of([(f64::from(TRUTH) + bias) as f32; 3], pixels(SIZE));
    let of_all = variance / 2.0 * (1.0 + CORRELATION);
    let best = of_all * bias * bias / (of_all + bias * bias);
    let with_ratio = |ratio: f32| {
        let ratios = vec![ratio; pixels(SIZE)];
        let raw = Raw { half_samples: [2, 2], ratios: &ratios, ..raw(&own, SIZE) };
        error(&mix(&raw, &[biased.filtered()]).colour) / best
    };
    // Among stratified samples with half of the noise of independent ones, halves have about this correlation.
    let found = with_ratio(0.5);
    assert!(found < 1.05, "{found} times the least error");
    let planted = with_ratio(1.0);
    assert!(planted > 1.25, "halves taken for independent: {planted} times the least error");
}

#[test]
fn a_denoiser_that_knows_the_truth_is_taken() {
    let own = Versions::noisy(0.0, NOISE, 1);
    let truth = Versions::of([TRUTH; 3], pixels(SIZE));
    let mixed = mixture(&own, &[&truth]);
    // A weight of 1 - d leaves d^2 of the variance. d is the mean of some 1,200 products of independent noise: 0.03.
    assert!(error(&mixed.colour) < 0.005 * error(&own.all), "{} of {}", error(&mixed.colour), error(&own.all));
    assert!(estimate(&mixed) < 0.02 * error(&own.all), "{}", estimate(&mixed));

    // Without independent halves, errors cannot be estimated.
    let planted = Versions { halves: [own.halves[0].clone(), own.halves[0].clone()], ..own.clone() };
    assert!(error(&mixture(&planted, &[&truth]).colour) > 0.9 * error(&own.all), "halves with the same noise");
}

#[test]
fn a_denoiser_that_gives_rubbish_is_left_out() {
    let own = Versions::noisy(0.0, NOISE, 2);
    let rubbish = Versions::of([TRUTH + 3.0, TRUTH - 3.0, TRUTH + 3.0], pixels(SIZE));
    let mixed = mixture(&own, &[&rubbish]);
    // The best weight is 0.3^2 / (0.3^2 + 3^2).
    assert!(error(&mixed.colour) < 1.01 * error(&own.all), "{} of {}", error(&mixed.colour), error(&own.all));
    assert!(is_near(estimate(&mixed), error(&mixed.colour)), "{} for {}", estimate(&mixed), error(&mixed.colour));

    // A denoiser that saw the other half seems to know the truth.
    let [a, b] = own.halves.clone();
    let planted = Versions { halves: [b, a], ..rubbish };
    assert!(error(&mixture(&own, &[&planted]).colour) > 50.0 * error(&own.all), "the noise of the other half");
}

/// Bias that is as large as the noise of half of the samples: the odds are even for halves (James and Stein 1961), and
/// half of that for all samples.
#[test]
fn a_biased_denoiser_is_mixed_by_its_error() {
    let own = Versions::noisy(0.0, NOISE, 3);
    let biased = Versions::of([TRUTH + NOISE as f32; 3], pixels(SIZE));
    let mixed = mixture(&own, &[&biased]);
    let mean = mixed.colour.iter().flatten().map(|x| f64::from(*x) - f64::from(TRUTH)).sum::<f64>();
    let weight = mean / (3 * mixed.colour.len()) as f64 / NOISE;
    let part = 1.0 / 3.0;
    // The weight around a pixel comes from some 1,200 products, as above: 0.03, and the mean of all is nearer.
    assert!((weight - part).abs() < 0.03, "{weight}");
    let expected = (part * NOISE).powi(2) + (1.0 - part).powi(2) * NOISE * NOISE / 2.0;
    assert!(is_near(error(&mixed.colour), expected) && is_near(estimate(&mixed), expected), "{}", estimate(&mixed));

    // Alone it keeps its bias, and the estimate includes it.
    let alone = alone(&raw(&own, SIZE), &biased.filtered());
    assert_eq!(alone.colour, biased.all);
    assert!(is_near(estimate(&alone), NOISE * NOISE), "{}", estimate(&alone));
}

/// The denoiser's own noise is in the estimate.
#[test]
fn the_error_of_all_samples_is_estimated_from_their_halves() {
    let own = Versions::noisy(0.0, NOISE, 4);
    for (offset, noise) in [(0.0, 0.1), (0.05, 0.05), (0.1, 0.0)] {
        let denoised = Versions::noisy(offset, noise, 5);
        let alone = alone(&raw(&own, SIZE), &denoised.filtered());
        let (found, expected) = (estimate(&alone), error(&denoised.all));
        // Bias is what is left of much more noise.
        assert!(found < 1.5 * expected && found > expected / 1.5, "{found} for {expected}");
    }
}

/// Light that comes off a coloured surface has errors of its colour. A dim channel must not hide them, although its
/// errors count more for relMSE.
#[test]
fn errors_of_saturated_colours_are_those_of_their_channels() {
    let tint = [1.0, 0.05, 0.01f32];
    let tinted = |image: Vec<Colour>| image.into_iter().map(|x| [0, 1, 2].map(|c| tint[c] * x[c])).collect::<Vec<_>>();
    let of = |versions: Versions| Versions { all: tinted(versions.all), halves: versions.halves.map(tinted) };
    let (own, denoised) = (of(Versions::noisy(0.0, NOISE, 14)), of(Versions::noisy(0.1, 0.1, 15)));
    let stated = alone(&raw(&own, SIZE), &denoised.filtered());
    for c in 0..3 {
        let square = |x: f32, truth: f32| (f64::from(x) - f64::from(truth)).powi(2);
        let expected: f64 = denoised.all.iter().map(|x| square(x[c], TRUTH * tint[c])).sum();
        let found: f64 = stated.error.iter().map(|x| square(x[c], 0.0)).sum();
        // Bias is what is left of much more noise.
        let is_right = |found: f64| found < 1.5 * expected && found > expected / 1.5;
        assert!(is_right(found), "channel {c}: {found} for {expected}");
        let planted: f64 = stated.error.iter().flatten().map(|x| square(*x, 0.0)).sum();
        assert!(!is_right(planted / 3.0), "channel {c}: the error of all channels");
    }
}

/// Pixels without noise have no error, although a noisy region begins beside them.
#[test]
fn the_error_stays_where_the_noise_is() {
    let (own, denoised) = (Versions::noisy(0.0, NOISE, 16), Versions::noisy(0.0, 0.2, 17));
    let is_exact = |i: usize| i % (SIZE[0] as usize) < 40;
    let half_exact = |image: &[Colour]| -> Vec<Colour> {
        image.iter().enumerate().map(|(i, x)| if is_exact(i) { [TRUTH; 3] } else { *x }).collect()
    };
    let of = |versions: &Versions| Versions {
        all: half_exact(&versions.all),
        halves: versions.halves.each_ref().map(|half| half_exact(half)),
    };
    let (own, denoised) = (of(&own), of(&denoised));
    let stated = alone(&raw(&own, SIZE), &denoised.filtered());
    // Immediate neighbourhoods end after two pixels.
    let exact = |(i, _): &(usize, &Colour)| i % (SIZE[0] as usize) < 38;
    assert!(stated.error.iter().enumerate().filter(exact).all(|(_, error)| *error == [0.0; 3]));
    assert!(is_near(estimate(&stated), error(&denoised.all)), "{} for {}", estimate(&stated), error(&denoised.all));
}

/// Noise of stratified halves that avoid each other is less in their mean than in their difference.
#[test]
fn the_error_of_stratified_samples_is_not_that_of_independent_ones() {
    // At a ratio of 0.1, 16 samples have 1 - 2 * 0.35 * 0.9 / sqrt(2) = 0.55 of the variance of what differs.
    let own = Versions::avoiding(0.55, 12);
    let stratified = Raw { ratios: &[0.1; pixels(SIZE)], ..raw(&own, SIZE) };
    let kept = alone(&stratified, &own.filtered());
    assert!(is_near(estimate(&kept), error(&own.all)), "{} for {}", estimate(&kept), error(&own.all));
    let planted = alone(&raw(&own, SIZE), &own.filtered());
    assert!(!is_near(estimate(&planted), error(&own.all)), "independent samples");
    // An image without noise has no noise to avoid.
    let truth = Versions::of([TRUTH; 3], pixels(SIZE));
    assert!(estimate(&alone(&stratified, &truth.filtered())) < 0.02 * error(&own.all));
}

#[test]
fn two_denoisers_are_weighed_against_each_other() {
    let own = Versions::noisy(0.0, NOISE, 6);
    let truth = Versions::of([TRUTH; 3], pixels(SIZE));
    let rubbish = Versions::of([TRUTH + 3.0; 3], pixels(SIZE));
    for denoised in [[&truth, &rubbish], [&rubbish, &truth], [&truth, &truth]] {
        assert!(error(&mixture(&own, &denoised).colour) < 0.005 * error(&own.all));
    }
    // Errors of opposite signs cancel. The weights are those of a half of the samples, and together at most 1.
    let (above, below) = (Versions::noisy(0.2, 0.0, 7), Versions::noisy(-0.2, 0.0, 8));
    let both = error(&mixture(&own, &[&above, &below]).colour);
    assert!(both < 0.02 * error(&own.all), "{both}");
    let one = error(&mixture(&own, &[&above]).colour);
    assert!(one > 5.0 * both, "{one} against {both}");
}

#[test]
fn the_mixture_is_the_raw_image_where_that_has_no_noise() {
    let exact = Versions::noisy(0.0, 0.0, 9);
    let blurred = Versions::noisy(0.1, 0.05, 10);
    let mixed = mixture(&exact, &[&blurred]);
    assert_eq!(mixed.colour, exact.all);
    assert!(mixed.error.iter().flatten().all(|error| *error == 0.0));
}

/// One pixel of one half is a million times as bright.
#[test]
fn a_firefly_does_not_spread() {
    let mut own = Versions::noisy(0.0, NOISE, 11);
    let pixel = (40 * SIZE[0] + 50) as usize;
    own.halves[0][pixel] = [2e6; 3];
    own.all[pixel] = [1e6; 3];
    let truth = Versions::of([TRUTH; 3], pixels(SIZE));
    let mut kept = truth.clone();
    kept.all[pixel] = own.all[pixel];
    kept.halves[0][pixel] = own.halves[0][pixel];
    for denoised in [&truth, &kept] {
        let mixed = mixture(&own, &[denoised]);
        let others = mixed.colour.iter().enumerate().filter(|(i, _)| *i != pixel);
        // Five standard deviations of the noise.
        let is_clean = |colour: &Colour| colour.iter().all(|x| (x - TRUTH).abs() < 5.0 * NOISE as f32);
        assert!(others.clone().all(|(_, colour)| is_clean(colour)));
    }
    // A denoiser without it is trusted there.
    assert!(mixture(&own, &[&truth]).colour[pixel][0] < 1e-3 * own.all[pixel][0]);
}

#[test]
fn images_without_light_or_with_much_of_it_stay_finite() {
    for size in [[1, 1], [1, 7], [30, 1], [5, 4]] {
        for values in [[0.0, 0.0, 0.0], [1e30, 2e30, 1.5e30], [f32::MAX, 0.0, f32::MIN_POSITIVE], [-1.0, 1.0, 0.0]] {
            let [a, b, denoised] = values;
            let count = pixels(size);
            let half = |x: f32| vec![[x, 0.0, x]; count];
            let own = Versions { all: half(a / 2.0 + b / 2.0), halves: [half(a), half(b)] };
            let other = Versions::of([denoised; 3], count);
            let filtered = [other.filtered(), other.filtered()];
            let mixed = mix(&raw(&own, size), &filtered);
            assert_eq!((mixed.colour.len(), mixed.error.len()), (count, count));
            let finite = mixed.colour.iter().chain(&mixed.error).flatten().all(|x| x.is_finite());
            assert!(finite, "{size:?} of {values:?}: {:?} {:?}", mixed.colour[0], mixed.error[0]);
            if values == [0.0; 3] {
                assert!(mixed.colour.iter().chain(&mixed.error).flatten().all(|x| *x == 0.0));
            }
        }
    }
}
