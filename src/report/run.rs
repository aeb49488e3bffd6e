//! Timed renders with snapshots at time budgets.

use std::collections::BTreeMap;
use std::time::Instant;

use kernel_kit::Gpu;

use super::entrant::Entrant;
use super::estimate;
use crate::settings::Settings;
use crate::specialisation::features::Feature;
use crate::statistics::{Rays, Statistics};
use crate::techniques::auto::Choice;
use crate::{Camera, Denoiser, Image, Renderer, Result, Scene, Technique};

/// A snapshot may be late by this factor of its budget: the duration of a batch is predicted from the previous one.
const MAX_LATENESS: f64 = 1.1;

/// The scene under measurement, rendered by several techniques and seeds.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// The scene.
    pub scene: &'a Scene,
    /// The camera.
    pub camera: &'a Camera,
    /// Settings of all renders, except for technique, denoiser, seed and samples.
    pub settings: &'a Settings,
    /// Time of first samples on this machine over the expected time; 1 if nothing is known.
    pub slowness: f64,
}

impl<'a> Subject<'a> {
    /// Creates a renderer of this scene with the given settings.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub(super) fn renderer(&self, settings: &Settings) -> Result<Renderer<'a>> {
        Renderer::new(self.gpu, self.scene.clone(), self.camera, settings)
    }
}

/// A render of one entrant and seed.
pub struct Run {
    /// Whether the technique was chosen for each budget, and the image rendered anew.
    pub is_automatic: bool,
    /// The settings of this run. If there is a choice at each budget, they are those of the last one.
    pub settings: Settings,
    /// Seconds until the first sample: BVH, compilation, upload of the scene, photons and their grid.
    pub setup: f64,
    /// Seconds until the first image, even one too late for all budgets. `None` if set-up and denoiser take longer than
    /// the longest budget.
    pub first: Option<f64>,
    /// The image at each budget that added samples.
    pub snapshots: Vec<Snapshot>,
    /// The image of the last snapshot before denoising: the channels `R`, `G`, `B` and, if it is known, `error`, the
    /// estimated standard error of the denoised image. `None` without a denoiser.
    pub noisy: Option<Image>,
    /// The names of the denoisers.
    pub denoisers: Vec<&'static str>,
    /// Seconds that removing the noise of the last image took, or is expected to take; 0 without a denoiser.
    pub denoise: f64,
    /// Statistics at the end; pass times are those of this run alone, without the denoiser's.
    pub statistics: Statistics,
    /// Why the technique left out the visibility map that it would have used, if it did.
    pub map_left_out: Option<String>,
    /// Seconds until the last image, without the time for snapshots; with a choice for each budget the sum over them.
    pub time: f64,
}

/// The state of a run at a budget.
pub struct Snapshot {
    /// The budget in seconds.
    pub budget: f64,
    /// The technique that rendered it.
    pub technique: Technique,
    /// Seconds from the imported scene to the last sample, including set-up.
    pub sampled: f64,
    /// Seconds that removing the noise took; 0 without a denoiser.
    pub denoise: f64,
    /// Samples per pixel.
    pub samples: u32,
    /// Rays traced so far.
    pub rays: Rays,
    /// The channels `R`, `G` and `B`, without noise if there is a denoiser.
    pub image: Image,
    /// The relMSE that the denoiser expects of it. `None` without a denoiser, and of a single sample.
    pub estimate: Option<f64>,
}

impl Snapshot {
    /// Seconds from the imported scene to this image. Close to the budget; the time axis of all curves.
    pub fn time(&self) -> f64 {
        self.sampled + self.denoise
    }
}

/// An entrant that is ready to run.
pub struct Starter {
    /// `None` for a choice at each budget.
    technique: Option<Technique>,
    denoiser: Denoiser,
    /// Seconds of the warm-up; 0 before it.
    pub warm_up: f64,
    /// Seconds that removing the noise of an image is expected to take.
    denoise: f64,
}

impl Starter {
    /// A starter for a technique, or for a choice at each budget if it is `None`. `denoiser` filters the images, if it
    /// holds any filter.
    pub fn new(technique: impl Into<Option<Technique>>, denoiser: Denoiser) -> Starter {
        Starter { technique: technique.into(), denoiser, warm_up: 0.0, denoise: 0.0 }
    }

    /// Its name.
    pub fn entrant(&self) -> Entrant {
        Entrant { technique: self.technique, denoise: self.denoiser.choice() }
    }

