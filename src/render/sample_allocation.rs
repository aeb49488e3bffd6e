//! How adaptive sampling allocates samples to blocks of pixels, or to single pixels: how many each has, and which are
//! next. Numbers of samples double where they grow, so that samples remain stratified.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::random::R2_STEPS;
use crate::settings::ImageSettings;

/// Side of a block in pixels. With 64 pixels, the error of the mean of a few samples is estimated to about a fifth.
const SIDE: u32 = 8;

/// Samples of each pixel before the first estimate. Where light is rare, fewer give no useful estimate.
const MIN_SAMPLES: u32 = 8;

/// Blocks get samples together if the error that each removes by one sample is at least this part of what the best
/// block removes. Twice the samples leave half of the error or less, so the gain by a further sample falls to a
/// quarter.
const ROUND_GAIN: f64 = 0.25;

/// Minimum and maximum samples of a pixel in adaptive sampling with a fixed budget, as doublings of the mean: half of
/// it and eight times it. Estimates of noise are rough, so no pixel may have much more noise than with equal numbers.
/// Where all noise is in a few pixels, more than eight times the samples gain little.
const DOUBLINGS: [i32; 2] = [-1, 3];

/// Pixels to each side of a pixel whose noise decides how many samples it gets: edges are one or two pixels wide.
const REACH: usize = 2;

/// Share of the mean variance of a sample that is added to the variance of each pixel: an estimate of 0 from a few
/// samples does not mean that there is no noise.
const MIN_VARIANCE: f64 = 1e-3;

/// Numbers of samples are rounded to powers of two times the mean. In this part of an octave around the border between
/// two of them, some pixels are rounded up and others down, so that any share of equal pixels can get more samples.
const ROUNDING: f64 = 0.25;

/// Base-2 logarithms of shares are integers with this number of binary digits after the point: a step is 0.07 % of a
/// share, far finer than the estimates. The search for the numbers that use up the samples takes a fifth of the time
/// that it takes with floats.
const OCTAVE_BITS: i32 = 10;

/// The samples of each block so far, and which ones are next.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct SampleAllocation {
    /// Side of a block in pixels.
    side: u32,
    /// Blocks in a row of the image.
    columns: u32,
    /// Samples of each pixel of a block, row by row.
    samples: Vec<u32>,
    /// Blocks that get more samples before the next estimate. Blocks with equal numbers of samples are consecutive; in
    /// adaptive sampling with a fixed budget the order is that of the image.
    next: Vec<Next>,
    /// Blocks whose estimated error was above the limit at the last decision.
    above: u32,
}

/// A block that gets samples.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Next {
    block: u32,
    /// The number of samples that its pixels will have.
    target: u32,
}

/// Blocks whose pixels have equal numbers of samples, and get equally many more.
pub(super) struct EqualBlocks {
    blocks: Vec<u32>,
    /// Samples of each of their pixels so far.
    pub first_sample: u32,
    /// Samples that each of their pixels gets.
    pub samples: u32,
}

/// Estimated errors of pixels.
pub(super) struct PixelErrors {
    /// The mean number of samples that a pixel had.
    pub samples: u32,
    /// The relMSE of each.
    pub of_pixels: Vec<f64>,
}

impl SampleAllocation {
    /// The blocks of an image whose pixels get different numbers of samples; `None` if all get the same number.
    pub fn of(image: &ImageSettings) -> Option<SampleAllocation> {
        if image.noise.is_some() {
            Some(SampleAllocation::new(image, SIDE, image.spp.min(MIN_SAMPLES)))
        } else {
            image.allocates_samples().then(|| SampleAllocation::new(image, 1, 2))
        }
    }

    /// Blocks without samples. All of them get `target` samples first.
    fn new(image: &ImageSettings, side: u32, target: u32) -> SampleAllocation {
        let crop = image.crop_window();
        let [columns, rows] = [crop.width, crop.height].map(|pixels| pixels.div_ceil(side));
        let mut blocks =
            SampleAllocation { side, columns, samples: vec![0; (columns * rows) as usize], next: Vec::new(), above: 0 };
        blocks.next = blocks.in_order().map(|block| Next { block, target }).collect();
        blocks
    }

