//! Guides where chance chooses what a sample shows: reflection or refraction in clear glass, a blended surface or what
//! is behind. With few samples each pixel then shows another mixture of two surfaces than its neighbours, and resembles
//! none of them. Here every pixel gets the mixture that the pixels around it show on average.

use glam::DVec3;

/// Pixels to each side of a pixel from which the two surfaces are estimated. Glass reflects a twenty-fifth of the
/// light, so 7 x 7 pixels with one sample each contain two reflections.
const REACH: usize = 3;

/// Added to the variance of the choices, so that it is never 0. A single choice among 49 pixels has a variance of 0.02.
const RIDGE: f64 = 1e-4;

/// The guides of a pixel's samples, and the random choices behind them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Share of samples for which chance chose a surface, 0 to 1.
    pub choosing: f64,
    /// Share of samples for which it chose the reflection, or the blended surface, 0 to 1.
    pub chosen: f64,
    /// Means of albedo, normal and position.
    pub guides: [DVec3; 3],
}

/// The guides of pixel `i` without the differences from its neighbours that are due to chance; `seen` returns the
/// samples of a pixel.
///
/// The guides of the pixels around are fitted by `a + b chosen`. The pixel gets the fit at their mean share, plus a
/// part of its own distance from the fit. If it shows a surface more often than they do, that part is their share of
/// the surface over its own. So if one of four samples finds a lamp in glass, the guides of its pixel stay like those
/// around it, and the light of the lamp stands out.
pub fn settled([width, height]: [u32; 2], seen: &impl Fn(usize) -> Seen, i: usize) -> [DVec3; 3] {
    let own = seen(i);
    if own.choosing == 0.0 {
        return own.guides;
    }
    let [width, height] = [width as usize, height as usize];
    let around = |at: usize, side: usize| at.saturating_sub(REACH)..=(at + REACH).min(side - 1);
    let mut sums = Sums::default();
    for y in around(i / width, height) {
        for other in around(i % width, width).map(|x| seen(y * width + x)).filter(|other| other.choosing > 0.0) {
            sums.add(&other);
        }
    }
    sums.settled(&own)
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
        // 0 / 0 is NaN, for which `min` returns the other number.
        let kept = 1f64.min(share / own.chosen).min((1.0 - share) / (1.0 - own.chosen));
        std::array::from_fn(|k| {
            let mean = self.guides[k] / self.count;
            let slope = (self.products[k] / self.count - share * mean) / variance;
            let fit = mean + slope * (own.chosen - share);
            mean + kept * (own.guides[k] - fit)
        })
    }
}