    /// Takes two untimed samples, and removes the noise of their image three times.
    ///
    /// The driver compiles every kernel on first use and caches it. That can take many times as long as later runs, and
    /// is no property of the entrant. If the first sample takes longer than the longest of the `budgets` (seconds,
    /// ascending), the second is skipped: no timed run will have an image in time. `auto` does so with each technique
    /// and each distribution of samples that it takes.
    ///
    /// # Errors
    /// As [`Renderer::new`], [`Renderer::render_batch`] and [`Renderer::add_denoised`].
    pub fn warm_up(&mut self, subject: &Subject<'_>, budgets: &[f64]) -> Result<()> {
        let start = Instant::now();
        let longest = budgets.last().copied().unwrap_or(0.0);
        let mut warm = Vec::new();
        // The choice for the longest budget is repeated at the end, when the time of the denoiser is known.
        for &budget in budgets.iter().rev().chain(budgets.last()) {
            let settings = self.settings(subject, subject.settings.image.seed, budget - self.denoise);
            // Adaptive sampling has kernels of its own.
            let kernels = (settings.technique, settings.image.sampling);
            if !warm.contains(&kernels) {
                warm.push(kernels);
                self.warm_up_with(subject, &settings, longest)?;
            }
        }
        self.warm_up = start.elapsed().as_secs_f64();
        Ok(())
    }

    fn warm_up_with(&mut self, subject: &Subject<'_>, settings: &Settings, longest: f64) -> Result<()> {
        let mut renderer = subject.renderer(settings)?;
        let sample = Instant::now();
        renderer.render_up_to(1)?;
        subject.gpu.wait("warm-up")?;
        if sample.elapsed().as_secs_f64() <= longest {
            // Later samples find fine cells.
            renderer.render_up_to(1)?;
            subject.gpu.wait("warm-up")?;
        }
        if self.entrant().is_denoised() {
            // The first filter compiles. The others tell how long before a budget sampling has to end. The shorter of
            // the two counts: if the machine did other work during the longer one, no time would be left for samples.
            let mut took = [0.0; 3];
            for seconds in &mut took {
                let start = Instant::now();
                renderer.add_denoised(&mut renderer.image()?, &self.denoiser)?;
                *seconds = start.elapsed().as_secs_f64();
            }
            self.denoise = took[1].min(took[2]);
        }
        Ok(())
    }

    /// The settings for an image whose samples must end within `within` seconds, which a choice of technique depends
    /// on.
    fn settings(&self, subject: &Subject<'_>, seed: u32, within: f64) -> Settings {
        let Subject { gpu, scene, camera, settings, slowness } = *subject;
        let settings = settings.clone().with(|s| {
            s.image.denoise = self.denoiser.choice();
            s.image.seed = seed;
            s.image.spp = Settings::UNLIMITED_SPP;
            s.image.aovs = Vec::new();
        });
        if let Some(technique) = self.technique {
            return settings.with(|s| s.technique = technique);
        }
        let Choice { technique, sampling, .. } = Choice::new(gpu, scene, camera, &settings, Some(within), slowness);
        settings.with(|s| (s.technique, s.image.sampling) = (technique, sampling))
    }
}