    /// All blocks. Neighbours in the image are near each other in the order, because their rays are traced together.
    fn in_order(&self) -> impl Iterator<Item = u32> + use<> {
        let (columns, rows) = (self.columns, self.samples.len() as u32 / self.columns);
        let near = SIDE / self.side;
        let spans = move |end: u32| (0..end).step_by(near as usize).map(move |i| i..(i + near).min(end));
        spans(rows).flat_map(move |ys| {
            spans(columns).flat_map(move |xs| ys.clone().flat_map(move |y| xs.clone().map(move |x| y * columns + x)))
        })
    }

    /// Whether the blocks belong to an image of this size.
    pub fn fits(&self, image: &ImageSettings) -> bool {
        let Some(new) = SampleAllocation::of(image) else { return false };
        let is_block =
            |next: &Next| self.samples.get(next.block as usize).is_some_and(|samples| next.target >= *samples);
        let is_size = (self.side, self.columns, self.samples.len()) == (new.side, new.columns, new.samples.len());
        is_size && self.next.iter().all(is_block)
    }

    /// The next blocks whose pixels have the same number of samples now and will have the same number before the next
    /// estimate; `None` if that is due.
    pub fn next_equal(&self) -> Option<EqualBlocks> {
        let first = self.next.first()?;
        let numbers = |next: &Next| (self.samples[next.block as usize], next.target);
        let (first_sample, target) = numbers(first);
        let same = self.next.iter().take_while(|next| numbers(next) == (first_sample, target));
        let blocks = same.map(|next| next.block).collect();
        Some(EqualBlocks { blocks, first_sample, samples: target - first_sample })
    }

    /// Those of the decided samples that raise the mean of all pixels from `mean` by `samples`, in the order in which
    /// they must be rendered. Parts end at powers of two, so that blocks with few samples join those with more.
    pub fn to_raise_mean(&self, samples: u32, mean: u32) -> Vec<EqualBlocks> {
        // Decisions are made at powers of two from 2 on.
        let all = (mean + 1).next_power_of_two().max(2) - mean;
        let mut equal = BTreeMap::<(u32, u32), Vec<u32>>::new();
        for Next { block, target } in &self.next {
            let mut first = self.samples[*block as usize];
            let missing = u64::from(target - first) * u64::from(samples);
            let end = first + ((missing + u64::from(all) / 2) / u64::from(all)) as u32;
            while first < end {
                let next = (first + 1).next_power_of_two().min(end);
                equal.entry((first, next - first)).or_default().push(*block);
                first = next;
            }
        }
        equal
            .into_iter()
            .map(|((first_sample, samples), blocks)| EqualBlocks { blocks, first_sample, samples })
            .collect()
    }

    /// Counts these samples as rendered.
    pub fn add(&mut self, rendered: &[EqualBlocks]) {
        for EqualBlocks { blocks, samples, .. } in rendered {
            blocks.iter().for_each(|block| self.samples[*block as usize] += samples);
        }
        let SampleAllocation { samples, next, .. } = self;
        next.retain(|next| samples[next.block as usize] < next.target);
    }

    /// Decides on the samples that raise the mean of the blocks, which are single pixels, to `mean`, by the estimated
    /// relMSE of each. The total error is smallest if numbers of samples are in proportion to the square roots of the
    /// variances of samples (Neyman 1934). A pixel's number depends on the pixels around it, whose samples are
    /// independent of its own. Otherwise pixels that look clean by chance would stay so, and the image would be too
    /// dark.
    pub fn allocate_samples(&mut self, errors: &[f64], mean: u32) {
        let logarithms = self.logarithms_of_shares(errors);
        let [fewest, most] = DOUBLINGS;
        let target = |pixel: usize, scale: i32| {
            let doublings = ((logarithms[pixel] + scale) >> OCTAVE_BITS).clamp(fewest, most);
            let target = if doublings < 0 { mean >> -doublings } else { mean.saturating_mul(1 << doublings) };
            target.max(self.samples[pixel])
        };
        let budget = u64::from(mean) * self.samples.len() as u64;
        let sum = |scale: i32| (0..logarithms.len()).into_par_iter().map(|i| u64::from(target(i, scale))).sum::<u64>();
        let (min, max) = (logarithms.iter().min().unwrap_or(&0), logarithms.iter().max().unwrap_or(&0));
        let (mut fits, mut exceeds) = ((fewest << OCTAVE_BITS) - max, ((most + 1) << OCTAVE_BITS) - min);
        while exceeds - fits > 1 {
            let middle = (fits + exceeds) / 2;
            if sum(middle) <= budget { fits = middle } else { exceeds = middle }
        }
        let next = |block: u32| {
            let target = target(block as usize, fits);
            (target > self.samples[block as usize]).then_some(Next { block, target })
        };
        self.next = self.in_order().filter_map(next).collect();
    }

