//! Guides if chance decides what samples show, on synthetic images whose mixtures are known.

use glam::DVec3;
use penumbra::internal::render::denoise::chance::{Seen, settled};

use crate::random::Random;

const SIZE: [u32; 2] = [40, 30];

/// Share of the light that one of the two surfaces gives.
const SHARE: f64 = 0.25;

/// Albedo, normal and position that grow with a number.
fn guides(x: f64) -> [DVec3; 3] {
    [DVec3::new(x, 0.5, 1.0 - x), DVec3::new(0.0, 1.0 - 0.5 * x, x), DVec3::splat(3.0 * x)]
}

/// Pixels of `samples` samples. Each sample shows the surface `front` with probability SHARE, else `back`.
fn mixed(samples: u32, front: impl Fn(usize) -> f64, back: impl Fn(usize) -> f64) -> Vec<Seen> {
    let mut random = Random(41);
    let pixel = |i: usize| {
        let chosen = (0..samples).filter(|_| random.uniform() < SHARE).count() as f64 / f64::from(samples);
        let [front, back] = [guides(front(i)), guides(back(i))];
        Seen { choosing: 1.0, chosen, guides: std::array::from_fn(|k| front[k] * chosen + back[k] * (1.0 - chosen)) }
    };
    (0..(SIZE[0] * SIZE[1]) as usize).map(pixel).collect()
}

/// The pixels with their settled guides.
fn settle(seen: &[Seen]) -> Vec<Seen> {
    let pixel = |i: usize| Seen { guides: settled(SIZE, &|other| seen[other], i), ..seen[i] };
    (0..seen.len()).map(pixel).collect()
}

/// The largest difference of an albedo's red from the mixture that `expected` returns for each pixel.
fn worst(seen: &[Seen], expected: impl Fn(usize) -> f64) -> f64 {
    seen.iter().enumerate().map(|(i, pixel)| (pixel.guides[0].x - expected(i)).abs()).fold(0.0, f64::max)
}

/// Share of the front that the 7 x 7 pixels around one have.
fn share_around(seen: &[Seen], i: usize) -> f64 {
    let [x, y] = [i % SIZE[0] as usize, i / SIZE[0] as usize];
    let near = |j: &usize| (j % SIZE[0] as usize).abs_diff(x) <= 3 && (j / SIZE[0] as usize).abs_diff(y) <= 3;
    let around: Vec<f64> = (0..seen.len()).filter(near).map(|j| seen[j].chosen).collect();
    around.iter().sum::<f64>() / around.len() as f64
}

/// Two even surfaces become the mixture of the pixels around, however few samples there are.
#[test]
fn two_surfaces_become_their_mixture() {
    for samples in [1, 4, 64] {
        let seen = mixed(samples, |_| 0.9, |_| 0.1);
        let settled = settle(&seen);
        let mixture = |i: usize| {
            let share = share_around(&seen, i);
            0.9 * share + 0.1 * (1.0 - share)
        };
        // The ridge of the fit leaves a part of the slope, 1e-4 over the variance of the shares, which is that of
        // choices over their number, and around some pixels a third of it.
        let variance = SHARE * (1.0 - SHARE) / f64::from(samples);
        let tolerance = 0.8 * 3e-4 / variance * worst(&seen, mixture);
        assert!(worst(&settled, mixture) < tolerance, "{samples} samples: {}", worst(&settled, mixture));
        assert!(worst(&seen, mixture) > 0.1, "the mixtures are alike");
        for (before, after) in seen.iter().zip(&settled) {
            assert_eq!((before.choosing, before.chosen), (after.choosing, after.chosen));
            // The guides were functions of one number, and still are.
            let expected = guides(after.guides[0].x);
            // Roundings of sums in f64, over the ridge.
            assert!((0..3).all(|k| after.guides[k].distance(expected[k]) < 1e-9), "{after:?}");
        }
    }
}

