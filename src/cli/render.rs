//! `penumbra render`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::{env, fs, process, thread};

use kernel_kit::Gpu;
use penumbra::internal::render::Checkpoint;
use penumbra::internal::render::film::{self, View};
use penumbra::internal::render::recovery::{self, Failure, Salvage};
use penumbra::internal::report::estimate;
use penumbra::internal::report::metrics::Measures;
use penumbra::internal::report::reference::Reference;
use penumbra::internal::techniques::auto::Choice;
use penumbra::settings::Denoise;
use penumbra::{Camera, Denoiser, Error, Image, Renderer, Result, Scene, Settings, Statistics};

use super::first_samples::FirstSamples;
use super::flags::with_flags;
use super::interrupt::Interrupt;
use super::names::check_names;
use super::options::{
    DeviceOptions, OidnOptions, PartOptions, RenderOptions, SceneOptions, Surroundings, denoisers, finite, positive,
    read_reference,
};
use super::progress::{Display, Goal, mega, show_compilation};
use super::sequence::{Frame, SequenceOptions};
use super::{Ending, compare, json, print, say};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneOptions,

    /// Output image: .exr (scene-linear, all channels) or .png (tone-mapped); may be given several times
    #[arg(short, long, value_name = "FILE", required = true, help_heading = "Output")]
    output: Vec<PathBuf>,

    /// Tone mapping of .png: neutral (Khronos PBR Neutral), agx, standard (sRGB, clipped) or raw (linear values)
    #[arg(long, value_name = "VIEW", default_value_t = View::default(), help_heading = "Output")]
    view: View,

    /// Exposure of .png, in stops
    #[arg(long, value_name = "EV", default_value_t = 0.0, value_parser = finite::<f32>, help_heading = "Output")]
    exposure: f32,

    /// Remove noise: a .png shows the denoised image; an .exr keeps the raw image, and has the denoised one beside it
    /// as denoised.R, denoised.G and denoised.B, with its estimated standard error as the channel error [default: auto
    /// if an output is .png, else none]. With --samples, the .exr instead keeps what `penumbra merge --denoise` needs
    #[arg(long, value_name = "DENOISER", value_parser = denoisers(), help_heading = "Output")]
    denoise: Option<Denoise>,

    #[command(flatten)]
    oidn: OidnOptions,

    /// Write statistics as JSON
    #[arg(long, value_name = "FILE.json", help_heading = "Output")]
    stats: Option<PathBuf>,

    /// Reference image: the error against it is printed, as by `penumbra compare`
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    reference: Option<PathBuf>,

    /// Write a checkpoint for --resume, every minute and at the end. Without --resume the file must not exist yet
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    checkpoint: Option<PathBuf>,

    /// Continue the render that wrote the --checkpoint file, or begin it if there is no such file; the image has the
    /// same bits as that of an uninterrupted render
    #[arg(long, requires = "checkpoint", help_heading = "Output")]
    resume: bool,

    /// Print only errors
    #[arg(long, help_heading = "Output")]
    quiet: bool,

    #[command(flatten)]
    sequence: SequenceOptions,

    #[command(flatten)]
    settings: RenderOptions,

    #[command(flatten)]
    part: PartOptions,

    /// Finish within this time, including reading, denoising and writing, unless it is too short for one sample; --spp
    /// is then only an upper limit, and there is none by default
    #[arg(long, value_name = "SECONDS", value_parser = budget, help_heading = "Image")]
    time: Option<Duration>,

    /// Render until the estimated relMSE of every block of 8 x 8 pixels is T or less: samples go where the image is
    /// noisiest; with --denoise, where the denoised image is. The estimate comes from the samples and from audits; it
    /// does not include the error of the photon map of indirect light, which all samples share. --spp is then only an
    /// upper limit for each pixel, and there is none by default
    #[arg(long, value_name = "T", value_parser = positive, help_heading = "Image")]
    noise: Option<f64>,

    #[command(flatten)]
    device: DeviceOptions,
}

fn budget(text: &str) -> std::result::Result<Duration, String> {
    Duration::try_from_secs_f64(positive(text)?).map_err(|problem| problem.to_string())
}

/// Largest share of `--time` for denoising. A filter gains as much as many times the samples, and more where there are
/// few.
const DENOISED_SHARE: f64 = 0.5;

