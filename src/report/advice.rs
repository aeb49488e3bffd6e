//! Advice on which technique to use for a scene.

use std::cmp::Ordering;
use std::fmt::Write;

use super::curve::ratio;
use super::document::{BASELINE, ComparisonReport};
use super::finding::FindingKind;
use super::format::number;
use super::interval::Interval;
use super::measure::MeasuredTechnique;
use super::reference::Reference;
use super::run::Run;
use crate::Error;
use crate::settings::Technique;

/// An error of this multiple of the smallest one is clearly worse, where times do not separate the techniques.
const CLEARLY: f64 = 2.0;

/// A technique for which no budget has an image of every run.
pub(super) struct LateTechnique {
    technique: Technique,
    /// Seconds of the slowest run's set-up.
    setup: f64,
    /// Seconds until all runs had an image. `None` if one of them never had.
    first: Option<f64>,
}

impl LateTechnique {
    pub fn new(technique: Technique, runs: &[&Run]) -> LateTechnique {
        let setup = runs.iter().map(|run| run.setup).fold(0.0, f64::max);
        let firsts: Option<Vec<f64>> = runs.iter().map(|run| run.first).collect();
        LateTechnique { technique, setup, first: firsts.map(|firsts| firsts.into_iter().fold(0.0, f64::max)) }
    }

    fn reason(&self) -> String {
        match self.first {
            Some(seconds) => format!("its first image takes up to {seconds:.2} s"),
            None => format!("its set-up alone takes up to {:.2} s", self.setup),
        }
    }
}

/// The error for budgets at which no technique has an image: says which technique is the soonest and what it needs.
pub(super) fn budgets_too_short(late: &[LateTechnique]) -> Error {
    // A technique with an image precedes one without.
    let order = |late: &LateTechnique| (late.first.is_none(), late.first.unwrap_or(late.setup));
    let soonest = late.iter().min_by(|a, b| order(a).partial_cmp(&order(b)).unwrap_or(Ordering::Equal));
    let Some(soonest) = soonest else { return Error::Usage("there are no runs to report".to_owned()) };
    let (more, seconds) = order(soonest);
    Error::Usage(format!(
        "`budgets` are too short: no technique has an image at one of them in all its runs; the soonest is {}, but {}: \
         give {} {:.2} s",
        soonest.technique,
        soonest.reason(),
        if more { "more than" } else { "at least" },
        // Rounded up, as no two runs take the same time.
        (seconds * 100.0).ceil() / 100.0
    ))
}

/// Which technique to use, and why; which techniques the reference cannot rank; which ones were too late.
pub(super) fn advice(
    techniques: &[MeasuredTechnique],
    reference: &Reference,
    late: &[LateTechnique],
    comparisons: &[ComparisonReport],
    map_left_out: Option<&str>,
) -> String {
    let mut text = best(techniques);
    if let Some(sentence) = limit_of_reference(techniques, reference) {
        text += &sentence;
    }
    let late: Vec<String> = late.iter().map(|late| format!("{} ({})", late.technique, late.reason())).collect();
    if !late.is_empty() {
        let _ = write!(text, " Left out, as no budget has an image of each run: {}.", late.join(", "));
    }
    if let Some(reason) = map_left_out {
        let _ = write!(text, " The visibility map is left out of this scene ({reason})");
        let cost = comparisons.iter().find(|comparison| comparison.technique == Technique::SHADOW_PHOTONS);
        if let Some(Interval { value, .. }) = cost.and_then(|comparison| comparison.time_ratio) {
            let _ = write!(text, "; {} took {value:.2} times the time of {BASELINE}", Technique::SHADOW_PHOTONS);
        }
        text.push('.');
    }
    text
}

