//! Renders that outlive their device, and those that end early leaving what they had.

use std::time::{Duration, Instant};

use crate::gpu::Gpu;
use crate::{Error, Image, Result, Statistics};

use super::checkpoint::Checkpoint;
use super::{Renderer, output};

/// What samples have left is kept once this many times as long has passed as keeping it took: a fiftieth of the time, at most.
const KEPT_PER_COST: u32 = 50;

/// How often a device may be lost before more samples are kept: one that is lost again and again at the same place is lost by
/// what it is asked to do.
const MOST_LOSSES: u64 = 3;

/// What a render left that failed.
pub struct Failure {
    /// Why it failed.
    pub error: Error,
    /// What there was when it was last kept; none before the first samples.
    pub salvage: Option<Box<Salvage>>,
}

/// A render as far as it had come.
pub struct Salvage {
    /// The image.
    pub image: Image,
    /// What was done.
    pub statistics: Statistics,
    /// To go on from.
    pub checkpoint: Checkpoint,
}

/// Has `work` done with a renderer that `start` makes and that goes on from `from`. Where the device is lost meanwhile, another
/// is opened by `open`, and `work` begins again with a renderer that stands where the state was last kept, in memory: the
/// image is the same, bit for bit. Keeping takes a fiftieth of the time at most, and as much memory as a checkpoint.
///
/// # Errors
/// Those of `start` and `work`, and of `open` where there is no other device or the device is lost again and again; with what
/// can be saved of the render.
pub fn render<T>(
    mut gpu: Gpu,
    open: impl Fn() -> Result<Gpu>,
    start: impl Fn(&Gpu) -> Result<Renderer<'_>>,
    from: Option<Checkpoint>,
    mut work: impl FnMut(&mut Renderer<'_>) -> Result<T>,
) -> std::result::Result<T, Failure> {
    let mut salvage: Option<Box<Salvage>> = None;
    // Since something was kept.
    let mut losses = 0;
    loop {
        let state = salvage.as_ref().map(|salvage| &salvage.checkpoint).or(from.as_ref());
        let begun = begin(&gpu, &start, state, losses);
        let (error, left) = match begun {
            Err(error) => (error, None),
            Ok(mut renderer) => match work(&mut renderer) {
                Ok(done) => return Ok(done),
                Err(error) => (error, renderer.salvage()),
            },
        };
        if left.is_some() {
            (salvage, losses) = (left, 0);
        }
        drop(gpu);
        gpu = match another(&open, error, losses) {
            Ok(gpu) => gpu,
            Err(error) => return Err(Failure { error, salvage }),
        };
        losses += 1;
    }
}

/// Has `work` done on `gpu`. Where that is lost meanwhile another takes its place, opened by `open`, and `work` begins anew: for
/// what is timed, and may not be pieced together.
///
/// # Errors
/// Those of `work`, and of `open` where there is no other device or the device is lost again and again.
pub fn anew<T>(gpu: &mut Gpu, open: impl Fn() -> Result<Gpu>, mut work: impl FnMut(&Gpu) -> Result<T>) -> Result<T> {
    let mut losses = 0;
    loop {
        match work(gpu) {
            Err(error @ Error::DeviceLost { .. }) => *gpu = another(&open, error, losses)?,
            outcome => return outcome,
        }
        losses += 1;
    }
}

/// Another device where `error` says that one was lost, as `losses` were before; else the error.
fn another(open: &impl Fn() -> Result<Gpu>, error: Error, losses: u64) -> Result<Gpu> {
    let Error::DeviceLost { at, problem } = error else { return Err(error) };
    if losses == MOST_LOSSES {
        return Err(Error::DeviceLost { at, problem });
    }
    open().map_err(|none| {
        let problem = format!("{problem}; and no other is to be had: {none}");
        Error::DeviceLost { at, problem }
    })
}

fn begin<'g>(
    gpu: &'g Gpu,
    start: &impl Fn(&'g Gpu) -> Result<Renderer<'g>>,
    from: Option<&Checkpoint>,
    losses: u64,
) -> Result<Renderer<'g>> {
    let mut renderer = start(gpu)?;
    if let Some(from) = from {
        renderer.resume_from(from)?;
    }
    renderer.totals.devices_lost += losses;
    renderer.keeping = Some(Keeping { state: None, at: Instant::now(), cost: Duration::ZERO });
    Ok(renderer)
}

/// What is kept of a render, in memory.
pub(super) struct Keeping {
    state: Option<Checkpoint>,
    at: Instant,
    /// The time that the last keeping took.
    cost: Duration,
}

impl Renderer<'_> {
    /// Keeps what samples have left, where that is asked for and due.
    pub(super) fn keep(&mut self) -> Result<()> {
        let Some(keeping) = &self.keeping else { return Ok(()) };
        if keeping.at.elapsed() < keeping.cost * KEPT_PER_COST {
            return Ok(());
        }
        let start = Instant::now();
        let state = Some(self.unsigned_checkpoint()?);
        self.keeping = Some(Keeping { state, at: Instant::now(), cost: start.elapsed() });
        Ok(())
    }

    /// Image, statistics and checkpoint of what was kept, without asking the device; the renderer is of no use then.
    fn salvage(&mut self) -> Option<Box<Salvage>> {
        let kept = self.keeping.take()?.state?;
        self.samples = kept.samples();
        self.totals = kept.totals().clone();
        let image = output::image(self, Some(&kept)).ok()?;
        let statistics = output::statistics(self, self.gpu.known_pass_times());
        Some(Box::new(Salvage { image, statistics, checkpoint: kept.signed(self) }))
    }
}
