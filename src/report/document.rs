//! The contents of a report, in the form of `report.json`; `docs/report.md` describes every key.

use std::collections::BTreeMap;
use std::fmt::Write;

use kernel_kit::DeviceInfo;
use serde::Serialize;

use super::classes::Classes;
use super::entrant::Entrant;
use super::finding::Finding;
use super::interval::Interval;
use super::sweep::Sweep;
use crate::settings::{Settings, Technique};
use crate::statistics::Rays;

/// Minimum number of runs of each entrant: the jackknife leaves one out, and a variance needs two.
pub const MIN_REPEATS: usize = 3;

/// The entrant that the others are compared with: it traces every shadow ray.
pub(super) const BASELINE: Entrant = Entrant::raw(Technique::TWO_PASS);

/// A report.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Version of the schema. Raised when a key changes its meaning or is removed.
    pub schema: u32,
    /// Version of Penumbra.
    pub version: &'static str,
    /// File name of the scene.
    pub scene: String,
    /// The device.
    pub device: DeviceInfo,
    /// Which entrant to use for this scene, and why.
    pub advice: String,
    /// The reference of all error measures.
    pub reference: ReferenceReport,
    /// Number of runs of each entrant.
    pub runs: usize,
    /// One entry per technique, alone or with a denoiser.
    pub entrants: Vec<EntrantReport>,
    /// Each entrant against `two-pass`.
    pub comparisons: Vec<ComparisonReport>,
    /// Each `auto` against the best other entrant, at each budget.
    pub auto: Vec<AutoReport>,
    /// The classes of the techniques that classify points.
    pub classes: Vec<Classes>,
    /// Effects of the settings that were swept.
    pub sweeps: Vec<Sweep>,
    /// Time spent outside the runs.
    pub overhead: Overhead,
    /// The measures of each image.
    #[serde(skip)]
    pub rows: Vec<Row>,
}

/// The reference of all error measures.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceReport {
    /// See [`Reference::samples`](super::reference::Reference::samples).
    pub samples: Option<u32>,
    /// See [`Reference::standard_error`](super::reference::Reference::standard_error).
    pub standard_error: Option<f64>,
    /// See [`Reference::goal`](super::reference::Reference::goal).
    pub goal: Option<f64>,
    /// See [`Reference::floor`](super::reference::Reference::floor).
    pub relmse: Option<f64>,
}

/// Results of an entrant.
#[derive(Clone, Debug, Serialize)]
pub struct EntrantReport {
    /// The name.
    pub entrant: Entrant,
    /// The denoisers that filtered its images; empty for raw images.
    pub denoisers: Vec<&'static str>,
    /// The settings of the first run.
    pub settings: Settings,
    /// Parts left out because the scene does not need them.
    pub left_out: Vec<String>,
    /// Remarks.
    pub notes: Vec<String>,
    /// Where the time is spent: means over the runs.
    pub time: TimeReport,
    /// The exponent of relMSE as a power of the time after set-up: -1 for independent, unbiased samples.
    pub slope: Option<Interval>,
    /// Mean radiance over the reference's at the last budget, minus 1.
    pub brightness: Interval,
    /// What the error consists of.
    pub finding: Finding,
    /// One entry per budget at which all runs had new samples.
    pub snapshots: Vec<SnapshotReport>,
}

/// Times in seconds.
#[derive(Clone, Debug, Serialize)]
pub struct TimeReport {
    /// Duration of the [`warm_up`](super::run::Starter::warm_up) before the runs. Not part of any run.
    pub warm_up: f64,
    /// All of the set-up, until the first sample.
    pub setup: f64,
    /// Building the BVH; part of the set-up.
    pub bvh: f64,
    /// Compilation.
    pub compile: f64,
    /// Removing the noise of the last image; 0 without a denoiser.
    pub denoise: f64,
    /// Time on the device until the last budget, by kernel and entry point, without the denoiser's.
    pub passes: BTreeMap<String, f64>,
}

/// Measures of the images of all runs at a budget.
#[derive(Clone, Debug, Serialize)]
pub struct SnapshotReport {
    /// The budget in seconds.
    pub budget: f64,
    /// The techniques that rendered the images, each once: more than one only if the runs of `auto` differ.
    pub techniques: Vec<Technique>,
    /// Seconds used.
    pub time: Interval,
    /// Samples per pixel.
    pub samples: Interval,
    /// See [`rmse`](super::metrics::rmse).
    pub rmse: Interval,
    /// See [`relmse`](super::metrics::relmse).
    pub relmse: Interval,
    /// The relMSE that the denoiser estimates without a reference. `None` without a denoiser, and for images of a
    /// single sample.
    pub estimate: Option<Interval>,
    /// `estimate` over the measured relMSE without the reference's own. `None` where that is not well above it.
    pub estimate_ratio: Option<Interval>,
    /// See [`mae`](super::metrics::mae).
    pub mae: Interval,
    /// See [`p99`](super::metrics::p99).
    pub p99: Interval,
    /// See [`flip`](super::metrics::flip). At the last budget only: it takes longer than all other measures together.
    pub flip: Option<Interval>,
    /// The part of relMSE that is the same in every run. It remains with more samples, unless it is that of a denoiser.
    pub bias: Interval,
    /// The part of relMSE that differs from run to run.
    pub variance: Interval,
    /// relMSE of the pixels classified boundary or unknown.
    pub relmse_boundary: Option<Interval>,
    /// relMSE of the other pixels.
    pub relmse_elsewhere: Option<Interval>,
    /// Rays: means over the runs.
    pub rays: Rays,
}

