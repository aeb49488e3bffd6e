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
use super::curve::{Comparison, Curve, ratio};
use super::interval::Interval;
use super::metrics::{Measures, RELMSE_FLOOR};
use super::reference::{Reference, variance};
use super::run::{Run, Snapshot};

/// Runs of a technique that intervals need: the jackknife leaves one out, and a variance needs two.
pub const LEAST_REPEATS: usize = 3;

/// What the others are compared with: the technique that traces every shadow ray.
const BASELINE: Technique = Technique::TwoPass;

/// A technique's light is called too strong or too weak from here on: less does not change an 8-bit code of mid grey.
const BRIGHTNESS: f64 = 0.005;

/// A technique is called biased where so much of its error is bias: less is lost in the noise of the picture.
const BIAS_SHARE: f64 = 0.1;

/// An error is not told from the reference's own where it is less than so many times that.
const ABOVE_FLOOR: f64 = 2.0;

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
    /// A technique each.
    pub techniques: Vec<TechniqueReport>,
    /// Each technique against `two-pass`.
    pub comparisons: Vec<ComparisonReport>,
    /// The photons' classes, of the techniques that ask them.
    pub classes: Vec<Classes>,
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
    /// The power of time with which relMSE falls: -1 for unbiased sampling, less set-up.
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
    /// Until the first sample: all of the set-up.
    pub setup: f64,
    /// Of which building the BVH.
    pub bvh: f64,
    /// Compilation, that after the pilot included.
    pub compile: f64,
    /// On the device, by kernel and entry point, until the last budget.
    pub passes: BTreeMap<String, f64>,
}

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

/// The images of all runs at a budget.
#[derive(Clone, Debug, Serialize)]
pub struct SnapshotReport {
    /// Seconds that were allowed.
    pub budget: f64,
    /// Seconds that were used.
    pub time: Interval,
    /// Samples a pixel.
    pub samples: Interval,
    /// See [`Measures`].
    pub rmse: Interval,
    /// See [`Measures`].
    pub relmse: Interval,
    /// See [`Measures`].
    pub mae: Interval,
    /// See [`Measures`].
    pub p99: Interval,
    /// See [`Measures`].
    pub flip: Interval,
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
    /// Seconds of everything else but the reference, up to the writing of this.
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
    measures: Measures,
    /// relMSE where photons do not decide, and elsewhere.
    parts: Option<[f64; 2]>,
    rays: Rays,
}

impl Report {
    /// Measures the runs, of which there must be the same number, at least [`LEAST_REPEATS`], of each technique, taken
    /// in turn.
    ///
    /// # Errors
    /// As [`Measures::new`].
    pub fn new(
        scene: &str,
        device: &DeviceInfo,
        reference: &Reference,
        runs: &[Run],
        classes: Vec<Classes>,
    ) -> Result<Report> {
        let mask = classes.first().map(Classes::mask);
        let snapshots: Vec<_> = runs.iter().flat_map(|run| run.snapshots.iter().map(move |s| (run, s))).collect();
        let row = |(run, snapshot): &(&Run, &Snapshot)| Row::new(run, snapshot, reference, mask.as_deref());
        let rows = snapshots.par_iter().map(row).collect::<Result<Vec<_>>>()?;

        let of = |technique: Technique| runs.iter().filter(move |run| run.settings.technique == technique);
        let present = |technique: &Technique| of(*technique).any(|run| !run.snapshots.is_empty());
        let present: Vec<Technique> = Technique::ALL.into_iter().filter(present).collect();
        let curves = |technique: Technique| -> Vec<Curve> {
            let curve = |run: &Run| {
                let own = rows.iter().filter(|row| row.is_of(run));
                Curve::new(own.map(|row| (row.time, row.measures.relmse)))
            };
            of(technique).filter(|run| !run.snapshots.is_empty()).map(curve).collect()
        };
        let curves: Vec<Vec<Curve>> = present.iter().map(|technique| curves(*technique)).collect();
        let techniques: Vec<TechniqueReport> = present
            .par_iter()
            .zip(&curves)
            .filter_map(|(technique, curves)| {
                let runs: Vec<&Run> = of(*technique).collect();
                TechniqueReport::new(&runs, curves, &rows, reference)
            })
            .collect();
        let baseline = present.iter().position(|technique| *technique == BASELINE);
        let others = present.iter().zip(&curves).filter(|(technique, _)| **technique != BASELINE);
        let comparisons = baseline.map_or(Vec::new(), |baseline| {
            let compare = |(technique, ours): (&Technique, &Vec<Curve>)| {
                let Comparison { time, error_ratio, error, time_ratio } = Comparison::new(ours, &curves[baseline]);
                ComparisonReport { technique: *technique, time, error_ratio, relmse: error, time_ratio }
            };
            others.map(compare).collect()
        });
        let map_left_out = runs.iter().find_map(|run| run.map_left_out.as_deref());
        let advice = advice(&techniques, &present, &curves, &comparisons, map_left_out);
        Ok(Report {
            schema: 1,
            version: env!("CARGO_PKG_VERSION"),
            scene: scene.to_owned(),
            device: device.clone(),
            advice,
            reference: ReferenceReport {
                samples: reference.samples(),
                standard_error: reference.standard_error(),
                relmse: reference.floor(),
            },
            techniques,
            comparisons,
            classes,
            overhead: Overhead::default(),
            rows,
        })
    }

