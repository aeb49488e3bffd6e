//! Ctrl-C and SIGTERM. Before there is an image to save, and in commands that save none, they end the process at once.
//! After [`Interrupt::defer`] the first one sets a flag that the render loop reads, and a second one ends the process
//! at once. No half-written file is left.

use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

use penumbra::internal::render::film;

/// The signals received so far.
pub struct Interrupt(&'static State);

struct State {
    deferred: AtomicBool,
    raised: AtomicBool,
}

/// The process has one, as it has one handler of each signal.
static STATE: State = State { deferred: AtomicBool::new(false), raised: AtomicBool::new(false) };

impl Interrupt {
    /// Listens to signals in a thread of its own: a signal handler could not remove temporary files. After the first
    /// call, others only return the same signals.
    pub fn listen() -> Self {
        static FIRST: Once = Once::new();
        FIRST.call_once(listen);
        Interrupt(&STATE)
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

impl State {
    /// Notes a signal. If the process is to end at once, no file can be written any more.
    fn ends_the_process(&self) -> bool {
        let again = self.raised.swap(true, Ordering::SeqCst);
        let ends = again || !self.deferred.load(Ordering::SeqCst);
        if ends {
            film::abandon_writes();
        }
        ends
    }
}

// If no handler can be set, a signal ends the process by its default action.

/// SIGINT and SIGTERM. The crate ctrlc does not report which of them came, and its handler of SIGHUP would end renders
/// that nohup started.
#[cfg(unix)]
fn listen() {
    use std::time::{Duration, Instant};

    use signal_hook::consts::{SIGINT, SIGTERM};

    // Time after a signal in which SIGTERM is the same signal again: Slurm sends it to all processes of a job, and the
    // job's script passes it on at once.
    const SAME: Duration = Duration::from_millis(500);

    if let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM]) {
        std::thread::spawn(move || {
            let mut last: Option<Instant> = None;
            for signal in signals.forever() {
                let is_same = signal == SIGTERM && last.is_some_and(|last| last.elapsed() < SAME);
                last = Some(Instant::now());
                if is_same {
                    continue;
                }
                if STATE.ends_the_process() {
                    // Without running exit handlers: those of drivers would release what other threads still use.
                    signal_hook::low_level::exit(128 + signal);
                }
            }
        });
    }
}

/// Ctrl-C and Ctrl-Break. Windows ends the process itself when the console is closed.
#[cfg(windows)]
fn listen() {
    let _ = ctrlc::set_handler(move || {
        if STATE.ends_the_process() {
            // The exit code that shells use for SIGINT.
            std::process::exit(130);
        }
    });
}
