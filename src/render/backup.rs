//! The copy of its state that a render keeps in memory in case its device is lost.

use std::time::{Duration, Instant};

use super::checkpoint::Checkpoint;

/// The time between two copies of the state over the time that a copy takes, so that copies take at most a fiftieth of
/// the time.
const KEPT_PER_COST: u32 = 50;

/// The copy that was made last.
pub(super) struct Backup {
    pub state: Option<Checkpoint>,
    at: Instant,
    /// The time that this took.
    cost: Duration,
}

impl Backup {
    /// Keeps no state yet, so the first is due.
    pub fn new() -> Backup {
        Backup { state: None, at: Instant::now(), cost: Duration::ZERO }
    }

    /// Keeps `state`, whose copy began at `start`.
    pub fn of(state: Checkpoint, start: Instant) -> Backup {
        Backup { state: Some(state), at: Instant::now(), cost: start.elapsed() }
    }

    /// Whether the next state is due.
    pub fn is_due(&self) -> bool {
        self.at.elapsed() >= self.cost * KEPT_PER_COST
    }
}
