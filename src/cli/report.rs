//! `penumbra report`.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use penumbra::film;
use penumbra::report::classes::{Classes, Truth};
use penumbra::report::document::{LEAST_REPEATS, Overhead, Report};
use penumbra::report::page::page;
use penumbra::report::plot;
use penumbra::report::reference::{Making, Reference, cache_folder};
use penumbra::report::run::{Run, Subject};
use penumbra::report::sweep::{self, Sweep};
use penumbra::{Error, Result, Technique};

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

    /// Runs of each technique, with seeds from --seed on: at least 3, as intervals come from their differences
    #[arg(long, value_name = "N", default_value_t = 5, help_heading = "Report")]
    repeats: usize,

    /// Setting of the visibility map to sweep, photons or nearest, like photons=1e3..1e6; may be given several times
    #[arg(long, value_name = "RANGE", help_heading = "Report")]
    sweep: Vec<sweep::Range>,

    /// Image to compare with, with its variance in .exr if it has that (--aov variance) [default: made by path tracing]
    #[arg(long, value_name = "FILE", help_heading = "Reference")]
    reference: Option<PathBuf>,

    /// Standard error of the reference that is made, over its mean radiance
    #[arg(long, value_name = "X", default_value_t = 0.01, value_parser = positive, help_heading = "Reference")]
    reference_error: f64,

    /// Folder where references are kept, and taken up again after an interruption [default: the user's cache folder]
    #[arg(long, value_name = "DIR", help_heading = "Reference")]
    cache: Option<PathBuf>,

    #[command(flatten)]
    settings: SettingsOptions,

    #[command(flatten)]
    device: DeviceOptions,
}

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
    let subject = Subject { gpu: &gpu, scene: &scene, camera: &camera, settings: &settings };
    let folder = cache_folder(&cache, &subject);

    interrupt.defer();
    let stop = || interrupt.raised();
    let tell = |line: String| {
        if !arguments.quiet {
            say(line);
        }
    };
    let reference = match given {
        Some(reference) => Some(reference),
        None => Reference::make(&subject, &folder, arguments.reference_error, &stop, &mut |making| {
            let Making { samples, standard_error } = making;
            tell(format!("reference: {samples} spp, standard error {:.2} %", 100.0 * standard_error));
        })?,
    };
    let Some(reference) = reference else {
        tell(format!("stopped; the reference so far is in {}", folder.display()));
        return Ok(Ending::Stopped);
    };
    let (techniques, budgets) = (arguments.techniques(), arguments.budgets());
    let asks = !arguments.sweep.is_empty() || techniques.iter().any(|technique| technique.classifies());
    let truth = if asks { Truth::make(&subject, &folder)? } else { None };

    let started = Instant::now();
    let mut runs = Vec::new();
    for repeat in 0..arguments.repeats {
        // In turn, so that a machine that grows slow is slow for all of them.
        for &technique in &techniques {
            let seed = settings.seed.wrapping_add(repeat as u32);
            let Some(run) = Run::new(&subject, technique, seed, &budgets, &stop)? else {
                tell("stopped; nothing is written".to_owned());
                return Ok(Ending::Stopped);
            };
            let samples = run.statistics.samples;
            tell(format!(
                "{technique}, run {} of {}: {samples} spp in {:.2} s",
                repeat + 1,
                arguments.repeats,
                run.time
            ));
            runs.push(run);
        }
    }
    let mut classes = Vec::new();
    if let Some(truth) = &truth {
        for technique in techniques.iter().filter(|technique| technique.classifies()) {
            classes.extend(Classes::new(&subject, *technique, truth)?);
        }
    }
    let counted = started.elapsed();
    let mut sweeps = Vec::new();
    for range in &arguments.sweep {
        let Some(truth) = &truth else {
            return Err(Error::Usage("--sweep: there are too many lights and pixels to tell true visibility".into()));
        };
        let Some(sweep) = Sweep::new(&subject, range, &reference, truth, &stop)? else {
            tell("stopped; nothing is written".to_owned());
            return Ok(Ending::Stopped);
        };
        sweeps.push(sweep);
    }
    let resumed = Instant::now();
    let name = arguments.scene.scene.file_name().unwrap_or_default().to_string_lossy();
    let mut report = Report::new(&name, &gpu.info, &reference, &runs, classes)?;
    report.sweeps = sweeps;
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
    Ok(Ending::Done)
}

fn write(path: &Path, text: &str) -> Result<()> {
    film::write_atomically(path, |file| Ok(file.write_all(text.as_bytes())?))
}

impl Arguments {
    /// Everything that can be known to be wrong before the scene is read.
    fn check(&self) -> Result<()> {
        self.settings.check()?;
        if self.repeats < LEAST_REPEATS {
            return Err(Error::Usage(format!("--repeats is {}; it must be {LEAST_REPEATS} or more", self.repeats)));
        }
        fs::create_dir_all(&self.output).map_err(|problem| Error::output(&self.output, problem))?;
        FILES.iter().try_for_each(|name| film::check_target(self.output.join(name)))
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
