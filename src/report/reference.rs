//! The reference of error measures: a given image, or one made by path tracing in two independent halves, whose
//! difference estimates its error.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use super::metrics::{self, variance};
use super::run::Subject;
use crate::render::film::Metadata;
use crate::settings::{Settings, Technique};
use crate::{Error, Image, Renderer, Result};

/// Interval between saves of the halves. The first saves come sooner, because a small image reaches its goal quickly.
const SAVE_INTERVAL: Duration = Duration::from_secs(10);
const FIRST_SAVE_INTERVAL: Duration = Duration::from_millis(250);

/// First seed of references, far from the seeds that users choose, so that no image is compared with its own samples.
const FIRST_SEED: u32 = 1 << 31;

/// Interval at which a waiting process checks the lock.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// Limit on the samples and sessions of a half. Below it neither their sums nor the seeds overflow.
const MAX_COUNT: i32 = 1 << 29;

/// Part of the key of a reference in the cache. Raise it when images of `path` change by more than noise, so that older
/// references are not found any more.
const EDITION: u32 = 1;

const SAMPLES: &str = "samplesPerPixel";
const SESSIONS: &str = "penumbra:sessions";
const SECONDS: &str = "penumbra:seconds";

/// A reference with its own error, if known.
pub struct Reference {
    /// Channels `R`, `G` and `B`, and if known `variance.R` and so on: the variance of the pixel's mean.
    pub image: Image,
    /// The goal for the standard error, if the reference was made here. The actual one is larger if time ran out.
    pub goal: Option<f64>,
}

/// When a reference is complete: as soon as it has reached the standard error or has taken the time.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// See [`Reference::standard_error`].
    pub standard_error: f64,
    /// Seconds of rendering, including earlier sessions.
    pub seconds: f64,
}

/// Progress of a reference that is being made.
#[derive(Clone, Copy, Debug)]
pub struct ReferenceProgress {
    /// Samples per pixel of both halves together.
    pub samples: u32,
    /// See [`Reference::standard_error`].
    pub standard_error: f64,
}

impl Reference {
    /// Reads an image of any format that [`Image::read`] supports.
    ///
    /// # Errors
    /// As [`Image::read`]; also [`Error::Input`] if it lacks a colour channel or has a sample that is not finite.
    pub fn read(path: &Path) -> Result<Reference> {
        let image = Image::read(path)?;
        // Comparing the image with itself finds its faults before anything is rendered.
        metrics::rmse(&image, &image).map_err(|error| match error {
            Error::Input { location, problem, .. } => Error::input(path, location, problem),
            other => other,
        })?;
        for name in ["R", "G", "B"].map(variance) {
            let bad = |x: &f32| !x.is_finite() || *x < 0.0;
            if image.channel(&name).is_some_and(|samples| samples.iter().any(bad)) {
                return Err(Error::input(path, name, "a variance is a finite number, 0 or more"));
            }
        }
        Ok(Reference { image, goal: None })
    }

    /// Renders a reference by path tracing until it reaches its goal, or continues the one in `folder`.
    ///
    /// If several processes make the same reference, one renders and the others wait. Returns `None` once `stop`
    /// returns true. The samples so far then stay in `folder`, as they do if the process is killed. `on_save` is called
    /// after each save.
    ///
    /// # Errors
    /// Those of [`Renderer`], [`Error::Output`] if `folder` cannot be written, [`Error::Input`] if a file in it is
    /// damaged.
    pub fn make(
        subject: &Subject<'_>,
        folder: &Path,
        goal: Goal,
        stop: &dyn Fn() -> bool,
        on_save: &mut dyn FnMut(ReferenceProgress),
    ) -> Result<Option<Reference>> {
        let size = [subject.settings.image.width, subject.settings.image.height];
        let open = || -> Result<[Half; 2]> { Ok([Half::open(folder, 0, size)?, Half::open(folder, 1, size)?]) };
        if let Some(reference) = complete(&open()?, goal)? {
            return Ok(Some(reference));
        }
        fs::create_dir_all(folder).map_err(|problem| Error::output(folder, problem))?;
        // If another process makes the same reference, waiting for it is the fastest way to have it.
        let Some(_lock) = lock(folder, stop) else { return Ok(None) };
        let halves = open()?;
        if let Some(reference) = complete(&halves, goal)? {
            return Ok(Some(reference));
        }
        Session::start(halves, subject)?.render(goal, stop, on_save)
    }

