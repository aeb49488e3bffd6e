//! Renders with snapshots at time budgets.

use std::collections::BTreeMap;
use std::time::Instant;

use crate::gpu::Gpu;
use crate::settings::{Settings, Technique};
use crate::statistics::{Rays, Statistics};
use crate::{Camera, Image, Renderer, Result, Scene};

/// A snapshot may come so much later than its budget, as the length of a batch is foretold by the last one's.
const LATEST: f64 = 1.1;

/// What is rendered again and again.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// The scene.
    pub scene: &'a Scene,
    /// The camera.
    pub camera: &'a Camera,
    /// What all renders share; their techniques, seeds and samples are their own.
    pub settings: &'a Settings,
}

impl<'a> Subject<'a> {
    /// A renderer with other settings.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub(super) fn renderer(&self, settings: &Settings) -> Result<Renderer<'a>> {
        Renderer::new(self.gpu, self.scene.clone(), self.camera, settings)
    }
}

/// A render of one technique and seed.
pub struct Run {
    /// What it was rendered with.
    pub settings: Settings,
    /// Seconds until the first sample: hierarchy, compilation, tables, photons and their grid.
    pub setup: f64,
    /// Seconds until the first image, in time or not; none where set-up alone took longer than the budgets.
    pub first: Option<f64>,
    /// The image at each budget that brought new samples.
    pub snapshots: Vec<Snapshot>,
    /// At the end, with the times of this run's passes alone.
    pub statistics: Statistics,
    /// Why the technique does without the visibility map that it would ask, where it does.
    pub map_left_out: Option<String>,
    /// Seconds that count, to the last sample: snapshots do not.
    pub time: f64,
    /// Those, and the seconds of what was prepared for samples that the last budget had no room for.
    pub spent: f64,
}

/// A run at a budget.
pub struct Snapshot {
    /// The budget in seconds.
    pub budget: f64,
    /// Seconds from the imported scene to this image, set-up and all: near the budget, and what curves are drawn over.
    pub time: f64,
    /// Samples a pixel.
    pub samples: u32,
    /// Rays so far.
    pub rays: Rays,
    /// The image: `R`, `G` and `B`.
    pub image: Image,
}

/// Takes the first samples, after which the driver has compiled every kernel and keeps it; says how many seconds that took. Where
/// kernels are new to a driver that is a multiple of what it takes from then on, and no property of a technique. One sample will
/// do where it takes longer than the `longest` budget, in seconds, as there will be no image in time.
///
/// # Errors
/// As [`Renderer::new`] and [`Renderer::render_batch`].
pub fn warm_up(subject: &Subject<'_>, technique: Technique, longest: f64) -> Result<f64> {
    let start = Instant::now();
    let mut renderer = subject.renderer(&settings(subject, technique, subject.settings.image.seed))?;
    let sample = Instant::now();
    renderer.render_at_most(1)?;
    subject.gpu.wait("warm-up")?;
    if sample.elapsed().as_secs_f64() <= longest {
        // The pilot may leave the visibility map out, and other kernels follow.
        renderer.render_at_most(1)?;
        subject.gpu.wait("warm-up")?;
    }
    Ok(start.elapsed().as_secs_f64())
}

fn settings(subject: &Subject<'_>, technique: Technique, seed: u32) -> Settings {
    subject.settings.clone().with(|s| {
        s.technique = technique;
        s.image.seed = seed;
        s.image.spp = Settings::UNLIMITED_SPP;
        s.image.aovs = Vec::new();
    })
}

impl Run {
    /// Renders until the last of the `budgets`, in seconds and in order. Nothing where `stop` says so.
    ///
    /// # Errors
    /// As [`Renderer::new`] and [`Renderer::render_batch`].
    pub fn new(
        subject: &Subject<'_>,
        technique: Technique,
        seed: u32,
        budgets: &[f64],
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Run>> {
        let settings = settings(subject, technique, seed);
        let passes_before = subject.gpu.pass_times()?;
        let scene = subject.scene.clone();

        let start = Instant::now();
        let mut renderer = Renderer::new(subject.gpu, scene, subject.camera, &settings)?;
        let setup = start.elapsed().as_secs_f64();
        let mut time = setup;
        // When the last sample was there: what is prepared for the next ones adds nothing to the image.
        let mut sampled = setup;
        let mut first = None;
        // Until then, for the same reason.
        let mut passes = subject.gpu.pass_times()?;
        let mut snapshots: Vec<Snapshot> = Vec::new();
        // Seconds a sample, once one is known.
        let mut pace = None;
        for &budget in budgets {
            loop {
                let start = Instant::now();
                renderer.refine()?;
                time += start.elapsed().as_secs_f64();
                let left = budget - time;
                let limit = pace.map_or(u32::from(left > 0.0), |pace: f64| (left / pace) as u32);
                if limit == 0 {
                    break;
                }
                if stop() {
                    return Ok(None);
                }
                let (before, start) = (renderer.samples(), Instant::now());
                renderer.render_at_most(limit)?;
                let took = start.elapsed().as_secs_f64();
                time += took;
                sampled = time;
                first.get_or_insert(sampled);
                pace = Some(took / f64::from(renderer.samples() - before));
                passes = subject.gpu.pass_times()?;
            }
            let shown = snapshots.last().map_or(0, |snapshot| snapshot.samples);
            if renderer.samples() > shown && sampled <= LATEST * budget {
                snapshots.push(Snapshot {
                    budget,
                    time: sampled,
                    samples: renderer.samples(),
                    rays: renderer.statistics()?.rays,
                    image: colour(renderer.image()?),
                });
            }
        }
        let mut statistics = renderer.statistics()?;
        statistics.time.passes = difference(&passes, &passes_before);
        let left_out = || renderer.specialisation().left_out.iter().find(|item| item.name == "visibility_map");
        let map_left_out = technique.uses_visibility_map().then(left_out).flatten().map(|item| item.reason.clone());
        Ok(Some(Run { settings, setup, first, snapshots, statistics, map_left_out, time: sampled, spent: time }))
    }
}

/// The image without channels that are not its colour.
pub(super) fn colour(mut image: Image) -> Image {
    image.channels.retain(|channel| ["R", "G", "B"].contains(&channel.name.as_str()));
    image
}

/// The device adds up passes over all renders.
fn difference(after: &BTreeMap<String, f64>, before: &BTreeMap<String, f64>) -> BTreeMap<String, f64> {
    let spent = |name: &String, seconds: f64| seconds - before.get(name).unwrap_or(&0.0);
    let passes = after.iter().map(|(name, seconds)| (name.clone(), spent(name, *seconds)));
    passes.filter(|(_, seconds)| *seconds > 0.0).collect()
}
