//! Denoising of sums of samples, which are those of a render or of merged pieces: the input of denoisers, and the
//! channels of their output.

use glam::{DVec3, DVec4};
use kernel_kit::Gpu;
use rayon::prelude::*;

use super::denoise::chance::{Seen, settled};
use super::denoise::mixture::of_regions;
use super::denoise::{Colour, Component, Denoised, Denoiser, Guides, Light, Noisy, RELMSE_FLOOR, relative};
use super::picture::{Quantity, Sums, behind, colour_of, means};
use super::tiles::first_half;
use crate::passes::film::{Sum, variance_of_mean};
use crate::settings::Background;
use crate::{Image, Result};

/// Adds what denoisers make of sums of samples to their image.
pub(super) fn add_denoised(
    image: &mut Image,
    denoiser: &Denoiser,
    gpu: &Gpu,
    sums: &dyn Sums,
    size: [u32; 2],
    background: Background,
) -> Result<()> {
    let mut noisy = noisy(sums, size)?;
    if denoiser.is_quick {
        noisy.halves = None;
    }
    let Some(mut denoised) = denoiser.denoise(gpu, &noisy)? else { return Ok(()) };
    if let (Some(errors), Some(shared)) = (&mut denoised.error, sums.shared_errors()) {
        add_shared(errors, &denoised.colour, shared, &noisy);
    }
    add_background(&mut denoised, sums, background)?;
    if let Some(errors) = &denoised.error {
        push_errors(image, &denoised.colour, errors);
    }
    for (c, name) in ["denoised.R", "denoised.G", "denoised.B"].into_iter().enumerate() {
        image.add_channel(name, denoised.colour.iter().map(|colour| colour[c]).collect());
    }
    Ok(())
}

/// Adds the part of a background's colour that is seen in each pixel to a denoised image, and the error of that part to
/// its errors.
pub(super) fn add_background(denoised: &mut Denoised, sums: &dyn Sums, background: Background) -> Result<()> {
    let Some(background) = colour_of(background) else { return Ok(()) };
    let direct = sums.sums(Quantity::Direct)?.unwrap_or_default();
    for (colour, sum) in denoised.colour.iter_mut().zip(&direct) {
        let behind = behind(background, sum);
        *colour = [0, 1, 2].map(|c| colour[c] + behind[c] as f32);
    }
    if let Some(errors) = &mut denoised.error {
        let means: Vec<DVec4> = direct.iter().map(Sum::mean).collect();
        for (error, variance) in errors.iter_mut().zip(coverage_variances(sums, &means)?) {
            *error = [0, 1, 2].map(|c| f64::from(error[c]).hypot(background[c] * variance.sqrt()) as f32);
        }
    }
    Ok(())
}

/// Adds errors that all samples share, which their halves do not show, to the estimated `errors`: the relMSE `shared`
/// of the pixels, as a mean over regions. No denoiser removes them. Pixels without any, such as those of a lamp, have
/// none; but near the others a change by chance is 0 along lines, where the error is as large as around them.
fn add_shared(errors: &mut [Colour], colours: &[Colour], shared: &[f32], noisy: &Noisy) {
    let means = |value: &dyn Fn(&f32) -> f64| of_regions(&shared.iter().map(value).collect::<Vec<_>>(), noisy.size);
    let (sums, counts) = (means(&|error| f64::from(*error)), means(&|error| f64::from(u8::from(*error > 0.0))));
    for (i, error) in errors.iter_mut().enumerate().filter(|(i, _)| shared[*i] > 0.0 && !noisy.is_clean[*i]) {
        let square = |c: usize| sums[i] / counts[i] * (f64::from(colours[i][c]).powi(2) + RELMSE_FLOOR);
        *error = [0, 1, 2].map(|c| f64::from(error[c]).hypot(square(c).sqrt()) as f32);
    }
}

/// Adds the channels of the estimated errors of a denoised image, which looks like `colours`.
fn push_errors(image: &mut Image, colours: &[Colour], errors: &[Colour]) {
    let square = |error: &Colour, c: usize| f64::from(error[c]).powi(2);
    let mean_square = |error| (0..3).map(|c| square(error, c)).sum::<f64>() / 3.0;
    image.add_channel("error", errors.iter().map(|error| mean_square(error).sqrt() as f32).collect());
    let pixel = |(colour, error): (&Colour, _)| relative(colour, |c| square(error, c)).sqrt() as f32;
    image.add_channel("relative_error", colours.iter().zip(errors).map(pixel).collect());
}

