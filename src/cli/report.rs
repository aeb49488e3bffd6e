//! `penumbra report`.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use kernel_kit::Gpu;
use penumbra::internal::render::film;
use penumbra::internal::render::recovery;
use penumbra::internal::report::classes::{Classes, Truth};
use penumbra::internal::report::document::{AutoReport, EntrantReport, MIN_REPEATS, Overhead, Report};
use penumbra::internal::report::entrant::Entrant;
use penumbra::internal::report::page::page;
use penumbra::internal::report::plot;
use penumbra::internal::report::reference::{Goal, Reference, ReferenceProgress, cache_folder};
use penumbra::internal::report::run::{Run, Starter, Subject};
use penumbra::internal::report::sweep::{self, Sweep};
use penumbra::{Camera, Error, Result, Scene, Settings, Technique};

use super::first_samples::FirstSamples;
use super::flags::with_flags;
use super::folder::make_folder;
use super::interrupt::Interrupt;
use super::options::{
    DeviceOptions, EntrantParser, OidnOptions, SceneOptions, SettingsOptions, positive, read_reference,
};
use super::render::{both, rescue, with_remark};
use super::{Ending, cache, json, print, say, write_text};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneOptions,

    /// Folder for report.html, report.json, report.csv, the plots as .svg, and reference.exr
    #[arg(short, long, value_name = "DIR", help_heading = "Output")]
    output: PathBuf,

    /// Print only errors
    #[arg(long, help_heading = "Output")]
    quiet: bool,

    #[command(flatten)]
    oidn: OidnOptions,

    /// Techniques to compare, separated by commas; +statistical, +oidn or +auto after a name compares its denoised
    /// images, as in path,path+auto: see --denoise of `penumbra render`. auto selects a technique for each budget, as
    /// `penumbra render --time` does, and is compared with the best of the others
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        default_values_t = Technique::all().map(Entrant::raw),
        value_parser = EntrantParser,
        help_heading = "Report"
    )]
    techniques: Vec<Entrant>,

    /// Seconds of run time at which images are compared, separated by commas; they include set-up and denoising, but
    /// not opening the device and reading the file
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        default_values_t = [0.5, 1.0, 2.0, 5.0, 10.0, 30.0],
        value_parser = positive,
        help_heading = "Report"
    )]
    budgets: Vec<f64>,

    /// Runs of each entrant, with consecutive seeds from --seed on: at least 3, because confidence intervals come from
    /// their differences. Each run lasts as long as the longest budget [default: 5, or as few as 3 where the report
    /// would take more than 3 minutes]
    #[arg(long, value_name = "N", help_heading = "Report")]
    repeats: Option<usize>,

    /// Setting to sweep, photons or nearest, and its range, as in photons=1e3..1e6; may be given once for each
    #[arg(long, value_name = "RANGE", help_heading = "Report")]
    sweep: Vec<sweep::Range>,

    /// Reference image; an .exr may hold its own variance (--aov variance) [default: made by path tracing]
    #[arg(long, value_name = "FILE", help_heading = "Reference")]
    reference: Option<PathBuf>,

    /// Standard error, over the mean radiance, at which the path-traced reference is good enough
    #[arg(long, value_name = "X", default_value_t = 0.01, value_parser = positive, help_heading = "Reference")]
    reference_error: f64,

    /// Maximum time for the path-traced reference in seconds; after that it is used with the error that it has
    #[arg(long, value_name = "SECONDS", default_value_t = 600.0, value_parser = positive, help_heading = "Reference")]
    reference_time: f64,

    /// Folder that keeps references, including unfinished ones [default: the user's cache folder]
    #[arg(long, value_name = "DIR", help_heading = "Reference")]
    cache: Option<PathBuf>,

    #[command(flatten)]
    settings: SettingsOptions,

    #[command(flatten)]
    device: DeviceOptions,
}

/// Default number of runs of each entrant, if time allows. With more runs, Student's factor, which widens the
/// intervals, hardly decreases.
const REPEATS: usize = 5;

/// Seconds that a report takes at most by default.
const LENGTH: f64 = 180.0;

/// Share of [`LENGTH`] left for the first runs, classes and measures.
const SHARE_BESIDE_RUNS: f64 = 0.1;

const FILES: [&str; 7] =
    ["report.json", "report.csv", "report.html", "error.svg", "rays.svg", "passes.svg", "reference.exr"];

