//! Assembles a report from measured runs.

use kernel_kit::DeviceInfo;
use rayon::prelude::*;

use super::advice::{LateEntrant, advice, budgets_too_short};
use super::classes::Classes;
use super::curve::Comparison;
use super::document::{AutoReport, BASELINE, ComparisonReport, Overhead, ReferenceReport, Report, Row, SnapshotReport};
use super::entrant::Entrant;
use super::interval::Interval;
use super::measure::{MeasuredEntrant, Yardstick, budgets};
use super::reference::Reference;
use super::run::{Run, Snapshot};
use crate::Result;

/// Version of the keys of `report.json`; 2 has `finding` for conclusions and `visible` in `classes`, 3 savings in
/// `sweeps`, 4 `entrants` for techniques.
const SCHEMA: u32 = 4;

impl Report {
    /// Measures the runs and draws conclusions.
    ///
    /// Each entrant needs the same number of runs, at least [`MIN_REPEATS`](super::document::MIN_REPEATS), taken in
    /// turn. One run is enough for an entrant that has no image in time.
    ///
    /// # Errors
    /// As [`rmse`](super::metrics::rmse); [`crate::Error::Usage`] if no entrant has an image of all its runs at one
    /// budget.
    pub fn new(
        scene: &str,
        device: &DeviceInfo,
        reference: &Reference,
        runs: &[Run],
        classes: Vec<Classes>,
    ) -> Result<Report> {
        let boundary = classes.first().map(Classes::mask);
        let mut rows = measure(runs, Yardstick { reference, boundary: boundary.as_deref() })?;
        let mut measured = Vec::new();
        let mut late = Vec::new();
        for entrant in Entrant::all() {
            let own = runs_of(runs, entrant);
            match MeasuredEntrant::new(entrant, &own, &rows, reference) {
                Some(found) => measured.push(found),
                None if own.is_empty() => {}
                None => late.push(LateEntrant::new(entrant, &own)),
            }
        }
        if measured.is_empty() {
            return Err(budgets_too_short(&late));
        }
        let comparisons = compare(&measured);
        let auto = against_best(&measured, &mut rows);
        let map_left_out = runs.iter().find_map(|run| run.map_left_out.as_deref());
        let advice = advice(&measured, reference, &late, &comparisons, map_left_out);
        Ok(Report {
            schema: SCHEMA,
            version: env!("CARGO_PKG_VERSION"),
            scene: scene.to_owned(),
            device: device.clone(),
            advice,
            reference: ReferenceReport {
                samples: reference.samples(),
                standard_error: reference.standard_error(),
                goal: reference.goal,
                relmse: reference.floor(),
            },
            runs: measured[0].curves.len(),
            entrants: measured.into_iter().map(|entrant| entrant.report).collect(),
            comparisons,
            auto,
            classes,
            sweeps: Vec::new(),
            overhead: Overhead::default(),
            rows,
        })
    }
}

fn runs_of(runs: &[Run], entrant: Entrant) -> Vec<&Run> {
    runs.iter().filter(|run| run.entrant() == entrant).collect()
}

/// Measures every image of every run.
fn measure(runs: &[Run], against: Yardstick<'_>) -> Result<Vec<Row>> {
    let last: Vec<_> =
        Entrant::all().map(|entrant| (entrant, budgets(&runs_of(runs, entrant)).last().copied())).collect();
    let is_last = |run: &Run, snapshot: &Snapshot| last.contains(&(run.entrant(), Some(snapshot.budget)));
    let snapshots: Vec<_> = runs.iter().flat_map(|run| run.snapshots.iter().map(move |s| (run, s))).collect();
    snapshots.par_iter().map(|(run, snapshot)| Row::new(run, snapshot, against, is_last(run, snapshot))).collect()
}

/// Compares each entrant with the baseline, if there is one.
fn compare(entrants: &[MeasuredEntrant]) -> Vec<ComparisonReport> {
    let Some(baseline) = entrants.iter().find(|measured| measured.entrant() == BASELINE) else { return Vec::new() };
    let others = entrants.iter().filter(|measured| measured.entrant() != BASELINE);
    let compare = |measured: &MeasuredEntrant| {
        let Comparison { time, error_ratio, error, time_ratio } = Comparison::new(&measured.curves, &baseline.curves);
        ComparisonReport { entrant: measured.entrant(), time, error_ratio, relmse: error, time_ratio }
    };
    others.map(compare).collect()
}

/// Compares each `auto` with the other entrant that has the smallest relMSE within each budget, if there is one.
fn against_best(entrants: &[MeasuredEntrant], rows: &mut [Row]) -> Vec<AutoReport> {
    // An image stays until there is a better one, so a budget without new samples has that of an earlier one.
    let within = |measured: &MeasuredEntrant, budget: f64| -> Option<SnapshotReport> {
        measured.report.snapshots.iter().rev().find(|snapshot| snapshot.budget <= budget).cloned()
    };
    let mut found = Vec::new();
    for auto in entrants.iter().filter(|measured| measured.entrant().is_automatic()) {
        for snapshot in &auto.report.snapshots {
            let others = entrants.iter().filter(|measured| !measured.entrant().is_automatic());
            let images = others.filter_map(|other| Some((other.entrant(), within(other, snapshot.budget)?)));
            let Some((best, theirs)) = images.min_by(|a, b| a.1.relmse.value.total_cmp(&b.1.relmse.value)) else {
                continue;
            };
            let relmses: Vec<(u32, f64)> = rows
                .iter()
                .filter(|row| row.entrant == best && row.budget == theirs.budget)
                .map(|row| (row.seed, row.relmse))
                .collect();
            let mut ratios = Vec::new();
            for row in rows.iter_mut().filter(|row| row.entrant == auto.entrant() && row.budget == snapshot.budget) {
                if let Some((_, relmse)) = relmses.iter().find(|(seed, _)| *seed == row.seed) {
                    // As in curves: an error of 0 has no ratio.
                    let ratio = row.relmse.max(f64::MIN_POSITIVE) / relmse.max(f64::MIN_POSITIVE);
                    row.best = Some((best, ratio));
                    ratios.push(ratio);
                }
            }
            found.push(AutoReport {
                entrant: auto.entrant(),
                budget: snapshot.budget,
                techniques: snapshot.techniques.clone(),
                relmse: snapshot.relmse,
                best,
                best_relmse: theirs.relmse,
                ratio: Interval::of_geometric_mean(&ratios),
            });
        }
    }
    found
}
