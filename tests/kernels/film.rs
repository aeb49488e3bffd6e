//! Pass `film` against sums in f64.

use glam::DVec4;
use kernel_kit::{Buffer, Gpu, kernel_test};
use penumbra::internal::passes::Tile;
use penumbra::internal::passes::film::{Change, Film, Inputs, Plane};
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::internal::statistics::Counter;

use crate::kit::device_features;
use crate::random::Random;

type Samples = Vec<[f32; 4]>;

fn film(gpu: &Gpu) -> Film {
    let features: Features = device_features(gpu);
    Film::new(gpu, &features).unwrap()
}

/// All pixels get samples.
fn inputs(counters: &Buffer) -> Inputs<'_> {
    Inputs { counters, sampled_pixels: None }
}

fn tile(pixel_count: u32, samples_per_pixel: u32) -> Tile {
    Tile { pixel_count, samples_per_pixel, point_count: pixel_count * samples_per_pixel, ..Tile::default() }
}

fn add(gpu: &Gpu, plane: &Plane, tile: &Tile, first_point: u32) {
    let mut frame = gpu.frame("test");
    plane.record_from(&mut frame, tile, first_point);
    frame.submit().unwrap();
}

fn finite(sample: &[f32; 4]) -> bool {
    sample.iter().all(|v| v.is_finite())
}

/// The mean of each pixel's finite samples, of which `of_pixel` lie one after the other, once or several times.
fn means<'s>(samples: impl Iterator<Item = &'s [f32; 4]>, pixels: usize, of_pixel: usize) -> Vec<DVec4> {
    let mut sums = vec![(DVec4::ZERO, 0.0); pixels];
    for (i, sample) in samples.enumerate().filter(|(_, sample)| finite(sample)) {
        let (sum, kept) = &mut sums[i / of_pixel % pixels];
        *sum += DVec4::from_array(sample.map(f64::from));
        *kept += 1.0;
    }
    sums.into_iter().map(|(sum, kept)| if kept > 0.0 { sum / kept } else { DVec4::ZERO }).collect()
}

/// The largest relative error of any component of any pixel. Tests allow 1e-6, a few roundings of f32: compensated sums
/// add none of their own.
fn error(got: &[DVec4], expected: &[DVec4]) -> f64 {
    assert_eq!(got.len(), expected.len());
    let relative = |(g, e): (&DVec4, &DVec4)| {
        ((g - e).abs() / e.abs().max(DVec4::splat(f64::MIN_POSITIVE))).to_array().into_iter().fold(0.0, nan_max)
    };
    got.iter().zip(expected).map(relative).fold(0.0, nan_max)
}

