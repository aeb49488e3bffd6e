//! What the error of a technique is made of, and which technique to use.

use std::cmp::Ordering;
use std::fmt::Write;

use serde::Serialize;

use crate::settings::Technique;
use crate::{Error, Image};

use super::curve::ratio;
use super::document::{BASELINE, ComparisonReport, Entrant, SnapshotReport, channels};
use super::interval::Interval;
use super::plot::number;
use super::reference::{Reference, variance};
use super::run::Run;

/// A technique's light is called too strong or too weak from here on: less does not change an 8-bit code of mid grey.
const BRIGHTNESS: f64 = 0.005;

/// A technique is called biased where so much of its error is bias: less is lost in the noise of the picture.
const BIAS_SHARE: f64 = 0.1;

/// An error so many times the least is plainly worse, where times do not tell techniques apart.
const CLEARLY: f64 = 2.0;

/// An error is not told from the reference's own where it is less than so many times that.
const ABOVE_FLOOR: f64 = 2.0;

/// What the error of a technique is made of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// The greater part, or what must be known.
    pub kind: VerdictKind,
    /// In a sentence.
    pub text: String,
}

/// See [`Verdict`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum VerdictKind {
    /// The image is wrong however long it is rendered.
    Bias,
    /// The error goes away with time.
    Noise,
    /// The error is no greater than the reference's.
    Reference,
}

/// Mean radiance over the reference's, less 1.
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
    let variances = ["R", "G", "B"].iter().filter_map(|name| reference.image.channel(&variance(name)));
    let error = variances.flatten().map(|v| f64::from(*v)).sum::<f64>().sqrt() / truth;
    // The reference's sum is one of very many independent pixels: 97.5 % quantile of the normal distribution.
    let half = (interval.high - interval.value).hypot(1.959_964 * error);
    Interval { low: interval.value - half, high: interval.value + half, ..interval }
}

pub(super) fn verdict(last: &SnapshotReport, brightness: &Interval, floor: Option<f64>) -> Verdict {
    let percent = |x: f64| format!("{:.1} %", 100.0 * x);
    let error = last.relmse.value;
    let [bias, noise] = [last.bias.value.max(0.0), last.variance.value.max(0.0)];
    // Of what is not the reference's own; of nothing at all where there is none.
    let share = |part: f64| if part > 0.0 { part / (bias + noise) } else { 0.0 };
    if !brightness.holds(0.0) && brightness.value.abs() >= BRIGHTNESS {
        let (word, sign) = if brightness.value > 0.0 { ("strong", 1.0) } else { ("weak", -1.0) };
        let mut ends = [sign * brightness.low, sign * brightness.high];
        ends.sort_by(f64::total_cmp);
        let [low, high] = ends.map(percent);
        let text = format!("biased: its light is too {word} by {} ({low} to {high})", percent(brightness.value.abs()));
        return Verdict { kind: VerdictKind::Bias, text };
    }
    // What all runs have in common has the reference's error in it, and where that is the work of a few bright pixels it is told
    // no better than to this factor.
    let unclear = floor.is_some_and(|floor| bias + floor < ABOVE_FLOOR * floor);
    if floor.is_some_and(|floor| error < ABOVE_FLOOR * floor || unclear && noise < bias + floor) {
        let text = "as near as the reference can tell".to_owned();
        return Verdict { kind: VerdictKind::Reference, text };
    }
    if last.bias.low > 0.0 && share(bias) >= BIAS_SHARE && !unclear {
        let part = if floor.is_some() { "" } else { ", or is the reference's, whose error is not known" };
        let text = format!("biased: {} of the error stays however long it renders{part}", percent(share(bias)));
        return Verdict { kind: VerdictKind::Bias, text };
    }
    let text = format!("noise: {} of the error differs from run to run", percent(share(noise)));
    Verdict { kind: VerdictKind::Noise, text }
}

/// A technique that has no budget at which all of its runs have an image.
pub(super) struct Late {
    technique: Technique,
    /// Seconds of the slowest run's set-up.
    setup: f64,
    /// Seconds until all runs had an image; none where one never had.
    first: Option<f64>,
}

impl Late {
    pub fn new(technique: Technique, runs: &[&Run]) -> Late {
        let setup = runs.iter().map(|run| run.setup).fold(0.0, f64::max);
        let firsts: Option<Vec<f64>> = runs.iter().map(|run| run.first).collect();
        Late { technique, setup, first: firsts.map(|firsts| firsts.into_iter().fold(0.0, f64::max)) }
    }

    fn why(&self) -> String {
        match self.first {
            Some(seconds) => format!("its first image takes up to {seconds:.2} s"),
            None => format!("its set-up alone takes up to {:.2} s", self.setup),
        }
    }
}

/// What to do where all techniques are late.
pub(super) fn too_short(late: &[Late]) -> Error {
    // Who has an image is sooner than who has none.
    let soonness = |late: &Late| (late.first.is_none(), late.first.unwrap_or(late.setup));
    let soonest = late.iter().min_by(|a, b| soonness(a).partial_cmp(&soonness(b)).unwrap_or(Ordering::Equal));
    let Some(soonest) = soonest else { return Error::Usage("there are no runs to report".to_owned()) };
    let (more, seconds) = soonness(soonest);
    Error::Usage(format!(
        "`budgets` are too short: no technique has an image at one of them in all its runs; of {}, the soonest, {}: give {} {:.2} s",
        soonest.technique,
        soonest.why(),
        if more { "more than" } else { "at least" },
        // A run is never just as fast as the one before.
        (seconds * 100.0).ceil() / 100.0
    ))
}