/// The plots of a sweep of a setting.
fn sweep_files(setting: &str) -> [String; 2] {
    ["sweep", "savings"].map(|plot| format!("{plot}-{setting}.svg"))
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let interrupt = Interrupt::listen();
    arguments.check()?;
    let cache = arguments.cache()?;
    let schedule = Schedule::new(arguments);
    let mut starters = schedule.starters(arguments)?;
    let (scene, camera) = arguments.scene.load(arguments.settings.aspect())?;
    let settings = arguments.settings.settings(&camera)?;
    arguments.sweep.iter().try_for_each(|range| range.check(&settings))?;
    let given = arguments.reference.as_deref().map(|path| read_reference(path, &settings)).transpose()?;
    let gpu = arguments.device.open()?;
    let _folder = arguments.folder()?;
    let mut bench = Bench {
        arguments,
        scene: &scene,
        camera: &camera,
        settings: &settings,
        slowness: FirstSamples::of(&gpu).slowness(),
        gpu,
    };
    let folder = cache_folder(&cache, &bench.subject());

    interrupt.defer();
    let stop = || interrupt.raised();
    schedule.announce(arguments);
    let Some(reference) = bench.reference(given, &folder, &stop)? else {
        arguments.tell(format!("stopped; the reference so far is in {}", folder.display()));
        return Ok(Ending::Stopped);
    };
    let truth = bench.truth(&schedule, &folder)?;
    if !bench.warm_up(&mut starters, &schedule, &stop)? {
        return Ok(arguments.nothing());
    }

    let started = Instant::now();
    let classes = bench.classes(&schedule, truth.as_ref())?;
    let Rounds { runs, whole, mut end } = Rounds::take(&mut bench, &schedule, &starters, &stop);
    if whole < MIN_REPEATS {
        return end.map(|_| arguments.nothing());
    }
    if whole < schedule.repeats {
        arguments.tell(format!("the report covers {whole} of {} runs", schedule.repeats));
    }
    let measured = started.elapsed();
    let sweeps = bench.sweeps(&reference, truth.as_ref(), &stop, &mut end);

    let resumed = Instant::now();
    let mut report = bench.report(&reference, &runs, classes, &starters)?;
    report.sweeps = sweeps;
    let timed: f64 = runs.iter().map(|run| run.time).sum();
    report.overhead = Overhead::new(timed, (measured + resumed.elapsed()).as_secs_f64());
    arguments.write(&report, &reference, &runs)?;
    end
}

/// The runs to make.
struct Schedule {
    /// In the order of [`Entrant::all`], each once.
    entrants: Vec<Entrant>,
    /// In ascending order, each once.
    budgets: Vec<f64>,
    /// Seconds of a run: the longest budget.
    longest: f64,
    /// Seconds of a run of each entrant.
    round: f64,
    /// Runs of each entrant.
    repeats: usize,
}

impl Schedule {
    fn new(arguments: &Arguments) -> Self {
        let wanted = |entrant: &Entrant| arguments.techniques.contains(entrant);
        let entrants: Vec<Entrant> = Entrant::all().filter(wanted).collect();
        let mut budgets = arguments.budgets.clone();
        budgets.sort_by(f64::total_cmp);
        budgets.dedup();
        let longest = budgets.last().copied().unwrap_or(0.0);
        // `auto` renders anew for each budget.
        let automatic = entrants.iter().filter(|entrant| entrant.is_automatic()).count();
        let round = (entrants.len() - automatic) as f64 * longest + automatic as f64 * budgets.iter().sum::<f64>();
        let affordable = ((1.0 - SHARE_BESIDE_RUNS) * LENGTH / round) as usize;
        let repeats = arguments.repeats.unwrap_or(affordable.clamp(MIN_REPEATS, REPEATS));
        Schedule { entrants, budgets, longest, round, repeats }
    }

    /// The entrants with their denoisers.
    fn starters(&self, arguments: &Arguments) -> Result<Vec<Starter>> {
        let starter = |entrant: &Entrant| -> Result<Starter> {
            Ok(Starter::new(entrant.technique, arguments.oidn.denoiser(entrant.denoise)?))
        };
        self.entrants.iter().map(starter).collect()
    }

    /// The techniques that classify points, each once.
    fn classifying(&self) -> impl Iterator<Item = Technique> {
        let wanted = |technique: &Technique| self.entrants.iter().any(|entrant| entrant.technique == Some(*technique));
        Technique::all().filter(|technique| technique.classifies()).filter(wanted)
    }

