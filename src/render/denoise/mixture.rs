//! The mixture of the raw image and denoised images that has the smallest estimated error in each region.
//!
//! Errors are estimated without a reference, from two halves A and B of the samples (cross-validation). Each is a
//! stratified part of the sample sequence, and their noise is nearly independent. Let M be an image made of A alone,
//! with error e, and r the error of B. Their difference has the mean square E[e^2] + E[r^2], whatever M is: so the
//! weights that bring a mixture closest to the other half are also those that bring it closest to the truth, and need
//! no variances. E[e^2] is what is left without E[r^2], which is half of the mean of (A - B)^2. All means are over a
//! region around each pixel.

use rayon::prelude::*;

use super::{Colour, Filtered, RELMSE_FLOOR};

/// Radius in pixels of each of the two box filters that average over a region. Among 5 to 16 pixels, 10 to 12 gave the
/// smallest error in four scenes at 2 to 256 samples. Smaller regions follow the denoisers' faults more closely, larger
/// ones estimate them better: with two samples, the estimate for a small region is mostly noise.
const RADIUS: usize = 10;

/// Radius in pixels of each of the two box filters that average over a pixel's immediate neighbourhood, which tells how
/// the error of a region is distributed. Two of 1 pixel cover 5 x 5 pixels. Fewer have too few squared differences.
const NEAR: usize = 1;

/// The weights found are right for halves. From a half to all samples the raw image gains more than filters do: the
/// squared error of n stratified samples falls as n^-1.5, to 0.35, that of filters to about 0.7. So the odds of filters
/// against the raw image fall to this part.
const ODDS_OF_ALL: f64 = 0.5;

/// How strongly the noise of the halves is anticorrelated, because their samples are points of one sequence: minus its
/// covariance over half of the mean square of their difference. This is the value at 4 samples where they are
/// stratified perfectly; it falls with the fourth root of their number. Measured with references in three scenes by two
/// techniques: 0.12 to 0.31 at 4 samples, 0.04 to 0.27 at 16, 0 to 0.2 at 256, and larger where the ratio
/// (`Raw::ratios`) is smaller.
const ANTICORRELATION: f64 = 0.35;

/// The part of a filter's apparent gain that is not real, at 4 samples that are stratified perfectly: the other half is
/// anticorrelated with the noise that a filter takes away, so it seems that more was taken. With smaller values filters
/// spoil small objects, with larger ones the mixture keeps noise that filters take away. By theory it is
/// [`ANTICORRELATION`] at any number of samples; measured images are better with more at 4 samples and with less at 16
/// (docs/experiments.md, "Weights of halves that avoid each other").
const FLATTERY: f64 = 0.5;

/// The raw image.
pub struct Raw<'a> {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// The image of all samples.
    pub all: &'a [Colour],
    /// The images of two halves of the samples, whose noise is nearly independent.
    pub halves: [&'a [Colour]; 2],
    /// Number of samples of each half.
    pub half_samples: [u32; 2],
    /// The noise of each pixel over that of independent samples, at most 1; see [`super::stratification`].
    pub ratios: &'a [f32],
}

/// The raw images after one denoiser.
pub struct FilteredImages<'a> {
    /// The filtered image of all samples.
    pub all: &'a [Colour],
    /// The filtered images of the halves.
    pub halves: [&'a [Colour]; 2],
}

/// A mixture.
pub struct Mixed {
    /// The image.
    pub colour: Vec<Colour>,
    /// The estimated standard errors of each pixel: those of its region, distributed within it (`Distribution`).
    pub error: Vec<Colour>,
}

/// The images of filters that were given halves; `None` if one was not.
pub(super) fn filtered_images(filtered: &[Filtered]) -> Option<Vec<FilteredImages<'_>>> {
    filtered.iter().map(FilteredImages::of).collect()
}

impl<'a> FilteredImages<'a> {
    fn of(filtered: &'a Filtered) -> Option<FilteredImages<'a>> {
        let halves = filtered.halves.as_ref()?.each_ref().map(Vec::as_slice);
        Some(FilteredImages { all: &filtered.all, halves })
    }

    /// Its half and the raw half, for [`Regions::products`], which takes their difference.
    fn difference(&self, raw: &Raw<'a>, half: usize) -> [&'a [Colour]; 2] {
        [self.halves[half], raw.halves[half]]
    }
}

/// The mixture of the raw image and the filtered ones. There must be at least one filter.
pub fn mix(raw: &Raw<'_>, filtered: &[FilteredImages<'_>]) -> Mixed {
    let regions = Regions::new(raw.size, filtered);
    let equations = Equations::new(raw, filtered, &regions);
    let weights = (0..raw.all.len()).into_par_iter().flat_map_iter(|pixel| equations.solve(pixel)).collect();
    mixed(raw, filtered, weights, &regions)
}

