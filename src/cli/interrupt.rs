//! Ctrl-C and termination: they end the process at once while there is nothing to save, and are a question that the render
//! loop asks from then on. A second one ends it at once whatever it does. No half-written file is left.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use penumbra::internal::render::film;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level;

/// What signals have come, and what is to become of the next.
pub struct Interrupt(Arc<State>);

#[derive(Default)]
struct State {
    deferred: AtomicBool,
    raised: AtomicBool,
}

impl Interrupt {
    /// Listens from now on, in a thread of its own: a signal handler could not tidy up.
    pub fn listen() -> Self {
        let state = Arc::new(State::default());
        // Where no handler can be set, the signal ends the process as it would have without us.
        if let Ok(mut signals) = Signals::new([SIGINT, SIGTERM]) {
            let state = state.clone();
            thread::spawn(move || {
                for signal in signals.forever() {
                    let again = state.raised.swap(true, Ordering::SeqCst);
                    if again || !state.deferred.load(Ordering::SeqCst) {
                        film::abandon_writes();
                        low_level::exit(128 + signal);
                    }
                }
            });
        }
        Interrupt(state)
    }

    /// From now on there is something to save: the first signal only raises the question.
    pub fn defer(&self) {
        self.0.deferred.store(true, Ordering::SeqCst);
    }

    pub fn raised(&self) -> bool {
        self.0.raised.load(Ordering::SeqCst)
    }
}