impl Run {
    /// Renders until the last of the `budgets`, given in seconds and ascending; `auto` renders anew for each. `None`
    /// once `stop` returns true.
    ///
    /// # Errors
    /// As [`Renderer::new`], [`Renderer::render_batch`] and [`Renderer::add_denoised`].
    pub fn new(
        subject: &Subject<'_>,
        starter: &Starter,
        seed: u32,
        budgets: &[f64],
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Run>> {
        let is_automatic = starter.entrant().is_automatic();
        let mut denoise = starter.denoise;
        let start = |budget: f64| TimedRender::start(subject, starter, seed, budget);
        let mut timed = start(budgets.first().copied().unwrap_or(0.0) - denoise)?;
        let mut snapshots: Vec<Snapshot> = Vec::new();
        let mut noisy = None;
        // Times of the renders for earlier budgets.
        let (mut spent, mut first) = (0.0, None);
        for (index, &budget) in budgets.iter().enumerate() {
            if is_automatic && index > 0 {
                spent += timed.time + denoise;
                first = first.or(timed.first);
                timed = start(budget - denoise)?;
            }
            // An image is ready once its noise is removed.
            if !timed.render_until(budget - denoise, stop)? {
                return Ok(None);
            }
            let shown = snapshots.last().filter(|_| !is_automatic).map_or(0, |snapshot| snapshot.samples);
            if timed.renderer.samples() > shown && timed.time + denoise <= MAX_LATENESS * budget {
                let (snapshot, before) = timed.snapshot(budget, &starter.denoiser)?;
                denoise = snapshot.denoise;
                if snapshot.time() <= MAX_LATENESS * budget {
                    snapshots.push(snapshot);
                    noisy = before;
                }
            }
        }
        let first = first.or(timed.first);
        let TimedRender { renderer, settings, setup, time, passes, .. } = timed;
        let mut statistics = renderer.statistics()?;
        statistics.time.passes = passes;
        statistics.time.passes.retain(|name, _| !name.starts_with(DENOISER_PASSES));
        let left_out = || renderer.specialisation().left_out.iter().find(|item| item.feature == Feature::VisibilityMap);
        let uses_map = settings.technique.uses_visibility_map();
        let map_left_out = uses_map.then(left_out).flatten().map(|item| item.reason.clone());
        Ok(Some(Run {
            is_automatic,
            settings,
            setup,
            first: first.map(|first| first + denoise),
            snapshots,
            noisy,
            denoisers: starter.denoiser.names().collect(),
            denoise,
            statistics,
            map_left_out,
            time: spent + time + denoise,
        }))
    }

    /// The entrant that ran.
    pub fn entrant(&self) -> Entrant {
        let Entrant { technique, denoise } = Entrant::of(&self.settings);
        Entrant { technique: technique.filter(|_| !self.is_automatic), denoise }
    }
}

/// A render with its clock, which stops while a snapshot is taken.
struct TimedRender<'a> {
    renderer: Renderer<'a>,
    settings: Settings,
    /// Seconds until the first sample.
    setup: f64,
    /// Seconds so far.
    time: f64,
    /// Seconds until the first image.
    first: Option<f64>,
    /// Pass times up to the last sample.
    passes: BTreeMap<String, f64>,
}

impl<'a> TimedRender<'a> {
    /// Starts a render whose samples must end within `within` seconds.
    fn start(subject: &Subject<'a>, starter: &Starter, seed: u32, within: f64) -> Result<TimedRender<'a>> {
        let gpu = subject.gpu;
        // The clone is not part of the time.
        let scene = subject.scene.clone();
        let start = Instant::now();
        let settings = starter.settings(subject, seed, within);
        let renderer = Renderer::new(gpu, scene, subject.camera, &settings)?;
        let setup = start.elapsed().as_secs_f64();
        let passes = renderer.pass_times()?;
        Ok(TimedRender { renderer, settings, setup, time: setup, first: None, passes })
    }

    /// Takes the samples expected to end within `budget`, in seconds since the start. False once `stop` returns true.
    fn render_until(&mut self, budget: f64, stop: &dyn Fn() -> bool) -> Result<bool> {
        // A budget that set-up has used up gets no image.
        while self.time < budget {
            if stop() {
                return Ok(false);
            }
            let start = Instant::now();
            let progress = self.renderer.render_within(budget - self.time)?;
            // Better indirect light may have taken the time of the samples that were to follow.
            self.time += start.elapsed().as_secs_f64();
            self.passes = self.renderer.pass_times()?;
            if progress.is_none() {
                break;
            }
            self.first.get_or_insert(self.time);
        }
        Ok(true)
    }

    /// The snapshot, and the image before its noise was removed, if it was; see [`Run::noisy`].
    fn snapshot(&self, budget: f64, denoiser: &Denoiser) -> Result<(Snapshot, Option<Image>)> {
        let mut image = self.renderer.image()?;
        let start = Instant::now();
        self.renderer.add_denoised(&mut image, denoiser)?;
        let took = start.elapsed().as_secs_f64();
        let denoised = image.denoised();
        let snapshot = |image: Image, denoise: f64, estimate: Option<f64>| -> Result<Snapshot> {
            let (samples, rays) = (self.renderer.samples(), self.renderer.statistics()?.rays);
            let technique = self.settings.technique;
            let (sampled, image) = (self.time, image.colour());
            Ok(Snapshot { budget, technique, sampled, denoise, samples, rays, image, estimate })
        };
        match denoised {
            None => Ok((snapshot(image, 0.0, None)?, None)),
            Some(denoised) => {
                let snapshot = snapshot(denoised, took, estimate::denoised_relmse(&image))?;
                image.channels.retain(|channel| ["R", "G", "B", "error"].contains(&channel.name.as_str()));
                Ok((snapshot, Some(image)))
            }
        }
    }
}

/// The kernel of the statistical denoiser. The images of all budgets run it, and the last one alone counts.
const DENOISER_PASSES: &str = "denoise/";
