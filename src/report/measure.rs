//! Measurement of runs against the reference: rows, snapshots and entrants of a report.

use std::collections::BTreeMap;

use super::curve::Curve;
use super::document::{EntrantReport, Row, SnapshotReport, TimeReport};
use super::entrant::Entrant;
use super::finding::{ABOVE_FLOOR, ErrorParts, brightness, finding};
use super::interval::Interval;
use super::metrics::{self, RELMSE_FLOOR, channels};
use super::reference::Reference;
use super::run::{Run, Snapshot};
use crate::settings::Technique;
use crate::statistics::Rays;
use crate::{Image, Result};

/// What all images are measured against.
#[derive(Clone, Copy)]
pub(super) struct Yardstick<'a> {
    pub reference: &'a Reference,
    /// The pixels classified boundary or unknown.
    pub boundary: Option<&'a [bool]>,
}

impl Row {
    /// Measures an image of a run. FLIP is measured at the last budget only.
    pub(super) fn new(run: &Run, snapshot: &Snapshot, against: Yardstick<'_>, is_last: bool) -> Result<Row> {
        let Snapshot { budget, denoise, samples, rays, ref image, estimate, .. } = *snapshot;
        let reference = &against.reference.image;
        let parts =
            against.boundary.map(|mask| [true, false].map(|inside| masked_relmse(image, reference, mask, inside)));
        Ok(Row {
            entrant: run.entrant(),
            seed: run.settings.image.seed,
            budget,
            technique: snapshot.technique,
            best: None,
            time: snapshot.time(),
            denoise,
            samples,
            rmse: metrics::rmse(image, reference)?,
            relmse: metrics::relmse(image, reference)?,
            estimate,
            mae: metrics::mae(image, reference)?,
            p99: metrics::p99(image, reference)?,
            flip: is_last.then(|| metrics::flip(image, reference)).transpose()?,
            parts,
            rays,
        })
    }

    fn is_of(&self, run: &Run) -> bool {
        self.entrant == run.entrant() && self.seed == run.settings.image.seed
    }
}

/// An entrant all of whose runs have an image at one budget at least.
pub(super) struct MeasuredEntrant {
    pub report: EntrantReport,
    /// relMSE over time, one curve per run.
    pub curves: Vec<Curve>,
}

impl MeasuredEntrant {
    /// Measures the runs of one entrant. `None` if there is no budget at which all of them have an image.
    pub fn new(entrant: Entrant, runs: &[&Run], rows: &[Row], reference: &Reference) -> Option<MeasuredEntrant> {
        let snapshots: Vec<(SnapshotReport, Vec<&Image>)> = budgets(runs)
            .into_iter()
            .map(|budget| {
                let all = runs.iter().flat_map(|run| &run.snapshots);
                let images: Vec<&Image> = all.filter(|s| s.budget == budget).map(|s| &s.image).collect();
                let own = |row: &&Row| row.budget == budget && runs.iter().any(|run| row.is_of(run));
                let rows: Vec<&Row> = rows.iter().filter(own).collect();
                (SnapshotReport::new(budget, &rows, &images, reference), images)
            })
            .collect();
        let (last, images) = snapshots.last()?;
        let brightness = brightness(images, reference);
        let SnapshotReport { relmse, bias, variance, .. } = last;
        let parts = ErrorParts {
            relmse: relmse.value,
            bias,
            earlier_bias: snapshots
                .first()
                .filter(|(first, _)| first.budget < last.budget)
                .map(|(first, _)| &first.bias),
            variance: variance.value,
            floor: reference.floor(),
            is_denoised: entrant.is_denoised(),
        };
        let finding = finding(&parts, &brightness);
        let curve = |run: &Run, time: &dyn Fn(&Row) -> f64| {
            let own = rows.iter().filter(|row| row.is_of(run));
            Curve::new(own.map(|row| (time(row), row.relmse)))
        };
        // Only sampling determines the slope, so set-up and denoiser do not count.
        let slope = |run: &&Run| curve(run, &|row| row.time - row.denoise - run.setup).slope();
        // The images of `auto` are of several renders, each with a set-up of its own.
        let slopes = (!entrant.is_automatic()).then(|| runs.iter().map(slope).collect()).flatten();
        let report = EntrantReport {
            entrant,
            denoisers: runs[0].denoisers.clone(),
            settings: runs[0].settings.clone(),
            left_out: runs[0].statistics.left_out.clone(),
            notes: runs[0].statistics.notes.clone(),
            time: TimeReport::new(runs),
            slope: slopes.map(|slopes: Vec<f64>| Interval::of_mean(&slopes)),
            brightness,
            finding,
            snapshots: snapshots.into_iter().map(|(report, _)| report).collect(),
        };
        Some(MeasuredEntrant { report, curves: runs.iter().map(|run| curve(run, &|row| row.time)).collect() })
    }

