//! `penumbra check`.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use kernel_kit::{DeviceChoice, DeviceInfo, Gpu};
use penumbra::internal::memory;
use penumbra::internal::render::film::{self, View};
use penumbra::internal::report::check::{Case, Cases, Finding, Outcome, junit, kind_of, page};
use penumbra::{Error, Image, Result};

use super::child::{Ended, run_within};
use super::interrupt::Interrupt;
use super::render::temporary_folder;
use super::{Ending, print, say, shell, write_text};

/// Memory of a render: a small image on lavapipe takes 0.2 to 0.4 GB.
const JOB_BYTES: u64 = 1 << 30;

/// Stands for all cases.
const ALL: &str = "all";

#[derive(clap::Args)]
pub struct Arguments {
    /// The cases: scenes, settings, baselines and limits; see docs/check.md
    #[arg(value_name = "CASES.toml")]
    cases: PathBuf,

    /// Run only this case; may be given several times
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,

    /// Make the new image of this case its baseline, or do so for all cases; may be given several times
    #[arg(long, value_name = "NAME|all")]
    bless: Vec<String>,

    /// Instead of rendering, compare the images in this folder, made by any renderer: NAME.exr, NAME.png or NAME.hdr
    #[arg(long, value_name = "DIR", conflicts_with_all = ["twice", "jobs", "device"])]
    images: Option<PathBuf>,

    /// Render each case twice; a case fails if its two runs differ in any bit
    #[arg(long)]
    twice: bool,

    /// Number of renders at the same time [default: on a software device one for each processor, or as many as have
    /// 1 GB of memory each if that is fewer; else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    jobs: Option<u32>,

    /// Page to write, with baselines, new images and differences
    #[arg(long, value_name = "FILE.html", default_value = "check.html")]
    html: PathBuf,

    /// Write the results as JUnit XML
    #[arg(long, value_name = "FILE.xml")]
    junit: Option<PathBuf>,

    /// Device: best, software, or the index or a part of the name that `penumbra devices` prints
    #[arg(long, value_name = "D", default_value = "best")]
    device: String,
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let interrupt = Interrupt::listen();
    let all = Cases::read(&arguments.cases)?;
    let cases = arguments.selected(&all)?;
    let pages = || arguments.junit.iter().chain([&arguments.html]);
    pages().try_for_each(film::check_target)?;
    let inputs = all.cases.iter().flat_map(|case| case.scene.iter().chain([&case.baseline]));
    film::check_names(inputs.chain([&arguments.cases]), pages())?;
    let device = arguments.render_device(&all)?;
    let outcomes = match &arguments.images {
        Some(folder) => Some(cases.iter().map(|case| compare(case, folder, &arguments.cases)).collect()),
        None => {
            // A signal would end this process alone, and leave its renders running. Deferred, the first one stops them,
            // too.
            interrupt.defer();
            let is_software = device.as_ref().is_some_and(DeviceInfo::is_software);
            arguments.render_all(&cases, is_software, &|| interrupt.raised())?
        }
    };
    let Some(mut outcomes) = outcomes else {
        say("stopped; nothing is written");
        return Ok(Ending::Stopped);
    };
    for outcome in &mut outcomes {
        arguments.bless(outcome, all.device.as_deref());
    }
    for outcome in &outcomes {
        print(&line(outcome))?;
    }
    let name = device.as_ref().map(|device| device.name.as_str());
    arguments.write_pages(&all, name, &outcomes)?;
    let good = outcomes.iter().filter(|outcome| outcome.is_good()).count();
    say(format_args!("{good} of {} cases passed; see {}", outcomes.len(), arguments.html.display()));
    Ok(if good < outcomes.len() { Ending::AboveLimit } else { Ending::Done })
}

impl Arguments {
    /// The cases to run.
    fn selected(&self, all: &Cases) -> Result<Vec<Case>> {
        let known = |name: &String| all.cases.iter().any(|case| case.name == *name);
        if let Some(name) = self.only.iter().chain(self.bless.iter().filter(|name| *name != ALL)).find(|n| !known(n)) {
            return Err(Error::Usage(format!("no case of {} is called '{name}'", self.cases.display())));
        }
        let is_selected = |name: &String| self.only.is_empty() || self.only.contains(name);
        if let Some(name) = self.bless.iter().find(|name| *name != ALL && !is_selected(name)) {
            let problem = format!("--bless {name}: --only leaves this case out; add --only {name}");
            return Err(Error::Usage(problem));
        }
        let cases: Vec<Case> = all.cases.iter().filter(|case| is_selected(&case.name)).cloned().collect();
        if let Some(case) = cases.iter().find(|case| case.scene.is_none() && self.images.is_none()) {
            let problem = "has no scene: only --images can check it";
            return Err(Error::input(&self.cases, format!("case {}", case.name), problem));
        }
        Ok(cases)
    }