/// The larger number, or NaN if either is NaN.
fn nan_max(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

/// 65,536 samples for each pixel lose no precision. A thousandth of them are a thousand times as bright, and the first
/// is a firefly in which an uncompensated sum would lose all others.
#[kernel_test("PENUMBRA_DEVICE")]
fn sums_of_65536_samples_lose_nothing(gpu: &Gpu) {
    // Over two workgroups.
    const PIXELS: usize = 65;
    const BATCHES: usize = 16;
    const SAMPLES: usize = 4096;
    let mut random = Random(11);
    let mut batches: Vec<Samples> = Vec::new();
    for batch in 0..BATCHES {
        let sample = |i: usize| {
            let first = batch == 0 && i.is_multiple_of(SAMPLES);
            let dim = random.uniform();
            let rare = if random.uniform() < 1e-3 { 1e3 } else { 1.0 };
            let broad = 10f64.powf(8.0 * random.uniform() - 4.0);
            [if first { 1e6 } else { 0.02 * dim } as f32, (dim * rare) as f32, broad as f32, 1.0]
        };
        batches.push((0..PIXELS * SAMPLES).map(sample).collect());
    }
    let samples = gpu.upload("test/samples", &batches[0]).unwrap();
    let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
    let plane = film(gpu).plane(gpu, PIXELS as u32, &samples, inputs(&counters)).unwrap();
    for batch in &batches {
        gpu.write(&samples, batch);
        add(gpu, &plane, &tile(PIXELS as u32, SAMPLES as u32), 0);
    }
    let got = plane.means(gpu, &|_| (BATCHES * SAMPLES) as u32).unwrap();
    let expected = means(batches.iter().flatten(), PIXELS, SAMPLES);
    // The relative error of a compensated sum of n numbers of one sign is at most 2^-24 + n 2^-48.
    let found = error(&got, &expected);
    assert!(found <= 1e-6, "relative error {found}");
    assert_eq!(gpu.read::<u32>(&counters, Counter::COUNT).unwrap(), [0; Counter::COUNT]);

    // The comparison must catch uncompensated sums, and a single sample that is left out.
    let mut plain = vec![[0f32; 4]; PIXELS];
    for (i, sample) in batches.iter().flatten().enumerate() {
        plain[i / SAMPLES % PIXELS].iter_mut().zip(sample).for_each(|(sum, x)| *sum += x);
    }
    let count = (BATCHES * SAMPLES) as f64;
    let plain: Vec<DVec4> = plain.iter().map(|sum| DVec4::from_array(sum.map(f64::from)) / count).collect();
    assert!(error(&plain, &expected) > 1e-4, "these samples need no compensation");
    batches[7][100] = [0.0; 4];
    assert!(error(&got, &means(batches.iter().flatten(), PIXELS, SAMPLES)) > 1e-6, "a lost sample is not found");
}

/// Samples with a NaN or an infinity in any component are left out completely and counted once. Other samples are not
/// affected, also at the edges of workgroups and beyond 65,535 workgroups.
#[kernel_test("PENUMBRA_DEVICE")]
fn samples_that_are_not_finite_are_left_out_and_counted(gpu: &Gpu) {
    let film = film(gpu);
    let mut random = Random(5);
    // A quiet, a signalling and a negative NaN, and both infinities.
    let bad = [0x7fc0_0000, 0x7f80_0001, 0xffff_ffff, 0x7f80_0000, 0xff80_0000].map(f32::from_bits);
    for (pixels, count) in [(1usize, 40usize), (63, 7), (64, 1), (65, 12), (65_535 * 64 + 65, 1)] {
        let mut samples: Samples =
            (0..pixels * count).map(|_| [random.uniform() as f32, -2.5, random.uniform() as f32 * 1e30, 1.0]).collect();
        // Every third sample is invalid, and all those of one pixel.
        let invalid: Vec<usize> =
            (0..samples.len()).filter(|i| i % 3 == 1 || (i / count == pixels / 2 && pixels > 1)).collect();
        for (k, i) in invalid.iter().enumerate() {
            samples[*i][k % 4] = bad[k / 4 % bad.len()];
        }
        let buffer = gpu.upload("test/samples", &samples).unwrap();
        let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
        let plane = film.plane(gpu, pixels as u32, &buffer, inputs(&counters)).unwrap();
        add(gpu, &plane, &tile(pixels as u32, count as u32), 0);
        let got = plane.means(gpu, &|_| count as u32).unwrap();
        let found = error(&got, &means(samples.iter(), pixels, count));
        assert!(found <= 1e-6, "{pixels} pixels: relative error {found}");
        let mut expected = [0u32; Counter::COUNT];
        expected[Counter::NotFinite as usize] = invalid.len() as u32;
        assert_eq!(gpu.read::<u32>(&counters, Counter::COUNT).unwrap(), expected, "{pixels} pixels");
        samples[invalid[0]] = [0.5; 4];
        assert!(error(&got, &means(samples.iter(), pixels, count)) > 1e-6, "a sample that was left out is not missed");
    }
}

/// Only the samples from `first_point` on are summed; all samples around them are NaNs.
#[kernel_test("PENUMBRA_DEVICE")]
fn the_samples_of_one_light_are_found_among_many(gpu: &Gpu) {
    const PIXELS: u32 = 65;
    const SAMPLES: u32 = 3;
    let mut random = Random(6);
    let tile = tile(PIXELS, SAMPLES);
    for first_point in [0, 1, tile.point_count, 4 * tile.point_count] {
        let mut samples = vec![[f32::NAN; 4]; 5 * tile.point_count as usize];
        let own = first_point as usize..(first_point + tile.point_count) as usize;
        samples[own.clone()].fill_with(|| [(); 4].map(|()| random.uniform() as f32));
        let buffer = gpu.upload("test/samples", &samples).unwrap();
        let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
        let plane = film(gpu).plane(gpu, PIXELS, &buffer, inputs(&counters)).unwrap();
        add(gpu, &plane, &tile, first_point);
        let got = plane.means(gpu, &|_| SAMPLES).unwrap();
        let expected = |own: std::ops::Range<usize>| means(samples[own].iter(), PIXELS as usize, SAMPLES as usize);
        assert!(error(&got, &expected(own.clone())) <= 1e-6, "from {first_point}");
        assert_eq!(gpu.read::<u32>(&counters, Counter::COUNT).unwrap(), [0; Counter::COUNT], "from {first_point}");
        let moved = if own.start > 0 { own.start - 1..own.end - 1 } else { own.start + 1..own.end + 1 };
        assert!(error(&got, &expected(moved)) > 1e-6, "an offset of one point is not found");
    }
}

/// A plane that took over the sums of another keeps them while samples are added to that one.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_snapshot_keeps_the_sums_so_far(gpu: &Gpu) {
    let film = film(gpu);
    let mut random = Random(9);
    for (pixels, count) in [(1usize, 2usize), (63, 4), (65, 8)] {
        let mut samples: Samples = (0..pixels * count).map(|_| [(); 4].map(|()| random.uniform() as f32)).collect();
        samples[pixels - 1][2] = f32::NAN;
        let buffer = gpu.upload("test/samples", &samples).unwrap();
        let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
        let sums = film.plane(gpu, pixels as u32, &buffer, inputs(&counters)).unwrap();
        let snapshot = film.snapshot(gpu, &sums, inputs(&counters)).unwrap();
        let half = tile(pixels as u32, count as u32 / 2);
        add(gpu, &sums, &half, 0);
        let mut frame = gpu.frame("test");
        snapshot.record(&mut frame, &half);
        frame.submit().unwrap();
        add(gpu, &sums, &half, half.point_count);
        // Each half has the samples of all pixels.
        let first = means(samples[..samples.len() / 2].iter(), pixels, count / 2);
        let all = means(samples.iter(), pixels, count / 2);
        assert!(error(&snapshot.means(gpu, &|_| count as u32 / 2).unwrap(), &first) <= 1e-6, "{pixels} pixels");
        assert!(error(&sums.means(gpu, &|_| count as u32).unwrap(), &all) <= 1e-6, "{pixels} pixels");
        assert!(error(&all, &first) > 1e-6, "the halves are not told apart");
    }
}