    pub fn entrant(&self) -> Entrant {
        self.report.entrant
    }

    /// The smallest relMSE that all runs have reached.
    pub fn reached(&self) -> f64 {
        self.curves.iter().map(|curve| curve.last().1).fold(0.0, f64::max)
    }

    /// The mean time in seconds to a relMSE; infinite if some run has not reached it.
    pub fn time_to(&self, relmse: f64) -> f64 {
        let times: Option<Vec<f64>> = self.curves.iter().map(|curve| curve.time_at(relmse)).collect();
        times.map_or(f64::INFINITY, |times| Interval::of_geometric_mean(&times).value)
    }
}

/// The budgets at which all of these runs have an image, in order.
pub(super) fn budgets(runs: &[&Run]) -> Vec<f64> {
    let has = |run: &Run, budget: f64| run.snapshots.iter().any(|snapshot| snapshot.budget == budget);
    let first = runs.first().into_iter().flat_map(|run| &run.snapshots).map(|snapshot| snapshot.budget);
    first.filter(|budget| runs.iter().all(|run| has(run, *budget))).collect()
}

impl TimeReport {
    /// Means over the runs.
    fn new(runs: &[&Run]) -> TimeReport {
        let mean = |f: &dyn Fn(&Run) -> f64| runs.iter().map(|run| f(run)).sum::<f64>() / runs.len() as f64;
        let mut passes = BTreeMap::new();
        for name in runs.iter().flat_map(|run| run.statistics.time.passes.keys()) {
            let seconds = |run: &Run| run.statistics.time.passes.get(name).copied().unwrap_or(0.0);
            passes.entry(name.clone()).or_insert_with(|| mean(&seconds));
        }
        TimeReport {
            warm_up: 0.0,
            setup: mean(&|run| run.setup),
            bvh: mean(&|run| run.statistics.time.bvh),
            compile: mean(&|run| run.statistics.time.compile),
            denoise: mean(&|run| run.snapshots.last().map_or(0.0, |snapshot| snapshot.denoise)),
            passes,
        }
    }
}

impl SnapshotReport {
    fn new(budget: f64, rows: &[&Row], images: &[&Image], reference: &Reference) -> SnapshotReport {
        let values = |f: &dyn Fn(&Row) -> f64| rows.iter().map(|row| f(row)).collect::<Vec<_>>();
        let mean = |f: &dyn Fn(&Row) -> f64| Interval::of_mean(&values(f));
        let error = |f: &dyn Fn(&Row) -> f64| Interval::of_geometric_mean(&values(f));
        let part = |index: usize| {
            let parts: Option<Vec<f64>> = rows.iter().map(|row| row.parts.map(|parts| parts[index])).collect();
            parts.filter(|parts| parts.iter().all(|x| x.is_finite())).map(|parts| Interval::of_geometric_mean(&parts))
        };
        let [bias, variance] = bias_and_variance(images, reference);
        let flips: Option<Vec<f64>> = rows.iter().map(|row| row.flip).collect();
        let estimates: Option<Vec<f64>> = rows.iter().map(|row| row.estimate).collect();
        let floor = reference.floor().unwrap_or(0.0);
        let ratio = |row: &&Row| {
            let is_resolved = row.relmse > ABOVE_FLOOR * floor;
            row.estimate.filter(|_| is_resolved).map(|estimate| estimate / (row.relmse - floor))
        };
        let ratios: Option<Vec<f64>> = rows.iter().map(ratio).collect();
        let mut techniques: Vec<Technique> = Vec::new();
        for row in rows {
            if !techniques.contains(&row.technique) {
                techniques.push(row.technique);
            }
        }
        SnapshotReport {
            budget,
            techniques,
            time: mean(&|row| row.time),
            samples: mean(&|row| f64::from(row.samples)),
            rmse: error(&|row| row.rmse),
            relmse: error(&|row| row.relmse),
            estimate: estimates.map(|estimates| Interval::of_geometric_mean(&estimates)),
            estimate_ratio: ratios.map(|ratios| Interval::of_geometric_mean(&ratios)),
            mae: error(&|row| row.mae),
            p99: error(&|row| row.p99),
            flip: flips.map(|flips| Interval::of_geometric_mean(&flips)),
            bias,
            variance,
            relmse_boundary: part(0),
            relmse_elsewhere: part(1),
            rays: mean_rays(rows),
        }
    }
}

