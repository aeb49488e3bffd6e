//! The blocks of pixels that adaptive sampling gives samples to: how many each has, and which ones are next. The
//! samples of a block double each time, so that they remain stratified.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::settings::ImageSettings;

/// Side of a block in pixels. Its 64 pixels tell the error of the mean of a few samples to about a fifth.
const SIDE: u32 = 8;

/// Samples of each pixel before the first estimate. Fewer say little where light is rare.
const MIN_SAMPLES: u32 = 8;

/// Blocks get samples together if the gain by each sample of one is at least this part of that of the best: twice the
/// samples have half of the error and less, so the gain by a further sample falls to a quarter.
const ROUND_GAIN: f64 = 0.25;

/// The samples of each block so far, and which ones are next.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Blocks {
    /// Blocks in a row of the image.
    columns: u32,
    /// Samples of each pixel of a block, row by row.
    samples: Vec<u32>,
    /// Blocks that get more before the next estimate, those of equal numbers side by side.
    next: Vec<Next>,
}

/// A block that gets samples.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Next {
    block: u32,
    /// The number of samples that its pixels will have.
    target: u32,
}

/// Blocks that get samples of the same numbers.
pub(super) struct Batch {
    blocks: Vec<u32>,
    /// Samples of their pixels so far.
    pub first_sample: u32,
    /// Samples that they are to get before the next estimate.
    pub missing: u32,
}

impl Blocks {
    /// No samples yet; the first ones are for all blocks.
    pub fn new(image: &ImageSettings) -> Blocks {
        let part = image.part();
        let [columns, rows] = [part.width, part.height].map(|side| side.div_ceil(SIDE));
        let target = image.spp.min(MIN_SAMPLES);
        let next = (0..columns * rows).map(|block| Next { block, target }).collect();
        Blocks { columns, samples: vec![0; (columns * rows) as usize], next }
    }

    /// Whether it is of an image of that size.
    pub fn fits(&self, image: &ImageSettings) -> bool {
        let new = Blocks::new(image);
        let is_block = |next: &Next| (next.block as usize) < new.samples.len();
        self.columns == new.columns && self.samples.len() == new.samples.len() && self.next.iter().all(is_block)
    }

    /// The next blocks whose pixels have and will have equal numbers of samples; none before the next estimate.
    pub fn batch(&self) -> Option<Batch> {
        let first = self.next.first()?;
        let numbers = |next: &Next| (self.samples[next.block as usize], next.target);
        let (first_sample, target) = numbers(first);
        let same = self.next.iter().take_while(|next| numbers(next) == (first_sample, target));
        Some(Batch { blocks: same.map(|next| next.block).collect(), first_sample, missing: target - first_sample })
    }

    /// Counts samples of each pixel of a batch.
    pub fn add(&mut self, batch: &Batch, samples: u32) {
        batch.blocks.iter().for_each(|block| self.samples[*block as usize] += samples);
        let Blocks { samples, next, .. } = self;
        next.retain(|next| samples[next.block as usize] < next.target);
    }

    /// Decides which blocks are next, by the estimated relMSE of each: `noise` is enough, and no block gets more than
    /// `spp` samples. At least `share` of the blocks that need samples are next.
    pub fn choose(&mut self, errors: &[f64], noise: f64, spp: u32, share: f64) {
        let gain = |block: u32| errors[block as usize] / f64::from(self.samples[block as usize]);
        let wants_more = |block: &u32| errors[*block as usize] > noise && self.samples[*block as usize] < spp;
        let mut wanted: Vec<u32> = (0..self.samples.len() as u32).filter(wants_more).collect();
        // Stable: equal gains remain in the order of the blocks.
        wanted.sort_by(|a, b| gain(*b).total_cmp(&gain(*a)));
        let Some(best) = wanted.first().map(|block| gain(*block)) else { return };
        let min_count = (wanted.len() as f64 * share).ceil() as usize;
        let end = wanted.partition_point(|block| gain(*block) >= ROUND_GAIN * best).max(min_count);
        wanted.truncate(end);
        wanted.sort_by_key(|block| (self.samples[*block as usize], *block));
        let double = |block: u32| Next { block, target: self.samples[block as usize].saturating_mul(2).min(spp) };
        self.next = wanted.into_iter().map(double).collect();
    }