/// Only the listed pixels get samples, squares and snapshots; all others keep their words. A list in another order
/// gives other sums.
#[kernel_test("PENUMBRA_DEVICE")]
fn only_listed_pixels_get_samples(gpu: &Gpu) {
    const PIXELS: usize = 300;
    const SAMPLES: usize = 3;
    let film = Film::new(gpu, &device_features(gpu).with(Feature::AdaptiveSampling, true)).unwrap();
    let mut random = Random(10);
    for listed in [1usize, 63, 64, 65, 200] {
        // Every 7th pixel, and so on round: 300 and 7 have no common factor, so no pixel comes twice.
        let list: Vec<u32> = (0..listed).map(|i| (i * 7 % PIXELS) as u32).collect();
        let samples: Samples =
            (0..listed * SAMPLES).map(|_| [(); 4].map(|()| (0.5 + random.uniform()) as f32)).collect();
        let buffer = gpu.upload("test/samples", &samples).unwrap();
        let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
        let listed_pixels = gpu.upload("test/list", &list).unwrap();
        let inputs = Inputs { counters: &counters, sampled_pixels: Some(&listed_pixels) };
        let zero = gpu.buffer::<[f32; 4]>("test/zero", 1).unwrap();
        let sums = film.plane(gpu, PIXELS as u32, &buffer, inputs).unwrap();
        let squares = film.plane_of_squares(gpu, PIXELS as u32, [&buffer, &zero], inputs).unwrap();
        let snapshot = film.snapshot(gpu, &sums, inputs).unwrap();
        // What the other pixels had, in whichever words.
        const OLD: f32 = 1e3;
        let old = vec![OLD.to_bits(); sums.state_words()];
        let empty = |words: &mut [u32]| {
            for pixel in &list {
                for half in [0, words.len() / 2] {
                    let first = half + 4 * *pixel as usize;
                    words[first..first + 4].fill(0);
                }
            }
        };
        let mut start = old.clone();
        empty(&mut start);
        for plane in [&sums, &squares] {
            plane.restore(gpu, &start);
        }
        snapshot.restore(gpu, &old);
        let mut frame = gpu.frame("test");
        for plane in [&sums, &squares, &snapshot] {
            plane.record(&mut frame, &tile(listed as u32, SAMPLES as u32));
        }
        frame.submit().unwrap();
        let expected = means(samples.iter(), listed, SAMPLES);
        let of_squares: Samples = samples.iter().map(|sample| sample.map(|x| x * x)).collect();
        let of_squares = means(of_squares.iter(), listed, SAMPLES);
        for (plane, expected) in [(&sums, &expected), (&squares, &of_squares), (&snapshot, &expected)] {
            let mut state = plane.state(gpu).unwrap();
            let found = Plane::sums_of(&state, &|_| SAMPLES as u32);
            let found: Vec<DVec4> = list.iter().map(|pixel| found[*pixel as usize].mean()).collect();
            // As above: compensated sums of three values.
            assert!(error(&found, expected) <= 1e-6, "{listed} pixels");
            let mut planted = found.clone();
            planted.rotate_left(1);
            assert!(listed == 1 || error(&planted, expected) > 1e-6, "another order is not noticed");
            empty(&mut state);
            assert_eq!(state, start, "{listed} pixels: others have changed");
        }
    }
}

