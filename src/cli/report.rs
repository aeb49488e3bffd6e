//! `penumbra report`.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use penumbra::internal::gpu::Gpu;
use penumbra::internal::render::film;
use penumbra::internal::render::recovery;
use penumbra::internal::report::classes::{Classes, Truth};
use penumbra::internal::report::document::{LEAST_REPEATS, Overhead, Report, TechniqueReport};
use penumbra::internal::report::page::page;
use penumbra::internal::report::plot;
use penumbra::internal::report::reference::{Goal, Making, Reference, cache_folder};
use penumbra::internal::report::run::{Run, Subject, warm_up};
use penumbra::internal::report::sweep::{self, Sweep};
use penumbra::{Camera, Error, Result, Scene, Settings, Technique};

use super::interrupt::Interrupt;
use super::options::{DeviceOptions, SceneOptions, SettingsOptions, positive, read_reference, techniques};
use super::{Ending, json, say};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneOptions,

    /// Folder to write to: report.html, report.json, report.csv, the plots as .svg, and reference.exr
    #[arg(short, long, value_name = "DIR", help_heading = "Output")]
    output: PathBuf,

    /// Print errors only
    #[arg(long, help_heading = "Output")]
    quiet: bool,

    /// Techniques to compare, with commas
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = Technique::ALL, value_parser = techniques(), help_heading = "Report")]
    techniques: Vec<Technique>,

    /// Seconds after which images are compared, with commas; set-up counts, opening the device and the file does not
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = [0.5, 1.0, 2.0, 5.0, 10.0, 30.0], value_parser = positive, help_heading = "Report")]
    budgets: Vec<f64>,

    /// Runs of each technique, with seeds from --seed on: at least 3, as intervals come from their differences. All runs of all
    /// techniques last as long as the longest budget [default: 5, or as few as 3 where the report would take more than 3 minutes]
    #[arg(long, value_name = "N", help_heading = "Report")]
    repeats: Option<usize>,

    /// Setting of the visibility map to sweep, photons or nearest, like photons=1e3..1e6; may be given several times
    #[arg(long, value_name = "RANGE", help_heading = "Report")]
    sweep: Vec<sweep::Range>,

    /// Image to compare with, with its variance in .exr if it has that (--aov variance) [default: made by path tracing]
    #[arg(long, value_name = "FILE", help_heading = "Reference")]
    reference: Option<PathBuf>,

    /// Standard error of the reference that is made, over its mean radiance
    #[arg(long, value_name = "X", default_value_t = 0.01, value_parser = positive, help_heading = "Reference")]
    reference_error: f64,

    /// Seconds that it may take in all, after which it is used as it is, with the error that it has by then
    #[arg(long, value_name = "SECONDS", default_value_t = 600.0, value_parser = positive, help_heading = "Reference")]
    reference_time: f64,

    /// Folder where references are kept, and taken up again after an interruption [default: the user's cache folder]
    #[arg(long, value_name = "DIR", help_heading = "Reference")]
    cache: Option<PathBuf>,

    #[command(flatten)]
    settings: SettingsOptions,

    #[command(flatten)]
    device: DeviceOptions,
}

/// Runs of each technique where nothing else is said and time allows: Student's factor on intervals falls by little from here on.
const REPEATS: usize = 5;

/// Seconds that a report is to take where the number of runs is not given, and the share of them that is left for what comes beside the
/// runs: first runs, classes, measures.
const LENGTH: f64 = 180.0;
const BESIDE: f64 = 0.1;