/// An entrant against `two-pass`.
#[derive(Clone, Debug, Serialize)]
pub struct ComparisonReport {
    /// The entrant.
    pub entrant: Entrant,
    /// The time in seconds at which errors are compared.
    pub time: f64,
    /// relMSE over the relMSE of `two-pass` at that time.
    pub error_ratio: Option<Interval>,
    /// The relMSE at which times are compared.
    pub relmse: f64,
    /// Time to reach that relMSE over the time of `two-pass`.
    pub time_ratio: Option<Interval>,
}

/// `auto` at a budget, against the other entrant with the smallest relMSE.
#[derive(Clone, Debug, Serialize)]
pub struct AutoReport {
    /// `auto`, alone or with a denoiser.
    pub entrant: Entrant,
    /// The budget in seconds.
    pub budget: f64,
    /// The techniques that it took, each once.
    pub techniques: Vec<Technique>,
    /// Its relMSE.
    pub relmse: Interval,
    /// The other entrant.
    pub best: Entrant,
    /// The relMSE of that one's last image within the budget.
    pub best_relmse: Interval,
    /// `relmse` over `best_relmse`, run by run.
    pub ratio: Interval,
}

/// Time that a report spends outside its runs.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Overhead {
    /// Seconds of the runs.
    pub runs: f64,
    /// Seconds of everything else until the report is written, except for the reference, warm-ups and sweeps.
    pub report: f64,
    /// `report` over `runs`.
    pub share: f64,
}

/// The measures of one image of one run.
#[derive(Clone, Debug)]
pub struct Row {
    pub(super) entrant: Entrant,
    pub(super) seed: u32,
    pub(super) budget: f64,
    pub(super) technique: Technique,
    /// For `auto`: the best other entrant at this budget, and the relMSE over that of its run with the same seed.
    pub(super) best: Option<(Entrant, f64)>,
    pub(super) time: f64,
    /// The part of `time` in which the noise was removed.
    pub(super) denoise: f64,
    pub(super) samples: u32,
    pub(super) rmse: f64,
    pub(super) relmse: f64,
    pub(super) estimate: Option<f64>,
    pub(super) mae: f64,
    pub(super) p99: f64,
    pub(super) flip: Option<f64>,
    /// relMSE of pixels classified boundary or unknown, and of all others.
    pub(super) parts: Option<[f64; 2]>,
    pub(super) rays: Rays,
}

impl Report {
    /// The measures of each image as comma-separated values, after a header line.
    pub fn csv(&self) -> String {
        let mut text = "entrant,seed,budget,time,denoise,samples,rmse,relmse,estimate,mae,p99,flip,\
                        relmse_boundary,relmse_elsewhere,rays_camera,rays_photon,rays_cell,rays_shadow,rays_audit,\
                        rays_bounce,rays_gather,rays_total,technique,best,relmse_over_best\n"
            .to_owned();
        let optional = |value: &Option<f64>| value.map_or(String::new(), |value| value.to_string());
        for row in &self.rows {
            let Row { entrant, seed, budget, time, denoise, samples, rmse, relmse, mae, p99, parts, rays, .. } = row;
            let best = row.best.map_or(",".to_owned(), |(best, ratio)| format!("{best},{ratio}"));
            let technique = row.technique;
            let [estimate, flip] = [&row.estimate, &row.flip].map(optional);
            let [boundary, elsewhere] = parts.map_or(Default::default(), |parts| parts.map(|x| x.to_string()));
            let Rays { camera, photon, cell, shadow, audit, bounce, gather, total } = rays;
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{entrant},{seed},{budget},{time},{denoise},{samples},{rmse},{relmse},{estimate},{mae},{p99},{flip},\
                 {boundary},{elsewhere},{camera},{photon},{cell},{shadow},{audit},{bounce},{gather},{total},\
                 {technique},{best}"
            );
        }
        text
    }
}

impl Overhead {
    /// From the seconds of the runs and of everything, runs included.
    pub fn new(runs: f64, all: f64) -> Overhead {
        Overhead { runs, report: all - runs, share: (all - runs) / runs }
    }
}
