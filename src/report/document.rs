//! What a report says, in the form of `report.json`; `docs/report.md` describes it.

use std::collections::BTreeMap;
use std::fmt::Write;

use rayon::prelude::*;
use serde::Serialize;

use crate::gpu::DeviceInfo;
use crate::settings::{Settings, Technique};
use crate::statistics::Rays;
use crate::{Image, Result};

use super::classes::Classes;
use super::curve::{Comparison, Curve};
use super::interval::Interval;
use super::metrics::{self, RELMSE_FLOOR};
use super::reference::Reference;
use super::run::{Run, Snapshot};
use super::sweep::Sweep;
use super::verdict::{Late, Verdict, advice, brightness, too_short, verdict};

/// Runs of a technique that intervals need: the jackknife leaves one out, and a variance needs two.
pub const LEAST_REPEATS: usize = 3;

/// What the others are compared with: the technique that traces every shadow ray.
pub(super) const BASELINE: Technique = Technique::TwoPass;

/// A report.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Version of the schema: raised when a key changes its meaning or goes.
    pub schema: u32,
    /// Version of Penumbra.
    pub version: &'static str,
    /// The scene's file.
    pub scene: String,
    /// The device.
    pub device: DeviceInfo,
    /// Which technique to use for this scene, and why.
    pub advice: String,
    /// What was compared with.
    pub reference: ReferenceReport,
    /// Runs of each technique.
    pub runs: usize,
    /// A technique each.
    pub techniques: Vec<TechniqueReport>,
    /// Each technique against `two-pass`.
    pub comparisons: Vec<ComparisonReport>,
    /// The photons' classes, of the techniques that ask them.
    pub classes: Vec<Classes>,
    /// What settings of the visibility map do.
    pub sweeps: Vec<Sweep>,
    /// What the report took beside the runs.
    pub overhead: Overhead,
    /// Every image by itself.
    #[serde(skip)]
    pub rows: Vec<Row>,
}

/// What was compared with.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceReport {
    /// See [`Reference::samples`].
    pub samples: Option<u32>,
    /// See [`Reference::standard_error`].
    pub standard_error: Option<f64>,
    /// See [`Reference::goal`].
    pub goal: Option<f64>,
    /// See [`Reference::floor`].
    pub relmse: Option<f64>,
}

/// What a technique did.
#[derive(Clone, Debug, Serialize)]
pub struct TechniqueReport {
    /// The settings of the first run.
    pub settings: Settings,
    /// What was left out because the scene does not need it.
    pub left_out: Vec<String>,
    /// Remarks.
    pub notes: Vec<String>,
    /// Where the time goes: means over the runs.
    pub time: TimeReport,
    /// The power of the time after set-up with which relMSE falls: -1 for independent unbiased samples.
    pub slope: Option<Interval>,
    /// Mean radiance over the reference's at the last budget, less 1.
    pub brightness: Interval,
    /// What the error is made of.
    pub verdict: Verdict,
    /// A budget each, where all runs had new samples.
    pub snapshots: Vec<SnapshotReport>,
}

/// Seconds.
#[derive(Clone, Debug, Serialize)]
pub struct TimeReport {
    /// What [`warm_up`](super::run::warm_up) took before the runs; counts in none of them.
    pub warm_up: f64,
    /// Until the first sample: all of the set-up.
    pub setup: f64,
    /// Of which building the BVH.
    pub bvh: f64,
    /// Compilation, that after the pilot included.
    pub compile: f64,
    /// On the device, by kernel and entry point, until the last budget.
    pub passes: BTreeMap<String, f64>,
}

/// The images of all runs at a budget.
#[derive(Clone, Debug, Serialize)]
pub struct SnapshotReport {
    /// Seconds that were allowed.
    pub budget: f64,
    /// Seconds that were used.
    pub time: Interval,
    /// Samples a pixel.
    pub samples: Interval,
    /// See [`metrics::rmse`].
    pub rmse: Interval,
    /// See [`metrics::relmse`].
    pub relmse: Interval,
    /// See [`metrics::mae`].
    pub mae: Interval,
    /// See [`metrics::p99`].
    pub p99: Interval,
    /// See [`metrics::flip`]; of the last budget alone, as it takes longer than all other measures together.
    pub flip: Option<Interval>,
    /// The part of relMSE that more samples of the same seeds' kind would leave.
    pub bias: Interval,
    /// The part of relMSE that differs from run to run.
    pub variance: Interval,
    /// relMSE of the pixels where photons do not decide.
    pub relmse_boundary: Option<Interval>,
    /// relMSE of the other pixels.
    pub relmse_elsewhere: Option<Interval>,
    /// Rays: means over the runs.
    pub rays: Rays,
}

