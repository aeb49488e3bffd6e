//! Error measures of an image against a reference, by the field's usual definitions.
//!
//! All measures use the root channels `R`, `G` and `B`. Their errors are [`Error::Input`] with the file name `image` or
//! `reference`, which callers replace by the path, and the channel at fault as the position.

use nv_flip::{DEFAULT_PIXELS_PER_DEGREE, FlipImageFloat, FlipImageRgb8};
use serde::Serialize;

use crate::render::film::{Image, View};
use crate::{Error, Result};

/// Added to r^2 in relMSE so that black pixels do not dominate it (Rousselle et al. 2011).
pub(super) use crate::render::denoise::RELMSE_FLOOR;

/// All error measures of an image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// See [`rmse`].
    pub rmse: f64,
    /// See [`relmse`].
    pub relmse: f64,
    /// See [`mae`].
    pub mae: f64,
    /// See [`p99`].
    pub p99: f64,
    /// See [`flip`].
    pub flip: f64,
}

impl Measures {
    /// Computes all measures of `image`.
    ///
    /// # Errors
    /// As [`rmse`].
    pub fn new(image: &Image, reference: &Image) -> Result<Measures> {
        Ok(Measures {
            rmse: rmse(image, reference)?,
            relmse: relmse(image, reference)?,
            mae: mae(image, reference)?,
            p99: p99(image, reference)?,
            flip: flip(image, reference)?,
        })
    }
}

/// Square root of the mean of (x - r)^2 over pixels and channels of linear radiance.
///
/// # Errors
/// Different sizes, no pixels, a missing channel, a sample that is not finite.
pub fn rmse(image: &Image, reference: &Image) -> Result<f64> {
    mean(image, reference, |x, r| (x - r) * (x - r)).map(f64::sqrt)
}

/// Mean of (x - r)^2 / (r^2 + 0.01) over pixels and channels of linear radiance (Rousselle et al. 2011).
///
/// # Errors
/// As [`rmse`].
pub fn relmse(image: &Image, reference: &Image) -> Result<f64> {
    mean(image, reference, |x, r| (x - r) * (x - r) / (r * r + RELMSE_FLOOR))
}

/// The expected [`relmse`] between an image with the channels `variance.R` and so on and the same image without noise:
/// the mean of variance / (r^2 + 0.01) over pixels and channels.
///
/// # Errors
/// A missing channel, under the name `reference`.
pub(super) fn relmse_of_noise(reference: &Image) -> Result<f64> {
    mean_with_variance(reference, |r, variance| variance / (r * r + RELMSE_FLOOR))
}

/// The mean of f(value, variance) over pixels and channels.
///
/// # Errors
/// As [`relmse_of_noise`].
pub(super) fn mean_with_variance(reference: &Image, f: impl Fn(f64, f64) -> f64) -> Result<f64> {
    let channel = |name: &str| reference.channel(name).ok_or_else(|| missing("reference", name));
    let mut sum = 0.0;
    for name in ["R", "G", "B"] {
        let pairs = channel(name)?.iter().zip(channel(&variance(name))?);
        sum += pairs.map(|(r, variance)| f(f64::from(*r), f64::from(*variance))).sum::<f64>();
    }
    Ok(sum / (3 * reference.pixels()) as f64)
}

/// Mean of |x - r| over pixels and channels of linear radiance.
///
/// # Errors
/// As [`rmse`].
pub fn mae(image: &Image, reference: &Image) -> Result<f64> {
    mean(image, reference, |x, r| (x - r).abs())
}

/// 99th percentile of |x - r| over pixels and channels of linear radiance: the smallest difference that 99 % of them do
/// not exceed.
///
/// # Errors
/// As [`rmse`].
pub fn p99(image: &Image, reference: &Image) -> Result<f64> {
    let pairs = check(image, reference)?;
    let difference = |(x, r): (&f32, &f32)| (f64::from(*x) - f64::from(*r)).abs();
    let mut all: Vec<f64> = pairs.iter().flat_map(|(x, r)| x.iter().zip(*r).map(difference)).collect();
    let rank = (all.len() * 99).div_ceil(100) - 1;
    Ok(*all.select_nth_unstable_by(rank, f64::total_cmp).1)
}