/// The filtered image as it is, with its estimated error.
pub fn alone(raw: &Raw<'_>, filtered: &FilteredImages<'_>) -> Mixed {
    let filtered = std::slice::from_ref(filtered);
    mixed(raw, filtered, vec![1.0; raw.all.len()], &Regions::new(raw.size, filtered))
}

/// The mixture with the given weights, of all filters for each pixel, and its error.
fn mixed(raw: &Raw<'_>, filtered: &[FilteredImages<'_>], weights: Vec<f64>, regions: &Regions) -> Mixed {
    let of = |raw: &[Colour], images: Vec<&[Colour]>| -> Vec<Colour> {
        let pixel = |(i, weights): (usize, &[f64])| {
            [0, 1, 2].map(|c| {
                let own = f64::from(raw[i][c]);
                let more = weights.iter().zip(&images).map(|(weight, image)| weight * (f64::from(image[i][c]) - own));
                (own + more.sum::<f64>()) as f32
            })
        };
        weights.par_chunks(images.len()).enumerate().map(pixel).collect()
    };
    let colour = of(raw.all, filtered.iter().map(|images| images.all).collect());
    let half = |half: usize| of(raw.halves[half], filtered.iter().map(|images| images.halves[half]).collect());
    Mixed { error: regions.errors(raw, [&half(0), &half(1)]), colour }
}

/// Averages over regions.
struct Regions {
    size: [u32; 2],
    /// The weight of squared errors at each pixel.
    scale: Vec<[f64; 3]>,
}