/// A technique against `two-pass`.
#[derive(Clone, Debug, Serialize)]
pub struct ComparisonReport {
    /// The technique.
    pub technique: Technique,
    /// Seconds at which errors are compared.
    pub time: f64,
    /// relMSE over that of `two-pass` then.
    pub error_ratio: Option<Interval>,
    /// relMSE at which times are compared.
    pub relmse: f64,
    /// Time over that of `two-pass` until then.
    pub time_ratio: Option<Interval>,
}

/// What a report took beside the runs.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Overhead {
    /// Seconds of the runs.
    pub runs: f64,
    /// Seconds of everything else but the reference, warm-ups and sweeps, up to the writing of this.
    pub report: f64,
    /// The second over the first.
    pub share: f64,
}

/// One image of one run.
#[derive(Clone, Debug)]
pub struct Row {
    technique: Technique,
    seed: u32,
    budget: f64,
    time: f64,
    samples: u32,
    rmse: f64,
    relmse: f64,
    mae: f64,
    p99: f64,
    flip: Option<f64>,
    /// relMSE where photons do not decide, and elsewhere.
    parts: Option<[f64; 2]>,
    rays: Rays,
}

impl Report {
    /// Measures the runs, of which there must be the same number, at least [`LEAST_REPEATS`], of each technique, taken
    /// in turn; one will do of a technique that has no image in time.
    ///
    /// # Errors
    /// As [`metrics::rmse`]; [`crate::Error::Usage`] where no technique has an image of all its runs at one budget.
    pub fn new(
        scene: &str,
        device: &DeviceInfo,
        reference: &Reference,
        runs: &[Run],
        classes: Vec<Classes>,
    ) -> Result<Report> {
        let mask = classes.first().map(Classes::mask);
        let of = |technique: Technique| -> Vec<&Run> {
            runs.iter().filter(|run| run.settings.technique == technique).collect()
        };
        let last = Technique::ALL.map(|technique| (technique, budgets(&of(technique)).last().copied()));
        let is_last = |run: &Run, snapshot: &Snapshot| last.contains(&(run.settings.technique, Some(snapshot.budget)));
        let snapshots: Vec<_> = runs.iter().flat_map(|run| run.snapshots.iter().map(move |s| (run, s))).collect();
        let row = |(run, snapshot): &(&Run, &Snapshot)| {
            Row::new(run, snapshot, reference, mask.as_deref(), is_last(run, snapshot))
        };
        let rows = snapshots.par_iter().map(row).collect::<Result<Vec<_>>>()?;

        let mut entrants = Vec::new();
        let mut late = Vec::new();
        for technique in Technique::ALL {
            let own = of(technique);
            match Entrant::new(&own, &rows, reference) {
                Some(entrant) => entrants.push(entrant),
                None if own.is_empty() => {}
                None => late.push(Late::new(technique, &own)),
            }
        }
        if entrants.is_empty() {
            return Err(too_short(&late));
        }
        let comparisons = compare(&entrants);
        let map_left_out = runs.iter().find_map(|run| run.map_left_out.as_deref());
        let advice = advice(&entrants, reference, &late, &comparisons, map_left_out);
        Ok(Report {
            schema: 1,
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
            runs: entrants[0].curves.len(),
            techniques: entrants.into_iter().map(|entrant| entrant.report).collect(),
            comparisons,
            classes,
            sweeps: Vec::new(),
            overhead: Overhead::default(),
            rows,
        })
    }

