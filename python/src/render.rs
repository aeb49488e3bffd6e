//! A render, with the interpreter's lock released.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use penumbra::internal::render::recovery::{self, Failure, Salvage};
use penumbra::settings::Denoise;
use penumbra::{Camera, Denoiser, DeviceChoice, Image, Renderer, Settings, Statistics};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

use crate::device::{Turn, detached, open, open_anew};
use crate::error::{Interrupted, error, of_library};
use crate::result::RenderResult;

/// What to render.
pub struct Job {
    pub scene: Arc<penumbra::Scene>,
    pub camera: Camera,
    pub settings: Settings,
    pub limits: Limits,
    pub oidn_library: Option<PathBuf>,
    pub device: DeviceChoice,
    /// Called after each batch.
    pub progress: Option<Py<PyAny>>,
    /// Seconds that it took to read the scene.
    pub import: f64,
}

/// Limits that end a render, in addition to its number of samples.
pub struct Limits {
    pub seconds: Option<f64>,
    /// The user gives no number of samples.
    pub is_open: bool,
}

/// How far a render has come.
#[pyclass(frozen, get_all, module = "penumbra")]
pub struct Progress {
    /// Samples per pixel so far.
    samples: u32,
    /// Samples per pixel at the end; None where time or noise alone ends the render.
    spp: Option<u32>,
    /// Rays of all types so far.
    rays: u64,
    /// Boundary and unknown points over all points so far.
    boundary_share: f64,
    /// Seconds since the render began.
    seconds: f64,
}

#[pymethods]
impl Progress {
    fn __repr__(&self) -> String {
        let of = self.spp.map_or(String::new(), |spp| format!(" of {spp}"));
        format!("<penumbra.Progress: {}{of} samples per pixel, {} rays>", self.samples, self.rays)
    }
}

/// The end of a render that nothing but Python has stopped.
struct Done {
    image: Image,
    statistics: Statistics,
    /// The exception that stopped it.
    stopped: Option<PyErr>,
}

/// Renders, and gives the result, or the exception with the result so far.
pub fn run(py: Python<'_>, mut job: Job) -> PyResult<RenderResult> {
    if job.limits.is_open {
        job.settings.image.spp = Settings::UNLIMITED_SPP;
    }
    job.settings.check().map_err(of_library)?;
    if job.settings.image.piece.is_some() && job.limits.seconds.is_some() {
        return Err(error(
            "time cannot be combined with samples: how many samples a pixel gets would depend on chance",
        ));
    }
    check_library(job.settings.image.denoise, job.oidn_library.as_deref())?;
    let budget = |seconds| match Duration::try_from_secs_f64(seconds) {
        Ok(time) if !time.is_zero() => Ok(time),
        _ => Err(error(&format!("time is {seconds}; it must be a finite number of seconds, more than 0"))),
    };
    let time = job.limits.seconds.map(budget).transpose()?;
    let scene_notes: Vec<String> = job.scene.notes.iter().cloned().chain(job.scene.clipped_away(&job.camera)).collect();
    let (outcome, notes) = detached(py, || {
        let mut notes = scene_notes;
        let outcome = render(&job, time, &mut notes);
        (outcome, notes)
    })?;
    let result = |image, mut statistics: Statistics| {
        let mut notes = notes.clone();
        notes.append(&mut statistics.notes);
        for note in notes {
            if !statistics.notes.contains(&note) {
                statistics.notes.push(note);
            }
        }
        RenderResult::new(py, image, &statistics)
    };
    match outcome {
        Ok(Done { image, statistics, stopped: None }) => {
            // A signal that arrived after the last batch, as while denoising, would be raised by the Python code that
            // makes the result, or before the caller has it.
            let stop = py.check_signals().err();
            let result = result(image, statistics)?;
            match stop.or_else(|| py.check_signals().err()) {
                None => Ok(result),
                Some(stop) => Err(interrupted(py, stop, Some(result))?),
            }
        }
        Ok(Done { image, statistics, stopped: Some(stop) }) => {
            let result = if statistics.samples > 0 { Some(result(image, statistics)?) } else { None };
            Err(interrupted(py, stop, result)?)
        }
        Err(Failure { error, salvage }) => {
            let raised = of_library(error);
            if let Some(salvage) = salvage {
                let Salvage { image, statistics, .. } = *salvage;
                raised.value(py).setattr("result", result(image, statistics)?)?;
            }
            Err(raised)
        }
    }
}