impl Regions {
    /// Weights by what the filters make of the pixels, which has little noise.
    fn new(size: [u32; 2], filtered: &[FilteredImages<'_>]) -> Regions {
        let count = filtered.len() as f64;
        let pixel = |i: usize| {
            [0, 1, 2].map(|c| {
                let mean = filtered.iter().map(|images| f64::from(images.all[i][c])).sum::<f64>() / count;
                1.0 / (mean * mean + RELMSE_FLOOR)
            })
        };
        Regions { size, scale: (0..filtered[0].all.len()).into_par_iter().map(pixel).collect() }
    }

    /// Weighted means of the products of the differences `a` - `b` and `c` - `d` over the regions around all pixels.
    fn products(&self, [a, b]: [&[Colour]; 2], [c, d]: [&[Colour]; 2]) -> Vec<f64> {
        self.means(|i| {
            let difference = |x: &[Colour], y: &[Colour], axis: usize| f64::from(x[i][axis]) - f64::from(y[i][axis]);
            let weighted = |axis: usize| self.scale[i][axis] * difference(a, b, axis) * difference(c, d, axis);
            (0..3).map(weighted).sum::<f64>() / 3.0
        })
    }

    /// The weighted squared differences of each pair of images, summed.
    fn differences(&self, pairs: [[&[Colour]; 2]; 2], c: usize) -> Vec<f64> {
        let square = |i: usize, [a, b]: [&[Colour]; 2]| (f64::from(a[i][c]) - f64::from(b[i][c])).powi(2);
        let pixel = |i: usize| self.scale[i][c] * pairs.iter().map(|pair| square(i, *pair)).sum::<f64>();
        (0..self.scale.len()).into_par_iter().map(pixel).collect()
    }

    /// Means of the pixels' values over the regions around them.
    fn means(&self, pixel: impl Fn(usize) -> f64 + Send + Sync) -> Vec<f64> {
        let values: Vec<f64> = (0..self.scale.len()).into_par_iter().map(pixel).collect();
        of_regions(&values, self.size)
    }

    /// The estimated standard errors of an image, from the results of the same steps for the halves of the samples.
    fn errors(&self, raw: &Raw<'_>, [of_a, of_b]: [&[Colour]; 2]) -> Vec<Colour> {
        let [a, b] = raw.halves;
        let squares = |x, y| self.products([x, y], [x, y]);
        let (noise, own) = (squares(a, b), squares(of_a, of_b));
        let across = [0, 1, 2].map(|c| Distribution::new(&self.differences([[of_a, b], [of_b, a]], c), self.size));
        // The noise that the image lost, from its difference from the raw image.
        let (lost_a, lost_b) = (self.products([of_a, a], [b, a]), self.products([of_b, b], [a, b]));
        let [count_a, count_b] = raw.half_samples.map(f64::from);
        // The variance of a mean over the mean squared difference of the means of its halves.
        let share = count_a * count_b / (count_a + count_b).powi(2);
        let anticorrelation = ANTICORRELATION * (4.0 / (count_a + count_b)).powf(0.25);
        let pixel = |i: usize| {
            // The squared error of a half is its squared bias plus its variance. All samples have less of the latter.
            let of_all = across.iter().map(|across| across.means[i]).sum::<f64>();
            let bias = (of_all / 3.0 - noise[i] - own[i]) / 2.0;
            // Where noise remains that avoids the noise of the other half, the halves' difference has more noise than
            // their mean. A filtered image without noise seems less biased than it is, but with few samples there is no
            // estimate by how much.
            let avoided = anticorrelation * (1.0 - f64::from(raw.ratios[i])) * (noise[i] / 2.0 - lost_a[i] - lost_b[i]);
            let variance = share * own[i];
            let relative = (bias.max(0.0) + variance - avoided.max(0.0)).max(variance / 2.0);
            // Pixels and channels have the shares that they have in the differences. An estimate for each alone would
            // be too uncertain.
            let share = |c: usize| if of_all > 0.0 { across[c].values[i] / of_all } else { 1.0 / 3.0 };
            [0, 1, 2].map(|c| (3.0 * relative * share(c) / self.scale[i][c]).sqrt() as f32)
        };
        (0..self.scale.len()).into_par_iter().map(pixel).collect()
    }
}

/// Equations for the weights of the filtered images at each pixel, with A and B the raw halves and D1, D2, ... the
/// filtered halves. They minimise the mean square of w1 (D1 - A) + w2 (D2 - A) + ... - (B - A), averaged over both
/// halves A.
struct Equations {
    /// Products of two filtered images' differences from the raw image.
    squares: Vec<Vec<Vec<f64>>>,
    /// Products of a filtered image's difference and the other half's difference from the raw half, less what they have
    /// because the halves avoid each other.
    right: Vec<Vec<f64>>,
}

impl Equations {
    fn new(raw: &Raw<'_>, filtered: &[FilteredImages<'_>], regions: &Regions) -> Equations {
        let over_halves = |of: &dyn Fn(usize) -> Vec<f64>| -> Vec<f64> {
            of(0).into_iter().zip(of(1)).map(|(first, second)| first + second).collect()
        };
        // Among many samples, halves of them avoid each other less.
        let flattery = FLATTERY * (4.0 / f64::from(raw.half_samples.iter().sum::<u32>())).min(1.0);
        let right = |k: &FilteredImages<'_>| -> Vec<f64> {
            let apparent = over_halves(&|half| {
                regions.products(k.difference(raw, half), [raw.halves[1 - half], raw.halves[half]])
            });
            let real = |(product, ratio): (f64, &f32)| product * (1.0 - flattery * (1.0 - f64::from(*ratio)));
            apparent.into_iter().zip(raw.ratios).map(real).collect()
        };
        let square = |k: &FilteredImages<'_>, l: &FilteredImages<'_>| {
            over_halves(&|half| regions.products(k.difference(raw, half), l.difference(raw, half)))
        };
        Equations {
            squares: filtered.iter().map(|k| filtered.iter().map(|l| square(k, l)).collect()).collect(),
            right: filtered.iter().map(right).collect(),
        }
    }

    /// The best weights that are 0 or more, and together at most 1, for all samples.
    fn solve(&self, pixel: usize) -> Vec<f64> {
        let count = self.right.len();
        let mut best = (0.0, vec![0.0; count]);
        // The minimum uses some of the filters, either within the bounds or with weights of sum 1.
        for members in 1u32..1 << count {
            let members: Vec<usize> = (0..count).filter(|k| members >> k & 1 == 1).collect();
            for is_whole in [false, true] {
                let Some(found) = self.minimum(pixel, &members, is_whole) else { continue };
                let mut weights = vec![0.0; count];
                members.iter().zip(found).for_each(|(k, weight)| weights[*k] = weight);
                // A sum of 1 may be a rounding more.
                let is_allowed = weights.iter().all(|x| *x >= 0.0) && weights.iter().sum::<f64>() < 1.0 + 1e-9;
                let value = self.value(pixel, &weights);
                if is_allowed && value < best.0 {
                    best = (value, weights);
                }
            }
        }
        of_all(best.1)
    }

    /// The quantity to minimise, up to a constant.
    fn value(&self, pixel: usize, weights: &[f64]) -> f64 {
        let row = |(k, weight): (usize, &f64)| {
            let square = |(l, other): (usize, &f64)| other * self.squares[k][l][pixel];
            weight * (weights.iter().enumerate().map(square).sum::<f64>() - 2.0 * self.right[k][pixel])
        };
        weights.iter().enumerate().map(row).sum()
    }

    /// The best weights of some filters regardless of bounds; their sum is 1 if `is_whole`. `None` if they are not
    /// determined, because their images are the same or the raw image itself.
    fn minimum(&self, pixel: usize, members: &[usize], is_whole: bool) -> Option<Vec<f64>> {
        let mut rows: Vec<Vec<f64>> = members
            .iter()
            .map(|k| {
                let squares = members.iter().map(|l| self.squares[*k][*l][pixel]);
                // The second term is Lagrange's multiplier for the sum.
                squares.chain(is_whole.then_some(1.0)).chain([self.right[*k][pixel]]).collect()
            })
            .collect();
        if is_whole {
            rows.push(members.iter().map(|_| 1.0).chain([0.0, 1.0]).collect());
        }
        let mut weights = solve(rows)?;
        weights.truncate(members.len());
        Some(weights)
    }
}