    /// Doubles the samples of each block.
    pub fn double(&mut self) {
        self.next = self.in_order().map(|block| self.doubled(block, u32::MAX)).collect();
    }

    /// The block with twice the samples that it has, and no more than `spp`.
    fn doubled(&self, block: u32, spp: u32) -> Next {
        Next { block, target: self.samples[block as usize].saturating_mul(2).min(spp) }
    }

    /// For each pixel the base-2 logarithm of its share of the samples, in units of [`OCTAVE_BITS`], up to a constant
    /// that all pixels have in common. Rounded down to an octave, it gives the number of samples.
    fn logarithms_of_shares(&self, errors: &[f64]) -> Vec<i32> {
        let of_samples = |(error, samples): (&f64, &u32)| error.min(1.0) * f64::from(*samples);
        let variances: Vec<f64> = errors.iter().zip(&self.samples).map(of_samples).collect();
        let mean = variances.iter().sum::<f64>() / variances.len() as f64;
        let more = (MIN_VARIANCE * mean).max(f64::MIN_POSITIVE);
        let logarithm = |(pixel, variance): (usize, &f64)| {
            let [x, y] = [pixel % self.columns as usize, pixel / self.columns as usize];
            let [of_column, of_row] = R2_STEPS;
            let spread = (x as f64 * of_column + y as f64 * of_row).fract();
            let logarithm = 0.5 * (variance + more).log2() + 0.5 + ROUNDING * (spread - 0.5);
            (logarithm * f64::from(1 << OCTAVE_BITS)) as i32
        };
        around(&variances, self.columns as usize).par_iter().enumerate().map(logarithm).collect()
    }

    /// Decides which blocks are next, by the estimated relMSE of each: `noise` is enough, and no block gets more than
    /// `spp` samples. At least `share` of the blocks that need samples are next.
    pub fn select_blocks(&mut self, errors: &[f64], noise: f64, spp: u32, share: f64) {
        let gain = |block: u32| errors[block as usize] / f64::from(self.samples[block as usize]);
        let mut wanted: Vec<u32> = (0..errors.len() as u32).filter(|block| errors[*block as usize] > noise).collect();
        self.above = wanted.len() as u32;
        wanted.retain(|block| self.samples[*block as usize] < spp);
        // Stable: equal gains remain in the order of the blocks.
        wanted.sort_by(|a, b| gain(*b).total_cmp(&gain(*a)));
        let Some(best) = wanted.first().map(|block| gain(*block)) else { return };
        let min_count = (wanted.len() as f64 * share).ceil() as usize;
        let end = wanted.partition_point(|block| gain(*block) >= ROUND_GAIN * best).max(min_count);
        wanted.truncate(end);
        wanted.sort_by_key(|block| (self.samples[*block as usize], *block));
        self.next = wanted.into_iter().map(|block| self.doubled(block, spp)).collect();
    }

    /// All blocks, by their numbers of samples.
    pub fn by_samples(&self) -> impl Iterator<Item = EqualBlocks> + use<> {
        let mut equal = BTreeMap::<u32, Vec<u32>>::new();
        for (block, samples) in (0..).zip(&self.samples) {
            equal.entry(*samples).or_default().push(block);
        }
        equal.into_iter().map(|(first_sample, blocks)| EqualBlocks { blocks, first_sample, samples: 0 })
    }

    /// The number of blocks whose estimated error was above the limit at the last decision, and the number of all
    /// blocks.
    pub fn above(&self) -> [usize; 2] {
        [self.above as usize, self.samples.len()]
    }