/// Refuses a library of Open Image Denoise that `choice` would not use.
pub fn check_library(choice: Denoise, library: Option<&Path>) -> PyResult<()> {
    match library {
        Some(library) if !choice.uses_oidn() => Err(error(&format!(
            "oidn_library {} is used only with denoise=\"auto\" or denoise=\"oidn\"",
            library.display()
        ))),
        _ => Ok(()),
    }
}

/// An `Interrupted` in place of a KeyboardInterrupt; other exceptions as they are. Each has the result.
fn interrupted(py: Python<'_>, stop: PyErr, result: Option<RenderResult>) -> PyResult<PyErr> {
    if !stop.is_instance_of::<PyKeyboardInterrupt>(py) {
        // Some exceptions take no further attribute.
        let _ = stop.value(py).setattr("result", result);
        return Ok(stop);
    }
    let raised = Interrupted::new_err("the render was interrupted; `result` has its samples so far");
    raised.value(py).setattr("result", result)?;
    Ok(raised)
}

fn render(job: &Job, time: Option<Duration>, notes: &mut Vec<String>) -> Result<Done, Failure> {
    let started = Instant::now();
    // A piece keeps what the denoisers of the merged image need.
    let is_piece = job.settings.image.piece.is_some();
    let choice = if is_piece { Denoise::None } else { job.settings.image.denoise };
    let denoiser = Denoiser::new(choice, job.oidn_library.as_deref())?;
    let shared = open(&job.device)?;
    let mut device = Turn::take(&shared, &job.device)?;
    let start = started.elapsed().as_secs_f64();
    // A time that no clock reaches is no limit.
    let deadline = time.and_then(|time| started.checked_add(time));
    let mut done = recovery::render(
        &mut device,
        || open_anew(&job.device),
        |device| Renderer::new(device, job.scene.as_ref().clone(), &job.camera, &job.settings),
        None,
        |renderer| {
            notes.extend_from_slice(renderer.notes());
            let stopped = sample(renderer, job, &denoiser, started, deadline)?;
            let (mut image, mut statistics) = (renderer.image()?, renderer.statistics()?);
            notes.extend(renderer.note_on_noise());
            notes.extend(renderer.note_on(&image));
            if renderer.samples() > 0 && denoiser.choice() != Denoise::None {
                let start = Instant::now();
                let outcome = renderer.add_denoised(&mut image, &denoiser);
                statistics.time.denoise = start.elapsed().as_secs_f64();
                if let Err(error) = outcome {
                    let salvage = Salvage { image, statistics, checkpoint: None };
                    return Err(Failure { error, salvage: Some(Box::new(salvage)) });
                }
            }
            Ok(Done { image, statistics, stopped })
        },
    )?;
    done.statistics.time.start = start;
    done.statistics.time.import = job.import;
    done.statistics.time.total = started.elapsed().as_secs_f64() + job.import;
    Ok(done)
}

/// Renders samples until there are enough, or until Python stops it: returns the exception, if there is one.
fn sample(
    renderer: &mut Renderer<'_>,
    job: &Job,
    denoiser: &Denoiser,
    started: Instant,
    deadline: Option<Instant>,
) -> penumbra::Result<Option<PyErr>> {
    let goal = Some(job.settings.image.spp).filter(|_| !job.limits.is_open);
    // Signals may have arrived during the preparation.
    if let Err(stop) = Python::attach(|py| py.check_signals()) {
        return Ok(Some(stop));
    }
    loop {
        let left = || deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()).as_secs_f64());
        if !renderer.wants_samples_within(denoiser, left().unwrap_or(f64::INFINITY))? {
            break;
        }
        let progress = match left() {
            None => Some(renderer.render_batch()?),
            Some(left) => renderer.render_within(left)?,
        };
        let Some(penumbra::Progress { samples, rays, boundary_share }) = progress else { break };
        let seconds = started.elapsed().as_secs_f64();
        let progress = Progress { samples, spp: goal, rays, boundary_share, seconds };
        match Python::attach(|py| report(py, job.progress.as_ref(), progress)) {
            Ok(true) => {}
            Ok(false) => break,
            Err(stop) => return Ok(Some(stop)),
        }
    }
    Ok(None)
}

/// Calls the user's function. Returns whether the render continues.
fn report(py: Python<'_>, function: Option<&Py<PyAny>>, progress: Progress) -> PyResult<bool> {
    py.check_signals()?;
    let Some(function) = function else { return Ok(true) };
    let answer = function.bind(py).call1((progress,))?;
    // A signal that arrives while Python code runs is raised by that code. Numpy has a `False` of its own.
    Ok(answer.extract().unwrap_or(true))
}
