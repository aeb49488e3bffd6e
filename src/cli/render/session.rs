//! A render from its first sample to its files.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread;
use std::time::{Duration, Instant};

use kernel_kit::Gpu;
use penumbra::internal::render::Checkpoint;
use penumbra::internal::render::recovery::{self, Failure, Salvage};
use penumbra::settings::Denoise;
use penumbra::{Denoiser, Error, Image, Renderer, Result, Settings, Statistics};

use super::arguments::Arguments;
use super::files::{Files, both, write_in_folder};
use super::inputs::Subject;
use super::notes::{Notes, say_denoised, summary};
use super::technique::FirstSample;
use super::times::Times;
use crate::cli::first_samples::FirstSamples;
use crate::cli::interrupt::Interrupt;
use crate::cli::progress::{Display, Goal, show_compilation};
use crate::cli::say;

/// Time between checkpoints: the maximum that a crash can lose.
const CHECKPOINT: Duration = Duration::from_secs(60);

/// A render from its first sample to its files, on one device or, after a loss, on several.
pub struct Session<'a> {
    pub(super) arguments: &'a Arguments,
    pub(super) denoiser: &'a Denoiser,
    pub(super) interrupt: Interrupt,
    pub(super) times: Times,
    /// The user has been told that the render has begun.
    announced: bool,
    /// `None` after the first sample, and where its time would not show how fast the machine is.
    first_sample: Option<FirstSample>,
    /// What [`FirstSample::ratio`] returned; stored once the image is written.
    first_sample_ratio: Option<(FirstSamples, f64)>,
    pub(super) notes: Notes,
    /// The render was stopped by a signal or a fault.
    pub(super) stopped: bool,
    pub(super) files: Files,
    /// The fingerprint of a frame of a sequence. Frames are written only when they are complete.
    pub(super) fingerprint: Option<String>,
}

/// Prepares an opened device. The returned flag is set if the driver compiles kernels for it. Kernels are kept and used
/// again: those of samples without photons by samples with photons, those of the first frame by the other frames of a
/// sequence, and by the denoisers those of theirs that are compiled together with the renderer's.
pub fn prepare_device(gpu: &Gpu, quiet: bool) -> Arc<AtomicBool> {
    gpu.keep_kernels();
    show_compilation(gpu, quiet)
}