    /// Every image by itself, as comma-separated values with a line of names.
    pub fn csv(&self) -> String {
        let mut text = "technique,seed,budget,time,samples,rmse,relmse,mae,p99,flip,relmse_boundary,relmse_elsewhere,\
                        rays_camera,rays_photon,rays_cell,rays_shadow,rays_audit,rays_bounce,rays_gather,rays_total\n"
            .to_owned();
        for Row { technique, seed, budget, time, samples, rmse, relmse, mae, p99, flip, parts, rays } in &self.rows {
            let flip = flip.map_or(String::new(), |flip| flip.to_string());
            let [boundary, elsewhere] = parts.map_or(Default::default(), |parts| parts.map(|x| x.to_string()));
            let Rays { camera, photon, cell, shadow, audit, bounce, gather, total } = rays;
            // A String takes whatever is written.
            let _ = writeln!(
                text,
                "{technique},{seed},{budget},{time},{samples},{rmse},{relmse},{mae},{p99},{flip},{boundary},{elsewhere},\
                 {camera},{photon},{cell},{shadow},{audit},{bounce},{gather},{total}"
            );
        }
        text
    }
}

impl Overhead {
    /// Of what took `all` seconds, `runs` of which were runs.
    pub fn new(runs: f64, all: f64) -> Overhead {
        Overhead { runs, report: all - runs, share: (all - runs) / runs }
    }
}

impl Row {
    /// Of an image of a run; with its FLIP where it is of the `last` budget.
    fn new(run: &Run, snapshot: &Snapshot, reference: &Reference, mask: Option<&[bool]>, last: bool) -> Result<Row> {
        let Snapshot { budget, time, samples, rays, ref image } = *snapshot;
        let reference = &reference.image;
        let parts = mask.map(|mask| [true, false].map(|inside| masked_relmse(image, reference, mask, inside)));
        Ok(Row {
            technique: run.settings.technique,
            seed: run.settings.image.seed,
            budget,
            time,
            samples,
            rmse: metrics::rmse(image, reference)?,
            relmse: metrics::relmse(image, reference)?,
            mae: metrics::mae(image, reference)?,
            p99: metrics::p99(image, reference)?,
            flip: last.then(|| metrics::flip(image, reference)).transpose()?,
            parts,
            rays,
        })
    }

    fn is_of(&self, run: &Run) -> bool {
        self.technique == run.settings.technique && self.seed == run.settings.image.seed
    }
}

/// A technique with an image of every run at one budget at least.
pub(super) struct Entrant {
    pub report: TechniqueReport,
    /// relMSE of each run.
    pub curves: Vec<Curve>,
}

impl Entrant {
    fn new(runs: &[&Run], rows: &[Row], reference: &Reference) -> Option<Entrant> {
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
        let verdict = verdict(last, &brightness, reference.floor());
        let mean = |f: &dyn Fn(&Run) -> f64| runs.iter().map(|run| f(run)).sum::<f64>() / runs.len() as f64;
        let mut passes = BTreeMap::new();
        for name in runs.iter().flat_map(|run| run.statistics.time.passes.keys()) {
            let seconds = |run: &Run| run.statistics.time.passes.get(name).copied().unwrap_or(0.0);
            passes.entry(name.clone()).or_insert_with(|| mean(&seconds));
        }
        let curve = |run: &Run, from: f64| {
            let own = rows.iter().filter(|row| row.is_of(run));
            Curve::new(own.map(|row| (row.time - from, row.relmse)))
        };
        // Set-up is no sampling.
        let slopes: Option<Vec<f64>> = runs.iter().map(|run| curve(run, run.setup).slope()).collect();
        let report = TechniqueReport {
            settings: runs[0].settings.clone(),
            left_out: runs[0].statistics.left_out.clone(),
            notes: runs[0].statistics.notes.clone(),
            time: TimeReport {
                warm_up: 0.0,
                setup: mean(&|run| run.setup),
                bvh: mean(&|run| run.statistics.time.bvh),
                compile: mean(&|run| run.statistics.time.compile),
                passes,
            },
            slope: slopes.map(|slopes| Interval::of_mean(&slopes)),
            brightness,
            verdict,
            snapshots: snapshots.into_iter().map(|(report, _)| report).collect(),
        };
        Some(Entrant { report, curves: runs.iter().map(|run| curve(run, 0.0)).collect() })
    }

    pub fn technique(&self) -> Technique {
        self.report.settings.technique
    }
}

/// The budgets at which all of these runs have an image, in order.
fn budgets(runs: &[&Run]) -> Vec<f64> {
    let has = |run: &Run, budget: f64| run.snapshots.iter().any(|snapshot| snapshot.budget == budget);
    let first = runs.first().into_iter().flat_map(|run| &run.snapshots).map(|snapshot| snapshot.budget);
    first.filter(|budget| runs.iter().all(|run| has(run, *budget))).collect()
}