/// A texture behind the other surface keeps its contrast times its part of the mixture, where the mean of the pixels
/// around would lose it.
#[test]
fn textures_behind_glass_stay() {
    let squares =
        |i: usize| if (i % SIZE[0] as usize / 2 + i / SIZE[0] as usize / 2).is_multiple_of(2) { 0.2 } else { 0.8 };
    let seen = mixed(1, |_| 0.5, squares);
    let settled = settle(&seen);
    // Pixels that show the texture, by its two colours.
    let mean_of = |colour: f64| {
        let shows = |i: &usize| seen[*i].chosen == 0.0 && squares(*i) == colour;
        let shown: Vec<f64> = (0..seen.len()).filter(shows).map(|i| settled[i].guides[0].x).collect();
        shown.iter().sum::<f64>() / shown.len() as f64
    };
    let contrast = mean_of(0.8) - mean_of(0.2);
    // 48 random choices around a pixel tell the share with a standard error of 0.06, hundreds of pixels far better.
    assert!((contrast / 0.6 - (1.0 - SHARE)).abs() < 0.03, "{contrast}");
}

/// Pixels that show the front more often than the mixture leave no mark: a pixel that shows it two or three times as
/// often as others keeps no more of its contrast.
#[test]
fn what_chance_shows_too_often_is_no_mark() {
    let stripes = |i: usize| if (i % SIZE[0] as usize).is_multiple_of(2) { 0.2 } else { 0.8 };
    let seen = mixed(4, stripes, |_| 0.5);
    let settled = settle(&seen);
    let contrast = |pixels: &[Seen], chosen: f64| {
        let mean_of = |colour: f64| {
            let shows = |i: &usize| seen[*i].chosen == chosen && stripes(*i) == colour;
            let shown: Vec<f64> = (0..seen.len()).filter(shows).map(|i| pixels[i].guides[0].x).collect();
            assert!(shown.len() > 20, "{} pixels show it", shown.len());
            shown.iter().sum::<f64>() / shown.len() as f64
        };
        mean_of(0.8) - mean_of(0.2)
    };
    for chosen in [0.25, 0.5, 0.75] {
        // The guides are exact mixtures: only the sums of the means are rounded, in f64.
        assert!((contrast(&seen, chosen) / 0.6 - chosen).abs() < 1e-9);
        let left = contrast(&settled, chosen) / 0.6;
        // 48 pixels of four choices around a pixel tell the share with a standard error of 0.03. Where it is less than
        // the pixel's own by chance, that is lost too: a mean of 0.4 of the error.
        assert!((left - SHARE).abs() < 0.03, "{left} of the contrast where {chosen} show it");
    }
}

/// Where chance chooses nothing, and where all pixels have the same share, nothing changes.
#[test]
fn what_is_settled_stays() {
    let mut random = Random(5);
    let mut even: Vec<Seen> = mixed(1, |_| 0.0, |_| 0.0);
    even.iter_mut().for_each(|pixel| {
        *pixel = Seen { choosing: 1.0, chosen: 0.25, guides: guides(random.uniform()) };
    });
    let settled = settle(&even);
    for (before, after) in even.iter().zip(&settled) {
        // Roundings of sums of 49 products, over the ridge.
        assert!((0..3).all(|k| before.guides[k].distance(after.guides[k]) < 1e-9), "{before:?} and {after:?}");
    }
    // The left half is behind no glass: its bits stay, and the right half does not see it.
    let beside = |left: f64| {
        let mut seen = mixed(1, |_| 0.9, |_| 0.1);
        seen.iter_mut().enumerate().filter(|(i, _)| i % (SIZE[0] as usize) < 20).for_each(|(i, pixel)| {
            *pixel = Seen { guides: guides(left * i as f64), ..Seen::default() };
        });
        let after = settle(&seen);
        (seen, after)
    };
    let ((before, after), (_, others)) = (beside(1e-3), beside(0.5));
    let (mut kept, mut changed) = (0, 0);
    for i in 0..before.len() {
        if before[i].choosing == 0.0 {
            assert_eq!(before[i], after[i]);
            kept += 1;
        } else {
            assert_eq!(after[i], others[i], "pixel {i}");
            changed += usize::from(before[i] != after[i]);
        }
    }
    assert!(kept == 600 && changed > 500, "{kept}, {changed}");
}
