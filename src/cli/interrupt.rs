//! Ctrl-C and termination, turned into a question that the render loop asks.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// Set by the first signal; a second one ends the process.
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Listens from now on.
    pub fn listen() -> Self {
        let raised = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // In this order, so that the first signal finds the flag down. Where a handler cannot be set, the signal
            // ends the process as it would have without us.
            let _ = flag::register_conditional_shutdown(signal, 128 + signal, raised.clone());
            let _ = flag::register(signal, raised.clone());
        }
        Interrupt(raised)
    }

    pub fn raised(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
