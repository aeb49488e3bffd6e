//! The mixture of the raw image and denoised images that has the smallest estimated error in each region.
//!
//! Errors are estimated without a reference, from two halves A and B of the samples, whose noise is independent. Let D
//! be what a denoiser makes of A alone. The mean of (D - B)^2 is then the squared error of D plus the variance of B, and
//! that of (A - B)^2 the sum of the variances of A and B. Their differences are averaged over a region. (Cross-validation
//! of this kind: Rousselle, Knaus and Zwicker 2012.)

use rayon::prelude::*;

use super::{Colour, Filtered};

/// Radius of a region in pixels: of each of the two box filters that average estimates. Smaller regions follow the
/// denoiser's faults more closely, and larger ones know them better.
const RADIUS: usize = 4;

/// Part of an image's mean luminance under which errors count as absolute: as the floor of relMSE does, which is 0.01 for
/// images whose luminance is about 1.
const DARK: f32 = 0.1;

/// The raw image.
pub struct Raw<'a> {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Of all samples.
    pub all: &'a [Colour],
    /// Of both halves.
    pub halves: [&'a [Colour]; 2],
    /// Number of samples of each half.
    pub half_samples: [u32; 2],
    /// Variance of each pixel's mean, as of independent samples.
    pub variance: &'a [Colour],
}

/// What one denoiser made of a raw image.
pub struct Candidate<'a> {
    /// Of all samples.
    pub all: &'a [Colour],
    /// Of each half alone.
    pub halves: [&'a [Colour]; 2],
}

/// A mixture.
pub struct Mixed {
    /// The image.
    pub colour: Vec<Colour>,
    /// The estimated standard error of each pixel: the root of the mean square over R, G and B.
    pub error: Vec<f32>,
}

/// The candidates of filters that were given halves; none if one was not.
pub(super) fn candidates(filtered: &[Filtered]) -> Option<Vec<Candidate<'_>>> {
    filtered.iter().map(Candidate::of).collect()
}

impl<'a> Candidate<'a> {
    fn of(filtered: &'a Filtered) -> Option<Candidate<'a>> {
        let halves = filtered.halves.as_ref()?.each_ref().map(Vec::as_slice);
        Some(Candidate { all: &filtered.all, halves })
    }
}

/// The mixture of the raw image and the candidates, of which there is at least one.
pub fn mix(raw: &Raw<'_>, candidates: &[Candidate<'_>]) -> Mixed {
    let errors = Errors::new(raw, candidates);
    mixed(raw, candidates, &errors, |errors, pixel| errors.best_weights(pixel))
}

/// The candidate as it is, with its estimated error.
pub fn alone(raw: &Raw<'_>, candidate: &Candidate<'_>) -> Mixed {
    let candidates = std::slice::from_ref(candidate);
    let errors = Errors::new(raw, candidates);
    let mut mixed = mixed(raw, candidates, &errors, |_, _| vec![1.0]);
    mixed.colour = candidate.all.to_vec();
    mixed
}