    /// Whether all blocks have the samples that were decided on.
    pub fn is_complete(&self) -> bool {
        self.next.is_empty()
    }

    /// Whether the pixels of all blocks have `spp` samples, so that no block may get more.
    pub fn has_all(&self, spp: u32) -> bool {
        self.samples.iter().all(|samples| *samples >= spp)
    }

    /// The share of all blocks that these are.
    pub fn share_of(&self, equal: &EqualBlocks) -> f64 {
        equal.blocks.len() as f64 / self.samples.len() as f64
    }

    /// Samples of a pixel.
    pub fn samples_of(&self, pixel: usize, width: u32) -> u32 {
        let [x, y] = [pixel % width as usize, pixel / width as usize].map(|i| i / self.side as usize);
        self.samples[y * self.columns as usize + x]
    }

    /// The relMSE of each block: the mean over its pixels, or over the pixels of its neighbours too if that is larger.
    /// A block alone may look clean by chance.
    pub fn errors(&self, pixels: &[f64], width: u32) -> Vec<f64> {
        let columns = self.columns as usize;
        let mut sums = vec![[0.0; 2]; self.samples.len()];
        let rows = sums.len() / columns;
        for (pixel, error) in pixels.iter().enumerate() {
            let [x, y] = [pixel % width as usize, pixel / width as usize].map(|i| i / self.side as usize);
            let [sum, count] = &mut sums[y * columns + x];
            (*sum, *count) = (*sum + error, *count + 1.0);
        }
        let near = |i: usize, end: usize| i.saturating_sub(1)..(i + 2).min(end);
        let around = |block: usize| {
            let blocks = near(block / columns, rows).flat_map(|y| near(block % columns, columns).map(move |x| (y, x)));
            let sums = blocks.map(|(y, x)| sums[y * columns + x]);
            sums.fold([0.0; 2], |[sum, count], [more, pixels]| [sum + more, count + pixels])
        };
        let mean = |[sum, count]: [f64; 2]| sum / count;
        sums.iter().enumerate().map(|(block, own)| mean(*own).max(mean(around(block)))).collect()
    }
}

impl EqualBlocks {
    /// Their pixels in some rows of the image, by their indices there, block by block. `all` has all blocks.
    pub fn pixels(&self, all: &SampleAllocation, rows: Range<u32>, width: u32) -> Vec<u32> {
        let in_block = |block: &u32| {
            let side = all.side;
            let [x, y] = [block % all.columns * side, block / all.columns * side];
            let (columns, rows) = (x..(x + side).min(width), y.max(rows.start)..(y + side).min(rows.end));
            rows.flat_map(move |y| columns.clone().map(move |x| (y, x)))
        };
        let index = |(y, x): (u32, u32)| (y - rows.start) * width + x;
        self.blocks.iter().flat_map(in_block).map(index).collect()
    }
}