/// Which technique to use, and why.
pub(super) fn advice(
    entrants: &[Entrant],
    reference: &Reference,
    late: &[Late],
    comparisons: &[ComparisonReport],
    map_left_out: Option<&str>,
) -> String {
    let mut text = best(entrants);
    let near = |entrant: &&Entrant| entrant.report.verdict.kind == VerdictKind::Reference;
    let near: Vec<Technique> = entrants.iter().filter(near).map(Entrant::technique).collect();
    let some = match near.as_slice() {
        // It is told from the others, but how near it comes is hidden.
        [one] if reference.is_short() => Some(format!("{one} comes")),
        [_, _, ..] => Some("Some come".to_owned()),
        _ => None,
    };
    if let Some((some, floor)) = some.zip(reference.floor()) {
        let better = if reference.is_short() { "longer `reference_time`" } else { "smaller `reference_error`" };
        let floor = number(round_up(floor));
        let _ = write!(
            text,
            " {some} as near as the reference can tell, whose own relMSE is up to {floor}: a {better} would tell more."
        );
    }
    let late: Vec<String> = late.iter().map(|late| format!("{} ({})", late.technique, late.why())).collect();
    if !late.is_empty() {
        let _ = write!(text, " Left out, as no budget has an image of each run: {}.", late.join(", "));
    }
    if let Some(reason) = map_left_out {
        let _ = write!(text, " Shadow photons are left out of this scene ({reason})");
        let cost = comparisons.iter().find(|comparison| comparison.technique == Technique::ShadowPhotons);
        if let Some(Interval { value, .. }) = cost.and_then(|comparison| comparison.time_ratio) {
            let _ = write!(text, "; {} took {value:.2} times the time of {BASELINE}", Technique::ShadowPhotons);
        }
        text.push('.');
    }
    text
}

/// The technique that is soonest at an error that another reaches too, or that comes nearer than any other.
fn best(entrants: &[Entrant]) -> String {
    // What all of its runs reach.
    let reached = |entrant: &Entrant| entrant.curves.iter().map(|curve| curve.last().1).fold(0.0, f64::max);
    let unbiased = |entrant: &&Entrant| entrant.report.verdict.kind != VerdictKind::Bias;
    let Some(fair) = entrants.iter().filter(unbiased).map(reached).min_by(f64::total_cmp) else {
        return "No technique is free of bias here: see what the error of each is made of.".to_owned();
    };
    // Whose bias is less than any other's whole error is the one to use all the same.
    let kept = |entrant: &&Entrant| unbiased(entrant) || reached(entrant) < fair;
    let mut by_error: Vec<(&Entrant, f64)> =
        entrants.iter().filter(kept).map(|entrant| (entrant, reached(entrant))).collect();
    by_error.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (nearest, least) = &by_error[0];
    let common = by_error.get(1).map_or(*least, |(_, error)| *error);
    let time = |entrant: &Entrant, target: f64| {
        let times: Option<Vec<f64>> = entrant.curves.iter().map(|curve| curve.time_at(target)).collect();
        times.map_or(f64::INFINITY, |times| Interval::of_geometric_mean(&times).value)
    };
    let reaches =
        |entrant: &Entrant, target: f64| format!("reaches relMSE {} in {:.2} s", number(target), time(entrant, target));
    let alone = || {
        let target = round_up(*least);
        format!("Use {}: it alone {}.", nearest.technique(), reaches(nearest, target))
    };

    let target = round_up(common);
    let mut ranked: Vec<&Entrant> = by_error.iter().map(|(entrant, _)| *entrant).collect();
    ranked.retain(|entrant| time(entrant, target).is_finite());
    ranked.sort_by(|a, b| time(a, target).total_cmp(&time(b, target)));
    let [best, others @ ..] = ranked.as_slice() else { return alone() };
    let other = others.iter().find(|other| other.technique() == BASELINE).or(others.first());
    let ratio = other.and_then(|other| ratio(&other.curves, &best.curves, |curve| curve.time_at(target)));
    let (Some(other), Some(Interval { value, low, high })) = (other, ratio) else { return alone() };
    let (found, other) = (reaches(best, target), other.technique());
    if low > 1.0 {
        let soonest = best.technique();
        let mut text =
            format!("Use {soonest}: it {found}, {value:.2} times sooner than {other} ({low:.2} to {high:.2}).");
        if nearest.technique() != soonest && plainly(nearest, best) {
            let _ = write!(text, " For less, use {}: it {}.", nearest.technique(), reaches(nearest, round_up(*least)));
        }
        text
    } else if common > CLEARLY * least && by_error.get(1).is_some_and(|(second, _)| plainly(nearest, second)) {
        alone()
    } else {
        format!("{} {found}; {other} may be as soon: it takes {low:.2} to {high:.2} times as long.", best.technique())
    }
}

/// Whether the last errors of all runs tell that the first technique comes nearer.
fn plainly(nearer: &Entrant, other: &Entrant) -> bool {
    ratio(&other.curves, &nearer.curves, |curve| Some(curve.last().1)).is_some_and(|ratio| ratio.low > 1.0)
}

/// The next of 1, 2 and 5 times a power of ten.
fn round_up(x: f64) -> f64 {
    let power = 10f64.powf(x.max(f64::MIN_POSITIVE).log10().floor());
    [1.0, 2.0, 5.0].map(|digit| digit * power).into_iter().find(|rounded| *rounded >= x).unwrap_or(10.0 * power)
}