fn mixed(
    raw: &Raw<'_>,
    candidates: &[Candidate<'_>],
    errors: &Errors,
    weights: impl Fn(&Errors, usize) -> Vec<f64> + Sync,
) -> Mixed {
    let pixel = |i: usize| {
        let weights = weights(errors, i);
        let mut colour = raw.all[i];
        for (candidate, weight) in candidates.iter().zip(&weights) {
            (0..3).for_each(|c| colour[c] += *weight as f32 * (candidate.all[i][c] - raw.all[i][c]));
        }
        (colour, (errors.of(i, &weights).max(0.0) / f64::from(errors.scale[i])).sqrt() as f32)
    };
    let (colour, error) = (0..raw.all.len()).into_par_iter().map(pixel).unzip();
    Mixed { colour, error }
}

/// Mean squared errors of the regions around each pixel, relative to the squares of the pixels' luminance.
struct Errors {
    /// One over the square of each pixel's luminance.
    scale: Vec<f32>,
    /// Of the raw image.
    raw: Vec<f64>,
    /// Of each candidate.
    candidates: Vec<Vec<f64>>,
    /// For each pair of candidates, products of their differences from the raw image.
    products: Vec<Vec<Vec<f64>>>,
}

impl Errors {
    fn new(raw: &Raw<'_>, candidates: &[Candidate<'_>]) -> Errors {
        let scale = scale(candidates);
        let average = |of: &(dyn Fn(usize) -> f64 + Sync)| {
            let values = (0..raw.all.len()).into_par_iter().map(|i| of(i) * f64::from(scale[i])).collect();
            smooth(smooth(values, raw.size), raw.size)
        };
        let [a, b] = raw.halves;
        let [of_a, of_b] = raw.half_samples.map(f64::from);
        // The variance of a mean over the mean squared difference of the means of its halves.
        let share = of_a * of_b / (of_a + of_b).powi(2);
        let noise = average(&|i| share * square(a[i], b[i]));
        let of_candidate = |Candidate { all, halves: [da, db] }: &Candidate<'_>| {
            let own = average(&|i| square(da[i], db[i]));
            let half = average(&|i| (square(da[i], b[i]) + square(db[i], a[i]) - square(a[i], b[i])) / 2.0);
            let difference = average(&|i| square(all[i], raw.all[i]));
            let estimate = |i: usize| {
                // The error of a half is bias and noise of the denoiser. All samples have less of the noise.
                let bias = (half[i] - own[i] / 2.0).max(0.0);
                // The triangle inequality: no estimate may contradict what is known of the difference.
                (bias + share * own[i]).max((difference[i].sqrt() - noise[i].sqrt()).powi(2))
            };
            (0..raw.all.len()).map(estimate).collect()
        };
        let product = |k: &Candidate<'_>, l: &Candidate<'_>| average(&|i| product(k.all[i], l.all[i], raw.all[i]));
        let products = candidates.iter().map(|k| candidates.iter().map(|l| product(k, l)).collect()).collect();
        let candidates = candidates.iter().map(of_candidate).collect();
        Errors { scale, raw: noise, candidates, products }
    }

    /// The estimated squared error at a pixel of the raw image plus weights times the candidates' differences from it.
    fn of(&self, pixel: usize, weights: &[f64]) -> f64 {
        let raw = self.raw[pixel];
        let mut error = raw;
        for (k, weight) in weights.iter().enumerate() {
            error += weight * self.slope(pixel, k);
            for (l, other) in weights.iter().enumerate() {
                error += weight * other * self.products[k][l][pixel];
            }
        }
        error
    }

    /// How the error grows with the weight of a candidate, from 0 on: twice the mean product of the raw image's error
    /// and the candidate's difference from it.
    fn slope(&self, pixel: usize, k: usize) -> f64 {
        self.candidates[k][pixel] - self.raw[pixel] - self.products[k][k][pixel]
    }

    /// The weights, 0 or more and together at most 1, with the smallest estimated error.
    fn best_weights(&self, pixel: usize) -> Vec<f64> {
        let count = self.candidates.len();
        let mut best = (self.raw[pixel], vec![0.0; count]);
        for members in 1u32..1 << count {
            let members: Vec<usize> = (0..count).filter(|k| members >> k & 1 == 1).collect();
            for whole in [false, true] {
                let Some(found) = self.minimum(pixel, &members, whole) else { continue };
                let mut weights = vec![0.0; count];
                members.iter().zip(found).for_each(|(k, weight)| weights[*k] = weight);
                let sum: f64 = weights.iter().sum();
                let is_allowed = weights.iter().all(|weight| *weight >= 0.0) && sum <= 1.0 + 1e-9;
                let error = self.of(pixel, &weights);
                if is_allowed && error < best.0 {
                    best = (error, weights);
                }
            }
        }
        best.1
    }

    /// The weights of some candidates where the error is stationary, with the sum 1 if they are to be the `whole`
    /// image; none if there are no such weights, because candidates are the same or the raw image itself.
    fn minimum(&self, pixel: usize, members: &[usize], whole: bool) -> Option<Vec<f64>> {
        let count = members.len() + usize::from(whole);
        let mut rows = vec![vec![0.0; count + 1]; count];
        for (row, k) in members.iter().enumerate() {
            for (column, l) in members.iter().enumerate() {
                rows[row][column] = 2.0 * self.products[*k][*l][pixel];
            }
            rows[row][count] = -self.slope(pixel, *k);
            if whole {
                // Lagrange's multiplier.
                (rows[row][count - 1], rows[count - 1][row]) = (1.0, 1.0);
            }
        }
        if whole {
            rows[count - 1][count] = 1.0;
        }
        solve(rows).map(|mut weights| {
            weights.truncate(members.len());
            weights
        })
    }
}