/// The input of denoisers for an image of `size`.
pub(super) fn noisy(sums: &dyn Sums, size: [u32; 2]) -> Result<Noisy> {
    let [albedo, normal, position] = [Quantity::GuideAlbedo, Quantity::GuideNormal, Quantity::GuidePosition]
        .map(|quantity| means(sums, quantity).map(Option::unwrap_or_default));
    let (albedo, normal, position) = (albedo?, normal?, position?);
    let guides = guides_of(size, [&albedo, &normal, &position]);

    let samples = |pixel: usize| sums.samples_of(pixel);
    let (mut all, mut halves, mut coverage) = (Vec::new(), [Vec::new(), Vec::new()], Vec::new());
    let lights = [(Quantity::Direct, Quantity::DirectSquares), (Quantity::Indirect, Quantity::IndirectSquares)];
    for (light, squares) in lights {
        let Some(whole) = sums.sums(light)? else { continue };
        if light == Quantity::Direct {
            coverage = whole.par_iter().map(|sum| sum.mean().w).collect();
        }
        let squares = sums.sums(squares)?;
        if let Some(first) = sums.first_halves(light)? {
            // A pixel without samples in one half does not show its error: it counts as exact.
            let mean = |half: Sum, whole: &Sum| if half.kept > 0.0 { half.mean() } else { whole.mean() };
            let both = first.par_iter().zip(&whole);
            let second = both.clone().map(|(first, whole)| colour(&mean(whole.without(first), whole)));
            halves[1].push(second.collect());
            halves[0].push(both.map(|(first, whole)| colour(&mean(*first, whole))).collect());
        }
        let variance = |(squares, sum): (&Sum, &Sum)| colour(&variance_of_mean(sum.mean(), squares.mean(), sum.kept));
        let variance = squares.map(|squares| squares.par_iter().zip(&whole).map(variance).collect());
        let mean = whole.par_iter().map(|sum| colour(&sum.mean())).collect();
        all.push(Component { mean, variance: variance.unwrap_or_else(|| vec![[0.0; 3]; whole.len()]) });
    }
    let [width, height] = size.map(|side| side as usize);
    // Filters take one number of samples: with adaptive sampling, that of the pixels with the fewest.
    let fewest = (0..width * height).map(samples).min().unwrap_or(0);
    let in_half = if fewest > 1 { first_half(fewest) } else { fewest };
    let half_samples = [in_half, fewest - in_half];
    let factor = |of: usize, pixel: usize| {
        let first = f64::from(first_half(samples(pixel))) / f64::from(samples(pixel));
        (1.0 / if of == 0 { first } else { 1.0 - first }) as f32
    };
    let half = |of: usize, means: Vec<Vec<Colour>>| Light {
        components: half_components(means, &all, &|pixel| factor(of, pixel)),
    };
    let [first, second] = halves;
    let halves = (!first.is_empty()).then(|| [half(0, first), half(1, second)]);
    let is_clean = clean(&coverage, sums.has_lens(), &albedo, &position);
    Ok(Noisy { size, all: Light { components: all }, halves, half_samples, guides, is_clean })
}

/// The variance of each pixel's coverage, w of `means`. Samples are stratified, so it is less than that of independent
/// zeros and ones: by a factor that the halves of all samples show, over all pixels together.
fn coverage_variances(sums: &dyn Sums, means: &[DVec4]) -> Result<Vec<f64>> {
    let independent =
        |(pixel, mean): (usize, &DVec4)| mean.w * (1.0 - mean.w) / (f64::from(sums.samples_of(pixel)) - 1.0).max(1.0);
    let variances: Vec<f64> = means.iter().enumerate().map(independent).collect();
    let all: f64 = variances.iter().sum();
    let (Some(first), Some(whole)) = (sums.first_halves(Quantity::Direct)?, sums.sums(Quantity::Direct)?) else {
        return Ok(variances);
    };
    let between = |(pixel, (first, whole)): (usize, (&Sum, &Sum))| {
        let second = whole.without(first);
        if first.kept == 0.0 || second.kept == 0.0 {
            return 0.0;
        }
        // Of halves of equal size, a quarter of the squared difference is the variance of the mean.
        let share = f64::from(first_half(sums.samples_of(pixel))) / f64::from(sums.samples_of(pixel));
        (first.mean().w - second.mean().w).powi(2) * share * (1.0 - share)
    };
    let between: f64 = first.iter().zip(&whole).enumerate().map(between).sum();
    let factor = if all > 0.0 { between / all } else { 1.0 };
    Ok(variances.into_iter().map(|variance| factor * variance).collect())
}