/// Time between checkpoints: the maximum that a crash can lose.
const CHECKPOINT: Duration = Duration::from_secs(60);

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let started = Instant::now();
    let interrupt = Interrupt::listen();
    arguments.check()?;
    let (mut denoiser, no_denoiser) = arguments.denoiser();
    // A piece keeps what the denoisers of the merged image need.
    let is_piece = arguments.part.is_piece();
    let denoise = if is_piece { arguments.denoise.unwrap_or_default() } else { denoiser.choice() };
    let opened = arguments.load_and_open(denoise)?;
    let Opened { scene, camera, surroundings, mut settings, reference, mut gpu, import, start } = opened;
    let mut notes = Notes { quiet: arguments.quiet, said: Vec::new() };
    let from = arguments.checkpoint.as_ref().filter(|path| path.exists()).map(Checkpoint::read).transpose()?;
    if let Some(path) = arguments.checkpoint.as_ref().filter(|_| arguments.resume && from.is_none()) {
        notes.say(&[format!("there is no checkpoint {} yet: a new render begins", path.display())]);
    }
    notes.say(&scene.notes);
    if let Some(problem) = &no_denoiser {
        notes.say(&[format!("{}; the image stays raw", with_flags(&problem.to_string()))]);
    }
    let is_compiled = prepare(&gpu, arguments.quiet);
    let pixels = u64::from(settings.image.part().width) * u64::from(settings.image.part().height);
    if let Some(time) = arguments.time.filter(|_| arguments.denoise.is_none() && arguments.noise.is_none())
        && denoiser.fit(&gpu, pixels, DENOISED_SHARE * time.as_secs_f64())
    {
        let rest = denoiser.names().next().map_or("the image stays raw".to_owned(), |name| {
            format!("{name} alone removes noise, and its error is not estimated")
        });
        notes.say(&[format!("denoising would take too much of --time {}: {rest}", time.as_secs_f64())]);
    }
    let denoising = Duration::from_secs_f64(denoiser.seconds(&gpu, pixels));
    let sampling = arguments.time.map(|time| time.saturating_sub(denoising));
    let mut first_sample = None;
    if arguments.settings.is_automatic() {
        let others = FirstSamples::of(&gpu);
        // Frames that are complete are found again by their settings, which so must not follow a clock.
        let is_sequence = arguments.sequence.first().is_some();
        let (elapsed, slowness) =
            if is_sequence { (0.0, 1.0) } else { (started.elapsed().as_secs_f64(), others.slowness()) };
        // An image with a checkpoint has the bits of one without a time.
        let limited = sampling.filter(|_| arguments.checkpoint.is_none());
        let within = limited.map(|time| time.as_secs_f64() - elapsed);
        let choice = Choice::new(&gpu, &scene, &camera, &settings, within, slowness);
        let Choice { technique, reason, sampling, first_sample: expected } = choice;
        // Frames that are there already are passed over first, which takes time.
        first_sample = expected.filter(|_| !is_sequence).map(|expected| FirstSample {
            expected,
            others,
            begun: Instant::now(),
            is_compiled,
        });
        settings.technique = technique;
        if arguments.settings.leaves_sampling() {
            settings.image.sampling = sampling;
        }
        if let Some(reason) = reason {
            notes.say(&[format!("using --technique {technique}, because {reason}")]);
        }
    }
    let mut session = Session {
        arguments,
        denoiser: &denoiser,
        interrupt,
        started,
        import,
        start,
        sampling,
        spp: settings.image.range().count(),
        announced: false,
        first_sample,
        ratio: None,
        notes,
        stopped: false,
        files: arguments.files(None),
        fingerprint: None,
    };
    let subject = Subject { scene, camera, settings };
    if arguments.sequence.first().is_some() {
        session.render_sequence(&mut gpu, subject, surroundings.as_ref())?;
        return end(session.stopped, no_denoiser);
    }
    let image = session.render_subject(&mut gpu, &subject, from)?;
    if let Some(reference) = reference {
        print(&compare::text(&Measures::new(&image, &reference.image)?))?;
        if let Some(denoised) = image.denoised() {
            print(&format!("denoised\n{}", compare::text(&Measures::new(&denoised, &reference.image)?)))?;
        }
    }
    end(session.stopped, no_denoiser)
}

/// Prepares an opened device. The returned flag is set if the driver compiles kernels for it. Kernels are kept and used
/// again: those of samples without photons by samples with photons, those of the first frame by the other frames of a
/// sequence, and those compiled with the renderer's by the denoisers.
fn prepare(gpu: &Gpu, quiet: bool) -> Arc<AtomicBool> {
    gpu.keep_kernels();
    show_compilation(gpu, quiet)
}

