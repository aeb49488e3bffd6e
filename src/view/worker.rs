//! The thread in which a session renders, so that the window answers meanwhile.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use kernel_kit::{Compilation, Gpu};

use super::session::{Command, Session, Snapshot, State};
use super::watch::{INTERVAL, Watch};
use crate::{Error, Result};

/// How often devices may be lost in succession without a new picture. If they are lost again and again, the scene is
/// the cause.
const MAX_LOSSES: u32 = 3;

/// An event that a worker sends to the window.
pub enum Event {
    /// There is a new picture.
    Picture,
    /// The driver compiles kernels that it has not compiled before.
    Compiling(Compilation),
    /// The device was lost, and this one takes its place.
    Device(Arc<Gpu>),
    /// There is no other device.
    Failed(Error),
}

type Latest = Arc<Mutex<Option<Snapshot>>>;

/// The thread of a session.
pub struct Worker {
    commands: Option<Sender<Command>>,
    latest: Latest,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts the session. `open` opens another device if the first is lost; `tell` runs in the worker's thread
    /// and in those that compile.
    pub fn start(
        gpu: Arc<Gpu>,
        state: State,
        open: impl Fn() -> Result<Arc<Gpu>> + Send + 'static,
        tell: impl Fn(Event) + Send + 'static,
    ) -> Worker {
        let (commands, receiver) = channel();
        let latest = Latest::default();
        let pictures = latest.clone();
        // The threads that compile take turns in reporting.
        let tell = Arc::new(Mutex::new(tell));
        let tell = move |event| tell.lock().unwrap_or_else(PoisonError::into_inner)(event);
        let work = move || run(gpu, state, &receiver, open, &tell, &pictures);
        Worker { commands: Some(commands), latest, thread: Some(thread::spawn(work)) }
    }

    /// Passes a command on.
    pub fn send(&self, command: Command) {
        // The thread has ended only if the window is about to.
        let _ = self.commands.as_ref().map(|commands| commands.send(command));
    }

    /// The last picture, if there is a new one.
    pub fn take(&self) -> Option<Snapshot> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.commands = None;
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Why a session ends on a device.
enum End {
    /// There are no more commands.
    Closed,
    Lost(Error),
}

fn run(
    mut gpu: Arc<Gpu>,
    mut state: State,
    commands: &Receiver<Command>,
    open: impl Fn() -> Result<Arc<Gpu>>,
    tell: &(impl Fn(Event) + Clone + Send + Sync + 'static),
    latest: &Latest,
) {
    let mut losses = 0;
    loop {
        let watch = tell.clone();
        gpu.watch_compilation(move |compilation| watch(Event::Compiling(compilation)));
        let mut session = Session::new(&gpu, state);
        let mut pictures = 0;
        let end = serve(&mut session, commands, |snapshot| {
            pictures += 1;
            *latest.lock().unwrap_or_else(PoisonError::into_inner) = Some(snapshot);
            tell(Event::Picture);
        });
        state = session.into_state();
        let End::Lost(error) = end else { return };
        losses = if pictures > 0 { 1 } else { losses + 1 };
        let another = if losses > MAX_LOSSES { Err(error) } else { open() };
        match another {
            Ok(another) => {
                gpu = another;
                state.say("the device was lost; the picture begins again on another".to_owned());
                tell(Event::Device(gpu.clone()));
            }
            Err(error) => return tell(Event::Failed(error)),
        }
    }
}

/// Obeys commands and renders, until there are no more commands.
fn serve(session: &mut Session<'_>, commands: &Receiver<Command>, mut show: impl FnMut(Snapshot)) -> End {
    let mut watch = Watch::new();
    watch.add(session.state().files());
    let mut is_busy = true;
    loop {
        if !is_busy {
            match commands.recv_timeout(session.wait().unwrap_or(INTERVAL).min(INTERVAL)) {
                Ok(command) => session.command(command),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return End::Closed,
            }
        }
        // All that wait: only the last of many movements is worth a picture.
        loop {
            match commands.try_recv() {
                Ok(command) => session.command(command),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return End::Closed,
            }
        }
        if watch.is_due() && watch.changed(session.state().files()) {
            session.command(Command::Reload);
        }
        let stepped = session.step();
        // At once: files may appear a moment after the scene that refers to them was refused.
        watch.add(session.state().files());
        match stepped {
            Ok((snapshot, worked)) => {
                snapshot.into_iter().for_each(&mut show);
                is_busy = worked;
            }
            Err(lost) => return End::Lost(lost),
        }
    }
}