    /// The device that renders the cases; `None` if none are rendered. Its kind must be that of the baselines.
    fn render_device(&self, all: &Cases) -> Result<Option<DeviceInfo>> {
        if self.images.is_some() {
            return Ok(None);
        }
        let Ok(choice) = self.device.parse::<DeviceChoice>();
        // The device is closed again: renders open their own.
        let device = Gpu::open(&choice)?.info.clone();
        match &all.device {
            Some(expected) if kind_of(expected) != kind_of(&device.name) => {
                let problem = format!("the baselines are of {expected}, not of {}; choose another device", device.name);
                Err(Error::input(&self.cases, "device", problem))
            }
            _ => Ok(Some(device)),
        }
    }

    /// Writes the page and the JUnit XML, and prints the baselines that no case uses.
    fn write_pages(&self, all: &Cases, device: Option<&str>, outcomes: &[Outcome]) -> Result<()> {
        let unused: Vec<String> = all.unused().iter().map(|path| path.display().to_string()).collect();
        for path in &unused {
            say(format_args!("note: no case uses the baseline {path}"));
        }
        write_text(&self.html, &page(&self.cases, device, outcomes, &unused)?)?;
        let Some(path) = &self.junit else { return Ok(()) };
        let suite = self.cases.file_stem().unwrap_or_default().to_string_lossy();
        write_text(path, &junit(&suite, outcomes)?)
    }

