//! Ctrl-C and SIGTERM. Before there is an image to save they end the process at once; after [`Interrupt::defer`] they
//! set a flag that the render loop reads. A second signal always ends the process at once. No half-written file is
//! left.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use penumbra::internal::render::film;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level;

/// The signals received so far.
pub struct Interrupt(Arc<State>);

#[derive(Default)]
struct State {
    deferred: AtomicBool,
    raised: AtomicBool,
}

impl Interrupt {
    /// Listens to signals in a thread of its own: a signal handler could not remove temporary files.
    pub fn listen() -> Self {
        let state = Arc::new(State::default());
        // If no handler can be set, a signal ends the process by its default action.
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

    /// From now on there is an image to save: the first signal only sets the flag.
    pub fn defer(&self) {
        self.0.deferred.store(true, Ordering::SeqCst);
    }

    /// A signal has arrived.
    pub fn raised(&self) -> bool {
        self.0.raised.load(Ordering::SeqCst)
    }
}