/// Sums squares of the sum of two parts; the second has as many vectors as the first, or one. A square that overflows
/// is left out and counted as such. A sample that is not finite is only left out: `accumulate` counts it.
#[kernel_test("PENUMBRA_DEVICE")]
fn squares_are_of_the_whole(gpu: &Gpu) {
    const PIXELS: usize = 65;
    const SAMPLES: usize = 9;
    let mut random = Random(8);
    let mut part = |count: usize| -> Samples {
        (0..count).map(|_| [(); 4].map(|()| (random.uniform() * 2.0 - 0.5) as f32)).collect()
    };
    let mut first = part(PIXELS * SAMPLES);
    first[3][1] = 1e30;
    first[PIXELS + 5][0] = f32::NAN;
    for other in [part(PIXELS * SAMPLES), vec![[0.25; 4]]] {
        let [a, b] = [&first, &other].map(|part| gpu.upload("test/part", part).unwrap());
        let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
        let plane = film(gpu).plane_of_squares(gpu, PIXELS as u32, [&a, &b], inputs(&counters)).unwrap();
        add(gpu, &plane, &tile(PIXELS as u32, SAMPLES as u32), 0);
        let got = plane.means(gpu, &|_| SAMPLES as u32).unwrap();
        let squares = |other: &[[f32; 4]]| {
            let square = |(i, x): (usize, &[f32; 4])| {
                let y = other[i % other.len()];
                [0, 1, 2, 3].map(|c| ((f64::from(x[c]) + f64::from(y[c])).powi(2)) as f32)
            };
            means(first.iter().enumerate().map(square).collect::<Samples>().iter(), PIXELS, SAMPLES)
        };
        // The sum, its square and the total are each rounded.
        let found = error(&got, &squares(&other));
        assert!(found <= 1e-6, "relative error {found}");
        let mut expected = [0u32; Counter::COUNT];
        expected[Counter::NearOverflow as usize] = 1;
        assert_eq!(gpu.read::<u32>(&counters, Counter::COUNT).unwrap(), expected);
        assert!(error(&got, &squares(&[[0.0; 4]])) > 1e-3, "a part that is left out is not found");
    }
}

/// A square with which the sum would exceed the largest number is left out and counted: the mean is that of the others.
#[kernel_test("PENUMBRA_DEVICE")]
fn sums_of_squares_stay_finite(gpu: &Gpu) {
    // Its square is 0.73 of the largest number.
    let bright = 2f32.powi(63) * 1.7;
    let samples = vec![[bright; 4], [bright; 4], [bright; 4], [1.0; 4], [1.0; 4], [1.0; 4]];
    let part = gpu.upload("test/part", &samples).unwrap();
    let none = gpu.upload("test/none", &[[0f32; 4]]).unwrap();
    let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
    let plane = film(gpu).plane_of_squares(gpu, 2, [&part, &none], inputs(&counters)).unwrap();
    add(gpu, &plane, &tile(2, 3), 0);
    let got = plane.means(gpu, &|_| 3).unwrap();
    let expected = [DVec4::splat(f64::from(bright).powi(2)), DVec4::ONE];
    assert!(error(&got, &expected) <= 1e-6, "{got:?}");
    let mut counts = [0u32; Counter::COUNT];
    counts[Counter::NearOverflow as usize] = 2;
    assert_eq!(gpu.read::<u32>(&counters, Counter::COUNT).unwrap(), counts);
}