fn mean_rays(rows: &[&Row]) -> Rays {
    let mean = |f: &dyn Fn(&Rays) -> u64| rows.iter().map(|row| f(&row.rays)).sum::<u64>() / rows.len() as u64;
    Rays {
        camera: mean(&|r| r.camera),
        photon: mean(&|r| r.photon),
        cell: mean(&|r| r.cell),
        shadow: mean(&|r| r.shadow),
        audit: mean(&|r| r.audit),
        bounce: mean(&|r| r.bounce),
        gather: mean(&|r| r.gather),
        ..Rays::default()
    }
    .summed()
}

/// Splits relMSE into bias and variance, with the jackknife's intervals over the runs.
///
/// The errors of two different runs have independent noise, so the mean of their products is the bias, plus the error
/// of the reference. The product of an image's error with itself contains its variance too.
fn bias_and_variance(images: &[&Image], reference: &Reference) -> [Interval; 2] {
    let products = products(images, &reference.image);
    let floor = reference.floor().unwrap_or(0.0);
    let split = |without: Option<usize>| {
        let kept: Vec<usize> = (0..images.len()).filter(|i| Some(*i) != without).collect();
        let n = kept.len() as f64;
        let own: f64 = kept.iter().map(|&i| products[i][i]).sum();
        let all: f64 = kept.iter().flat_map(|&i| kept.iter().map(move |&j| (i, j))).map(|(i, j)| products[i][j]).sum();
        let shared = (all - own) / (n * (n - 1.0));
        (shared - floor, own / n - shared)
    };
    [
        Interval::jackknife(images.len(), |without| split(without).0),
        Interval::jackknife(images.len(), |without| split(without).1),
    ]
}

/// The mean product of the differences of each pair of images.
fn products(images: &[&Image], reference: &Image) -> Vec<Vec<f64>> {
    let differences: Vec<Vec<f64>> = images.iter().map(|image| differences(image, reference)).collect();
    let product = |a: &Vec<f64>, b: &Vec<f64>| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len() as f64;
    differences.iter().map(|a| differences.iter().map(|b| product(a, b)).collect()).collect()
}

/// The relative differences from the reference; relMSE is the mean of their squares.
fn differences(image: &Image, reference: &Image) -> Vec<f64> {
    let pairs = channels(image).zip(channels(reference));
    let difference = |(x, r): (&f32, &f32)| {
        let (x, r) = (f64::from(*x), f64::from(*r));
        (x - r) / (r * r + RELMSE_FLOOR).sqrt()
    };
    pairs.flat_map(|((_, x), (_, r))| x.iter().zip(r).map(difference)).collect()
}

/// relMSE over the pixels whose mask equals `inside`; NaN if there are none.
fn masked_relmse(image: &Image, reference: &Image, mask: &[bool], inside: bool) -> f64 {
    let differences = differences(image, reference);
    let within = differences.iter().zip(mask.iter().cycle()).filter(|(_, m)| **m == inside);
    let (sum, count) = within.fold((0.0, 0u32), |(sum, count), (d, _)| (sum + d * d, count + 1));
    sum / f64::from(count)
}