    /// Renders and compares all cases, some at the same time. Each render is a process of its own, so that a crash
    /// breaks no more than its case. `None` if `stop` returns true; all renders have then ended.
    fn render_all(
        &self,
        cases: &[Case],
        is_software: bool,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<Vec<Outcome>>> {
        let jobs = self.jobs.map_or_else(|| if is_software { default_jobs() } else { 1 }, |jobs| jobs as usize);
        let unknown = |problem| Error::Usage(format!("the file of this program cannot be found: {problem}"));
        let program = env::current_exe().map_err(unknown)?;
        let folder = temporary_folder()?;
        let next = AtomicUsize::new(0);
        let outcomes = Mutex::new(vec![None; cases.len()]);
        thread::scope(|scope| {
            for _ in 0..jobs.min(cases.len()) {
                scope.spawn(|| {
                    while let Some((index, case)) = cases.iter().enumerate().nth(next.fetch_add(1, Ordering::Relaxed)) {
                        if stop() {
                            break;
                        }
                        let outcome = self.render(case, &program, &folder, stop);
                        if let Ok(mut outcomes) = outcomes.lock() {
                            outcomes[index] = Some(outcome);
                        }
                    }
                });
            }
        });
        // A folder for temporary files that cannot be removed does no harm.
        let _ = fs::remove_dir_all(&folder);
        let outcomes = outcomes.into_inner().unwrap_or_default().into_iter().flatten().collect();
        Ok(Some(outcomes).filter(|_| !stop()))
    }

    /// Renders a case once or twice, and compares it.
    fn render(&self, case: &Case, program: &Path, folder: &Path, stop: &dyn Fn() -> bool) -> Outcome {
        // The render runs in the folder of the file of cases, because paths in flags are relative to it.
        let own_folder = self.cases.parent().unwrap_or(Path::new(""));
        let scene = case.scene.as_deref().unwrap_or(Path::new(""));
        let scene = scene.strip_prefix(own_folder).unwrap_or(scene);
        let mut words = vec!["render".to_owned(), scene.display().to_string()];
        words.extend(case.flags.iter().cloned());
        words.push(format!("--device={}", self.device));
        let start = Instant::now();
        let render = |run: u32| -> std::result::Result<Image, String> {
            let file = folder.join(format!("{}-{run}.exr", case.name));
            let mut command = Command::new(program);
            command.args(&words).args(["--quiet", "-o"]).arg(&file);
            if !own_folder.as_os_str().is_empty() {
                command.current_dir(own_folder);
            }
            let limit = case.limits.seconds;
            let ended = run_within(&mut command, Duration::from_secs_f64(limit), stop);
            let Some(Ended { status, stderr }) = ended.map_err(|problem| problem.to_string())? else {
                return Err(format!("took longer than its limit `seconds`, {limit} s, and was stopped"));
            };
            if !status.success() {
                let last = stderr.lines().last().unwrap_or("it failed without a message");
                return Err(last.trim_start_matches("penumbra: error: ").to_owned());
            }
            let image = Image::read(&file).map_err(|problem| problem.to_string())?;
            // If the flags of a case denoise the image, the denoised image is compared.
            Ok(image.shown().into_owned())
        };
        let first = render(1);
        let seconds = start.elapsed().as_secs_f64();
        let both = first.and_then(|image| Ok((image, self.twice.then(|| render(2)).transpose()?)));
        words.insert(0, "penumbra".to_owned());
        words.extend(["-o".to_owned(), format!("{}.exr", case.name)]);
        let command = shell::quoted(&words);
        match both {
            Ok((image, again)) => {
                Outcome::of(case, command, seconds, image, again.as_ref(), baseline(case, &self.cases))
            }
            Err(problem) => Outcome::broken(case, command, seconds, problem),
        }
    }

    /// Makes the image of a case its baseline, if that is requested and can be.
    fn bless(&self, outcome: &mut Outcome, device: Option<&str>) {
        let name = &outcome.case.name;
        if !self.bless.iter().any(|requested| requested == ALL || requested == name) {
            return;
        }
        if let Some(problem) = outcome.cannot_be_blessed(device) {
            outcome.finding = Finding::Broken(format!("no new baseline: {problem}"));
            return;
        }
        if let Some(image) = outcome.new_baseline() {
            let path = &outcome.case.baseline;
            let folder = path.parent().unwrap_or(Path::new(""));
            let folder = fs::create_dir_all(folder).map_err(|problem| Error::output(folder, problem));
            outcome.finding = match folder.and_then(|()| image.write(path, View::Standard, 0.0)) {
                Ok(()) => {
                    say(format_args!("wrote {}", path.display()));
                    Finding::Blessed
                }
                Err(problem) => Finding::Broken(format!("no new baseline: {problem}")),
            };
        }
    }
}

/// Compares an image of another renderer.
fn compare(case: &Case, folder: &Path, cases: &Path) -> Outcome {
    let files = ["exr", "png", "hdr"].map(|extension| folder.join(format!("{}.{extension}", case.name)));
    let Some(file) = files.iter().find(|file| file.exists()) else {
        let problem = format!("there is no {}, .png or .hdr", files[0].display());
        return Outcome::broken(case, String::new(), 0.0, problem);
    };
    match read(file) {
        Ok(image) => Outcome::of(case, String::new(), 0.0, image, None, baseline(case, cases)),
        Err(problem) => Outcome::broken(case, String::new(), 0.0, problem.to_string()),
    }
}

/// An image that can be shown and compared.
fn read(path: &Path) -> Result<Image> {
    let image = Image::read(path)?;
    image.rgb().map_err(|channel| Error::input(path, channel, "there is no such channel"))?;
    Ok(image)
}

/// The baseline of a case, or why there is none.
fn baseline(case: &Case, cases: &Path) -> std::result::Result<Image, String> {
    if !case.baseline.exists() {
        let (file, name) = (case.baseline.display(), &case.name);
        let command = format!("penumbra check {} --bless {name}", cases.display());
        return Err(format!("there is no baseline {file}; {command} makes it"));
    }
    read(&case.baseline).map_err(|problem| problem.to_string())
}

/// One for each processor, if memory is enough.
fn default_jobs() -> usize {
    let processors = thread::available_parallelism().map_or(1, usize::from);
    let fitting = memory::available().map_or(usize::MAX, |bytes| (bytes / JOB_BYTES) as usize);
    processors.min(fitting).max(1)
}

fn line(outcome: &Outcome) -> String {
    let Outcome { case, comparison, seconds, .. } = outcome;
    let mut line = format!("{:<8} {:<24}", outcome.word(), case.name);
    if let Some(comparison) = comparison {
        let (relmse, flip, changed) = (comparison.relmse, comparison.flip, 100.0 * comparison.changed);
        line += &format!(" relMSE {relmse:.2e}  FLIP {flip:.4}  changed {changed:.2} %  {seconds:.1} s");
    }
    let reasons = outcome.reasons();
    if !reasons.is_empty() {
        line += &format!("\n         {reasons}");
    }
    line + "\n"
}
