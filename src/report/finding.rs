//! What the error of an entrant consists of: bias, noise, or the error of the reference.

use serde::Serialize;

use super::format::percent;
use super::interval::Interval;
use super::metrics::{channels, variance};
use super::reference::Reference;
use crate::Image;
use crate::statistics::NORMAL_QUANTILE;

/// Relative brightness error from which an entrant counts as biased. A smaller one does not change an 8-bit code of
/// mid grey.
const BRIGHTNESS: f64 = 0.005;

/// Share of bias in the error from which an entrant counts as biased. A smaller share is lost in the noise of the
/// image.
const BIAS_SHARE: f64 = 0.1;

/// A bias counts as falling if it was this many times as large at the first budget. One that falls by less may be about
/// to stop, while the noise of n samples falls as 1 / n over budgets that usually double at least.
const MIN_FALL: f64 = 1.5;

/// An error below this multiple of the reference's own error cannot be distinguished from it.
pub(super) const ABOVE_FLOOR: f64 = 2.0;

/// What the error of an entrant consists of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The larger part of the error.
    pub kind: FindingKind,
    /// The same in a sentence, with figures.
    pub text: String,
}

/// The kinds of [`Finding`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FindingKind {
    /// The image stays wrong however long it renders, as far as the budgets show.
    Bias,
    /// The image is wrong in the same way in every run, but less so the longer it renders, as with denoisers.
    FallingBias,
    /// The error decreases with time.
    Noise,
    /// The error is no larger than that of the reference.
    Reference,
}

/// The relMSE of an entrant at its last budget, and its parts.
pub(super) struct ErrorParts<'a> {
    pub relmse: f64,
    pub bias: &'a Interval,
    /// The bias at the first budget, if there are several.
    pub earlier_bias: Option<&'a Interval>,
    pub variance: f64,
    /// relMSE of the reference itself, if known.
    pub floor: Option<f64>,
    /// Whether a denoiser adds a bias of its own, which may fall with the noise.
    pub is_denoised: bool,
}

impl ErrorParts<'_> {
    /// Whether the intervals of the bias show that it decreases with time.
    fn bias_falls(&self) -> bool {
        self.earlier_bias.is_some_and(|earlier| MIN_FALL * self.bias.high < earlier.low)
    }

    /// The kind of a bias, and a text on how it develops over the budgets.
    fn trend(&self) -> (FindingKind, &'static str) {
        match self.earlier_bias {
            Some(_) if self.bias_falls() => (FindingKind::FallingBias, "; the bias falls with time"),
            _ if !self.is_denoised => (FindingKind::Bias, ""),
            Some(_) => (FindingKind::Bias, "; the bias does not clearly fall from the first to the last budget"),
            None => (FindingKind::Bias, "; a single budget does not show whether the bias falls with time"),
        }
    }
}

/// Mean radiance over the reference's, minus 1. The interval includes the reference's own error where that is known.
pub(super) fn brightness(images: &[&Image], reference: &Reference) -> Interval {
    let sum = |image: &Image| -> f64 { channels(image).flat_map(|(_, samples)| samples).map(|x| f64::from(*x)).sum() };
    let truth = sum(&reference.image);
    if truth == 0.0 {
        let any = images.iter().any(|image| sum(image) != 0.0);
        let value = if any { f64::INFINITY } else { 0.0 };
        return Interval { value, low: value, high: value };
    }
    let ratios: Vec<f64> = images.iter().map(|image| sum(image) / truth - 1.0).collect();
    let interval = Interval::of_mean(&ratios);
    let deviations = ["R", "G", "B"].iter().filter_map(|name| reference.image.channel(&variance(name)));
    let mut of_pixels = vec![0.0; reference.image.pixels()];
    for channel in deviations {
        of_pixels.iter_mut().zip(channel).for_each(|(sum, variance)| *sum += f64::from(*variance).sqrt());
    }
    // The channels of a pixel have their light from the same paths, so their errors add up.
    let error = of_pixels.iter().map(|deviation| deviation * deviation).sum::<f64>().sqrt() / truth;
    // The reference's sum is over very many independent pixels, so its error is normal.
    let half = (interval.high - interval.value).hypot(NORMAL_QUANTILE * error);
    Interval { low: interval.value - half, high: interval.value + half, ..interval }
}

/// Decides which part of the error is the larger one.
pub(super) fn finding(parts: &ErrorParts<'_>, brightness: &Interval) -> Finding {
    let ErrorParts { relmse: error, floor, .. } = *parts;
    let [bias, noise] = [parts.bias.value.max(0.0), parts.variance.max(0.0)];
    // The share of what is not the reference's error.
    let share = |part: f64| if part > 0.0 { part / (bias + noise) } else { 0.0 };
    if !brightness.holds(0.0) && brightness.value.abs() >= BRIGHTNESS {
        let (word, sign) = if brightness.value > 0.0 { ("bright", 1.0) } else { ("dark", -1.0) };
        let mut ends = [sign * brightness.low, sign * brightness.high];
        ends.sort_by(f64::total_cmp);
        let [low, high] = ends.map(percent);
        let (kind, trend) = parts.trend();
        let value = percent(brightness.value.abs());
        let text = format!("biased: the image is too {word} by {value} ({low} to {high}){trend}");
        return Finding { kind, text };
    }
    // The error that all runs share includes the reference's error. A few bright pixels can dominate that error, and
    // then its estimate is only good to this factor.
    let unclear = floor.is_some_and(|floor| bias + floor < ABOVE_FLOOR * floor);
    if floor.is_some_and(|floor| error < ABOVE_FLOOR * floor || unclear && noise < bias + floor) {
        let text = "as small as the reference can resolve".to_owned();
        return Finding { kind: FindingKind::Reference, text };
    }
    if parts.bias.low > 0.0 && share(bias) >= BIAS_SHARE && !unclear {
        let part = if floor.is_some() { "" } else { ", unless it is the error of the reference, which is not known" };
        let (kind, trend) = parts.trend();
        let stays = if trend.is_empty() { "stays however long the render takes" } else { "is the same in every run" };
        let text = format!("biased: {} of the error {stays}{part}{trend}", percent(share(bias)));
        return Finding { kind, text };
    }
    let text = format!("noise: {} of the error differs from run to run", percent(share(noise)));
    Finding { kind: FindingKind::Noise, text }
}
