//! The times of an image.

use std::time::{Duration, Instant};

/// The times of an image, from its first input.
pub struct Times {
    pub started: Instant,
    /// Seconds that reading the scene took.
    pub import: f64,
    /// Seconds that opening the device took; 0 for all frames of a sequence but the first.
    pub start: f64,
    /// From the start of an image to its last sample, if its time is limited: the rest is for denoising.
    pub sampling: Option<Duration>,
}

impl Times {
    /// When the last sample is due, if the time is limited.
    pub fn deadline(&self) -> Option<Instant> {
        self.sampling.map(|time| self.started + time)
    }
}
