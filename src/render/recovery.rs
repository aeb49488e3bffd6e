//! Renders that go on after their device is lost, and what is left of those that fail.

use std::time::Instant;

use kernel_kit::Gpu;

use super::checkpoint::Checkpoint;
use super::keeping::Keeping;
use super::output;
use super::renderer::Renderer;
use crate::{Error, Image, Result, Statistics};

/// How often a device may be lost before more samples are kept: where it is lost again and again at the same sample,
/// its work is the cause.
const MAX_LOSSES: u64 = 3;

/// What a failed render left.
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

/// Runs `work` with a renderer that `start` makes and that resumes `from`. Where the device is lost, `open` opens
/// another one, and `work` begins again with a renderer that resumes the state kept last in memory: the image is the
/// same, bit for bit. Keeping the state takes a fiftieth of the time at most, and as much memory as a checkpoint.
///
/// # Errors
/// Those of `start` and `work`, and of `open` where there is no other device or the device is lost again and again;
/// with what can be saved of the render.
pub fn render<T>(
    mut gpu: Gpu,
    open: impl Fn() -> Result<Gpu>,
    start: impl Fn(&Gpu) -> Result<Renderer<'_>>,
    from: Option<Checkpoint>,
    mut work: impl FnMut(&mut Renderer<'_>) -> Result<T>,
) -> std::result::Result<T, Failure> {
    let mut salvage: Option<Box<Salvage>> = None;
    // Since a state was kept.
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

/// Runs `work` on `gpu`. Where the device is lost, `open` opens another one, and `work` begins anew: for timed work,
/// which may not be pieced together.
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

/// Another device where `error` says that one was lost, after `losses` before it; else the error.
fn another(open: &impl Fn() -> Result<Gpu>, error: Error, losses: u64) -> Result<Gpu> {
    let Error::DeviceLost { at, problem } = error else { return Err(error) };
    if losses == MAX_LOSSES {
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
    renderer.keeping = Some(Keeping::new());
    Ok(renderer)
}

impl Renderer<'_> {
    /// Keeps what samples have left, where the caller wants that and it is due.
    pub(super) fn keep(&mut self) -> Result<()> {
        if self.keeping.as_ref().is_some_and(Keeping::is_due) {
            let start = Instant::now();
            self.keeping = Some(Keeping::of(self.unsigned_checkpoint()?, start));
        }
        Ok(())
    }

    /// Image, statistics and checkpoint of the state kept last, without the device; the renderer is of no use then.
    fn salvage(&mut self) -> Option<Box<Salvage>> {
        let kept = self.keeping.take()?.state?;
        self.samples = kept.header.samples;
        self.totals = kept.header.totals.clone();
        let image = output::image(self, Some(&kept)).ok()?;
        let statistics = output::statistics(self, self.gpu.known_pass_times());
        Some(Box::new(Salvage { image, statistics, checkpoint: kept.signed(self.fingerprint()) }))
    }
}