    /// All blocks, those of equal numbers of samples together.
    pub fn by_samples(&self) -> impl Iterator<Item = Batch> + use<> {
        let mut batches = BTreeMap::<u32, Vec<u32>>::new();
        for (block, samples) in (0..).zip(&self.samples) {
            batches.entry(*samples).or_default().push(block);
        }
        batches.into_iter().map(|(first_sample, blocks)| Batch { blocks, first_sample, missing: 0 })
    }

    /// Whether all blocks have the samples that were decided on.
    pub fn is_complete(&self) -> bool {
        self.next.is_empty()
    }

    /// Samples of a pixel.
    pub fn samples_of(&self, pixel: usize, width: u32) -> u32 {
        let [x, y] = [pixel % width as usize, pixel / width as usize].map(|i| i / SIDE as usize);
        self.samples[y * self.columns as usize + x]
    }

    /// Mean relMSE of the pixels of each block, or of all pixels of the blocks around it too if that is larger: by luck
    /// alone a block may look clean.
    pub fn errors(&self, pixels: &[f64], width: u32) -> Vec<f64> {
        let columns = self.columns as usize;
        let mut sums = vec![[0.0; 2]; self.samples.len()];
        let rows = sums.len() / columns;
        for (pixel, error) in pixels.iter().enumerate() {
            let [x, y] = [pixel % width as usize, pixel / width as usize].map(|i| i / SIDE as usize);
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

impl Batch {
    /// The blocks' pixels in some rows of the image, by their indices there, block by block.
    pub fn pixels(&self, adaptive: &Blocks, rows: Range<u32>, width: u32) -> Vec<u32> {
        let in_block = |block: &u32| {
            let [x, y] = [block % adaptive.columns * SIDE, block / adaptive.columns * SIDE];
            let (columns, rows) = (x..(x + SIDE).min(width), y.max(rows.start)..(y + SIDE).min(rows.end));
            rows.flat_map(move |y| columns.clone().map(move |x| (y, x)))
        };
        let index = |(y, x): (u32, u32)| (y - rows.start) * width + x;
        self.blocks.iter().flat_map(in_block).map(index).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The smallest part of the blocks that get samples together.
    const SHARE: f64 = 0.125;

    fn image(width: u32, height: u32, spp: u32) -> ImageSettings {
        ImageSettings { width, height, spp, ..ImageSettings::default() }
    }

    /// Adds all samples of the blocks that are next, at most `layers` at a time; the batches as blocks and numbers.
    fn render(adaptive: &mut Blocks, layers: u32) -> Vec<(Vec<u32>, u32, u32)> {
        let mut batches = Vec::new();
        while let Some(batch) = adaptive.batch() {
            let more = batch.missing.min(layers);
            adaptive.add(&batch, more);
            batches.push((batch.blocks, batch.first_sample, more));
        }
        batches
    }

    /// All blocks get the first samples, also where `spp` is less.
    #[test]
    fn the_first_samples_are_for_all() {
        for (spp, first) in [(1, 1), (5, 5), (8, 8), (1000, 8)] {
            let mut adaptive = Blocks::new(&image(17, 8, spp));
            assert_eq!(render(&mut adaptive, u32::MAX), [(vec![0, 1, 2], 0, first)]);
            assert_eq!(adaptive.samples, [first; 3]);
        }
    }

    /// Blocks with more than the noise double their samples up to the limit, those of the largest gain first; batches
    /// are of blocks with equal numbers.
    #[test]
    fn samples_go_where_they_gain() {
        let mut adaptive = Blocks::new(&image(64, 8, 40));
        render(&mut adaptive, 8);
        // Gains by a sample: 1/8 of it. A quarter of the best is enough, and an error of 0.1 is.
        let errors = [0.1, 8.0, 2.0, 1.9, 0.2, 0.09, 0.0, 8.0];
        adaptive.choose(&errors, 0.1, 40, SHARE);
        assert_eq!(render(&mut adaptive, 5), [(vec![1, 2, 7], 8, 5), (vec![1, 2, 7], 13, 3)]);
        // Now 2 / 16 is a quarter of 8 / 16, and 1.9 / 8 is more: two numbers of samples, two batches.
        adaptive.choose(&errors, 0.1, 40, SHARE);
        assert_eq!(render(&mut adaptive, 99), [(vec![3], 8, 8), (vec![1, 2, 7], 16, 16)]);
        adaptive.choose(&errors, 0.1, 40, SHARE);
        assert_eq!(render(&mut adaptive, 99), [(vec![3], 16, 16), (vec![1, 2, 7], 32, 8)]);
        assert_eq!(adaptive.samples, [8, 40, 40, 32, 8, 8, 8, 40]);
        // At the limit, or below the noise, nothing is wanted.
        adaptive.choose(&[0.1, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 8.0], 0.1, 40, SHARE);
        assert!(adaptive.batch().is_none());
    }

    /// Of many blocks at least an eighth go together, those of the largest gain.
    #[test]
    fn rounds_are_not_too_small() {
        let mut adaptive = Blocks::new(&image(8 * 16, 8, 64));
        render(&mut adaptive, 8);
        let errors: Vec<f64> = (0..16).map(|block| 10f64.powi(block)).collect();
        adaptive.choose(&errors, 0.5, 64, SHARE);
        assert_eq!(render(&mut adaptive, 8), [(vec![14, 15], 8, 8)]);
    }

    /// The error of a block is that of its pixels, or of those around it if that is larger. Blocks at the edge have
    /// fewer pixels.
    #[test]
    fn errors_are_means_over_blocks_and_their_neighbours() {
        let adaptive = Blocks::new(&image(26, 9, 64));
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

    /// Tiles divide blocks; each pixel of a batch is in one of them.
    #[test]
    fn batches_list_each_pixel_once() {
        let mut adaptive = Blocks::new(&image(26, 19, 64));
        let parts = [0..5, 5..6, 6..16, 16..19];
        let pixels = |adaptive: &Blocks| -> Vec<u32> {
            let batch = adaptive.batch().unwrap();
            let of_rows = |rows: &Range<u32>| -> Vec<u32> {
                batch.pixels(adaptive, rows.clone(), 26).into_iter().map(|i| i + rows.start * 26).collect()
            };
            parts.iter().flat_map(of_rows).collect()
        };
        let mut all = pixels(&adaptive);
        assert_eq!(all[..9], [0, 1, 2, 3, 4, 5, 6, 7, 26], "block by block");
        all.sort_unstable();
        assert!(all.iter().copied().eq(0..26 * 19));
        render(&mut adaptive, 8);
        let mut errors = [0.0; 12];
        (errors[3], errors[10]) = (1.0, 1.0);
        adaptive.choose(&errors, 0.1, 64, SHARE);
        let of_blocks = |pixel: &u32| matches!((pixel % 26 / 8, pixel / 26 / 8), (3, 0) | (2, 2));
        let mut some = pixels(&adaptive);
        some.sort_unstable();
        assert!(some.into_iter().eq((0..26 * 19).filter(of_blocks)));
    }

    /// A block's samples are those of its pixels.
    #[test]
    fn pixels_have_the_samples_of_their_block() {
        let mut adaptive = Blocks::new(&image(26, 9, 64));
        adaptive.samples = (1..9).collect();
        for (pixel, samples) in [(0, 1), (7, 1), (8, 2), (25, 4), (7 * 26 + 8, 2), (8 * 26 + 8, 6), (8 * 26 + 25, 8)] {
            assert_eq!(adaptive.samples_of(pixel, 26), samples, "pixel {pixel}");
        }
    }
}
