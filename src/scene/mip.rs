//! Smaller levels of images, for scenes whose images have more texels than devices take.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::Vec4;
use rayon::prelude::*;

use super::texture::{ColourSpace, TextureImage};

/// The level of each image, counted from 0, such that all of them together have at most `max` texels. The largest image
/// is halved along both sides until they do.
pub(super) fn levels(sizes: &[[u32; 2]], max: u64) -> Vec<u32> {
    let texels = |size: [u32; 2], level: u32| level_size(size, level).map(u64::from).iter().product::<u64>();
    let mut levels = vec![0; sizes.len()];
    // Images of equal size are reduced in the order of the file.
    let mut largest: BinaryHeap<_> = sizes.iter().enumerate().map(|(i, size)| (texels(*size, 0), Reverse(i))).collect();
    let mut total: u64 = largest.iter().map(|(texels, _)| texels).sum();
    while total > max
        && let Some((before, Reverse(index))) = largest.pop().filter(|(texels, _)| *texels > 1)
    {
        levels[index] += 1;
        let after = texels(sizes[index], levels[index]);
        total -= before - after;
        largest.push((after, Reverse(index)));
    }
    levels
}

fn level_size(size: [u32; 2], level: u32) -> [u32; 2] {
    size.map(|side| (side >> level).max(1))
}

/// The texels out of `size` that the `i`-th of `count` equal parts covers, each with the covered interval.
pub(crate) fn covered(i: usize, count: u32, size: u32) -> impl Iterator<Item = (usize, [f64; 2])> {
    let end = |i: usize| i as f64 * f64::from(size) / f64::from(count);
    let (low, high) = (end(i), end(i + 1));
    let texels = low as usize..(high.ceil() as usize).min(size as usize);
    texels.map(move |k| (k, [low.max(k as f64), high.min(k as f64 + 1.0)])).filter(|(_, [a, b])| b > a)
}

impl TextureImage {
    /// The image at a level: each texel is the mean of those that it covers, of colours in linear light.
    pub(super) fn at_level(self, level: u32, space: ColourSpace) -> TextureImage {
        if level == 0 {
            return self;
        }
        let [width, height] = level_size([self.width, self.height], level);
        let mut texels = vec![[0; 4]; width as usize * height as usize];
        texels.par_chunks_exact_mut(width as usize).enumerate().for_each(|(row, texels)| {
            for (column, texel) in texels.iter_mut().enumerate() {
                let (mut sum, mut area) = (Vec4::ZERO, 0.0);
                for (y, [top, bottom]) in covered(row, height, self.height) {
                    for (x, [left, right]) in covered(column, width, self.width) {
                        let part = ((bottom - top) * (right - left)) as f32;
                        sum += part * self.linear([x as u32, y as u32], space);
                        area += part;
                    }
                }
                *texel = TextureImage::coded(sum / area, space);
            }
        });
        TextureImage { name: self.name, width, height, texels }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, texels: Vec<[u8; 4]>) -> TextureImage {
        TextureImage { name: String::new(), width, height, texels }
    }

    #[test]
    fn the_largest_images_are_halved_first() {
        let sizes = [[64, 64], [256, 16], [16, 16], [1, 1]];
        let texels = 2 * 4096 + 256 + 1;
        assert_eq!(levels(&sizes, texels), [0, 0, 0, 0]);
        assert_eq!(levels(&sizes, texels - 1), [1, 0, 0, 0]);
        assert_eq!(levels(&sizes, 3000), [1, 1, 0, 0]);
        // Sides of one texel stay.
        assert_eq!(levels(&sizes, 4), [6, 8, 4, 0]);
        assert_eq!(levels(&sizes, 0), [6, 8, 4, 0], "there is nothing left to halve");
        assert_eq!(levels(&[], 0), [0; 0]);
    }

    #[test]
    fn every_byte_is_its_own_code() {
        for space in [ColourSpace::Srgb, ColourSpace::Linear] {
            let all = image(256, 1, (0..=255).map(|byte| [byte; 4]).collect());
            for byte in 0..=255 {
                assert_eq!(TextureImage::coded(all.linear([u32::from(byte), 0], space), space), [byte; 4]);
            }
        }
    }

    /// The mean of black and white is half of the light: 188 as sRGB codes it (the inverse of IEC 61966-2-1 at 0.5,
    /// 0.7354), and 128 where values are linear, as alpha always is.
    #[test]
    fn texels_are_means_of_light() {
        let board = image(4, 2, (0..8).map(|i| [if (i % 4 + i / 4) % 2 == 0 { 0 } else { 255 }; 4]).collect());
        let halved = board.clone().at_level(1, ColourSpace::Srgb);
        assert_eq!((halved.width, halved.height, halved.texels), (2, 1, vec![[188, 188, 188, 128]; 2]));
        assert_eq!(board.clone().at_level(1, ColourSpace::Linear).texels, vec![[128; 4]; 2]);
        assert_eq!(board.clone().at_level(0, ColourSpace::Srgb), board);
        // Three texels become one; of five, the middle one is half in each of two.
        assert_eq!(image(3, 1, vec![[0; 4], [0; 4], [255; 4]]).at_level(1, ColourSpace::Linear).texels, [[85; 4]]);
        let five = image(5, 1, vec![[0; 4], [0; 4], [255; 4], [0; 4], [255; 4]]);
        // 0.5 / 2.5 and 1.5 / 2.5 of 255.
        assert_eq!(five.at_level(1, ColourSpace::Linear).texels, [[51; 4], [153; 4]]);
    }
}