/// The result of a render whose images are written.
fn end(stopped: bool, no_denoiser: Option<Error>) -> Result<Ending> {
    // The raw image is written, but the user requested a denoised one.
    if let Some(problem) = no_denoiser {
        return Err(problem);
    }
    Ok(if stopped { Ending::Stopped } else { Ending::Done })
}

/// What is rendered.
struct Subject {
    scene: Scene,
    camera: Camera,
    settings: Settings,
}

/// A render from its first sample to its files, on one device or, after a loss, on several.
struct Session<'a> {
    arguments: &'a Arguments,
    denoiser: &'a Denoiser,
    interrupt: Interrupt,
    started: Instant,
    /// Seconds that reading the scene and opening the device took.
    import: f64,
    start: f64,
    /// From the start of an image to its last sample, if its time is limited: the rest is for denoising.
    sampling: Option<Duration>,
    spp: u32,
    /// The user has been told that the render has begun.
    announced: bool,
    /// `None` after the first sample, and where its time would not show how fast the machine is.
    first_sample: Option<FirstSample>,
    /// The time of the first sample over the expected time; stored once the image is written.
    ratio: Option<(FirstSamples, f64)>,
    notes: Notes,
    /// The render was stopped by a signal or a fault.
    stopped: bool,
    files: Files,
    /// The fingerprint of a frame of a sequence. Frames are written only when they are complete.
    fingerprint: Option<String>,
}

/// A first sample, whose time shows how fast the machine is.
struct FirstSample {
    /// Seconds.
    expected: f64,
    /// The ratios of earlier renders.
    others: FirstSamples,
    begun: Instant,
    /// The driver has compiled kernels meanwhile.
    is_compiled: Arc<AtomicBool>,
}

impl FirstSample {
    /// The ratios of earlier renders, and this one's: the time of the first sample over the expected time. `None` if
    /// the driver has compiled kernels meanwhile.
    fn ratio(self) -> Option<(FirstSamples, f64)> {
        let ratio = self.begun.elapsed().as_secs_f64() / self.expected;
        (!self.is_compiled.load(Ordering::Relaxed)).then_some((self.others, ratio))
    }
}

/// The files of an image.
struct Files {
    outputs: Vec<PathBuf>,
    stats: Option<PathBuf>,
}

impl Files {
    /// Whether all files exist, and the images are complete and have this fingerprint.
    fn are_complete(&self, fingerprint: &str) -> bool {
        let is_same = |path: &PathBuf| film::fingerprint(path).is_some_and(|found| found == fingerprint);
        self.outputs.iter().all(is_same) && self.stats.iter().all(|path| path.exists())
    }
}