/// The weights of filters for all samples, from those that are right for halves.
fn of_all(mut weights: Vec<f64>) -> Vec<f64> {
    let filtered = weights.iter().sum::<f64>().min(1.0);
    let factor = ODDS_OF_ALL / (ODDS_OF_ALL * filtered + 1.0 - filtered);
    weights.iter_mut().for_each(|weight| *weight *= factor);
    weights
}

/// Solves linear equations, whose rows end with their right sides (Gauss and Jordan's elimination with pivots).
fn solve(mut rows: Vec<Vec<f64>>) -> Option<Vec<f64>> {
    let count = rows.len();
    for column in 0..count {
        let pivot = (column..count).max_by(|a, b| rows[*a][column].abs().total_cmp(&rows[*b][column].abs()))?;
        rows.swap(column, pivot);
        let pivot = rows[column].clone();
        for (_, row) in rows.iter_mut().enumerate().filter(|(index, _)| *index != column) {
            let factor = row[column] / pivot[column];
            row.iter_mut().zip(&pivot).for_each(|(x, pivot)| *x -= factor * pivot);
        }
    }
    let solution: Vec<f64> = rows.iter().enumerate().map(|(k, row)| row[count] / row[k]).collect();
    solution.iter().all(|x| x.is_finite()).then_some(solution)
}

/// Means of values over the regions around all pixels, and how they are distributed within the regions.
struct Distribution {
    /// The means over the regions.
    means: Vec<f64>,
    /// The same in all, but less where a pixel's immediate neighbourhood has less than its region: a lamp without noise
    /// beside a noisy wall has no error.
    values: Vec<f64>,
}

impl Distribution {
    fn new(values: &[f64], size: [u32; 2]) -> Distribution {
        let means = of_regions(values, size);
        let near = smooth(&smooth(values, size, NEAR), size, NEAR);
        let weights: Vec<f64> = near.iter().zip(&means).map(|(near, mean)| near.min(*mean)).collect();
        let of_weights = of_regions(&weights, size);
        let value = |i: usize| if of_weights[i] > 0.0 { means[i] * (weights[i] / of_weights[i]) } else { 0.0 };
        Distribution { values: (0..means.len()).map(value).collect(), means }
    }
}

/// Means over the regions around all pixels.
pub(in crate::render) fn of_regions(values: &[f64], size: [u32; 2]) -> Vec<f64> {
    smooth(&smooth(values, size, RADIUS), size, RADIUS)
}

/// Means over squares of `radius`, as far as they are within the image.
fn smooth(values: &[f64], [width, height]: [u32; 2], radius: usize) -> Vec<f64> {
    let (width, height) = (width as usize, height as usize);
    let around = |i: usize, count: usize| i.saturating_sub(radius)..(i + radius + 1).min(count);
    // Running sums would be faster, but lose the digits of dim pixels next to bright ones.
    let mut rows = vec![0.0; values.len()];
    rows.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(means, line)| {
        means.iter_mut().enumerate().for_each(|(x, mean)| {
            let around = &line[around(x, width)];
            *mean = around.iter().sum::<f64>() / around.len() as f64;
        });
    });
    // Row by row, so that a step adds neighbours in memory at once.
    let mut means = vec![0.0; values.len()];
    means.par_chunks_mut(width).enumerate().for_each(|(y, means)| {
        let around = around(y, height);
        let count = around.len() as f64;
        for row in rows[around.start * width..around.end * width].chunks(width) {
            means.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        means.iter_mut().for_each(|sum| *sum /= count);
    });
    means
}
