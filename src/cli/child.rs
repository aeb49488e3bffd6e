//! Processes that are ended after some time, or on request.

use std::io::{self, Read};
use std::process::{Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Interval between checks whether a process has ended: short compared with the tenths of a second that each runs.
const POLL: Duration = Duration::from_millis(5);

/// A process that ended by itself: how, and what it wrote to stderr.
pub struct Ended {
    pub status: ExitStatus,
    pub stderr: String,
}

/// Runs a process. Kills it and returns `None` if it takes longer than `limit`, or once `stop` returns true.
pub fn run_within(command: &mut Command, limit: Duration, stop: &dyn Fn() -> bool) -> io::Result<Option<Ended>> {
    let start = Instant::now();
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn()?;
    let mut pipe = child.stderr.take();
    // A full pipe would stop the process.
    let reader = thread::spawn(move || {
        let mut said = Vec::new();
        // Output that cannot be read is dropped.
        let _ = pipe.as_mut().map(|pipe| pipe.read_to_end(&mut said));
        String::from_utf8_lossy(&said).into_owned()
    });
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break Some(status);
        }
        if start.elapsed() >= limit || stop() {
            child.kill()?;
            child.wait()?;
            break None;
        }
        thread::sleep(POLL);
    };
    let stderr = reader.join().unwrap_or_default();
    Ok(status.map(|status| Ended { status, stderr }))
}