impl Session<'_> {
    /// Renders the missing frames of a sequence; `first` is the first of them.
    fn render_sequence(&mut self, gpu: &mut Gpu, first: Subject, around: Option<&Surroundings>) -> Result<()> {
        let arguments = self.arguments;
        let (view, settings) = (first.camera.clone(), first.settings.clone());
        let (space, is_framed) = (first.scene.normalisation, arguments.scene.frames(&first.scene));
        let views = arguments.views(&first.scene)?.unwrap_or_default();
        let standing = (!views.is_empty()).then(|| first.scene.clone());
        let mut next = Some(first);
        for frame in arguments.sequence.frames().into_iter().flatten() {
            if self.interrupt.raised() {
                self.stopped = true;
                break;
            }
            let mut subject = match next.take() {
                Some(first) => first,
                None => {
                    self.started = Instant::now();
                    self.start = 0.0;
                    let mut scene = match &standing {
                        Some(scene) => scene.clone(),
                        None => arguments.scene.load_at(frame.seconds)?,
                    };
                    if let Some(around) = around.filter(|_| standing.is_none()) {
                        arguments.scene.surround(&mut scene, around)?;
                    }
                    // A view that frames the scene would move with it.
                    let camera = match views.get(frame.number as usize) {
                        Some(camera) => camera.clone(),
                        None if is_framed && arguments.scene.frames(&scene) => {
                            view.renormalised(&space, &scene.normalisation)
                        }
                        None => arguments.scene.camera(&scene, arguments.settings.aspect())?,
                    };
                    self.import = self.started.elapsed().as_secs_f64();
                    // All frames have the size of the first.
                    Subject { scene, camera, settings: settings.clone() }
                }
            };
            subject.settings.image.seed = settings.image.seed.wrapping_add(frame.seed);
            self.files = arguments.files(Some(frame));
            let denoisers: Vec<&str> = self.denoiser.names().collect();
            let fingerprint = arguments.fingerprint(&subject, &denoisers);
            if self.files.are_complete(&fingerprint) {
                if !arguments.quiet {
                    say(format_args!("frame {} is complete", frame.number));
                }
                continue;
            }
            if !arguments.quiet {
                match frame.seconds {
                    Some(seconds) => say(format_args!("frame {} at {seconds:.3} s", frame.number)),
                    None => say(format_args!("view {} of {}", frame.number, views.len())),
                }
            }
            self.notes.say(&subject.scene.notes);
            self.fingerprint = Some(fingerprint);
            self.render_subject(gpu, &subject, None)?;
            if self.stopped {
                break;
            }
        }
        Ok(())
    }

    /// Renders an image and writes its files.
    fn render_subject(&mut self, gpu: &mut Gpu, subject: &Subject, from: Option<Checkpoint>) -> Result<Image> {
        let Subject { scene, camera, settings } = subject;
        let device = &self.arguments.device;
        let (denoiser, quiet) = (self.denoiser, self.arguments.quiet);
        let open = || {
            let gpu = device.open()?;
            prepare(&gpu, quiet);
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
                let later = if self.sampling.is_none() { renderer.later_kernels() } else { None };
                let gpu = renderer.gpu();
                thread::scope(|scope| {
                    // An error here is dropped: the same kernels fail again where they are needed.
                    later.map(|compile| scope.spawn(move || compile(gpu)));
                    self.render(renderer)
                })
            },
        );
        rendered.map_err(|Failure { error, salvage }| {
            // A file is at fault before the first sample or after the image was written.
            if let Some(salvage) = salvage.filter(|_| !matches!(error, Error::Output { .. } | Error::Input { .. })) {
                self.stopped = true;
                let Salvage { image, statistics, checkpoint } = *salvage;
                // The error to report is the one that ended the render.
                let _ = self.finish(image, statistics, Some(&checkpoint));
            }
            error
        })
    }

    /// Renders until there are enough samples or a signal stops it, and writes the files.
    fn render(&mut self, renderer: &mut Renderer<'_>) -> Result<Image> {
        let arguments = self.arguments;
        self.notes.say(renderer.notes());
        // Before this point there is nothing to save.
        self.interrupt.defer();
        let deadline = self.sampling.map(|time| self.started + time);
        if !arguments.quiet && !self.announced {
            let Settings { technique, image, .. } = renderer.settings();
            let device = &renderer.gpu().info.name;
            say(format_args!("rendering {} x {} pixels, {technique}, on {device}", image.width, image.height));
            self.announced = true;
        }
        let mut display = Display::new(Goal { spp: self.spp, deadline }, arguments.quiet);
        let mut written = Instant::now();
        let failed = loop {
            match unless_lost(renderer.wants_samples(self.denoiser))? {
                Ok(true) => {}
                Ok(false) => break None,
                Err(problem) => break Some(problem),
            }
            let left = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()).as_secs_f64());
            let progress = match left {
                None => Some(renderer.render_batch()?),
                // A render that is resumed must have the same bits as one without an interruption.
                Some(left) if arguments.checkpoint.is_some() => renderer.render_batch_within(left)?,
                Some(left) => renderer.render_within(left)?,
            };
            let Some(progress) = progress else { break None };
            display.update(&progress);
            if let Some(first) = self.first_sample.take()
                && progress.samples == 1
            {
                self.ratio = first.ratio();
            }
            if self.interrupt.raised() {
                break None;
            }
            if let Some(path) = arguments.checkpoint.as_ref().filter(|_| written.elapsed() > CHECKPOINT) {
                // A disk that is full now may have room the next time.
                if let Err(problem @ Error::Output { .. }) = renderer.checkpoint()?.write(path) {
                    self.notes.say(&[format!("{problem}; the render continues")]);
                }
                written = Instant::now();
            }
        };
        drop(display);
        self.stopped = failed.is_some();
        if !self.stopped && self.interrupt.raised() {
            self.stopped = unless_lost(renderer.wants_samples(self.denoiser))?.unwrap_or(true);
        }
        self.notes.say(renderer.notes());
        let checkpoint = arguments.checkpoint.as_ref().map(|_| renderer.checkpoint()).transpose()?;
        let (mut image, mut statistics) = (renderer.image()?, renderer.statistics()?);
        self.notes.say(renderer.note_on(&image).as_slice());
        self.notes.say(renderer.note_on_noise().as_slice());
        let start = Instant::now();
        let outcome = match failed {
            Some(problem) => Err(problem),
            None => unless_lost(renderer.add_denoised(&mut image, self.denoiser))?,
        };
        if self.denoiser.choice() != Denoise::None {
            statistics.time.denoise = start.elapsed().as_secs_f64();
        }
        let estimate = renderer.estimated_relmse()?.filter(|_| arguments.noise.is_some() && !arguments.quiet);
        if let Some(estimate) = estimate {
            let rest = if statistics.indirect.photons > 0 {
                " without the error of the photon map of indirect light"
            } else {
                ""
            };
            say(format_args!("estimated relMSE {estimate:.2e} of the raw image{rest}"));
        }
        let image = self.finish(image, statistics, checkpoint.as_ref())?;
        outcome.map(|()| image)
    }

    /// Prints a summary and writes all files; a file that fails does not stop the others.
    fn finish(
        &mut self,
        mut image: Image,
        mut statistics: Statistics,
        checkpoint: Option<&Checkpoint>,
    ) -> Result<Image> {
        let arguments = self.arguments;
        if !arguments.quiet {
            say(summary(&statistics, self.stopped));
            self.say_denoised(&image, &statistics);
        }
        self.notes.say(&statistics.notes);
        self.notes.say(arguments.note_on_exposure(&image).as_slice());
        let checkpointed = match (&arguments.checkpoint, checkpoint) {
            (Some(path), Some(checkpoint)) => written(path, || checkpoint.write(path)),
            _ => Ok(()),
        };
        if self.stopped && self.fingerprint.is_some() {
            self.notes.say(&["an incomplete frame is not written".to_owned()]);
            return Ok(image);
        }
        if let Some(fingerprint) = &self.fingerprint {
            image.sign(fingerprint.clone());
        }
        let written = arguments.write(&image, &self.files);
        if let Some((others, ratio)) = self.ratio.take() {
            others.add(ratio);
        }
        statistics.notes.clone_from(&self.notes.said);
        statistics.time.start = self.start;
        statistics.time.import = self.import;
        statistics.time.total = self.started.elapsed().as_secs_f64();
        both(both(written, arguments.write_statistics(&statistics, &self.files)), checkpointed)?;
        Ok(image)
    }

    /// Says by what the image was denoised, and how well.
    fn say_denoised(&self, image: &Image, statistics: &Statistics) {
        if image.channel("denoised.R").is_none() {
            return;
        }
        let names: Vec<&str> = self.denoiser.names().collect();
        let error = match estimate::denoised_relmse(image) {
            Some(error) => format!("estimated relMSE {error:.2e}"),
            None if statistics.samples == 1 => "error unknown: it cannot be estimated from a single sample".to_owned(),
            None => "error unknown: --time was too short to estimate it".to_owned(),
        };
        let (choice, seconds) = (self.denoiser.choice(), statistics.time.denoise);
        say(format_args!("denoised by {choice} ({}) in {seconds:.2} s, {error}", names.join(", ")));
    }
}