/// Counts pixels whose sum is beyond 2^104 in any component, of either sign, once for each batch that leaves them
/// there.
#[kernel_test("PENUMBRA_DEVICE")]
fn sums_near_overflow_are_counted(gpu: &Gpu) {
    const PIXELS: usize = 130;
    let limit = 2f32.powi(104);
    let mut samples = vec![[1.0f32; 4]; PIXELS];
    for (pixel, value) in [(3, 0.4 * limit), (64, -0.6 * limit), (65, 0.6 * limit), (129, 1.1 * limit)] {
        samples[pixel][pixel % 3] = value;
    }
    let buffer = gpu.upload("test/samples", &samples).unwrap();
    let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
    let plane = film(gpu).plane(gpu, PIXELS as u32, &buffer, inputs(&counters)).unwrap();
    // Pixels above the limit: after the first batch 129; after the second 64, 65 and 129, while pixel 3 is at 0.8 of
    // it; after the third all four.
    for expected in [1, 1 + 3, 1 + 3 + 4] {
        add(gpu, &plane, &tile(PIXELS as u32, 1), 0);
        let mut counts = [0u32; Counter::COUNT];
        counts[Counter::NearOverflow as usize] = expected;
        assert_eq!(gpu.read::<u32>(&counters, Counter::COUNT).unwrap(), counts);
    }
}

/// Samples that change have the sums, and the squares of two parts, of samples that were so from the beginning; at the
/// edges of workgroups, with samples that were left out, and with changes that are not finite, which change nothing.
#[kernel_test("PENUMBRA_DEVICE")]
fn changed_samples_are_as_if_they_had_been_so(gpu: &Gpu) {
    let film = film(gpu);
    let mut random = Random(17);
    const SAMPLES: usize = 7;
    for pixels in [1usize, 63, 64, 65, 300] {
        let mut sample = || -> [f32; 4] { std::array::from_fn(|_| random.uniform() as f32) };
        let mut direct: Samples = (0..pixels * SAMPLES).map(|_| sample()).collect();
        let mut indirect: Samples = (0..pixels * SAMPLES).map(|_| sample()).collect();
        let mut change: Samples = (0..pixels).map(|_| sample().map(|x| x - 0.5)).collect();
        change[pixels / 2][1] = f32::NAN;
        // Both parts, as the squares of a sample are left out with it.
        (direct[0][0], indirect[0][0]) = (f32::INFINITY, f32::INFINITY);
        let upload = |samples: &Samples| gpu.upload("test/samples", samples).unwrap();
        let (of_direct, of_indirect, of_change) = (upload(&direct), upload(&indirect), upload(&change));
        let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
        let inputs = inputs(&counters);
        let plane = |samples: &Buffer| film.plane(gpu, pixels as u32, samples, inputs).unwrap();
        let (direct_sums, sums) = (plane(&of_direct), plane(&of_indirect));
        let parts = [&of_direct, &of_indirect];
        let squares = film.plane_of_squares(gpu, pixels as u32, parts, inputs).unwrap();
        for plane in [&direct_sums, &sums, &squares] {
            add(gpu, plane, &tile(pixels as u32, SAMPLES as u32), 0);
        }
        let earlier_samples = SAMPLES as u32;
        let changes = Change { change: &of_change, pixel_count: pixels as u32, earlier_samples, inputs };
        let mut frame = gpu.frame("test");
        film.correct_squares(gpu, &mut frame, &squares, &[&direct_sums, &sums], &changes).unwrap();
        film.correct(gpu, &mut frame, &sums, &changes).unwrap();
        frame.submit().unwrap();

        let changed = |by: f32| -> Samples {
            let with = |(i, x): (usize, &[f32; 4])| {
                let change = change[i / SAMPLES];
                let change = if finite(&change) { change.map(|c| by * c) } else { [0.0; 4] };
                std::array::from_fn(|c| x[c] + change[c])
            };
            indirect.iter().enumerate().map(with).collect()
        };
        let square = |indirect: &Samples| -> Samples {
            let whole = |(d, i): (&[f32; 4], &[f32; 4])| std::array::from_fn(|c| (d[c] + i[c]) * (d[c] + i[c]));
            direct.iter().zip(indirect).map(whole).collect()
        };
        let got = [&sums, &squares].map(|plane| plane.means(gpu, &|_| SAMPLES as u32).unwrap());
        // Sums of some samples of about 1 in f32, of which changes may take nearly all. w has no compensation.
        let largest = |by: f32| {
            let expected =
                [means(changed(by).iter(), pixels, SAMPLES), means(square(&changed(by)).iter(), pixels, SAMPLES)];
            let off = |(g, e): (&DVec4, &DVec4)| (*g - *e).abs().max_element();
            got.iter().zip(&expected).map(|(g, e)| g.iter().zip(e).map(off).fold(0.0, nan_max)).fold(0.0, nan_max)
        };
        assert!(largest(1.0) < 2e-6, "{pixels} pixels: {}", largest(1.0));
        if pixels > 2 {
            assert!(largest(0.9) > 1e-2 && largest(0.0) > 1e-2, "changes make no difference: the test proves nothing");
        }
    }
}
