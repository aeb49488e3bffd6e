//! How far an image is from a reference, by the definitions of the field.
//!
//! All measures are over the root channels `R`, `G` and `B`. Their errors are [`Error::Input`] with the file `image` or
//! `reference` (callers that know the paths put them there) and the channel at fault as the place.

use serde::Serialize;

use crate::render::film::{Image, View};
use crate::{Error, Result};

/// What is added to r^2 in relMSE, so that black pixels do not decide it alone (Rousselle et al. 2011).
pub(super) const RELMSE_FLOOR: f64 = 0.01;

/// All measures of an image.
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
    /// Measures `image`.
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

/// Root of the mean of (x - r)^2 over pixels and channels of linear radiance.
///
/// # Errors
/// Sizes that differ, a missing channel, a sample that is not finite.
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

/// Mean of |x - r| over pixels and channels of linear radiance.
///
/// # Errors
/// As [`rmse`].
pub fn mae(image: &Image, reference: &Image) -> Result<f64> {
    mean(image, reference, |x, r| (x - r).abs())
}

/// 99th percentile of |x - r| over pixels and channels of linear radiance: the smallest that 99 % do not exceed.
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

/// Mean LDR-FLIP (Andersson et al. 2020), 0 (the same) to 1, of both images as 8-bit sRGB under the
/// [neutral view](View::Neutral) at exposure 0, alpha ignored, at the authors' 67 pixels per degree. Computed by the
/// authors' own code, which the crate `nv-flip` binds.
///
/// # Errors
/// As [`rmse`].
pub fn flip(image: &Image, reference: &Image) -> Result<f64> {
    check(image, reference)?;
    let display = |name: &str, image: &Image| {
        let mut colour = image.clone();
        colour.channels.retain(|channel| ["R", "G", "B"].contains(&channel.name.as_str()));
        let bytes = colour.display(View::Neutral, 0.0).map_err(|channel| missing(name, channel))?;
        Ok(nv_flip::FlipImageRgb8::with_data(image.width, image.height, &bytes))
    };
    let (reference, image) = (display("reference", reference)?, display("image", image)?);
    let map = nv_flip::flip(reference, image, nv_flip::DEFAULT_PIXELS_PER_DEGREE).to_vec();
    Ok(map.iter().map(|&error| f64::from(error)).sum::<f64>() / map.len() as f64)
}

/// Mean of `error(x, r)` over pixels and channels.
fn mean(image: &Image, reference: &Image, error: impl Fn(f64, f64) -> f64) -> Result<f64> {
    let pairs = check(image, reference)?;
    // Rows of few samples are summed apart, so that the sum of a large image keeps its digits.
    let sum = |(x, r): &(&[f32], &[f32])| -> f64 {
        let row = |(x, r): (&[f32], &[f32])| -> f64 {
            x.iter().zip(r).map(|(&x, &r)| error(f64::from(x), f64::from(r))).sum()
        };
        x.chunks(4096).zip(r.chunks(4096)).map(row).sum()
    };
    Ok(pairs.iter().map(sum).sum::<f64>() / (3 * image.pixels()) as f64)
}

/// The colour channels of both, as pairs of slices of one size.
fn check<'a>(image: &'a Image, reference: &'a Image) -> Result<[(&'a [f32], &'a [f32]); 3]> {
    let size = |image: &Image| format!("{} x {}", image.width, image.height);
    if (image.width, image.height) != (reference.width, reference.height) {
        let problem = format!("is {} pixels, the reference {}", size(image), size(reference));
        return Err(Error::input("image", "file", problem));
    }
    if image.pixels() == 0 {
        return Err(Error::input("image", "file", "has no pixels"));
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