/// The result of a denoiser, apart from errors that lose the samples. If only its library fails, the raw image is safe.
fn unless_lost<T>(outcome: Result<T>) -> Result<Result<T>> {
    match outcome {
        Err(problem @ Error::Input { .. }) => Ok(Err(problem)),
        outcome => Ok(Ok(outcome?)),
    }
}

/// Writes a file. If its folder has been removed since the start, it is created again.
fn written(path: &Path, write: impl Fn() -> Result<()>) -> Result<()> {
    write().or_else(|problem| match path.parent() {
        Some(folder) if !folder.exists() && fs::create_dir_all(folder).is_ok() => write(),
        _ => Err(problem),
    })
}

/// The outcome of writing two files, whose error names both if neither is written.
pub fn both(first: Result<()>, second: Result<()>) -> Result<()> {
    match (first, second) {
        (Err(Error::Output { file, problem }), Err(Error::Output { file: other, .. })) => {
            Err(Error::Output { file, problem: format!("{problem}; {} is not written either", other.display()) })
        }
        (first, second) => first.and(second),
    }
}

/// The inputs of a render, and the seconds that it took to load them.
struct Opened {
    scene: Scene,
    camera: Camera,
    /// The panorama, which all frames of a sequence share.
    surroundings: Option<Surroundings>,
    settings: Settings,
    reference: Option<Reference>,
    gpu: Gpu,
    import: f64,
    start: f64,
}

