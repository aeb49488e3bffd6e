//! Advice on which entrant to use for a scene.

use std::cmp::Ordering;
use std::fmt::Write;

use super::curve::ratio;
use super::document::{BASELINE, ComparisonReport};
use super::entrant::Entrant;
use super::finding::FindingKind;
use super::format::number;
use super::interval::Interval;
use super::measure::MeasuredEntrant;
use super::reference::Reference;
use super::run::Run;
use crate::Error;
use crate::settings::Technique;

/// An error of this multiple of the smallest one is clearly worse, where times do not separate the entrants.
const CLEARLY: f64 = 2.0;

/// An entrant for which no budget has an image of every run.
pub(super) struct LateEntrant {
    entrant: Entrant,
    /// Seconds of the slowest run's set-up and denoiser.
    setup: f64,
    /// Seconds until all runs had an image. `None` if one of them never had.
    first: Option<f64>,
}

impl LateEntrant {
    pub fn new(entrant: Entrant, runs: &[&Run]) -> LateEntrant {
        let setup = runs.iter().map(|run| run.setup + run.denoise).fold(0.0, f64::max);
        let firsts: Option<Vec<f64>> = runs.iter().map(|run| run.first).collect();
        LateEntrant { entrant, setup, first: firsts.map(|firsts| firsts.into_iter().fold(0.0, f64::max)) }
    }

    fn reason(&self) -> String {
        match self.first {
            Some(seconds) => format!("its first image takes up to {seconds:.2} s"),
            None if self.entrant.is_denoised() => format!("its set-up and denoiser take up to {:.2} s", self.setup),
            None => format!("its set-up alone takes up to {:.2} s", self.setup),
        }
    }
}

/// The error for budgets at which no entrant has an image: says which one is the soonest and what it needs.
pub(super) fn budgets_too_short(late: &[LateEntrant]) -> Error {
    // An entrant with an image precedes one without.
    let order = |late: &LateEntrant| (late.first.is_none(), late.first.unwrap_or(late.setup));
    let soonest = late.iter().min_by(|a, b| order(a).partial_cmp(&order(b)).unwrap_or(Ordering::Equal));
    let Some(soonest) = soonest else { return Error::Usage("there are no runs to report".to_owned()) };
    let (more, seconds) = order(soonest);
    Error::Usage(format!(
        "`budgets` are too short: no technique has an image at one of them in all its runs; the soonest is {}, but {}: \
         set one of {} {:.2} s",
        soonest.entrant,
        soonest.reason(),
        if more { "more than" } else { "at least" },
        // Rounded up, as no two runs take the same time.
        (seconds * 100.0).ceil() / 100.0
    ))
}

/// Which entrant to use, and why; which entrants the reference cannot rank; which ones were too late.
pub(super) fn advice(
    entrants: &[MeasuredEntrant],
    reference: &Reference,
    late: &[LateEntrant],
    comparisons: &[ComparisonReport],
    map_left_out: Option<&str>,
) -> String {
    let mut text = best(entrants);
    if let Some(sentence) = limit_of_reference(entrants, reference) {
        text += &sentence;
    }
    let late: Vec<String> = late.iter().map(|late| format!("{} ({})", late.entrant, late.reason())).collect();
    if !late.is_empty() {
        let _ = write!(text, " Left out, because no budget has an image of every run: {}.", late.join(", "));
    }
    if let Some(reason) = map_left_out {
        let _ = write!(text, " The visibility map is left out of this scene ({reason})");
        let by_photons = Entrant::raw(Technique::SHADOW_PHOTONS);
        let cost = comparisons.iter().find(|comparison| comparison.entrant == by_photons);
        if let Some(Interval { value, .. }) = cost.and_then(|comparison| comparison.time_ratio) {
            let _ = write!(text, "; {} took {value:.2} times the time of {BASELINE}", by_photons);
        }
        text.push('.');
    }
    text
}

/// Names the entrants whose error is no larger than the reference's, and the option that would resolve them.
fn limit_of_reference(entrants: &[MeasuredEntrant], reference: &Reference) -> Option<String> {
    let unresolved = |measured: &&MeasuredEntrant| measured.report.finding.kind == FindingKind::Reference;
    let unresolved: Vec<Entrant> = entrants.iter().filter(unresolved).map(MeasuredEntrant::entrant).collect();
    let subject = match unresolved.as_slice() {
        // A single unresolved entrant is still told apart from the others. Only its true error is hidden, and that is
        // worth saying if the reference fell short of its goal.
        [one] if reference.is_short() => format!("The error of {one} is"),
        [_, _, ..] => "Some errors are".to_owned(),
        _ => return None,
    };
    let floor = number(round_up(reference.floor()?));
    let better = if reference.is_short() { "longer `reference_time`" } else { "smaller `reference_error`" };
    Some(format!(" {subject} too small for this reference, whose own relMSE is up to {floor}: use a {better}."))
}