    /// Every image by itself, as comma-separated values with a line of names.
    pub fn csv(&self) -> String {
        let mut text = "technique,seed,budget,time,samples,rmse,relmse,mae,p99,flip,relmse_boundary,relmse_elsewhere,\
                        rays_camera,rays_photon,rays_shadow,rays_audit,rays_bounce,rays_gather,rays_total\n"
            .to_owned();
        for Row { technique, seed, budget, time, samples, measures, parts, rays } in &self.rows {
            let Measures { rmse, relmse, mae, p99, flip } = measures;
            let [boundary, elsewhere] = parts.map_or(Default::default(), |parts| parts.map(|x| x.to_string()));
            let Rays { camera, photon, shadow, audit, bounce, gather, total } = rays;
            // A String takes whatever is written.
            let _ = writeln!(
                text,
                "{technique},{seed},{budget},{time},{samples},{rmse},{relmse},{mae},{p99},{flip},{boundary},{elsewhere},\
                 {camera},{photon},{shadow},{audit},{bounce},{gather},{total}"
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
    fn new(run: &Run, snapshot: &Snapshot, reference: &Reference, mask: Option<&[bool]>) -> Result<Row> {
        let Snapshot { budget, time, samples, rays, image } = snapshot;
        let measures = Measures::new(image, &reference.image)?;
        let parts = mask.map(|mask| [true, false].map(|inside| masked_relmse(image, &reference.image, mask, inside)));
        let Settings { technique, seed, .. } = run.settings;
        Ok(Row { technique, seed, budget: *budget, time: *time, samples: *samples, measures, parts, rays: *rays })
    }

    fn is_of(&self, run: &Run) -> bool {
        self.technique == run.settings.technique && self.seed == run.settings.seed
    }
}

impl TechniqueReport {
    /// None where no budget has an image of every run.
    fn new(runs: &[&Run], curves: &[Curve], rows: &[Row], reference: &Reference) -> Option<TechniqueReport> {
        let budgets = runs[0].snapshots.iter().map(|snapshot| snapshot.budget);
        let snapshots: Vec<(SnapshotReport, Vec<&Image>)> = budgets
            .filter_map(|budget| {
                let all = runs.iter().flat_map(|run| &run.snapshots);
                let images: Vec<&Image> = all.filter(|s| s.budget == budget).map(|s| &s.image).collect();
                let own = |row: &&Row| row.budget == budget && runs.iter().any(|run| row.is_of(run));
                let rows: Vec<&Row> = rows.iter().filter(own).collect();
                (images.len() == runs.len()).then(|| (SnapshotReport::new(budget, &rows, &images, reference), images))
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
        let slopes: Option<Vec<f64>> = curves.iter().map(Curve::slope).collect();
        Some(TechniqueReport {
            settings: runs[0].settings.clone(),
            left_out: runs[0].statistics.left_out.clone(),
            notes: runs[0].statistics.notes.clone(),
            time: TimeReport {
                setup: mean(&|run| run.setup),
                bvh: mean(&|run| run.statistics.time.bvh),
                compile: mean(&|run| run.statistics.time.compile),
                passes,
            },
            slope: slopes.map(|slopes| Interval::of_mean(&slopes)),
            brightness,
            verdict,
            snapshots: snapshots.into_iter().map(|(report, _)| report).collect(),
        })
    }
}

impl SnapshotReport {
    fn new(budget: f64, rows: &[&Row], images: &[&Image], reference: &Reference) -> SnapshotReport {
        let mean = |f: &dyn Fn(&Row) -> f64| Interval::of_mean(&rows.iter().map(|row| f(row)).collect::<Vec<_>>());
        let part = |index: usize| {
            let parts: Option<Vec<f64>> = rows.iter().map(|row| row.parts.map(|parts| parts[index])).collect();
            parts.filter(|parts| parts.iter().all(|x| x.is_finite())).map(|parts| Interval::of_mean(&parts))
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
        let rays = |f: &dyn Fn(&Rays) -> u64| rows.iter().map(|row| f(&row.rays)).sum::<u64>() / rows.len() as u64;
        SnapshotReport {
            budget,
            time: mean(&|row| row.time),
            samples: mean(&|row| f64::from(row.samples)),
            rmse: mean(&|row| row.measures.rmse),
            relmse: mean(&|row| row.measures.relmse),
            mae: mean(&|row| row.measures.mae),
            p99: mean(&|row| row.measures.p99),
            flip: mean(&|row| row.measures.flip),
            bias: Interval::jackknife(images.len(), |without| split(without).0),
            variance: Interval::jackknife(images.len(), |without| split(without).1),
            relmse_boundary: part(0),
            relmse_elsewhere: part(1),
            rays: Rays {
                camera: rays(&|r| r.camera),
                photon: rays(&|r| r.photon),
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
fn channels(image: &Image) -> impl Iterator<Item = (&'static str, &[f32])> {
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

/// Mean radiance over the reference's, less 1.
fn brightness(images: &[&Image], reference: &Reference) -> Interval {
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

fn verdict(last: &SnapshotReport, brightness: &Interval, floor: Option<f64>) -> Verdict {
    let percent = |x: f64| format!("{:.1} %", 100.0 * x);
    let error = last.relmse.value;
    let share = |part: f64| (part / error).clamp(0.0, 1.0);
    if !brightness.holds(0.0) && brightness.value.abs() >= BRIGHTNESS {
        let (word, sign) = if brightness.value > 0.0 { ("strong", 1.0) } else { ("weak", -1.0) };
        let mut ends = [sign * brightness.low, sign * brightness.high];
        ends.sort_by(f64::total_cmp);
        let [low, high] = ends.map(percent);
        let text = format!("biased: its light is too {word} by {} ({low} to {high})", percent(brightness.value.abs()));
        return Verdict { kind: VerdictKind::Bias, text };
    }
    if floor.is_some_and(|floor| error < ABOVE_FLOOR * floor) {
        let text = "as near as the reference can tell".to_owned();
        return Verdict { kind: VerdictKind::Reference, text };
    }
    let bias = share(last.bias.value);
    if last.bias.low > 0.0 && bias >= BIAS_SHARE {
        let part = if floor.is_some() { "" } else { ", or the reference's, whose error is not known" };
        let text = format!("biased: {} of relMSE stays however long it renders{part}", percent(bias));
        return Verdict { kind: VerdictKind::Bias, text };
    }
    let text = format!("noise: {} of relMSE differs from run to run", percent(share(last.variance.value)));
    Verdict { kind: VerdictKind::Noise, text }
}

/// Which technique to use, and why.
fn advice(
    techniques: &[TechniqueReport],
    present: &[Technique],
    curves: &[Vec<Curve>],
    comparisons: &[ComparisonReport],
    map_left_out: Option<&str>,
) -> String {
    let biased = |technique: Technique| {
        let report = techniques.iter().find(|report| report.settings.technique == technique);
        report.is_none_or(|report| report.verdict.kind == VerdictKind::Bias)
    };
    let mut candidates: Vec<usize> = (0..present.len()).filter(|i| !biased(present[*i])).collect();
    if candidates.is_empty() {
        return "No technique is free of bias here: see what the error of each is made of.".to_owned();
    }
    // An error that two reach, where there are two, in every run.
    let reached = |i: usize| curves[i].iter().map(|curve| curve.last().1).fold(0.0, f64::max);
    let mut errors: Vec<f64> = candidates.iter().map(|i| reached(*i)).collect();
    errors.sort_by(f64::total_cmp);
    let target = round_up(errors[1.min(errors.len() - 1)]);
    let time = |i: usize| -> Option<f64> {
        let times: Option<Vec<f64>> = curves[i].iter().map(|curve| curve.time_at(target)).collect();
        let times = times?;
        Some((times.iter().map(|time| time.ln()).sum::<f64>() / times.len() as f64).exp())
    };
    candidates.retain(|i| time(*i).is_some());
    candidates.sort_by(|a, b| time(*a).partial_cmp(&time(*b)).unwrap_or(std::cmp::Ordering::Equal));
    let best = candidates[0];
    let found = format!("relMSE {target:.0e} in {:.2} s", time(best).unwrap_or(f64::NAN));
    let other = candidates[1..].iter().find(|i| present[**i] == BASELINE).or(candidates.get(1));
    let sooner = other.and_then(|other| {
        let ratio = ratio(&curves[*other], &curves[best], |curve| curve.time_at(target))?;
        Some((present[*other], ratio))
    });
    let mut text = match sooner {
        Some((other, Interval { value, low, high })) if low > 1.0 => format!(
            "Use {}: it reaches {found}, {value:.2} times sooner than {other} ({low:.2} to {high:.2} times).",
            present[best]
        ),
        Some((other, Interval { low, high, .. })) => format!(
            "{} reaches {found}, but {other} may be as soon ({low:.2} to {high:.2} times as long).",
            present[best]
        ),
        None => format!("Use {}: it alone reaches {found}.", present[best]),
    };
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

/// The next of 1, 2 and 5 times a power of ten.
fn round_up(x: f64) -> f64 {
    let power = 10f64.powf(x.max(f64::MIN_POSITIVE).log10().floor());
    [1.0, 2.0, 5.0].map(|digit| digit * power).into_iter().find(|rounded| *rounded >= x).unwrap_or(10.0 * power)
}