impl Arguments {
    /// Checks everything that can be checked before the scene is read.
    fn check(&self) -> Result<()> {
        self.settings.check(&self.part)?;
        self.sequence.check_names(self.output.iter().chain(&self.stats))?;
        let files = self.files(self.sequence.first());
        for path in &files.outputs {
            film::check_writable(path)?;
        }
        if self.settings.has_aovs() && !self.output.iter().any(|path| is_exr(path)) {
            return Err(Error::Usage("--aov needs an output that is .exr: a .png holds only the picture".into()));
        }
        if self.part.is_piece() {
            if self.noise.is_some() {
                let problem = "--noise cannot be combined with --samples: which pixels get samples would depend on \
                     other pieces";
                return Err(Error::Usage(problem.into()));
            }
            if self.time.is_some() {
                let problem = "--time cannot be combined with --samples: how many samples a pixel gets would depend \
                     on chance";
                return Err(Error::Usage(problem.into()));
            }
            if !self.output.iter().any(|path| is_exr(path)) {
                let problem = "--samples needs an output that is .exr: a .png has no sums that could be merged";
                return Err(Error::Usage(problem.into()));
            }
        }
        if self.noise.is_some() && !self.settings.is_unbiased() {
            let problem = "--noise needs an unbiased technique without --clamp, and audits where photons classify \
                 points, to estimate the error";
            return Err(Error::Usage(problem.into()));
        }
        files.stats.iter().chain(&self.checkpoint).try_for_each(film::check_target)?;
        if let Some(path) = self.checkpoint.as_ref().filter(|path| path.exists() && !self.resume) {
            let problem = "exists already: add --resume to continue its render, or remove it to begin another";
            return Err(Error::Usage(format!("--checkpoint {} {problem}", path.display())));
        }
        self.check_names(&[])
    }

    /// Checks that no output overwrites another output or an input. `referred` are the files that the scene's file
    /// refers to.
    fn check_names(&self, referred: &[PathBuf]) -> Result<()> {
        let Files { outputs, stats } = self.files(self.sequence.first());
        let others = self.scene.other_files();
        let inputs = [&self.scene.scene].into_iter().chain(&others).chain(&self.reference).chain(referred);
        check_names(inputs, outputs.iter().chain(&stats).chain(&self.checkpoint))
    }

    /// The scene within the panorama, and its camera. For a sequence, those of the first frame.
    fn load(&self, surroundings: Option<&Surroundings>) -> Result<(Scene, Camera)> {
        let time = self.sequence.first().and_then(|frame| frame.seconds);
        let (scene, camera) = self.scene.load_first(time, surroundings, self.settings.aspect())?;
        let first = self.views(&scene)?.and_then(|views| views.into_iter().next());
        Ok((scene, first.unwrap_or(camera)))
    }

    /// The cameras of a turntable, if that is what is rendered.
    fn views(&self, scene: &Scene) -> Result<Option<Vec<Camera>>> {
        let cameras = |views| self.scene.turntable(scene, self.settings.aspect(), views);
        self.sequence.views().map(cameras).transpose()
    }

    /// Imports the scene while the device opens. The error of a bad file comes before that of the device.
    fn load_and_open(&self, denoise: Denoise) -> Result<Opened> {
        let timed = |start: Instant| start.elapsed().as_secs_f64();
        thread::scope(|scope| {
            let device = scope.spawn(|| {
                let start = Instant::now();
                self.device.open().map(|gpu| (gpu, timed(start)))
            });
            let start = Instant::now();
            let surroundings = self.scene.surroundings()?;
            let (scene, camera) = self.load(surroundings.as_ref())?;
            let import = timed(start);
            self.check_names(&scene.files)?;
            let mut settings = self.settings.settings(&camera, &self.part)?;
            if (self.time.is_some() || self.noise.is_some()) && self.settings.spp.is_none() {
                settings.image.spp = Settings::UNLIMITED_SPP;
            }
            settings.image.denoise = denoise;
            settings.image.noise = self.noise;
            let reference = self.reference.as_deref().map(|path| read_reference(path, &settings)).transpose()?;
            let (gpu, start) = device.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
            Ok(Opened { scene, camera, surroundings, settings, reference, gpu, import, start })
        })
    }