const FILES: [&str; 7] =
    ["report.json", "report.csv", "report.html", "error.svg", "rays.svg", "passes.svg", "reference.exr"];

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let interrupt = Interrupt::listen();
    arguments.check()?;
    let cache = arguments.cache()?;
    let (scene, camera) = arguments.scene.load()?;
    let settings = arguments.settings.settings(&camera)?;
    arguments.sweep.iter().try_for_each(|range| range.check(&settings))?;
    let given = arguments.reference.as_deref().map(|path| read_reference(path, &settings)).transpose()?;
    let gpu = arguments.device.open()?;
    let _folder = arguments.folder()?;
    let mut bench = Bench { arguments, scene: &scene, camera: &camera, settings: &settings, gpu };
    let folder = cache_folder(&cache, &bench.subject());

    interrupt.defer();
    let stop = || interrupt.raised();
    let tell = |line: String| arguments.tell(line);
    let (techniques, budgets) = (arguments.techniques(), arguments.budgets());
    let longest = budgets.last().copied().unwrap_or(0.0);
    let repeats = arguments.repeats(longest);
    let count = techniques.len() * repeats;
    tell(format!(
        "{count} runs of {longest} s: {}, and before that the reference where there is none, and a first run of each technique",
        duration(count as f64 * longest)
    ));
    if arguments.repeats.is_none() && repeats < REPEATS {
        tell(format!(
            "{repeats} runs of each technique instead of {REPEATS}, whose intervals would be narrower: --repeats {REPEATS} takes {}",
            duration((techniques.len() * REPEATS) as f64 * longest)
        ));
    }
    let goal = Goal { standard_error: arguments.reference_error, seconds: arguments.reference_time };
    let reference = match given {
        Some(reference) => Some(reference),
        None => bench.on(|subject| {
            Reference::make(subject, &folder, goal, &stop, &mut |making| {
                let Making { samples, standard_error } = making;
                tell(format!("reference: {samples} spp, standard error {:.2} %", 100.0 * standard_error));
            })
        })?,
    };
    let Some(reference) = reference else {
        tell(format!("stopped; the reference so far is in {}", folder.display()));
        return Ok(Ending::Stopped);
    };
    if reference.is_short() {
        tell(format!(
            "note: the reference has a standard error of {:.1} % after {}, not the {:.1} % asked for, and no error below that can be \
             told: --reference-time gives it longer",
            100.0 * reference.standard_error().unwrap_or(0.0),
            duration(goal.seconds),
            100.0 * goal.standard_error
        ));
    }
    let nothing = || {
        tell("stopped; nothing is written".to_owned());
        Ok(Ending::Stopped)
    };
    let asks = !arguments.sweep.is_empty() || techniques.iter().any(|technique| technique.classifies());
    let truth = if asks { bench.on(|subject| Truth::make(subject, &folder))? } else { None };
    if truth.is_none() && !arguments.sweep.is_empty() {
        return Err(Error::Usage("--sweep: there are too many lights and pixels to tell true visibility".into()));
    }
    let mut warm_ups = Vec::new();
    for &technique in &techniques {
        if stop() {
            return nothing();
        }
        let seconds = bench.on(|subject| warm_up(subject, technique, longest))?;
        tell(format!("{technique}: ready after {seconds:.2} s"));
        warm_ups.push((technique, seconds));
    }

    let started = Instant::now();
    let mut classes = Vec::new();
    if let Some(truth) = &truth {
        for technique in techniques.iter().filter(|technique| technique.classifies()) {
            classes.extend(bench.on(|subject| Classes::new(subject, *technique, truth))?);
        }
    }
    let Rounds { runs, whole, mut end } = Rounds::take(&mut bench, repeats, &techniques, &budgets, &stop);
    if whole < LEAST_REPEATS {
        return end.and_then(|_| nothing());
    }
    if whole < repeats {
        tell(format!("the report is of {whole} of {repeats} runs"));
    }
    let counted = started.elapsed();
    let mut sweeps = Vec::new();
    if let Some(truth) = &truth {
        for range in &arguments.sweep {
            if !matches!(end, Ok(Ending::Done)) {
                break;
            }
            match bench.on(|subject| Sweep::new(subject, range, &reference, truth, &stop)) {
                Ok(Some(sweep)) => sweeps.push(sweep),
                Ok(None) => end = Ok(Ending::Stopped),
                Err(error) => end = Err(error),
            }
        }
    }
    let resumed = Instant::now();
    let name = arguments.scene.scene.file_name().unwrap_or_default().to_string_lossy();
    let mut report = Report::new(&name, &bench.gpu.info, &reference, &runs, classes)?;
    report.sweeps = sweeps;
    for TechniqueReport { settings, time, .. } in &mut report.techniques {
        let own = warm_ups.iter().find(|(technique, _)| *technique == settings.technique);
        time.warm_up = own.map_or(0.0, |(_, seconds)| *seconds);
    }
    let timed: f64 = runs.iter().map(|run| run.spent).sum();
    report.overhead = Overhead::new(timed, (counted + resumed.elapsed()).as_secs_f64());

    // It was there at the start.
    fs::create_dir_all(&arguments.output).map_err(|problem| Error::output(&arguments.output, problem))?;
    let [document, csv, html, error, rays, passes, image] = FILES.map(|name| arguments.output.join(name));
    let text = json(&report).map_err(|problem| Error::output(&document, problem))?;
    write(&document, &(text + "\n"))?;
    write(&csv, &report.csv())?;
    write(&html, &page(&report, &reference, &runs)?)?;
    write(&error, &plot::error_over_time(&report)?)?;
    write(&rays, &plot::error_over_rays(&report)?)?;
    write(&passes, &plot::time_by_pass(&report)?)?;
    for sweep in &report.sweeps {
        write(&arguments.output.join(format!("sweep-{}.svg", sweep.setting.name())), &plot::sweep(sweep)?)?;
    }
    reference.image.write_exr(&image)?;
    tell(format!("{}\nwrote {}", report.advice, html.display()));
    end
}

/// The folder of the report. One that was made for it goes again where no report comes into it.
struct Folder<'a> {
    path: &'a Path,
    made: bool,
}

impl Drop for Folder<'_> {
    fn drop(&mut self) {
        if self.made {
            // Refused where there is something in it.
            let _ = fs::remove_dir(self.path);
        }
    }
}

/// What is measured, on the device that was opened or one like it that took its place.
struct Bench<'a> {
    arguments: &'a Arguments,
    scene: &'a Scene,
    camera: &'a Camera,
    settings: &'a Settings,
    gpu: Gpu,
}

