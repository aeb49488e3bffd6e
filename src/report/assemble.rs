//! Assembles a report from measured runs.

use kernel_kit::DeviceInfo;
use rayon::prelude::*;

use super::advice::{LateTechnique, advice, budgets_too_short};
use super::classes::Classes;
use super::curve::Comparison;
use super::document::{BASELINE, ComparisonReport, Overhead, ReferenceReport, Report, Row};
use super::measure::{MeasuredTechnique, Yardstick, budgets};
use super::reference::Reference;
use super::run::{Run, Snapshot};
use crate::Result;
use crate::settings::Technique;

/// Version of the keys of `report.json`; 2 has `finding` for conclusions and `visible` in `classes`, 3 savings in
/// `sweeps`.
const SCHEMA: u32 = 3;

impl Report {
    /// Measures the runs and draws conclusions.
    ///
    /// Each technique needs the same number of runs, at least [`MIN_REPEATS`](super::document::MIN_REPEATS), taken in
    /// turn. One run is enough for a technique that has no image in time.
    ///
    /// # Errors
    /// As [`rmse`](super::metrics::rmse); [`crate::Error::Usage`] if no technique has an image of all its runs at one
    /// budget.
    pub fn new(
        scene: &str,
        device: &DeviceInfo,
        reference: &Reference,
        runs: &[Run],
        classes: Vec<Classes>,
    ) -> Result<Report> {
        let boundary = classes.first().map(Classes::mask);
        let rows = measure(runs, Yardstick { reference, boundary: boundary.as_deref() })?;
        let mut measured = Vec::new();
        let mut late = Vec::new();
        for technique in Technique::all() {
            let own = runs_of(runs, technique);
            match MeasuredTechnique::new(&own, &rows, reference) {
                Some(found) => measured.push(found),
                None if own.is_empty() => {}
                None => late.push(LateTechnique::new(technique, &own)),
            }
        }
        if measured.is_empty() {
            return Err(budgets_too_short(&late));
        }
        let comparisons = compare(&measured);
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
            techniques: measured.into_iter().map(|technique| technique.report).collect(),
            comparisons,
            classes,
            sweeps: Vec::new(),
            overhead: Overhead::default(),
            rows,
        })
    }
}

fn runs_of(runs: &[Run], technique: Technique) -> Vec<&Run> {
    runs.iter().filter(|run| run.settings.technique == technique).collect()
}

/// Measures every image of every run.
fn measure(runs: &[Run], against: Yardstick<'_>) -> Result<Vec<Row>> {
    let last = Technique::all()
        .map(|technique| (technique, budgets(&runs_of(runs, technique)).last().copied()))
        .collect::<Vec<_>>();
    let is_last = |run: &Run, snapshot: &Snapshot| last.contains(&(run.settings.technique, Some(snapshot.budget)));
    let snapshots: Vec<_> = runs.iter().flat_map(|run| run.snapshots.iter().map(move |s| (run, s))).collect();
    snapshots.par_iter().map(|(run, snapshot)| Row::new(run, snapshot, against, is_last(run, snapshot))).collect()
}

/// Compares each technique with the baseline, if there is one.
fn compare(techniques: &[MeasuredTechnique]) -> Vec<ComparisonReport> {
    let Some(baseline) = techniques.iter().find(|measured| measured.technique() == BASELINE) else { return Vec::new() };
    let others = techniques.iter().filter(|measured| measured.technique() != BASELINE);
    let compare = |measured: &MeasuredTechnique| {
        let Comparison { time, error_ratio, error, time_ratio } = Comparison::new(&measured.curves, &baseline.curves);
        ComparisonReport { technique: measured.technique(), time, error_ratio, relmse: error, time_ratio }
    };
    others.map(compare).collect()
}
