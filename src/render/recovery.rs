//! Renders that continue after their device is lost, and the results of renders that fail.

use std::time::Instant;

use kernel_kit::Gpu;

use super::backup::Backup;
use super::checkpoint::Checkpoint;
use super::host_memory::has_room;
use super::output;
use super::renderer::Renderer;
use crate::light_transport::fine_cells::FineCellMap;
use crate::passes::film::Plane;
use crate::{Error, Image, Result, Statistics};

/// How often a device may be lost without new samples: if it is lost at the same sample again and again, the render
/// itself is the cause.
const MAX_LOSSES: u64 = 3;

/// A failed render.
pub struct Failure {
    /// The reason.
    pub error: Error,
    /// What the work had in hand, else the state that was kept last; `None` before the first samples.
    pub salvage: Option<Box<Salvage>>,
}

impl From<Error> for Failure {
    /// With nothing in hand.
    fn from(error: Error) -> Failure {
        Failure { error, salvage: None }
    }
}

/// The results of an incomplete render.
pub struct Salvage {
    /// The image.
    pub image: Image,
    /// The statistics.
    pub statistics: Statistics,
    /// A checkpoint from which it can continue, if one was requested or kept.
    pub checkpoint: Option<Checkpoint>,
}

/// Runs `work` on `gpu`, with a renderer that `start` makes and that resumes `from`. If the device is lost, `open`
/// opens another one, and `work` begins again with a renderer that resumes from the state kept last in memory. The
/// image has the same bits, unless it is to end in time. Keeping the state takes at most a fiftieth of the time, and as
/// much memory as a checkpoint, if so much is left.
///
/// Work that fails when its samples are in memory, such as while it denoises them, passes them on with its error. If
/// the device is lost it begins again all the same, because another device may complete it.
///
/// # Errors
/// Those of `start` and `work`, and of `open` if there is no other device or the device is lost again and again; with
/// the results that can be saved.
pub fn render<T>(
    gpu: &mut Gpu,
    open: impl Fn() -> Result<Gpu>,
    start: impl Fn(&Gpu) -> Result<Renderer<'_>>,
    from: Option<Checkpoint>,
    mut work: impl FnMut(&mut Renderer<'_>) -> std::result::Result<T, Failure>,
) -> std::result::Result<T, Failure> {
    let (mut in_hand, mut salvage): (Option<Box<Salvage>>, Option<Box<Salvage>>) = (None, None);
    // Since the last state was kept.
    let mut losses = 0;
    loop {
        let state = salvage.as_ref().and_then(|salvage| salvage.checkpoint.as_ref()).or(from.as_ref());
        let begun = begin(gpu, &start, state, losses);
        let (error, left) = match begun {
            Err(error) => (error, None),
            Ok(mut renderer) => match work(&mut renderer) {
                Ok(done) => return Ok(done),
                Err(Failure { error, salvage }) => {
                    in_hand = salvage.or(in_hand);
                    (error, renderer.salvage())
                }
            },
        };
        if left.is_some() {
            (salvage, losses) = (left, 0);
        }
        *gpu = match another(&open, error, losses) {
            Ok(gpu) => gpu,
            Err(error) => return Err(Failure { error, salvage: in_hand.or(salvage) }),
        };
        losses += 1;
    }
}

/// Runs `work` on `gpu`. If the device is lost, `open` opens another one, and `work` begins again: for timed work,
/// which must run without a break.
///
/// # Errors
/// Those of `work`, and of `open` if there is no other device or the device is lost again and again.
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

/// Another device if `error` is the loss of one, after `losses` earlier ones; else the error.
fn another(open: &impl Fn() -> Result<Gpu>, error: Error, losses: u64) -> Result<Gpu> {
    let Error::DeviceLost { at, problem } = error else { return Err(error) };
    if losses == MAX_LOSSES {
        return Err(Error::DeviceLost { at, problem });
    }
    open().map_err(|none| {
        let problem = format!("{problem}; no other device is available: {none}");
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
    renderer.backup = Some(Backup::new());
    Ok(renderer)
}

impl Renderer<'_> {
    /// Copies the state of the samples to memory, if the caller requests this and a copy is due.
    pub(super) fn back_up_if_due(&mut self) -> Result<()> {
        if self.backup.as_ref().is_some_and(Backup::is_due) {
            if !self.has_room_for_copy() {
                let note =
                    "there is too little memory to keep a copy of the samples: if the device is lost, so are they";
                if !self.notes.iter().any(|said| said == note) {
                    self.notes.push(note.to_owned());
                }
                return Ok(());
            }
            let start = Instant::now();
            self.backup = Some(Backup::of(self.checkpoint_without_fingerprint()?, start));
        }
        Ok(())
    }

    /// Whether there is enough memory for a copy of the state.
    fn has_room_for_copy(&self) -> bool {
        let state = match &self.piece_sums {
            Some(sums) => sums.bytes(),
            None => self.planes().map(Plane::bytes).sum(),
        };
        // Besides the planes: means and errors by which gather rays grow, the samples of pixels, and fine cells.
        let numbers = 3 * size_of::<u32>() as u64 * self.settings.image.crop_window().pixels();
        let state = state + numbers + self.view.lighting.fine_cells.as_ref().map_or(0, FineCellMap::bytes);
        has_room(state, &self.settings, self.view.tiles.iter().any(|tile| tile.indirect.is_some()))
    }

    /// Image, statistics and checkpoint of the state kept last, without the device. The renderer cannot be used
    /// afterwards.
    fn salvage(&mut self) -> Option<Box<Salvage>> {
        let kept = self.backup.take()?.state?;
        self.sampling.samples = kept.header.samples;
        self.sampling.allocation.clone_from(&kept.header.blocks);
        self.totals = kept.header.totals.clone();
        let image = output::image(self, Some(&kept)).ok()?;
        let statistics = output::statistics(self, self.without_earlier_renders(self.gpu.known_pass_times()));
        let checkpoint = Some(kept.with_fingerprint(self.fingerprint()));
        Some(Box::new(Salvage { image, statistics, checkpoint }))
    }
}
