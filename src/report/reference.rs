//! What images are compared with: a given image, or one made by path tracing in two independent halves, whose
//! difference says how far it is from the truth.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use crate::fingerprint::fingerprint;
use crate::render::film::Metadata;
use crate::settings::{Settings, Technique};
use crate::{Error, Image, Renderer, Result};

use super::metrics::{self, RELMSE_FLOOR};
use super::run::{Subject, colour};

/// Halves are saved this often, and at first sooner, as a small image is soon good enough.
const SAVE: Duration = Duration::from_secs(10);
const FIRST_SAVE: Duration = Duration::from_millis(250);

/// Seeds of references start here, far from those that people choose, so that nothing is compared with itself.
const FIRST_SEED: u32 = 1 << 31;

/// A process that waits for another looks this often whether it is done.
const LOOK: Duration = Duration::from_millis(200);

/// More samples or sessions than a half ever has: neither their sums nor the seeds overflow below.
const MAX_COUNT: i32 = 1 << 29;

const SAMPLES: &str = "samplesPerPixel";
const SESSIONS: &str = "penumbra:sessions";
const SECONDS: &str = "penumbra:seconds";

/// A reference and, where it is known, its own error.
pub struct Reference {
    /// `R`, `G` and `B`; `variance.R` and so on, the variance of the pixel's mean, where that is known.
    pub image: Image,
    /// The standard error that it was to have, where it was made; it has a larger one where its time was up.
    pub goal: Option<f64>,
}

/// When a reference is done: whichever comes first.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// See [`Reference::standard_error`].
    pub standard_error: f64,
    /// Seconds of rendering, those of earlier sessions included.
    pub seconds: f64,
}

/// How far a reference in the making is.
#[derive(Clone, Copy, Debug)]
pub struct Making {
    /// Samples a pixel of both halves.
    pub samples: u32,
    /// See [`Reference::standard_error`].
    pub standard_error: f64,
}

