//! How long first samples take on this machine, from render to render.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::{fs, thread};

use kernel_kit::Gpu;
use penumbra::internal::render::film::write_atomically;

use super::cache;

/// Number of the latest renders of each device that are remembered. Older ones say little: machines change, and are
/// busy at times.
const REMEMBERED: usize = 9;

/// Minimum number of renders for their times to count: a single one may have run on a busy machine.
const MIN_RENDERS: usize = 3;

/// The times of first samples over those that were expected, in the user's cache folder.
pub struct FirstSamples {
    /// `None` if the user has no cache folder.
    file: Option<PathBuf>,
    device: String,
    /// The ratios of each device, oldest first.
    ratios: BTreeMap<String, Vec<f64>>,
}

impl FirstSamples {
    /// Reads the ratios of a device. A file that cannot be read counts as empty.
    pub fn of(gpu: &Gpu) -> FirstSamples {
        let file = cache::folder().map(|folder| folder.join("first_samples.json"));
        let text = file.as_ref().and_then(|file| fs::read(file).ok()).unwrap_or_default();
        let cores = thread::available_parallelism().map_or(1, usize::from);
        FirstSamples {
            file,
            device: format!("{}, {cores} cores", gpu.info.name),
            ratios: serde_json::from_slice(&text).unwrap_or_default(),
        }
    }

    /// The lower quartile of the time of first samples over the expected time; 1 until a few are known. On a busy
    /// machine, first samples take up to twice as long. To expect that of the next renders too would cost more than to
    /// be late for a while, because `path`, which would then be chosen, has up to ten times the error.
    pub fn slowness(&self) -> f64 {
        let mut ratios = self.ratios.get(&self.device).cloned().unwrap_or_default();
        ratios.retain(|ratio| ratio.is_finite() && *ratio > 0.0);
        ratios.sort_by(f64::total_cmp);
        if ratios.len() < MIN_RENDERS { 1.0 } else { ratios[ratios.len() / 4] }
    }

    /// Stores another ratio, if there is a cache folder.
    pub fn add(mut self, ratio: f64) {
        let ratios = self.ratios.entry(self.device).or_default();
        ratios.push(ratio);
        ratios.drain(..ratios.len().saturating_sub(REMEMBERED));
        if let Some(file) = &self.file {
            // If two processes write at once, one ratio is lost. Errors are dropped: without a file, `slowness` is 1.
            let _ = write_atomically(file, |file| Ok(serde_json::to_writer_pretty(file, &self.ratios)?));
        }
    }
}
