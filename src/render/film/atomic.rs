//! Atomic writes: a file is replaced whole or not at all.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::thread;
use std::time::Duration;

use crate::{Error, Result};

/// The error of an encoder.
pub(super) type Problem = Box<dyn std::error::Error + Send + Sync>;

/// Replaces the file at `path` with the output of `write`, which goes to a temporary file in the same folder that is
/// synced to the disk and renamed. After an error the old file is unchanged and there is no temporary file. A symbolic
/// link stays a link, and its target is replaced.
///
/// # Errors
/// [`Error::Output`] with the error of the system or of `write`.
pub fn write_atomically(
    path: impl AsRef<Path>,
    write: impl FnOnce(&mut BufWriter<File>) -> std::result::Result<(), Problem>,
) -> Result<()> {
    let path = path.as_ref();
    let replace = || -> std::result::Result<(), Problem> {
        let (target, folder) = locate(path)?;
        let (temporary, file) = Temporary::create(&folder)?;
        let mut file = BufWriter::new(file);
        write(&mut file)?;
        file.into_inner()?.sync_all()?;
        Ok(temporary.rename(&target)?)
    };
    replace().map_err(|problem| Error::output(path, problem))
}

/// Checks that [`write_atomically`] can write to `path`, without touching an existing file.
///
/// # Errors
/// [`Error::Output`] if the folder is missing or not writable, or if `path` is not a regular file.
pub fn check_target(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    locate(path)
        .and_then(|(_, folder)| Temporary::create(&folder))
        .map(drop)
        .map_err(|problem| Error::output(path, problem))
}

/// The file to replace, with symbolic links resolved, and its folder.
fn locate(path: &Path) -> io::Result<(PathBuf, PathBuf)> {
    let target = followed(path);
    match fs::metadata(&target) {
        Ok(kind) if kind.is_dir() => return Err(io::Error::other("it is a folder")),
        Ok(kind) if !kind.is_file() => return Err(io::Error::other("it is not a regular file")),
        _ if target.file_name().is_none() => return Err(io::Error::other("it names no file")),
        _ => {}
    }
    let folder = match target.parent() {
        Some(folder) if folder != Path::new("") => folder.to_owned(),
        _ => PathBuf::from("."),
    };
    if !folder.is_dir() {
        return Err(io::Error::other(format!("there is no folder {}", folder.display())));
    }
    Ok((target, folder))
}

/// The path with symbolic links resolved. A link to a file that does not exist yet is followed, too, but no second one
/// behind it.
fn followed(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| match fs::read_link(path) {
        Ok(next) => path.parent().unwrap_or(Path::new("")).join(next),
        Err(_) => path.to_owned(),
    })
}

/// Removes all temporary files and blocks all further writes. Call it when the process is about to exit: every target
/// is then either unchanged or complete.
pub fn abandon_writes() {
    let temporary_files = temporary_files();
    for path in temporary_files.iter() {
        // There is no remedy if this fails.
        let _ = fs::remove_file(path);
    }
    // Keep the lock until the process exits.
    std::mem::forget(temporary_files);
}

/// The existing temporary files. Only the holder of the lock may create, rename or remove one.
fn temporary_files() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    static TEMPORARY_FILES: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    TEMPORARY_FILES.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// A temporary file, removed on drop.
struct Temporary(PathBuf);

impl Temporary {
    /// Creates a file in `folder` with the default permissions. Files of the `tempfile` crate are readable by their
    /// owner only.
    fn create(folder: &Path) -> io::Result<(Self, File)> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let mut temporary_files = temporary_files();
        loop {
            let number = NEXT.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!(".penumbra-{}-{number}.tmp", std::process::id()));
            match OpenOptions::new().read(true).write(true).create_new(true).open(&path) {
                Ok(file) => {
                    temporary_files.insert(path.clone());
                    return Ok((Temporary(path), file));
                }
                // Left by a killed process with the same id.
                Err(problem) if problem.kind() == ErrorKind::AlreadyExists => continue,
                Err(problem) => return Err(problem),
            }
        }
    }
}

impl Temporary {
    /// Renames it to `target`.
    fn rename(self, target: &Path) -> io::Result<()> {
        let mut temporary_files = temporary_files();
        if let Err(problem) = rename(&self.0, target) {
            // Dropping `self` takes the lock.
            drop(temporary_files);
            return Err(problem);
        }
        temporary_files.remove(&self.0);
        // There is nothing to remove after the rename.
        std::mem::forget(self);
        Ok(())
    }
}

/// Renames a file. Windows does not replace one that another program keeps to itself: indexers and virus scanners let
/// go of it within some tens of milliseconds, a viewer only when the user closes it.
fn rename(from: &Path, to: &Path) -> io::Result<()> {
    let mut attempts = 20;
    loop {
        match fs::rename(from, to) {
            Err(problem) if is_kept(&problem) => {
                attempts -= 1;
                if attempts == 0 {
                    let problem = format!("is it open in another program? {problem}");
                    return Err(io::Error::other(problem));
                }
                thread::sleep(Duration::from_millis(50));
            }
            ended => return ended,
        }
    }
}

/// Another program may keep the file to itself. If it does, Windows says so, or that access is denied.
fn is_kept(problem: &io::Error) -> bool {
    /// `ERROR_SHARING_VIOLATION`
    const SHARING_VIOLATION: i32 = 32;
    cfg!(windows)
        && (problem.kind() == ErrorKind::PermissionDenied || problem.raw_os_error() == Some(SHARING_VIOLATION))
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let mut temporary_files = temporary_files();
        temporary_files.remove(&self.0);
        // There is no remedy if this fails, and the error that led here is the one to report.
        let _ = fs::remove_file(&self.0);
    }
}