/// Names the techniques whose error is no larger than the reference's, and the option that would resolve them.
fn limit_of_reference(techniques: &[MeasuredTechnique], reference: &Reference) -> Option<String> {
    let unresolved = |measured: &&MeasuredTechnique| measured.report.finding.kind == FindingKind::Reference;
    let unresolved: Vec<Technique> = techniques.iter().filter(unresolved).map(MeasuredTechnique::technique).collect();
    let subject = match unresolved.as_slice() {
        // A single technique is distinguished from the others. Its true error is hidden if the reference fell short of
        // its goal.
        [one] if reference.is_short() => format!("The error of {one} is"),
        [_, _, ..] => "Some errors are".to_owned(),
        _ => return None,
    };
    let floor = number(round_up(reference.floor()?));
    let better = if reference.is_short() { "longer `reference_time`" } else { "smaller `reference_error`" };
    Some(format!(
        " {subject} as small as the reference can resolve, whose own relMSE is up to {floor}: use a {better}."
    ))
}

/// The technique that is the fastest to an error that another one reaches too, or that reaches a smaller error than any
/// other.
fn best(techniques: &[MeasuredTechnique]) -> String {
    let unbiased = |measured: &&MeasuredTechnique| measured.report.finding.kind != FindingKind::Bias;
    let reached = techniques.iter().filter(unbiased).map(MeasuredTechnique::reached);
    let Some(min_unbiased) = reached.min_by(f64::total_cmp) else {
        return "No technique is free of bias here: the finding of each says what its error consists of.".to_owned();
    };
    // A biased technique stays in if its whole error is below that of all unbiased ones.
    let kept = |measured: &&MeasuredTechnique| unbiased(measured) || measured.reached() < min_unbiased;
    let mut by_error: Vec<(&MeasuredTechnique, f64)> =
        techniques.iter().filter(kept).map(|measured| (measured, measured.reached())).collect();
    by_error.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (nearest, min_error) = by_error[0];
    // The smallest error that two techniques reach.
    let common = by_error.get(1).map_or(min_error, |(_, error)| *error);
    let reaches = |measured: &MeasuredTechnique, target: f64| {
        format!("reaches relMSE {} in {:.2} s", number(target), measured.time_to(target))
    };
    let alone = || {
        let target = round_up(min_error);
        format!("Use {}: it alone {}.", nearest.technique(), reaches(nearest, target))
    };

    let target = round_up(common);
    let mut ranked: Vec<&MeasuredTechnique> = by_error.iter().map(|(measured, _)| *measured).collect();
    ranked.retain(|measured| measured.time_to(target).is_finite());
    ranked.sort_by(|a, b| a.time_to(target).total_cmp(&b.time_to(target)));
    let [best, others @ ..] = ranked.as_slice() else { return alone() };
    let other = others.iter().find(|other| other.technique() == BASELINE).or(others.first());
    let ratio = other.and_then(|other| ratio(&other.curves, &best.curves, |curve| curve.time_at(target)));
    let (Some(other), Some(Interval { value, low, high })) = (other, ratio) else { return alone() };
    let (found, other) = (reaches(best, target), other.technique());
    if low > 1.0 {
        let fastest = best.technique();
        let mut text =
            format!("Use {fastest}: it {found}, {value:.2} times faster than {other} ({low:.2} to {high:.2}).");
        if nearest.technique() != fastest && is_closer(nearest, best) {
            let (nearest, reaches) = (nearest.technique(), reaches(nearest, round_up(min_error)));
            let _ = write!(text, " For a smaller error use {nearest}: it {reaches}.");
        }
        text
    } else if common > CLEARLY * min_error && by_error.get(1).is_some_and(|(second, _)| is_closer(nearest, second)) {
        alone()
    } else {
        format!("{} {found}; {other} may be as fast: it takes {low:.2} to {high:.2} times as long.", best.technique())
    }
}

/// Whether the last errors of all runs show that the first technique comes closer to the reference.
fn is_closer(first: &MeasuredTechnique, other: &MeasuredTechnique) -> bool {
    ratio(&other.curves, &first.curves, |curve| Some(curve.last().1)).is_some_and(|ratio| ratio.low > 1.0)
}

/// The next of 1, 2 and 5 times a power of ten.
fn round_up(x: f64) -> f64 {
    let power = 10f64.powf(x.max(f64::MIN_POSITIVE).log10().floor());
    [1.0, 2.0, 5.0].map(|digit| digit * power).into_iter().find(|rounded| *rounded >= x).unwrap_or(10.0 * power)
}