/// Mean LDR-FLIP (Andersson et al. 2020), from 0 (identical) to 1.
///
/// Both images are converted to 8-bit sRGB by the [neutral view](View::Neutral) at exposure 0, without alpha. The
/// viewing distance is the authors' 67 pixels per degree. The crate `nv-flip` binds the authors' own code.
///
/// # Errors
/// As [`rmse`].
pub fn flip(image: &Image, reference: &Image) -> Result<f64> {
    check(image, reference)?;
    let size = [image.width, image.height];
    let (mean, _) = flip_of(size, &display("image", image)?, &display("reference", reference)?);
    Ok(mean)
}

/// The colours of an image as [`flip`] compares them, three bytes a pixel; `name` is for errors.
pub(super) fn display(name: &str, image: &Image) -> Result<Vec<u8>> {
    image.colour().display(View::Neutral, 0.0).map_err(|channel| missing(name, channel))
}

/// The mean of FLIP between an image and a reference, given by their colours ([`display`]), and the map of all pixels.
pub(super) fn flip_of([width, height]: [u32; 2], image: &[u8], reference: &[u8]) -> (f64, FlipImageFloat) {
    let of = |bytes: &[u8]| FlipImageRgb8::with_data(width, height, bytes);
    let map = nv_flip::flip(of(reference), of(image), DEFAULT_PIXELS_PER_DEGREE);
    let errors = map.to_vec();
    (errors.iter().copied().map(f64::from).sum::<f64>() / errors.len() as f64, map)
}

/// Mean of `error(x, r)` over pixels and channels.
fn mean(image: &Image, reference: &Image, error: impl Fn(f64, f64) -> f64) -> Result<f64> {
    let pairs = check(image, reference)?;
    // Partial sums of 4096 samples keep the precision of the sum over a large image.
    let sum = |(x, r): &(&[f32], &[f32])| -> f64 {
        let part = |(x, r): (&[f32], &[f32])| -> f64 {
            x.iter().zip(r).map(|(&x, &r)| error(f64::from(x), f64::from(r))).sum()
        };
        x.chunks(4096).zip(r.chunks(4096)).map(part).sum()
    };
    Ok(pairs.iter().map(sum).sum::<f64>() / (3 * image.pixels()) as f64)
}

/// The colour channels of both images in pairs, checked to have the same size and finite samples.
fn check<'a>(image: &'a Image, reference: &'a Image) -> Result<[(&'a [f32], &'a [f32]); 3]> {
    let size = |image: &Image| format!("{} x {}", image.width, image.height);
    if (image.width, image.height) != (reference.width, reference.height) {
        let crops =
            if image.crop == reference.crop { "" } else { "; a part of an image needs a reference of that part" };
        let problem = format!("its size is {} pixels, that of the reference {}{crops}", size(image), size(reference));
        return Err(Error::input("image", "file", problem));
    }
    if image.crop.zip(reference.crop).is_some_and(|(a, b)| a != b) {
        return Err(Error::input("image", "file", "it shows another part of the image than the reference"));
    }
    if image.pixels() == 0 {
        return Err(Error::input("image", "file", "it has no pixels"));
    }
    let [x, r] = [("image", image), ("reference", reference)].map(|(name, image)| {
        let channels = image.rgb().map_err(|channel| missing(name, channel))?;
        for (samples, channel) in channels.iter().zip(["R", "G", "B"]) {
            if let Some(i) = samples.iter().position(|x| !x.is_finite()) {
                let (column, row) = (i % image.width as usize, i / image.width as usize);
                let problem = format!("pixel ({column}, {row}) is {}", samples[i]);
                return Err(Error::input(name, channel, problem));
            }
        }
        Ok(channels)
    });
    let (x, r) = (x?, r?);
    Ok([(x[0], r[0]), (x[1], r[1]), (x[2], r[2])])
}

fn missing(name: &str, channel: &str) -> Error {
    Error::input(name, channel, "there is no such channel")
}

/// The names and samples of the colour channels that an image has.
pub(super) fn channels(image: &Image) -> impl Iterator<Item = (&'static str, &[f32])> {
    ["R", "G", "B"].into_iter().filter_map(|name| Some((name, image.channel(name)?)))
}

/// The name of the channel with the variance of another.
pub(super) fn variance(channel: &str) -> String {
    format!("variance.{channel}")
}