impl<'a> Session<'a> {
    /// A render of the command line that has not begun.
    pub fn new(
        arguments: &'a Arguments,
        denoiser: &'a Denoiser,
        interrupt: Interrupt,
        times: Times,
        first_sample: Option<FirstSample>,
        notes: Notes,
    ) -> Session<'a> {
        Session {
            arguments,
            denoiser,
            interrupt,
            times,
            announced: false,
            first_sample,
            first_sample_ratio: None,
            notes,
            stopped: false,
            files: arguments.files(None),
            fingerprint: None,
        }
    }

    /// Renders an image and writes its files.
    pub fn render_subject(&mut self, gpu: &mut Gpu, subject: &Subject, from: Option<Checkpoint>) -> Result<Image> {
        let Subject { scene, camera, settings } = subject;
        let device = &self.arguments.device;
        let (denoiser, quiet) = (self.denoiser, self.arguments.quiet);
        let open = || {
            let gpu = device.open()?;
            prepare_device(&gpu, quiet);
            Ok(gpu)
        };
        let rendered = recovery::render(
            gpu,
            open,
            |gpu| {
                let (compile, mut compiled) = (denoiser.compilation(), Ok(()));
                let renderer = thread::scope(|scope| {
                    scope.spawn(|| compiled = compile(gpu));
                    Renderer::new(gpu, scene.clone(), camera, settings)
                });
                compiled.and(renderer)
            },
            from,
            |renderer| {
                // If time is limited, these kernels may never be needed, and compiling them takes time from samples.
                let later = if self.times.sampling.is_none() { renderer.later_kernels() } else { None };
                let gpu = renderer.gpu();
                thread::scope(|scope| {
                    // An error here is dropped: the same kernels fail again where they are needed.
                    later.map(|compile| scope.spawn(move || compile(gpu)));
                    self.render(renderer)
                })
            },
        );
        rendered.unwrap_or_else(|Failure { error, salvage }| {
            if let Some(salvage) = salvage {
                // Without its denoised image, a frame of a sequence is not complete: the same command renders it again.
                self.stopped = true;
                let Salvage { image, statistics, checkpoint } = *salvage;
                let checkpointed = self.write_checkpoint(checkpoint.as_ref());
                // The error to report is the one that ended the render.
                let _ = self.finish(image, statistics, checkpointed);
            }
            Err(error)
        })
    }

    /// Renders until there are enough samples or a signal stops it, and writes the files: the inner result.
    fn render(&mut self, renderer: &mut Renderer<'_>) -> std::result::Result<Result<Image>, Failure> {
        self.notes.say(renderer.notes());
        // Before this point there is nothing to save.
        self.interrupt.defer();
        self.announce(renderer);
        let failed = self.add_samples(renderer)?;
        self.stopped = failed.is_some();
        self.stopped |= self.interrupt.raised() && !renderer.is_complete();
        self.notes.say(renderer.notes());
        let checkpoint = self.arguments.checkpoint.as_ref().map(|_| renderer.checkpoint()).transpose()?;
        // Before denoising, which may take longer than a cluster waits after a signal.
        let checkpointed = self.write_checkpoint(checkpoint.as_ref());
        let (mut image, mut statistics) = (renderer.image()?, renderer.statistics()?);
        self.notes.say(renderer.note_on(&image).as_slice());
        self.notes.say(renderer.note_on_noise().as_slice());
        let start = Instant::now();
        let outcome = match failed {
            Some(problem) => Err(problem),
            None => renderer.add_denoised(&mut image, self.denoiser),
        };
        if self.denoiser.choice() != Denoise::None {
            statistics.time.denoise = start.elapsed().as_secs_f64();
        }
        if let Err(error) = outcome.and(self.say_estimate(renderer, &statistics)) {
            // A checkpoint that could not be written may have a place now.
            let checkpoint = checkpoint.filter(|_| checkpointed.is_err());
            return Err(Failure { error, salvage: Some(Box::new(Salvage { image, statistics, checkpoint })) });
        }
        Ok(self.finish(image, statistics, checkpointed))
    }

    /// Says once what is rendered.
    fn announce(&mut self, renderer: &Renderer<'_>) {
        if self.arguments.quiet || self.announced {
            return;
        }
        let Settings { technique, image, .. } = renderer.settings();
        let device = &renderer.gpu().info.name;
        say(format_args!("rendering {} x {} pixels, {technique}, on {device}", image.width, image.height));
        self.announced = true;
    }

    /// Renders until there are enough samples or a signal stops it. Returns the error of a denoiser, if that ended the
    /// render.
    fn add_samples(&mut self, renderer: &mut Renderer<'_>) -> Result<Option<Error>> {
        let arguments = self.arguments;
        let deadline = self.times.deadline();
        let goal = Goal { spp: renderer.settings().image.range().count(), deadline };
        let mut display = Display::new(goal, &renderer.progress(), arguments.quiet);
        let mut written = Instant::now();
        loop {
            let left = || deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()).as_secs_f64());
            match unless_lost(renderer.wants_samples_within(self.denoiser, left().unwrap_or(f64::INFINITY)))? {
                Ok(true) => {}
                Ok(false) => return Ok(None),
                Err(problem) => return Ok(Some(problem)),
            }
            let progress = match left() {
                None => Some(renderer.render_batch()?),
                // A render that is resumed must have the same bits as one without an interruption.
                Some(left) if arguments.checkpoint.is_some() => renderer.render_batch_within(left)?,
                Some(left) => renderer.render_within(left)?,
            };
            let Some(progress) = progress else { return Ok(None) };
            display.update(&progress);
            if let Some(first) = self.first_sample.take()
                && progress.samples == 1
            {
                self.first_sample_ratio = first.ratio();
            }
            if self.interrupt.raised() {
                return Ok(None);
            }
            if let Some(path) = arguments.checkpoint.as_ref().filter(|_| written.elapsed() > CHECKPOINT) {
                // A disk that is full now may have room the next time.
                if let Err(problem @ Error::Output { .. }) = renderer.checkpoint()?.write(path) {
                    self.notes.say(&[format!("{problem}; the render continues")]);
                }
                written = Instant::now();
            }
        }
    }

    /// Says the estimated error of a render with `--noise`.
    fn say_estimate(&self, renderer: &Renderer<'_>, statistics: &Statistics) -> Result<()> {
        // The estimate reads the film from the device, which takes time that may be limited.
        if self.arguments.settings.noise.is_none() || self.arguments.quiet {
            return Ok(());
        }
        let Some(estimate) = renderer.estimated_relmse()? else { return Ok(()) };
        let rest =
            if statistics.indirect.photons > 0 { " without the error of the photon map of indirect light" } else { "" };
        say(format_args!("estimated relMSE {estimate:.2e} of the raw image{rest}"));
        Ok(())
    }

    fn write_checkpoint(&self, checkpoint: Option<&Checkpoint>) -> Result<()> {
        match (&self.arguments.checkpoint, checkpoint) {
            (Some(path), Some(checkpoint)) => write_in_folder(path, || checkpoint.write(path)),
            _ => Ok(()),
        }
    }

    /// Prints a summary and writes all other files than the checkpoint; a file that fails does not stop the others.
    fn finish(&mut self, mut image: Image, mut statistics: Statistics, checkpointed: Result<()>) -> Result<Image> {
        let arguments = self.arguments;
        if !arguments.quiet {
            say(summary(&statistics, self.stopped));
            say_denoised(self.denoiser, &image, &statistics);
        }
        self.notes.say(&statistics.notes);
        self.notes.say(arguments.note_on_exposure(&image).as_slice());
        if self.stopped && self.fingerprint.is_some() {
            self.notes.say(&["an incomplete frame is not written".to_owned()]);
            return Ok(image);
        }
        if let Some(fingerprint) = &self.fingerprint {
            image.set_fingerprint(fingerprint.clone());
        }
        let written = self.files.write_images(&image, arguments.view, arguments.exposure, arguments.quiet);
        if let Some((earlier, ratio)) = self.first_sample_ratio.take() {
            earlier.add(ratio);
        }
        statistics.notes = self.notes.current().to_vec();
        statistics.time.start = self.times.start;
        statistics.time.import = self.times.import;
        statistics.time.total = self.times.started.elapsed().as_secs_f64();
        both(both(written, self.files.write_statistics(&statistics)), checkpointed)?;
        Ok(image)
    }
}