/// The mean of the values around each pixel of rows of `width`, without its own; the only one where there is no other.
fn around(values: &[f64], width: usize) -> Vec<f64> {
    let height = values.len() / width;
    let near = |i: usize, end: usize| i.saturating_sub(REACH)..(i + REACH + 1).min(end);
    let pixel = |pixel: usize| {
        let [x, y] = [pixel % width, pixel / width];
        let [rows, columns] = [near(y, height), near(x, width)];
        let others = rows.len() * columns.len() - 1;
        let sum: f64 = rows.map(|y| values[y * width..][columns.clone()].iter().sum::<f64>()).sum();
        if others > 0 { (sum - values[pixel]).max(0.0) / others as f64 } else { sum }
    };
    (0..values.len()).into_par_iter().map(pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Sampling;

    /// The smallest part of the blocks that get samples together.
    const SHARE: f64 = 0.125;

    /// The blocks of an image in adaptive sampling to a noise threshold.
    fn blocks(width: u32, height: u32, spp: u32) -> SampleAllocation {
        SampleAllocation::of(&ImageSettings { width, height, spp, noise: Some(0.1), ..ImageSettings::default() })
            .unwrap()
    }

    /// The pixels of an image in adaptive sampling with a fixed budget.
    fn pixels(width: u32, height: u32, spp: u32) -> SampleAllocation {
        let sampling = Sampling::Adaptive;
        SampleAllocation::of(&ImageSettings { width, height, spp, sampling, ..ImageSettings::default() }).unwrap()
    }

    /// Adds all samples of the blocks that are next, at most `limit` at a time. Returns the blocks that got samples
    /// together, the first sample, and how many they got.
    fn render(adaptive: &mut SampleAllocation, limit: u32) -> Vec<(Vec<u32>, u32, u32)> {
        let mut rendered = Vec::new();
        while let Some(mut equal) = adaptive.next_equal() {
            equal.samples = equal.samples.min(limit);
            rendered.push((equal.blocks.clone(), equal.first_sample, equal.samples));
            adaptive.add(&[equal]);
        }
        rendered
    }

    /// All blocks get the first samples, also where `spp` is less.
    #[test]
    fn the_first_samples_are_for_all() {
        for (spp, first) in [(1, 1), (5, 5), (8, 8), (1000, 8)] {
            let mut adaptive = blocks(17, 8, spp);
            assert_eq!(render(&mut adaptive, u32::MAX), [(vec![0, 1, 2], 0, first)]);
            assert_eq!(adaptive.samples, [first; 3]);
        }
    }

    /// Blocks above the noise double their samples up to the limit, the ones with the largest gain first. Only blocks
    /// with equal numbers of samples get samples together.
    #[test]
    fn samples_go_where_they_gain() {
        let mut adaptive = blocks(64, 8, 40);
        render(&mut adaptive, 8);
        // Gains by a sample: 1/8 of it. A quarter of the best is enough, and an error of 0.1 is.
        let errors = [0.1, 8.0, 2.0, 1.9, 0.2, 0.09, 0.0, 8.0];
        adaptive.select_blocks(&errors, 0.1, 40, SHARE);
        assert_eq!(render(&mut adaptive, 5), [(vec![1, 2, 7], 8, 5), (vec![1, 2, 7], 13, 3)]);
        // Now 2 / 16 is a quarter of 8 / 16, and 1.9 / 8 is more: two numbers of samples, one after the other.
        adaptive.select_blocks(&errors, 0.1, 40, SHARE);
        assert_eq!(render(&mut adaptive, 99), [(vec![3], 8, 8), (vec![1, 2, 7], 16, 16)]);
        adaptive.select_blocks(&errors, 0.1, 40, SHARE);
        assert_eq!(render(&mut adaptive, 99), [(vec![3], 16, 16), (vec![1, 2, 7], 32, 8)]);
        assert_eq!(adaptive.samples, [8, 40, 40, 32, 8, 8, 8, 40]);
        assert!(adaptive.has_all(8) && !adaptive.has_all(9));
        // At the limit, or below the noise, nothing is wanted.
        adaptive.select_blocks(&[0.1, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 8.0], 0.1, 40, SHARE);
        assert!(adaptive.next_equal().is_none());
    }

    /// At least an eighth of many blocks get samples together: those with the largest gain.
    #[test]
    fn rounds_are_not_too_small() {
        let mut adaptive = blocks(8 * 16, 8, 64);
        render(&mut adaptive, 8);
        let errors: Vec<f64> = (0..16).map(|block| 10f64.powi(block)).collect();
        adaptive.select_blocks(&errors, 0.5, 64, SHARE);
        assert_eq!(adaptive.share_of(&adaptive.next_equal().unwrap()), 2.0 / 16.0);
        assert_eq!(render(&mut adaptive, 8), [(vec![14, 15], 8, 8)]);
    }

    /// The error of a block is that of its pixels, or of those around it if that is larger. Blocks at the edge have
    /// fewer pixels.
    #[test]
    fn errors_are_means_over_blocks_and_their_neighbours() {
        let adaptive = blocks(26, 9, 64);
        assert_eq!(adaptive.samples.len(), 8);
        let mut pixels = vec![0.0; 26 * 9];
        // One pixel of the block of 8 x 1 pixels below the first one.
        pixels[8 * 26 + 3] = 8.0;
        let errors = adaptive.errors(&pixels, 26);
        let around = 8.0 / f64::from(16 * 9);
        let expected = [around, 8.0 / f64::from(24 * 9), 0.0, 0.0, 1.0, 8.0 / f64::from(24 * 9), 0.0, 0.0];
        for (got, expected) in errors.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-12, "{errors:?}");
        }
    }

    /// Tiles divide blocks; each pixel of blocks is in one of them.
    #[test]
    fn tiles_list_each_pixel_once() {
        let mut adaptive = blocks(26, 19, 64);
        let tiles = [0..5, 5..6, 6..16, 16..19];
        let pixels = |adaptive: &SampleAllocation| -> Vec<u32> {
            let equal = adaptive.next_equal().unwrap();
            let of_rows = |rows: &Range<u32>| -> Vec<u32> {
                equal.pixels(adaptive, rows.clone(), 26).into_iter().map(|i| i + rows.start * 26).collect()
            };
            tiles.iter().flat_map(of_rows).collect()
        };
        let mut all = pixels(&adaptive);
        assert_eq!(all[..9], [0, 1, 2, 3, 4, 5, 6, 7, 26], "block by block");
        all.sort_unstable();
        assert!(all.iter().copied().eq(0..26 * 19));
        render(&mut adaptive, 8);
        let mut errors = [0.0; 12];
        (errors[3], errors[10]) = (1.0, 1.0);
        adaptive.select_blocks(&errors, 0.1, 64, SHARE);
        let of_blocks = |pixel: &u32| matches!((pixel % 26 / 8, pixel / 26 / 8), (3, 0) | (2, 2));
        let mut some = pixels(&adaptive);
        some.sort_unstable();
        assert!(some.into_iter().eq((0..26 * 19).filter(of_blocks)));
    }

    /// A pixel has the samples of its block.
    #[test]
    fn pixels_have_the_samples_of_their_block() {
        let mut adaptive = blocks(26, 9, 64);
        adaptive.samples = (1..9).collect();
        for (pixel, samples) in [(0, 1), (7, 1), (8, 2), (25, 4), (7 * 26 + 8, 2), (8 * 26 + 8, 6), (8 * 26 + 25, 8)] {
            assert_eq!(adaptive.samples_of(pixel, 26), samples, "pixel {pixel}");
        }
    }

    /// Raises the mean of all pixels by `samples`. Returns how many pixels got samples together, the first sample, and
    /// how many they got.
    fn raise_mean(blocks: &mut SampleAllocation, samples: u32, mean: u32) -> Vec<(usize, u32, u32)> {
        let next = blocks.to_raise_mean(samples, mean);
        blocks.add(&next);
        next.into_iter().map(|equal| (equal.blocks.len(), equal.first_sample, equal.samples)).collect()
    }

    /// The first two samples are for all pixels, one at a time.
    #[test]
    fn all_pixels_get_two_samples() {
        let mut blocks = pixels(3, 2, 100);
        assert_eq!(raise_mean(&mut blocks, 1, 0), [(6, 0, 1)]);
        assert!(!blocks.is_complete());
        assert_eq!(raise_mean(&mut blocks, 1, 1), [(6, 1, 1)]);
        assert!(blocks.is_complete() && blocks.samples == [2; 6]);
    }

    /// Pixels around a noisy one get most, and that pixel itself, like those far away, fewest: its own samples do not
    /// decide. The mean is what was requested, but for less than one in a hundred.
    #[test]
    fn noise_around_a_pixel_brings_samples() {
        let mut blocks = pixels(40, 40, 100);
        raise_mean(&mut blocks, 2, 0);
        let noisy = 20 * 40 + 20;
        let mut errors = vec![0.0; 40 * 40];
        errors[noisy] = 0.5;
        blocks.allocate_samples(&errors, 8);
        let target = |x: usize, y: usize| {
            let of_block = |next: &&Next| next.block as usize == y * 40 + x;
            blocks.next.iter().find(of_block).map_or(2, |next| next.target)
        };
        let around: Vec<u32> =
            (18..23).flat_map(|y| (18..23).map(move |x| (x, y))).map(|(x, y)| target(x, y)).collect();
        let far: Vec<u32> = [(0, 0), (17, 20), (20, 23), (39, 39)].map(|(x, y)| target(x, y)).into();
        assert!(around.iter().enumerate().all(|(i, target)| i == 12 || *target == 64), "{around:?}");
        assert!(far.iter().chain([&around[12]]).all(|target| [4, 8].contains(target)), "{far:?}, {}", around[12]);
        let sum: u32 = (0..40).flat_map(|y| (0..40).map(move |x| (x, y))).map(|(x, y)| target(x, y)).sum();
        let mean = f64::from(sum) / 1600.0;
        assert!(mean > 7.92 && mean <= 8.0, "{mean}");
    }

    /// Numbers of samples are in proportion to the square roots of the variances of a sample, by powers of two.
    #[test]
    fn samples_follow_the_square_root_of_the_variance() {
        // Halves of an image, one with four times the variance: twice the samples.
        let mut blocks = pixels(64, 16, 100);
        raise_mean(&mut blocks, 2, 0);
        let errors: Vec<f64> = (0..64 * 16).map(|pixel| if pixel % 64 < 32 { 0.04 } else { 0.01 }).collect();
        blocks.allocate_samples(&errors, 16);
        let mean_of = |columns: Range<usize>| {
            let of_columns = |next: &&Next| columns.contains(&(next.block as usize % 64));
            let targets: Vec<u32> = blocks.next.iter().filter(of_columns).map(|next| next.target).collect();
            assert!(targets.len() == 12 * 16, "{}", targets.len());
            f64::from(targets.iter().sum::<u32>()) / targets.len() as f64
        };
        // Away from the border between them; to an eighth of an octave, by which numbers are rounded.
        let quotient = mean_of(10..22) / mean_of(42..54);
        assert!(quotient > 2.0 / 1.1 && quotient < 2.0 * 1.1, "{quotient}");
    }

    /// Samples are in order and end at powers of two. A share of a step of the mean is that share of its samples.
    #[test]
    fn samples_end_at_powers_of_two() {
        let mut blocks = pixels(4, 1, 100);
        blocks.samples = vec![2, 4, 4, 8];
        let next = |(block, target): (u32, u32)| Next { block, target };
        blocks.next = [(0, 16), (1, 4), (2, 8), (3, 32)].map(next).into();
        let numbers = |next: Vec<EqualBlocks>| -> Vec<(Vec<u32>, u32, u32)> {
            next.into_iter().map(|equal| (equal.blocks, equal.first_sample, equal.samples)).collect()
        };
        let whole = [(vec![0], 2, 2), (vec![0, 2], 4, 4), (vec![0, 3], 8, 8), (vec![3], 16, 16)];
        assert_eq!(numbers(blocks.to_raise_mean(8, 8)), whole);
        let quarter = [(vec![0], 2, 2), (vec![2], 4, 1), (vec![0], 4, 2), (vec![3], 8, 6)];
        assert_eq!(numbers(blocks.to_raise_mean(2, 8)), quarter);
    }

    /// Without a decision each pixel doubles its samples, some at a time.
    #[test]
    fn numbers_of_samples_are_doubled() {
        let mut blocks = pixels(4, 1, 100);
        blocks.samples = vec![2, 4, 4, 8];
        blocks.next.clear();
        blocks.double();
        assert!(!blocks.is_complete());
        assert_eq!(raise_mean(&mut blocks, 1, 4), [(1, 2, 1), (2, 4, 1), (1, 8, 2)]);
        assert_eq!(blocks.samples, [3, 5, 5, 10]);
        raise_mean(&mut blocks, 3, 5);
        assert!(blocks.is_complete() && blocks.samples == [4, 8, 8, 16], "{:?}", blocks.samples);
    }

    /// Without noise anywhere all pixels get the same, and so does a single pixel.
    #[test]
    fn equal_pixels_share_equally() {
        for [width, height] in [[1, 1], [1, 9], [12, 10]] {
            for error in [0.0, 0.01, f64::INFINITY] {
                let mut blocks = pixels(width, height, 100);
                raise_mean(&mut blocks, 2, 0);
                blocks.allocate_samples(&vec![error; (width * height) as usize], 4);
                assert!(blocks.next.iter().all(|next| next.target == 4), "{width} x {height}");
                assert_eq!(blocks.next.len(), (width * height) as usize);
            }
        }
    }
}