    fn announce(&self, arguments: &Arguments) {
        let Schedule { longest, round, repeats, .. } = *self;
        let is_anew = self.entrants.iter().any(|entrant| entrant.is_automatic());
        let anew = if is_anew { " (auto renders anew for each budget)" } else { "" };
        let length = |repeats: usize| duration(repeats as f64 * round);
        arguments.tell(format!(
            "{} runs of {longest} s{anew}: {}, preceded by a first run of each technique, and by the reference if \
             there is none yet",
            self.entrants.len() * repeats,
            length(repeats)
        ));
        if arguments.repeats.is_none() && repeats < REPEATS {
            arguments.tell(format!(
                "{repeats} runs of each technique instead of {REPEATS}, which would give narrower intervals: \
                 --repeats {REPEATS} takes {}",
                length(REPEATS)
            ));
        }
    }
}

/// The folder of the report. If it was made for the report and stays empty, it is removed.
struct Folder<'a> {
    path: &'a Path,
    made: bool,
}

impl Drop for Folder<'_> {
    fn drop(&mut self) {
        if self.made {
            // Fails if there is something in it.
            let _ = fs::remove_dir(self.path);
        }
    }
}

/// The subject of the measurements, and the device: the one opened at the start, or a replacement of the same name.
struct Bench<'a> {
    arguments: &'a Arguments,
    scene: &'a Scene,
    camera: &'a Camera,
    settings: &'a Settings,
    gpu: Gpu,
    slowness: f64,
}