/// Separates the loss of the device (the outer result) from errors of a denoiser (the inner one), after which the raw
/// image can still be read.
fn unless_lost<T>(outcome: Result<T>) -> Result<Result<T>> {
    match outcome {
        Err(lost @ Error::DeviceLost { .. }) => Err(lost),
        outcome => Ok(outcome),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use clap::Parser;

    use super::*;
    use crate::cli::{Command, CommandLine};

    fn arguments(output: &Path, more: &str) -> Arguments {
        let device = std::env::var("PENUMBRA_DEVICE").unwrap_or("software".into());
        let words = format!("penumbra render --device {device} --width 24 --height 16 --max-bounces 0 {more} -o");
        let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/box.glb");
        let line = CommandLine::parse_from(words.split(' ').chain([output.to_str().unwrap(), scene]));
        let Command::Render(arguments) = line.command else { panic!("another command") };
        *arguments
    }

    /// A render of 16 samples whose film keeps what this denoiser needs.
    fn subject(arguments: &Arguments, denoise: Denoise) -> Subject {
        let (scene, camera) = arguments.scene.load(1.0).unwrap();
        let settings = arguments.settings.settings(&camera, &arguments.extent).unwrap();
        let settings = settings.with(|s| (s.image.spp, s.image.denoise) = (16, denoise));
        Subject { scene, camera, settings }
    }

    fn session<'a>(arguments: &'a Arguments, denoiser: &'a Denoiser) -> Session<'a> {
        let times = Times { started: Instant::now(), import: 0.0, start: 0.0, sampling: None };
        Session::new(arguments, denoiser, Interrupt::listen(), times, None, Notes::new(true))
    }

    /// Whatever the error of a denoiser is, all samples are saved, as a raw image and as a checkpoint.
    #[test]
    fn an_image_that_cannot_be_denoised_is_saved() {
        let folder = tempfile::tempdir().unwrap();
        let [exr, state] = ["a.exr", "state"].map(|name| folder.path().join(name));
        let arguments = arguments(&exr, &format!("--quiet --checkpoint {}", state.display()));
        let denoiser = Denoiser::new(Denoise::Statistical, None).unwrap();
        // The film keeps nothing for the denoiser, which refuses it.
        let subject = subject(&arguments, Denoise::None);
        let mut gpu = arguments.device.open().unwrap();
        let refused = session(&arguments, &denoiser).render_subject(&mut gpu, &subject, None);
        assert!(matches!(refused, Err(Error::Setting { name: "image.denoise", .. })));
        assert_eq!(Checkpoint::read(&state).unwrap().samples(), 16);
        let (saved, raw) = (Image::read(&exr).unwrap(), Denoiser::default());
        assert!(saved.channel("denoised.R").is_none());
        std::fs::remove_file(&state).unwrap();
        let expected = session(&arguments, &raw).render_subject(&mut gpu, &subject, None).unwrap();
        assert!(saved.rgb().unwrap() == expected.rgb().unwrap());
    }

    /// The error is estimated only to be said: nothing else needs the device for it.
    #[test]
    fn an_estimate_that_is_not_said_is_not_made() {
        let estimate = |more: &str| {
            let arguments = arguments(Path::new("a.exr"), more);
            let Subject { scene, camera, settings } = subject(&arguments, Denoise::Statistical);
            let gpu = arguments.device.open().unwrap();
            let mut renderer = Renderer::new(&gpu, scene, &camera, &settings).unwrap();
            renderer.render_batch().unwrap();
            renderer.render_batch().unwrap();
            let statistics = renderer.statistics().unwrap();
            gpu.lose();
            session(&arguments, &Denoiser::default()).say_estimate(&renderer, &statistics)
        };
        assert!(estimate("--denoise statistical").is_ok());
        assert!(estimate("--denoise statistical --noise 1e-3 --quiet").is_ok());
        assert!(matches!(estimate("--denoise statistical --noise 1e-3"), Err(Error::DeviceLost { .. })));
    }
}