/// Solves linear equations, whose rows end with their right sides, by Gauss's elimination with pivots.
fn solve(mut rows: Vec<Vec<f64>>) -> Option<Vec<f64>> {
    let count = rows.len();
    for column in 0..count {
        let pivot = (column..count).max_by(|a, b| rows[*a][column].abs().total_cmp(&rows[*b][column].abs()))?;
        rows.swap(column, pivot);
        let pivot = rows[column].clone();
        // A sum of squares that is smaller is 0 but for roundings.
        if !(pivot[column].abs() > f64::from(f32::MIN_POSITIVE)) {
            return None;
        }
        for (row, values) in rows.iter_mut().enumerate().filter(|(row, _)| *row != column) {
            let _ = row;
            let factor = values[column] / pivot[column];
            values.iter_mut().zip(&pivot).for_each(|(value, pivot)| *value -= factor * pivot);
        }
    }
    let solution: Vec<f64> = (0..count).map(|k| rows[k][count] / rows[k][k]).collect();
    solution.iter().all(|x| x.is_finite()).then_some(solution)
}

/// One over the square of each pixel's luminance, which the candidates have without noise, and which is not below a
/// tenth of the image's mean.
fn scale(candidates: &[Candidate<'_>]) -> Vec<f32> {
    let count = candidates.len() as f32;
    let luminance = |i: usize| {
        let sum: f32 =
            candidates.iter().map(|candidate| candidate.all[i].iter().map(|x| x.abs() / 3.0).sum::<f32>()).sum();
        sum / count
    };
    let luminances: Vec<f32> = (0..candidates[0].all.len()).map(luminance).collect();
    let mean = luminances.iter().map(|x| f64::from(*x)).sum::<f64>() / luminances.len().max(1) as f64;
    let floor = (DARK * mean as f32).max(f32::MIN_POSITIVE.sqrt());
    luminances.iter().map(|x| 1.0 / (x * x + floor * floor)).collect()
}

/// Mean squared difference over R, G and B.
fn square(a: Colour, b: Colour) -> f64 {
    product(a, a, b)
}

/// Mean product over R, G and B of the differences of `a` and `b` from `from`.
fn product(a: Colour, b: Colour, from: Colour) -> f64 {
    let difference = |x: Colour, c: usize| f64::from(x[c]) - f64::from(from[c]);
    (0..3).map(|c| difference(a, c) * difference(b, c)).sum::<f64>() / 3.0
}

/// Means over squares of [`RADIUS`], as far as they are within the image.
fn smooth(values: Vec<f64>, [width, height]: [u32; 2]) -> Vec<f64> {
    let (width, height) = (width as usize, height as usize);
    let line = |length: usize, at: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let mean = |i: usize| {
            let around = i.saturating_sub(RADIUS)..(i + RADIUS + 1).min(length);
            let count = around.len() as f64;
            around.map(at).sum::<f64>() / count
        };
        (0..length).map(mean).collect()
    };
    let rows: Vec<f64> =
        (0..height).into_par_iter().flat_map_iter(|y| line(width, &|x| values[y * width + x])).collect();
    let columns: Vec<Vec<f64>> = (0..width).into_par_iter().map(|x| line(height, &|y| rows[y * width + x])).collect();
    (0..height).into_par_iter().flat_map_iter(|y| columns.iter().map(move |column| column[y])).collect()
}