impl Reference {
    /// Reads an image of any format that [`Image::read`] knows.
    ///
    /// # Errors
    /// As [`Image::read`]; [`Error::Input`] too where it has no colour, or a number that is not finite.
    pub fn read(path: &Path) -> Result<Reference> {
        let image = Image::read(path)?;
        // What cannot be compared with itself can be compared with nothing: better known before anything is rendered.
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

    /// Renders one by path tracing until it reaches its goal, or takes up what `folder` has of it; of processes that make the same reference one does and the others wait. Nothing where `stop` says so; what there is then stays in `folder`, as it does should the
    /// process be killed. `tell` hears of each save.
    ///
    /// # Errors
    /// Those of [`Renderer`], [`Error::Output`] where `folder` cannot be written, [`Error::Input`] where a file in it
    /// is damaged.
    pub fn make(
        subject: &Subject<'_>,
        folder: &Path,
        goal: Goal,
        stop: &dyn Fn() -> bool,
        tell: &mut dyn FnMut(Making),
    ) -> Result<Option<Reference>> {
        let size = [subject.settings.image.width, subject.settings.image.height];
        let open = || -> Result<[Half; 2]> { Ok([Half::open(folder, 0, size)?, Half::open(folder, 1, size)?]) };
        let good = |halves: &[Half; 2]| -> Result<Option<Reference>> {
            let [Some(a), Some(b)] = halves.each_ref().map(|half| half.saved.as_ref()) else { return Ok(None) };
            let reference = Reference { goal: Some(goal.standard_error), ..Reference::of_halves(a, b)? };
            Ok(Some(reference).filter(|reference| !reference.is_short() || seconds(a) >= goal.seconds))
        };
        if let Some(reference) = good(&open()?)? {
            return Ok(Some(reference));
        }
        fs::create_dir_all(folder).map_err(|problem| Error::output(folder, problem))?;
        // Where another process makes the same reference, waiting for it is the fastest way to have it.
        let Some(_lock) = lock(folder, stop) else { return Ok(None) };
        let mut halves = open()?;
        if let Some(reference) = good(&halves)? {
            return Ok(Some(reference));
        }
        let mut renderers = Vec::new();
        for half in &mut halves {
            renderers.push(half.renderer(subject)?);
        }
        let before = halves[0].saved.as_ref().map_or(0.0, seconds);
        let began = Instant::now();
        let spent = || before + began.elapsed().as_secs_f64();
        let mut wait = FIRST_SAVE;
        loop {
            let start = Instant::now();
            // However short its time is, there is an image.
            let goes_on =
                |renderer: &Renderer| renderer.samples() == 0 || start.elapsed() < wait && spent() < goal.seconds;
            while goes_on(&renderers[1]) && !stop() {
                for renderer in &mut renderers {
                    renderer.render_batch()?;
                }
            }
            wait = (2 * wait).min(SAVE);
            if renderers[1].samples() == 0 {
                return Ok(None);
            }
            let seconds = spent();
            let [a, b] = [halves[0].save(&renderers[0], seconds)?, halves[1].save(&renderers[1], seconds)?];
            let reference = Reference { goal: Some(goal.standard_error), ..Reference::of_halves(&a, &b)? };
            let standard_error = reference.standard_error().unwrap_or(0.0);
            tell(Making { samples: reference.samples().unwrap_or(0), standard_error });
            if !reference.is_short() || seconds >= goal.seconds {
                return Ok(Some(reference));
            }
            if stop() {
                return Ok(None);
            }
        }
    }

    /// The mean of two independent halves, and a quarter of their squared difference: what the variance of that mean is
    /// expected to be.
    ///
    /// # Errors
    /// [`Error::Input`] where they have no colour, a number that is not finite, or not the same size.
    pub fn of_halves(a: &Image, b: &Image) -> Result<Reference> {
        metrics::rmse(a, b)?;
        let mut image = Image::new(a.width, a.height);
        let merge = |a: &[f32], b: &[f32], f: fn(f64, f64) -> f64| -> Vec<f32> {
            a.iter().zip(b).map(|(a, b)| f(f64::from(*a), f64::from(*b)) as f32).collect()
        };
        for name in ["R", "G", "B"] {
            let find = |half: &Image| half.channel(name).map(<[f32]>::to_vec).ok_or_else(|| lacks("half", name));
            let (a, b) = (find(a)?, find(b)?);
            image.add_channel(name, merge(&a, &b, |a, b| 0.5 * (a + b)));
            image.add_channel(variance(name), merge(&a, &b, |a, b| 0.25 * (a - b) * (a - b)));
        }
        let samples = integer(a, SAMPLES).saturating_add(integer(b, SAMPLES));
        image.metadata.insert(SAMPLES.to_owned(), Metadata::Int(samples));
        image.metadata.insert(SECONDS.to_owned(), Metadata::Float(seconds(a) as f32));
        image.metadata.insert("penumbra:technique".to_owned(), Metadata::Text(Technique::Path.name().to_owned()));
        Ok(Reference { image, goal: None })
    }

    /// It was made, and its time was up before its goal was reached.
    pub fn is_short(&self) -> bool {
        self.goal.is_some_and(|goal| self.standard_error() > Some(goal))
    }

    /// Samples a pixel, where the file says.
    pub fn samples(&self) -> Option<u32> {
        u32::try_from(integer(&self.image, SAMPLES)).ok().filter(|samples| *samples > 0)
    }

    /// Root of the mean variance of its pixels, over its mean radiance; none where its variance is not known.
    pub fn standard_error(&self) -> Option<f64> {
        let variance = self.mean(|_, variance| variance)?;
        let radiance = self.mean(|r, _| r)?;
        // A black reference without variance is exact. One that is negative is no render, and no better known for it.
        Some(if variance == 0.0 { 0.0 } else { variance.sqrt() / radiance.abs() })
    }

    /// The relMSE that the truth itself would have against it: no curve is to be believed below.
    pub fn floor(&self) -> Option<f64> {
        self.mean(|r, variance| variance / (r * r + RELMSE_FLOOR))
    }

    /// The mean over pixels and channels; none where the variance is not known.
    fn mean(&self, f: impl Fn(f64, f64) -> f64) -> Option<f64> {
        let mut sum = 0.0;
        for name in ["R", "G", "B"] {
            let (r, variance) = (self.image.channel(name)?, self.image.channel(&variance(name))?);
            sum += r.iter().zip(variance).map(|(r, v)| f(f64::from(*r), f64::from(*v))).sum::<f64>();
        }
        Some(sum / (3 * self.image.pixels()) as f64)
    }
}

/// The folder below `cache` for what belongs to a scene as it is seen with these settings.
pub fn cache_folder(cache: &Path, subject: &Subject<'_>) -> PathBuf {
    let (width, height, max_bounces, light_scale) = (
        subject.settings.image.width,
        subject.settings.image.height,
        subject.settings.indirect.max_bounces,
        subject.settings.light_scale,
    );
    cache.join(fingerprint(subject.scene, &(subject.camera, width, height, max_bounces, light_scale)))
}

/// Waits until no other process makes the reference in `folder`; none where `stop` says so. The system lets go of the lock when
/// its process ends, however it ends. Where folders cannot be locked, the last process to save has the last word.
fn lock(folder: &Path, stop: &dyn Fn() -> bool) -> Option<Option<File>> {
    let Ok(handle) = File::open(folder) else { return Some(None) };
    loop {
        match handle.try_lock() {
            Ok(()) => return Some(Some(handle)),
            Err(TryLockError::Error(_)) => return Some(None),
            Err(TryLockError::WouldBlock) if stop() => return None,
            Err(TryLockError::WouldBlock) => thread::sleep(LOOK),
        }
    }
}

/// One of two independent halves: what is on the disk, and what is rendered on top of it.
struct Half {
    index: u32,
    file: PathBuf,
    saved: Option<Image>,
    /// Renderers so far: each has a seed of its own, so that it brings new samples.
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
                return Err(Error::input(&file, "file", "is no half of this reference; delete the file"));
            }
        }
        let sessions = saved.as_ref().map_or(0, |image| integer(image, SESSIONS)) as u32;
        Ok(Half { index, file, saved, sessions })
    }

    fn renderer<'g>(&mut self, subject: &Subject<'g>) -> Result<Renderer<'g>> {
        let seed = FIRST_SEED + 2 * self.sessions + self.index;
        self.sessions += 1;
        subject.renderer(&subject.settings.clone().with(|s| {
            s.technique = Technique::Path;
            s.image.seed = seed;
            s.image.spp = Settings::UNLIMITED_SPP;
            s.image.aovs = Vec::new();
        }))
    }

    /// Writes and returns the mean of what was saved before the renderer began and of what it has, after so many seconds in all.
    fn save(&self, renderer: &Renderer<'_>, seconds: f64) -> Result<Image> {
        let mut image = colour(renderer.image()?);
        let new = renderer.samples() as i32;
        let old = self.saved.as_ref().map_or(0, |saved| integer(saved, SAMPLES));
        if let Some(saved) = &self.saved {
            let share = f64::from(old) / f64::from(old + new);
            for channel in &mut image.channels {
                let before = saved.channel(&channel.name).ok_or_else(|| lacks(&self.file, &channel.name))?;
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

/// The channel that has the variance of another.
pub(super) fn variance(channel: &str) -> String {
    format!("variance.{channel}")
}

/// An attribute, 0 where it is not there.
fn integer(image: &Image, name: &str) -> i32 {
    match image.metadata.get(name) {
        Some(Metadata::Int(value)) => *value,
        _ => 0,
    }
}

/// Seconds that both halves have been rendered for; 0 where the image does not say.
fn seconds(image: &Image) -> f64 {
    match image.metadata.get(SECONDS) {
        // What is damaged may say anything.
        Some(Metadata::Float(seconds)) => f64::from(*seconds).max(0.0),
        _ => 0.0,
    }
}

fn lacks(file: impl AsRef<Path>, channel: &str) -> Error {
    Error::input(file, channel, "there is no such channel; delete the file")
}
