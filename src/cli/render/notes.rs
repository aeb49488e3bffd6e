//! What a render tells: notes, a summary, how the image was denoised and its error.

use std::collections::BTreeSet;

use penumbra::internal::report::estimate;
use penumbra::{Denoiser, Image, Statistics};

use crate::cli::progress::mega;
use crate::cli::say;

/// Notes, each printed once.
pub struct Notes {
    quiet: bool,
    /// Those of the whole command, then those of the image that is rendered, for its statistics.
    current: Vec<String>,
    /// Those that were printed.
    said: BTreeSet<String>,
}

impl Notes {
    /// No notes yet.
    pub fn new(quiet: bool) -> Notes {
        Notes { quiet, current: Vec::new(), said: BTreeSet::new() }
    }

    /// Prints those that are new.
    pub fn say(&mut self, notes: &[String]) {
        for note in notes {
            if !self.current.contains(note) {
                self.current.push(note.clone());
            }
            if self.said.insert(note.clone()) && !self.quiet {
                say(format_args!("note: {note}"));
            }
        }
    }

    /// Another frame begins: of the notes so far, only the first `shared` are also on it.
    pub fn begin_frame(&mut self, shared: usize) {
        self.current.truncate(shared);
    }

    /// Those of the whole command and of this image.
    pub fn current(&self) -> &[String] {
        &self.current
    }
}

/// A summary of the render in one line.
pub fn summary(statistics: &Statistics, stopped: bool) -> String {
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

/// Says by what the image was denoised, and how well.
pub fn say_denoised(denoiser: &Denoiser, image: &Image, statistics: &Statistics) {
    if image.channel("denoised.R").is_none() {
        return;
    }
    let names: Vec<&str> = denoiser.names().collect();
    let error = match estimate::denoised_relmse(image) {
        Some(error) => format!("estimated relMSE {error:.2e}"),
        None if statistics.samples == 1 => "error unknown: it cannot be estimated from a single sample".to_owned(),
        None => "error unknown: --time was too short to estimate it".to_owned(),
    };
    let (choice, seconds) = (denoiser.choice(), statistics.time.denoise);
    say(format_args!("denoised by {choice} ({}) in {seconds:.2} s, {error}", names.join(", ")));
}