impl Bench<'_> {
    fn subject(&self) -> Subject<'_> {
        let Bench { scene, camera, settings, ref gpu, slowness, .. } = *self;
        Subject { gpu, scene, camera, settings, slowness }
    }

    /// Runs `work`. If the device is lost, runs it again from its start on another one.
    fn on<T>(&mut self, mut work: impl FnMut(&Subject<'_>) -> Result<T>) -> Result<T> {
        let Bench { arguments, scene, camera, settings, gpu, slowness } = self;
        let slowness = *slowness;
        let lost = gpu.info.clone();
        let open = || {
            let gpu = arguments.device.open()?;
            if gpu.info != lost {
                return Err(Error::NoDevice(format!("times on {} are not comparable", gpu.info.name)));
            }
            arguments
                .tell(format!("note: the device was lost; the current step starts again on another {}", lost.name));
            Ok(gpu)
        };
        recovery::anew(gpu, open, |gpu| work(&Subject { gpu, scene, camera, settings, slowness }))
    }

    /// The reference: `given`, or one made by path tracing and kept in `folder`. `None` after a signal.
    fn reference(
        &mut self,
        given: Option<Reference>,
        folder: &Path,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Reference>> {
        let arguments = self.arguments;
        let goal = Goal { standard_error: arguments.reference_error, seconds: arguments.reference_time };
        let show = |making: ReferenceProgress| {
            let ReferenceProgress { samples, standard_error } = making;
            arguments.tell(format!("reference: {samples} spp, standard error {:.2} %", 100.0 * standard_error));
        };
        let reference = match given {
            Some(reference) => Some(reference),
            None => self.on(|subject| Reference::make(subject, folder, goal, &stop, &mut { show }))?,
        };
        if let Some(reference) = reference.as_ref().filter(|reference| reference.is_short()) {
            arguments.tell(format!(
                "note: the reference has a standard error of {:.1} % after {}, above the goal of {:.1} %, and smaller \
                 errors cannot be measured against it: --reference-time gives it more time",
                100.0 * reference.standard_error().unwrap_or(0.0),
                duration(goal.seconds),
                100.0 * goal.standard_error
            ));
        }
        Ok(reference)
    }

    /// True visibility, if sweeps or techniques that classify points are compared with it.
    fn truth(&mut self, schedule: &Schedule, folder: &Path) -> Result<Option<Truth>> {
        let sweeps = !self.arguments.sweep.is_empty();
        if !sweeps && schedule.classifying().next().is_none() {
            return Ok(None);
        }
        let truth = self.on(|subject| Truth::make(subject, folder))?;
        if truth.is_none() && sweeps {
            return Err(Error::Usage(
                "--sweep: there are too many lights and pixels to compute true visibility".into(),
            ));
        }
        Ok(truth)
    }

    /// The first run of each entrant, which compiles its kernels. False after a signal.
    fn warm_up(&mut self, starters: &mut [Starter], schedule: &Schedule, stop: &dyn Fn() -> bool) -> Result<bool> {
        for starter in starters {
            if stop() {
                return Ok(false);
            }
            self.on(|subject| starter.warm_up(subject, &schedule.budgets))?;
            self.arguments.tell(format!("{}: ready after {:.2} s", starter.entrant(), starter.warm_up));
        }
        Ok(true)
    }

    /// The classes of each technique that classifies points, against `truth`.
    fn classes(&mut self, schedule: &Schedule, truth: Option<&Truth>) -> Result<Vec<Classes>> {
        let mut classes = Vec::new();
        if let Some(truth) = truth {
            for technique in schedule.classifying() {
                classes.extend(self.on(|subject| Classes::new(subject, technique, truth))?);
            }
        }
        Ok(classes)
    }

    /// The sweeps until one is stopped or fails, which sets `end`.
    fn sweeps(
        &mut self,
        reference: &Reference,
        truth: Option<&Truth>,
        stop: &dyn Fn() -> bool,
        end: &mut Result<Ending>,
    ) -> Vec<Sweep> {
        let mut sweeps = Vec::new();
        let Some(truth) = truth else { return sweeps };
        for range in &self.arguments.sweep {
            if !matches!(end, Ok(Ending::Done)) {
                break;
            }
            match self.on(|subject| Sweep::new(subject, range, reference, truth, &stop)) {
                Ok(Some(sweep)) => sweeps.push(sweep),
                Ok(None) => *end = Ok(Ending::Stopped),
                Err(error) => *end = Err(error),
            }
        }
        sweeps
    }

    /// The report on these runs, with the time of each entrant's first run.
    fn report(
        &self,
        reference: &Reference,
        runs: &[Run],
        classes: Vec<Classes>,
        starters: &[Starter],
    ) -> Result<Report> {
        let name = self.arguments.scene.scene.file_name().unwrap_or_default().to_string_lossy();
        let mut report = Report::new(&name, &self.gpu.info, reference, runs, classes)?;
        for EntrantReport { entrant, time, .. } in &mut report.entrants {
            let own = starters.iter().find(|starter| starter.entrant() == *entrant);
            time.warm_up = own.map_or(0.0, |starter| starter.warm_up);
        }
        Ok(report)
    }
}

/// The runs of all complete rounds.
struct Rounds {
    runs: Vec<Run>,
    /// Number of complete rounds.
    whole: usize,
    /// [`Ending::Done`] after all rounds; else what ended them.
    end: Result<Ending>,
}

impl Rounds {
    fn take(bench: &mut Bench<'_>, schedule: &Schedule, starters: &[Starter], stop: &dyn Fn() -> bool) -> Rounds {
        let mut rounds = Rounds { runs: Vec::new(), whole: 0, end: Ok(Ending::Done) };
        let mut starters: Vec<&Starter> = starters.iter().collect();
        while rounds.whole < schedule.repeats {
            match Rounds::round(bench, schedule, rounds.whole, &starters, stop) {
                Ok(Some(runs)) => {
                    // An entrant that has no image in one of its runs is not shown, so it needs no further runs.
                    starters.retain(|starter| {
                        let own = |run: &&Run| run.entrant() == starter.entrant();
                        runs.iter().find(own).is_some_and(|run| !run.snapshots.is_empty())
                    });
                    rounds.runs.extend(runs);
                    rounds.whole += 1;
                }
                Ok(None) => return Rounds { end: Ok(Ending::Stopped), ..rounds },
                Err(error) => return Rounds { end: Err(error), ..rounds },
            }
        }
        rounds
    }

    /// One run of each entrant, so that a machine that slows down is slow for all of them.
    fn round(
        bench: &mut Bench<'_>,
        schedule: &Schedule,
        index: usize,
        starters: &[&Starter],
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Vec<Run>>> {
        let Bench { arguments, settings, .. } = *bench;
        let Schedule { budgets, repeats, .. } = schedule;
        let seed = settings.image.seed.wrapping_add(index as u32);
        let mut runs = Vec::new();
        for starter in starters {
            let Some(run) = bench.on(|subject| Run::new(subject, starter, seed, budgets, stop))? else {
                return Ok(None);
            };
            let entrant = starter.entrant();
            let Run { ref snapshots, ref statistics, time, .. } = run;
            let late = if snapshots.is_empty() { ", too late for all budgets: no further runs" } else { "" };
            let samples = statistics.samples;
            arguments.tell(format!("{entrant}, run {} of {repeats}: {samples} spp in {time:.2} s{late}", index + 1));
            runs.push(run);
        }
        Ok(Some(runs))
    }
}

/// A duration for users.
fn duration(seconds: f64) -> String {
    super::progress::duration(seconds, |seconds| (seconds * 1e3).round() / 1e3)
}

fn write(path: &Path, text: &str) -> Result<()> {
    write_text(path, &with_flags(text))
}

/// Saves measurements that took minutes: in the folder for temporary files or, if that is full too, on stdout.
fn rescue_measurements(text: &str) -> Result<String> {
    match rescue("measurements are", "json", |path| write(path, text)) {
        Some(remark) => Ok(remark),
        None => print(text).map(|()| "; the measurements are on stdout".to_owned()),
    }
}

impl Arguments {
    /// Checks everything that can be checked before the scene is read.
    fn check(&self) -> Result<()> {
        self.settings.check(Technique::default())?;
        // `auto` takes the default technique where another would refuse the settings.
        for technique in self.techniques.iter().filter_map(|entrant| entrant.technique) {
            self.settings.check(technique).map_err(|error| match error {
                Error::Setting { name, problem } => {
                    Error::setting(name, format!("{problem}; --techniques selects those that are compared"))
                }
                other => other,
            })?;
        }
        let settings: Vec<&str> = self.sweep.iter().map(sweep::Range::setting).collect();
        if let Some(i) = (1..settings.len()).find(|i| settings[..*i].contains(&settings[*i])) {
            return Err(Error::Usage(format!("--sweep: there are two ranges of {}", settings[i])));
        }
        if let Some(repeats) = self.repeats.filter(|repeats| *repeats < MIN_REPEATS) {
            return Err(Error::Usage(format!("--repeats is {repeats}; it must be {MIN_REPEATS} or more")));
        }
        Ok(())
    }

    /// The folder of the report, in which all files can be written.
    fn folder(&self) -> Result<Folder<'_>> {
        let folder = Folder { path: &self.output, made: !self.output.exists() };
        make_folder(folder.path)?;
        let plots = self.sweep.iter().flat_map(|range| sweep_files(range.setting()));
        let names = FILES.iter().map(|name| (*name).to_owned()).chain(plots);
        names.into_iter().try_for_each(|name| film::check_target(folder.path.join(name)))?;
        Ok(folder)
    }

    /// Writes all files of the report, and says what it concludes. A file that fails does not stop the others.
    fn write(&self, report: &Report, reference: &Reference, runs: &[Run]) -> Result<()> {
        // It may have been removed since the start. If it cannot be made, neither can the files.
        let _ = fs::create_dir_all(&self.output);
        let [document, csv, html, error, rays, passes, image] = FILES.map(|name| self.output.join(name));
        let text = json(report).map(|text| text + "\n").map_err(|problem| Error::output(&document, problem))?;
        let measurements = write(&document, &text);
        let is_lost = measurements.is_err();
        let mut outcomes = vec![measurements, write(&csv, &report.csv())];
        let mut draw = |path: &Path, content: Result<String>| {
            outcomes.push(content.and_then(|content| write(path, &content)));
        };
        draw(&html, page(report, reference, runs));
        draw(&error, plot::error_over_time(report));
        draw(&rays, plot::error_over_rays(report));
        draw(&passes, plot::time_by_pass(report));
        for sweep in &report.sweeps {
            let [classes, savings] = sweep_files(sweep.setting.name()).map(|name| self.output.join(name));
            draw(&classes, plot::sweep(sweep));
            draw(&savings, plot::savings(sweep));
        }
        outcomes.push(reference.image.write_exr(&image));
        self.conclude(report);
        let remark = if is_lost { rescue_measurements(&text)? } else { String::new() };
        outcomes.into_iter().fold(Ok(()), both).map_err(|error| with_remark(error, &remark))?;
        self.tell(format!("wrote {}", html.display()));
        Ok(())
    }

    /// Says how `auto` compares with the others, and what to use.
    fn conclude(&self, report: &Report) {
        for row in &report.auto {
            let AutoReport { entrant, budget, relmse, best, best_relmse, ratio, .. } = row;
            let taken: Vec<String> = row.techniques.iter().map(ToString::to_string).collect();
            self.tell(format!(
                "{entrant} within {budget} s: {}, relMSE {:.3e}; best {best}, {:.3e}; ratio {:.2} ({:.2} to {:.2})",
                taken.join(" or "),
                relmse.value,
                best_relmse.value,
                ratio.value,
                ratio.low,
                ratio.high
            ));
        }
        self.tell(report.advice.clone());
    }

    /// Stopped before there was anything to report.
    fn nothing(&self) -> Ending {
        self.tell("stopped; nothing is written".to_owned());
        Ending::Stopped
    }

    fn tell(&self, line: String) {
        if !self.quiet {
            say(line);
        }
    }

    fn cache(&self) -> Result<PathBuf> {
        self.cache
            .clone()
            .or_else(cache::folder)
            .ok_or_else(|| Error::Usage("this user has no cache folder: name one with --cache".into()))
    }
}