/// The entrant that is the fastest to an error that another one reaches too, or that reaches a smaller error than any
/// other.
fn best(entrants: &[MeasuredEntrant]) -> String {
    // Times to an error mean nothing where every image has none.
    let mut snapshots = entrants.iter().flat_map(|measured| &measured.report.snapshots);
    if snapshots.all(|snapshot| snapshot.relmse.value == 0.0) {
        return "No image has an error, so none is better than another: is there light in the scene?".to_owned();
    }
    // A bias that falls with time costs time, as noise does.
    let unbiased = |measured: &&MeasuredEntrant| measured.report.finding.kind != FindingKind::Bias;
    let reached = entrants.iter().filter(unbiased).map(MeasuredEntrant::reached);
    let Some(min_unbiased) = reached.min_by(f64::total_cmp) else {
        return "No entrant is free of bias here: the finding of each says what its error consists of.".to_owned();
    };
    // A biased entrant stays in if its whole error is below that of all unbiased ones.
    let kept = |measured: &&MeasuredEntrant| unbiased(measured) || measured.reached() < min_unbiased;
    let mut by_error: Vec<(&MeasuredEntrant, f64)> =
        entrants.iter().filter(kept).map(|measured| (measured, measured.reached())).collect();
    by_error.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (nearest, min_error) = by_error[0];
    // The smallest error that two entrants reach.
    let common = by_error.get(1).map_or(min_error, |(_, error)| *error);
    let reaches = |measured: &MeasuredEntrant, target: f64| {
        format!("reaches relMSE {} in {:.2} s", number(target), measured.time_to(target))
    };
    let alone = || {
        let target = round_up(min_error);
        format!("Use {}: it alone {}.", nearest.entrant(), reaches(nearest, target))
    };

    let target = round_up(common);
    let mut ranked: Vec<&MeasuredEntrant> = by_error.iter().map(|(measured, _)| *measured).collect();
    ranked.retain(|measured| measured.time_to(target).is_finite());
    ranked.sort_by(|a, b| a.time_to(target).total_cmp(&b.time_to(target)));
    let [best, others @ ..] = ranked.as_slice() else { return alone() };
    let other = others.iter().find(|other| other.entrant() == BASELINE).or(others.first());
    let ratio = other.and_then(|other| ratio(&other.curves, &best.curves, |curve| curve.time_at(target)));
    let (Some(other), Some(Interval { value, low, high })) = (other, ratio) else { return alone() };
    let (found, other) = (reaches(best, target), other.entrant());
    if low > 1.0 {
        let fastest = best.entrant();
        let mut text =
            format!("Use {fastest}: it {found}, {value:.2} times as fast as {other} ({low:.2} to {high:.2}).");
        if nearest.entrant() != fastest && is_closer(nearest, best) {
            let (nearest, reaches) = (nearest.entrant(), reaches(nearest, round_up(min_error)));
            let _ = write!(text, " For a smaller error use {nearest}: it {reaches}.");
        }
        text
    } else if common > CLEARLY * min_error && by_error.get(1).is_some_and(|(second, _)| is_closer(nearest, second)) {
        alone()
    } else {
        format!("{} {found}; {other} may be as fast: it takes {low:.2} to {high:.2} times as long.", best.entrant())
    }
}

/// Whether the last errors of all runs show that the first technique comes closer to the reference.
fn is_closer(first: &MeasuredEntrant, other: &MeasuredEntrant) -> bool {
    ratio(&other.curves, &first.curves, |curve| Some(curve.last().1)).is_some_and(|ratio| ratio.low > 1.0)
}

/// The next of 1, 2 and 5 times a power of ten.
fn round_up(x: f64) -> f64 {
    let power = 10f64.powf(x.max(f64::MIN_POSITIVE).log10().floor());
    [1.0, 2.0, 5.0].map(|digit| digit * power).into_iter().find(|rounded| *rounded >= x).unwrap_or(10.0 * power)
}