impl Bench<'_> {
    fn subject(&self) -> Subject<'_> {
        Subject { gpu: &self.gpu, scene: self.scene, camera: self.camera, settings: self.settings }
    }

    /// Has `work` done, anew where the device is lost.
    fn on<T>(&mut self, mut work: impl FnMut(&Subject<'_>) -> Result<T>) -> Result<T> {
        let Bench { arguments, scene, camera, settings, gpu } = self;
        let lost = gpu.info.clone();
        let open = || {
            let gpu = arguments.device.open()?;
            if gpu.info != lost {
                return Err(Error::NoDevice(format!("times on {} are not comparable", gpu.info.name)));
            }
            arguments
                .tell(format!("note: the device was lost; what was under way begins anew on another {}", lost.name));
            Ok(gpu)
        };
        recovery::anew(gpu, open, |gpu| work(&Subject { gpu, scene, camera, settings }))
    }
}

/// The runs of whole rounds of all techniques.
struct Rounds {
    runs: Vec<Run>,
    /// How many rounds are whole.
    whole: usize,
    /// Whether they are all; else what ended them.
    end: Result<Ending>,
}

impl Rounds {
    fn take(
        bench: &mut Bench<'_>,
        repeats: usize,
        techniques: &[Technique],
        budgets: &[f64],
        stop: &dyn Fn() -> bool,
    ) -> Rounds {
        let mut rounds = Rounds { runs: Vec::new(), whole: 0, end: Ok(Ending::Done) };
        let mut techniques = techniques.to_vec();
        while rounds.whole < repeats {
            match Rounds::round(bench, [rounds.whole, repeats], &techniques, budgets, stop) {
                Ok(Some(runs)) => {
                    // No further run could help who has no image in one: none is shown that not all runs have.
                    techniques.retain(|technique| {
                        let own = |run: &&Run| run.settings.technique == *technique;
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

    /// A run of each, in turn, so that a machine that grows slow is slow for all techniques.
    fn round(
        bench: &mut Bench<'_>,
        [index, repeats]: [usize; 2],
        techniques: &[Technique],
        budgets: &[f64],
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Vec<Run>>> {
        let Bench { arguments, settings, .. } = *bench;
        let seed = settings.image.seed.wrapping_add(index as u32);
        let mut runs = Vec::new();
        for &technique in techniques {
            let Some(run) = bench.on(|subject| Run::new(subject, technique, seed, budgets, stop))? else {
                return Ok(None);
            };
            let Run { ref snapshots, ref statistics, time, .. } = run;
            let late = if snapshots.is_empty() { ", too late for all budgets: no further runs" } else { "" };
            let samples = statistics.samples;
            arguments.tell(format!("{technique}, run {} of {repeats}: {samples} spp in {time:.2} s{late}", index + 1));
            runs.push(run);
        }
        Ok(Some(runs))
    }
}

/// Seconds in words.
fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, _) => format!("{} s", (seconds * 1e3).round() / 1e3),
        (0, minutes, seconds) => format!("{minutes} min {seconds} s"),
        (hours, minutes, _) => format!("{hours} h {minutes} min"),
    }
}

fn write(path: &Path, text: &str) -> Result<()> {
    film::write_atomically(path, |file| Ok(file.write_all(text.as_bytes())?))
}

impl Arguments {
    /// Everything that can be known to be wrong before the scene is read.
    fn check(&self) -> Result<()> {
        self.settings.check()?;
        if let Some(repeats) = self.repeats.filter(|repeats| *repeats < LEAST_REPEATS) {
            return Err(Error::Usage(format!("--repeats is {repeats}; it must be {LEAST_REPEATS} or more")));
        }
        Ok(())
    }

    /// The folder, in which a report can be written.
    fn folder(&self) -> Result<Folder<'_>> {
        let folder = Folder { path: &self.output, made: !self.output.exists() };
        fs::create_dir_all(folder.path).map_err(|problem| Error::output(folder.path, problem))?;
        FILES.iter().try_for_each(|name| film::check_target(folder.path.join(name)))?;
        Ok(folder)
    }

    /// Runs of each technique: as many as are asked for, or as there is time for.
    fn repeats(&self, longest: f64) -> usize {
        let round = self.techniques().len() as f64 * longest;
        let whole = ((1.0 - BESIDE) * LENGTH / round) as usize;
        self.repeats.unwrap_or(whole.clamp(LEAST_REPEATS, REPEATS))
    }

    fn tell(&self, line: String) {
        if !self.quiet {
            say(line);
        }
    }

    fn cache(&self) -> Result<PathBuf> {
        let own = || dirs::cache_dir().map(|folder| folder.join("penumbra"));
        self.cache.clone().or_else(own).ok_or_else(|| Error::Usage("no cache folder is known: give --cache".into()))
    }

    /// In the order of [`Technique::ALL`], each once.
    fn techniques(&self) -> Vec<Technique> {
        Technique::ALL.into_iter().filter(|technique| self.techniques.contains(technique)).collect()
    }

    /// In order, each once.
    fn budgets(&self) -> Vec<f64> {
        let mut budgets = self.budgets.clone();
        budgets.sort_by(f64::total_cmp);
        budgets.dedup();
        budgets
    }
}