/// Pixels whose samples show nothing, or the environment alone. Those of the second kind have no surface and no random
/// choice (w of `albedo`), and the camera has no lens.
fn clean(coverage: &[f64], has_lens: bool, albedo: &[DVec4], position: &[DVec4]) -> Vec<bool> {
    let is_clean = |(i, coverage): (usize, &f64)| {
        let without_surface = || position.get(i).is_some_and(|p| p.w == 0.0) && albedo[i].w == 0.0;
        *coverage == 0.0 || !has_lens && without_surface()
    };
    coverage.iter().enumerate().map(is_clean).collect()
}

/// The guides by the means of what pass `primary` wrote.
fn guides_of(size: [u32; 2], [albedo, normal, position]: [&[DVec4]; 3]) -> Guides {
    // The mean over the samples that hit a surface; w is their share.
    let met = |p: DVec4| if p.w > 0.0 { p.truncate() / p.w } else { DVec3::ZERO };
    let seen = |i: usize| Seen {
        choosing: albedo[i].w,
        chosen: normal[i].w,
        guides: [albedo[i].truncate(), normal[i].truncate(), met(position[i])],
    };
    let pixel = |i: usize| {
        let [albedo, normal, position] = settled(size, &seen, i).map(|guide| guide.as_vec3().to_array());
        (albedo.map(|x| x.clamp(0.0, 1.0)), (normal, position))
    };
    let (albedo, (normal, position)) = (0..albedo.len()).into_par_iter().map(pixel).unzip();
    Guides { albedo, normal, position }
}

/// The components of one half of the samples. The variances of their means are those of all samples times `factor`.
fn half_components(means: Vec<Vec<Colour>>, all: &[Component], factor: &dyn Fn(usize) -> f32) -> Vec<Component> {
    let variance = |(pixel, variance): (usize, &Colour)| variance.map(|x| x * factor(pixel));
    let component = |(mean, all): (Vec<Colour>, &Component)| Component {
        mean,
        variance: all.variance.iter().enumerate().map(variance).collect(),
    };
    means.into_iter().zip(all).map(component).collect()
}

fn colour(value: &DVec4) -> Colour {
    value.truncate().as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::film::Channel;

    /// Pixels of three samples, which cover all combinations of hits and misses. The first half is one sample.
    struct Thirds;

    impl Thirds {
        fn pixels(counted: &[usize]) -> Vec<Sum> {
            let hits = |pixel: usize| counted.iter().filter(|sample| pixel >> **sample & 1 == 1).count() as f64;
            (0..8).map(|pixel| Sum { total: DVec4::W * hits(pixel), kept: counted.len() as f64 }).collect()
        }
    }

    impl Sums for Thirds {
        fn sums(&self, _: Quantity) -> Result<Option<Vec<Sum>>> {
            Ok(Some(Thirds::pixels(&[0, 1, 2])))
        }

        fn first_halves(&self, _: Quantity) -> Result<Option<Vec<Sum>>> {
            Ok(Some(Thirds::pixels(&[0])))
        }

        fn has_lens(&self) -> bool {
            false
        }

        fn samples_of(&self, _: usize) -> u32 {
            3
        }

        fn shared_errors(&self) -> Option<&[f32]> {
            None
        }

        fn push_class_channels(&self, _: &mut Vec<Channel>) -> Result<()> {
            Ok(())
        }
    }

    /// Of three independent samples, each a hit with probability 1/2, the mean has the variance 1/12. All eight
    /// combinations together have this mean estimate. A quarter of the squared difference of the unequal halves would
    /// be 9/8 of it.
    #[test]
    fn unequal_halves_show_the_variance_of_the_mean() {
        let means: Vec<DVec4> = Thirds::pixels(&[0, 1, 2]).iter().map(Sum::mean).collect();
        let variances = coverage_variances(&Thirds, &means).unwrap();
        let mean = variances.iter().sum::<f64>() / 8.0;
        assert!((mean * 12.0 - 1.0).abs() < 1e-12, "{mean}");
    }
}