    /// The mean of two independent halves. Its variance is estimated by a quarter of their squared difference.
    ///
    /// # Errors
    /// [`Error::Input`] if a colour channel is missing, a sample is not finite, or the sizes differ.
    pub fn of_halves(a: &Image, b: &Image) -> Result<Reference> {
        metrics::rmse(a, b)?;
        let mut image = Image::new(a.width, a.height);
        let merge = |a: &[f32], b: &[f32], f: fn(f64, f64) -> f64| -> Vec<f32> {
            a.iter().zip(b).map(|(a, b)| f(f64::from(*a), f64::from(*b)) as f32).collect()
        };
        for name in ["R", "G", "B"] {
            let find = |half: &Image| half.channel(name).map(<[f32]>::to_vec).ok_or_else(|| missing("half", name));
            let (a, b) = (find(a)?, find(b)?);
            image.add_channel(name, merge(&a, &b, |a, b| 0.5 * (a + b)));
            image.add_channel(variance(name), merge(&a, &b, |a, b| 0.25 * (a - b) * (a - b)));
        }
        let samples = integer(a, SAMPLES).saturating_add(integer(b, SAMPLES));
        image.metadata.insert(SAMPLES.to_owned(), Metadata::Int(samples));
        image.metadata.insert(SECONDS.to_owned(), Metadata::Float(seconds(a) as f32));
        image.metadata.insert("penumbra:technique".to_owned(), Metadata::Text(Technique::PATH.name().to_owned()));
        Ok(Reference { image, goal: None })
    }

    /// Whether the reference was made here and time ran out before its goal was reached.
    pub fn is_short(&self) -> bool {
        self.goal.is_some_and(|goal| self.standard_error() > Some(goal))
    }

    /// Samples per pixel, if the file states them.
    pub fn samples(&self) -> Option<u32> {
        u32::try_from(integer(&self.image, SAMPLES)).ok().filter(|samples| *samples > 0)
    }

    /// Square root of the pixels' mean variance, over the mean radiance. `None` if the variance is not known.
    pub fn standard_error(&self) -> Option<f64> {
        let variance = metrics::mean_with_variance(&self.image, |_, variance| variance).ok()?;
        let radiance = metrics::mean_with_variance(&self.image, |r, _| r).ok()?;
        // A black reference without variance is exact. The absolute value keeps the error of a negative image positive.
        Some(if variance == 0.0 { 0.0 } else { variance.sqrt() / radiance.abs() })
    }

    /// The expected relMSE of a perfect image against this reference. Curves below it mean nothing.
    pub fn floor(&self) -> Option<f64> {
        metrics::relmse_of_noise(&self.image).ok()
    }
}

/// The reference of two saved halves, if it has reached its goal.
fn complete(halves: &[Half; 2], goal: Goal) -> Result<Option<Reference>> {
    let [Some(a), Some(b)] = halves.each_ref().map(|half| half.saved.as_ref()) else { return Ok(None) };
    let reference = Reference { goal: Some(goal.standard_error), ..Reference::of_halves(a, b)? };
    Ok(Some(reference).filter(|reference| !reference.is_short() || seconds(a) >= goal.seconds))
}

/// Renders both halves of a reference, continuing from what was saved.
struct Session<'g> {
    halves: [Half; 2],
    renderers: Vec<Renderer<'g>>,
    /// Seconds of earlier sessions.
    earlier: f64,
    began: Instant,
}

