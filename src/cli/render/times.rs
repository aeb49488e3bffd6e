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
    /// When the last sample is due, if the time is limited: one beyond the system's clock is not.
    pub fn deadline(&self) -> Option<Instant> {
        self.started.checked_add(self.sampling?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_beyond_the_clock_is_no_limit() {
        let started = Instant::now();
        let of = |sampling| Times { started, import: 0.0, start: 0.0, sampling }.deadline();
        assert_eq!(of(Some(Duration::from_secs_f64(1e19))), None);
        let hour = Duration::from_secs(3600);
        assert_eq!(of(Some(hour)), Some(started + hour));
        assert_eq!(of(None), None);
    }
}
