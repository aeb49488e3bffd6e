//! Guides where chance chooses what a sample shows: reflection or refraction in clear glass, a blended surface or what
//! is behind. With few samples each pixel then shows another mixture of two surfaces than its neighbours, and resembles
//! none of them. Here every pixel gets the mixture that the pixels around it show on average.

use glam::DVec3;
use rayon::prelude::*;

/// Pixels around a pixel, on each side, that tell the two surfaces: reflections in glass are a twenty-fifth of what it
/// shows, so that 7 x 7 pixels with a sample each have two.
const REACH: i32 = 3;

/// Added to the variance of the choices: a single choice among 49 pixels has 0.02.
const RIDGE: f64 = 1e-4;

/// What the samples of a pixel show.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Share of samples for which chance chose a surface, 0 to 1.
    pub choosing: f64,
    /// Share of samples for which it chose the reflection, or the blended surface, 0 to 1.
    pub chosen: f64,
    /// Means of albedo, normal and position.
    pub guides: [DVec3; 3],
}

/// Removes from the guides of an image what the chosen shares of its pixels differ by chance.
///
/// Around a pixel guides are fitted by `a + b chosen`. The pixel gets the fit at the mean share, and a part of its own
/// distance from the fit: all where its share is the mean, and where its samples show only one surface the part that
/// this surface has in the mixture.
pub fn settle_choices([width, height]: [u32; 2], seen: &mut [Seen]) {
    if seen.iter().all(|pixel| pixel.choosing == 0.0) {
        return;
    }
    let [width, height] = [width as i32, height as i32];
    let settled = |(i, own): (usize, &Seen)| -> [DVec3; 3] {
        if own.choosing == 0.0 {
            return own.guides;
        }
        let [x, y] = [i as i32 % width, i as i32 / width];
        let [left, right] = [(x - REACH).max(0), (x + REACH).min(width - 1)];
        let rows = (y - REACH).max(0)..=(y + REACH).min(height - 1);
        let around = rows.flat_map(|row| &seen[(row * width + left) as usize..=(row * width + right) as usize]);
        let mut sums = Sums::default();
        around.filter(|other| other.choosing > 0.0).for_each(|other| sums.add(other));
        sums.settled(own)
    };
    let guides: Vec<[DVec3; 3]> = seen.par_iter().enumerate().map(settled).collect();
    seen.iter_mut().zip(guides).for_each(|(pixel, guides)| pixel.guides = guides);
}

/// Sums over the pixels around one.
#[derive(Default)]
struct Sums {
    count: f64,
    chosen: f64,
    squares: f64,
    guides: [DVec3; 3],
    products: [DVec3; 3],
}

impl Sums {
    fn add(&mut self, pixel: &Seen) {
        self.count += 1.0;
        self.chosen += pixel.chosen;
        self.squares += pixel.chosen * pixel.chosen;
        for (k, guide) in pixel.guides.iter().enumerate() {
            self.guides[k] += *guide;
            self.products[k] += pixel.chosen * *guide;
        }
    }

    fn settled(&self, own: &Seen) -> [DVec3; 3] {
        let share = self.chosen / self.count;
        let variance = self.squares / self.count - share * share + RIDGE;
        let kept = 1.0 - (own.chosen - share).abs();
        std::array::from_fn(|k| {
            let mean = self.guides[k] / self.count;
            let slope = (self.products[k] / self.count - share * mean) / variance;
            let fit = mean + slope * (own.chosen - share);
            mean + kept * (own.guides[k] - fit)
        })
    }
}