impl<'g> Session<'g> {
    fn start(mut halves: [Half; 2], subject: &Subject<'g>) -> Result<Session<'g>> {
        let mut renderers = Vec::new();
        for half in &mut halves {
            renderers.push(half.renderer(subject)?);
        }
        let earlier = halves[0].saved.as_ref().map_or(0.0, seconds);
        Ok(Session { halves, renderers, earlier, began: Instant::now() })
    }

    /// Seconds of rendering, including earlier sessions.
    fn spent(&self) -> f64 {
        self.earlier + self.began.elapsed().as_secs_f64()
    }

    fn samples(&self) -> u32 {
        self.renderers[1].samples()
    }

    fn render(
        mut self,
        goal: Goal,
        stop: &dyn Fn() -> bool,
        on_save: &mut dyn FnMut(ReferenceProgress),
    ) -> Result<Option<Reference>> {
        let mut wait = FIRST_SAVE_INTERVAL;
        loop {
            let start = Instant::now();
            // At least one sample is taken, however short the time.
            while (self.samples() == 0 || start.elapsed() < wait && self.spent() < goal.seconds) && !stop() {
                for renderer in &mut self.renderers {
                    renderer.render_batch()?;
                }
            }
            wait = (2 * wait).min(SAVE_INTERVAL);
            if self.samples() == 0 {
                return Ok(None);
            }
            let seconds = self.spent();
            let a = self.halves[0].save(&self.renderers[0], seconds)?;
            let b = self.halves[1].save(&self.renderers[1], seconds)?;
            let reference = Reference { goal: Some(goal.standard_error), ..Reference::of_halves(&a, &b)? };
            let standard_error = reference.standard_error().unwrap_or(0.0);
            on_save(ReferenceProgress { samples: reference.samples().unwrap_or(0), standard_error });
            if !reference.is_short() || seconds >= goal.seconds {
                return Ok(Some(reference));
            }
            if stop() {
                return Ok(None);
            }
        }
    }
}

/// The folder in `cache` for files that depend on the scene, the camera and the settings that `path` uses.
pub fn cache_folder(cache: &Path, subject: &Subject<'_>) -> PathBuf {
    let (width, height, max_bounces, light_scale) = (
        subject.settings.image.width,
        subject.settings.image.height,
        subject.settings.indirect.max_bounces,
        subject.settings.light_scale,
    );
    cache.join(subject.scene.fingerprint(&(EDITION, subject.camera, width, height, max_bounces, light_scale)))
}

/// Waits until no other process makes the reference in `folder`. Returns `None` once `stop` returns true, and
/// `Some(None)` where folders cannot be locked; the last process to save wins then. The system releases the lock when
/// its process ends.
fn lock(folder: &Path, stop: &dyn Fn() -> bool) -> Option<Option<File>> {
    let Ok(handle) = File::open(folder) else { return Some(None) };
    loop {
        match handle.try_lock() {
            Ok(()) => return Some(Some(handle)),
            Err(TryLockError::Error(_)) => return Some(None),
            Err(TryLockError::WouldBlock) if stop() => return None,
            Err(TryLockError::WouldBlock) => thread::sleep(POLL_INTERVAL),
        }
    }
}

/// One of two independent halves of a reference.
struct Half {
    index: u32,
    file: PathBuf,
    /// The image on disk.
    saved: Option<Image>,
    /// Number of renderers so far. Each has its own seed, so that its samples are new.
    sessions: u32,
}

impl Half {
    fn open(folder: &Path, index: u32, size: [u32; 2]) -> Result<Half> {
        let file = folder.join(format!("half-{index}.exr"));
        let saved = file.exists().then(|| Image::read(&file)).transpose()?;
        if let Some(saved) = &saved {
            let fits = [saved.width, saved.height] == size && metrics::rmse(saved, saved).is_ok();
            let counts = [SAMPLES, SESSIONS].map(|name| integer(saved, name));
            if !fits || counts.iter().any(|count| !(1..MAX_COUNT).contains(count)) {
                return Err(Error::input(&file, "file", "the file does not belong to this reference; delete it"));
            }
        }
        let sessions = saved.as_ref().map_or(0, |image| integer(image, SESSIONS)) as u32;
        Ok(Half { index, file, saved, sessions })
    }

    fn renderer<'g>(&mut self, subject: &Subject<'g>) -> Result<Renderer<'g>> {
        let seed = FIRST_SEED + 2 * self.sessions + self.index;
        self.sessions += 1;
        subject.renderer(&subject.settings.clone().with(|s| {
            s.technique = Technique::PATH;
            // Paths refuse some strategies, and the reference of a scene is the same with each.
            s.light_sampling.strategy = None;
            s.image.seed = seed;
            s.image.spp = Settings::UNLIMITED_SPP;
            s.image.aovs = Vec::new();
            // A limit biases the image, and references serve reports without one too.
            s.indirect.clamp = None;
        }))
    }

    /// Merges the renderer's image with the one saved before it started, and writes the result. `seconds` is the total
    /// rendering time.
    fn save(&self, renderer: &Renderer<'_>, seconds: f64) -> Result<Image> {
        let mut image = renderer.image()?.colour();
        let new = renderer.samples() as i32;
        let old = self.saved.as_ref().map_or(0, |saved| integer(saved, SAMPLES));
        if let Some(saved) = &self.saved {
            let share = f64::from(old) / f64::from(old + new);
            for channel in &mut image.channels {
                let before = saved.channel(&channel.name).ok_or_else(|| missing(&self.file, &channel.name))?;
                for (x, before) in channel.samples.iter_mut().zip(before) {
                    *x = (share * f64::from(*before) + (1.0 - share) * f64::from(*x)) as f32;
                }
            }
        }
        image.metadata.insert(SAMPLES.to_owned(), Metadata::Int(old + new));
        image.metadata.insert(SESSIONS.to_owned(), Metadata::Int(self.sessions as i32));
        image.metadata.insert(SECONDS.to_owned(), Metadata::Float(seconds as f32));
        image.write_exr(&self.file)?;
        Ok(image)
    }
}

/// An integer attribute; 0 if it is missing.
fn integer(image: &Image, name: &str) -> i32 {
    match image.metadata.get(name) {
        Some(Metadata::Int(value)) => *value,
        _ => 0,
    }
}

/// The total rendering time in seconds; 0 if it is missing.
fn seconds(image: &Image) -> f64 {
    match image.metadata.get(SECONDS) {
        // A damaged file may have any value.
        Some(Metadata::Float(seconds)) => f64::from(*seconds).max(0.0),
        _ => 0.0,
    }
}

fn missing(file: impl AsRef<Path>, channel: &str) -> Error {
    Error::input(file, channel, "there is no such channel; delete the file")
}
