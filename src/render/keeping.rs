//! What a render keeps in memory, in case its device is lost.

use std::time::{Duration, Instant};

use super::checkpoint::Checkpoint;

/// What samples have left is kept once this many times as long has passed as keeping it took: at most a fiftieth of the
/// time.
const KEPT_PER_COST: u32 = 50;

/// The last state that was kept.
pub(super) struct Keeping {
    pub state: Option<Checkpoint>,
    at: Instant,
    /// The time that the last keeping took.
    cost: Duration,
}

impl Keeping {
    /// Nothing is kept yet, and the first state is due.
    pub fn new() -> Keeping {
        Keeping { state: None, at: Instant::now(), cost: Duration::ZERO }
    }

    /// `state`, which has taken the time since `start`.
    pub fn of(state: Checkpoint, start: Instant) -> Keeping {
        Keeping { state: Some(state), at: Instant::now(), cost: start.elapsed() }
    }

    /// The next state is due.
    pub fn is_due(&self) -> bool {
        self.at.elapsed() >= self.cost * KEPT_PER_COST
    }
}