    /// The denoiser. If it cannot be used: an empty one, and the error.
    fn denoiser(&self) -> (Denoiser, Option<Error>) {
        if self.part.is_piece() {
            return (Denoiser::default(), None);
        }
        let shows = self.output.iter().any(|path| !is_exr(path));
        let default = if shows { Denoise::Auto } else { Denoise::None };
        match self.oidn.denoiser(self.denoise.unwrap_or(default)) {
            Ok(denoiser) => (denoiser, None),
            Err(problem) => (Denoiser::default(), Some(problem)),
        }
    }

    /// Writes all output images. If one fails, the image is saved in the folder for temporary files, so that a full
    /// disk does not lose the render.
    fn write(&self, image: &Image, files: &Files) -> Result<()> {
        let mut result = Ok(());
        let denoised = image.denoised();
        for path in &files.outputs {
            // An .exr has all channels; a .png shows one picture.
            let shown = denoised.as_ref().filter(|_| !is_exr(path)).unwrap_or(image);
            let outcome = written(path, || shown.write(path, self.view, self.exposure));
            if outcome.is_ok() && !self.quiet {
                say(format_args!("wrote {}", path.display()));
            }
            result = both(result, outcome);
        }
        result.map_err(|error| match error {
            Error::Output { file, problem } => {
                let rescue = env::temp_dir().join(format!("penumbra-{}.exr", process::id()));
                let kept = match image.write_exr(&rescue) {
                    Ok(()) => format!("; the image is in {}", rescue.display()),
                    Err(_) => String::new(),
                };
                Error::Output { file, problem: problem + &kept }
            }
            other => other,
        })
    }

    /// A note if most of a .png is white or black.
    fn note_on_exposure(&self, image: &Image) -> Option<String> {
        let png = self.output.iter().find(|path| !is_exr(path))?;
        let suggested = image.suggested_exposure(self.exposure)?;
        let seen = if suggested < self.exposure { "white" } else { "black" };
        Some(format!("{} is mostly {seen}: try --exposure {suggested}", png.display()))
    }

    /// The files of an image, or of a frame of a sequence.
    fn files(&self, frame: Option<Frame>) -> Files {
        let name = |path: &PathBuf| frame.map_or_else(|| path.clone(), |frame| frame.file(path));
        Files { outputs: self.output.iter().map(name).collect(), stats: self.stats.as_ref().map(name) }
    }

    /// Identifies a frame by everything that decides the content of its files.
    fn fingerprint(&self, Subject { scene, camera, settings }: &Subject, denoisers: &[&str]) -> String {
        scene.fingerprint(&(camera, settings, self.time, denoisers, self.view, self.exposure))
    }

    fn write_statistics(&self, statistics: &Statistics, files: &Files) -> Result<()> {
        let Some(path) = &files.stats else { return Ok(()) };
        let text = json(statistics).map_err(|problem| Error::output(path, problem))?;
        written(path, || film::write_atomically(path, |file| Ok(writeln!(file, "{text}")?)))
    }
}

pub fn is_exr(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"))
}

/// A summary of the render in one line.
fn summary(statistics: &Statistics, stopped: bool) -> String {
    let Statistics { samples, mean_samples, settings, rays, points, time, .. } = statistics;
    let samples = match settings.image.noise {
        Some(_) if stopped => format!("stopped after {mean_samples:.1} (at most {samples})"),
        Some(_) => format!("{mean_samples:.1} (at most {samples})"),
        None if stopped => format!("stopped after {samples} of {}", settings.image.range().count()),
        None => samples.to_string(),
    };
    let saved = points
        .saved_shadow_rays(rays)
        .map_or(String::new(), |share| format!(", {:.0} % of shadow rays saved", 100.0 * share));
    format!("{samples} spp in {:.2} s, {:.1} Mrays/s{saved}", time.render, mega(rays.total, time.render))
}

/// Notes, each printed once.
struct Notes {
    quiet: bool,
    said: Vec<String>,
}

impl Notes {
    fn say(&mut self, notes: &[String]) {
        for note in notes {
            if !self.said.contains(note) {
                if !self.quiet {
                    say(format_args!("note: {note}"));
                }
                self.said.push(note.clone());
            }
        }
    }
}