/// Each technique against the baseline, where that is there.
fn compare(entrants: &[Entrant]) -> Vec<ComparisonReport> {
    let Some(baseline) = entrants.iter().find(|entrant| entrant.technique() == BASELINE) else { return Vec::new() };
    let others = entrants.iter().filter(|entrant| entrant.technique() != BASELINE);
    let compare = |entrant: &Entrant| {
        let Comparison { time, error_ratio, error, time_ratio } = Comparison::new(&entrant.curves, &baseline.curves);
        ComparisonReport { technique: entrant.technique(), time, error_ratio, relmse: error, time_ratio }
    };
    others.map(compare).collect()
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
        let products = products(images, &reference.image);
        let floor = reference.floor().unwrap_or(0.0);
        // Products of different runs' errors have no noise in their mean; a run's with itself has.
        let split = |without: Option<usize>| {
            let kept: Vec<usize> = (0..images.len()).filter(|i| Some(*i) != without).collect();
            let n = kept.len() as f64;
            let own: f64 = kept.iter().map(|&i| products[i][i]).sum();
            let all: f64 =
                kept.iter().flat_map(|&i| kept.iter().map(move |&j| (i, j))).map(|(i, j)| products[i][j]).sum();
            let shared = (all - own) / (n * (n - 1.0));
            (shared - floor, own / n - shared)
        };
        let flips: Option<Vec<f64>> = rows.iter().map(|row| row.flip).collect();
        let rays = |f: &dyn Fn(&Rays) -> u64| rows.iter().map(|row| f(&row.rays)).sum::<u64>() / rows.len() as u64;
        SnapshotReport {
            budget,
            time: mean(&|row| row.time),
            samples: mean(&|row| f64::from(row.samples)),
            rmse: error(&|row| row.rmse),
            relmse: error(&|row| row.relmse),
            mae: error(&|row| row.mae),
            p99: error(&|row| row.p99),
            flip: flips.map(|flips| Interval::of_geometric_mean(&flips)),
            bias: Interval::jackknife(images.len(), |without| split(without).0),
            variance: Interval::jackknife(images.len(), |without| split(without).1),
            relmse_boundary: part(0),
            relmse_elsewhere: part(1),
            rays: Rays {
                camera: rays(&|r| r.camera),
                photon: rays(&|r| r.photon),
                cell: rays(&|r| r.cell),
                shadow: rays(&|r| r.shadow),
                audit: rays(&|r| r.audit),
                bounce: rays(&|r| r.bounce),
                gather: rays(&|r| r.gather),
                ..Rays::default()
            }
            .summed(),
        }
    }
}

/// The channels of an image whose size and channels are known to be right: [`Row::new`] has measured it.
pub(super) fn channels(image: &Image) -> impl Iterator<Item = (&'static str, &[f32])> {
    ["R", "G", "B"].into_iter().filter_map(|name| Some((name, image.channel(name)?)))
}

/// The differences from the reference that count in relMSE: its mean is that of their squares.
fn differences(image: &Image, reference: &Image) -> Vec<f64> {
    let pairs = channels(image).zip(channels(reference));
    let difference = |(x, r): (&f32, &f32)| {
        let (x, r) = (f64::from(*x), f64::from(*r));
        (x - r) / (r * r + RELMSE_FLOOR).sqrt()
    };
    pairs.flat_map(|((_, x), (_, r))| x.iter().zip(r).map(difference)).collect()
}

/// The mean products of the differences of every image with those of every other.
fn products(images: &[&Image], reference: &Image) -> Vec<Vec<f64>> {
    let differences: Vec<Vec<f64>> = images.iter().map(|image| differences(image, reference)).collect();
    let product = |a: &Vec<f64>, b: &Vec<f64>| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len() as f64;
    differences.iter().map(|a| differences.iter().map(|b| product(a, b)).collect()).collect()
}

/// relMSE over the pixels where the mask is as asked; NaN where there is none.
fn masked_relmse(image: &Image, reference: &Image, mask: &[bool], inside: bool) -> f64 {
    let differences = differences(image, reference);
    let within = differences.iter().zip(mask.iter().cycle()).filter(|(_, m)| **m == inside);
    let (sum, count) = within.fold((0.0, 0u32), |(sum, count), (d, _)| (sum + d * d, count + 1));
    sum / f64::from(count)
}
