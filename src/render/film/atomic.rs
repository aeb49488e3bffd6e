//! Files that are replaced whole or not at all.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard};

use crate::{Error, Result};

/// What an encoder can fail with.
pub(super) type Problem = Box<dyn std::error::Error + Send + Sync>;

/// Replaces the file at `path` by what `write` writes: into a temporary file of the same folder, which is synced to
/// the disk and renamed. Whatever fails, the old file stays as it was and no temporary one is left. A symbolic link
/// stays a link, and its target is replaced.
///
/// # Errors
/// [`Error::Output`] with what the system or `write` said.
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

/// Says whether [`write_atomically`] could write to `path`, without touching a file that is there.
///
/// # Errors
/// [`Error::Output`] where the folder is missing or does not let a file be made, or where `path` is no regular file.
pub fn check_target(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    locate(path)
        .and_then(|(_, folder)| Temporary::create(&folder))
        .map(drop)
        .map_err(|problem| Error::output(path, problem))
}

/// The file to replace, behind symbolic links, and its folder.
fn locate(path: &Path) -> io::Result<(PathBuf, PathBuf)> {
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
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

/// Removes what all writes that are under way have written, and lets none begin or end any more: for a process that is about
/// to end at once. Files are then as they were, or whole.
pub fn abandon_writes() {
    let under_way = under_way();
    for path in under_way.iter() {
        // Nothing more can be done where this fails.
        let _ = fs::remove_file(path);
    }
    // Held until the process ends.
    std::mem::forget(under_way);
}

/// The temporary files there are. Who holds the lock may make one, rename it or remove it.
fn under_way() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    static UNDER_WAY: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    UNDER_WAY.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// A file that goes when it is dropped.
struct Temporary(PathBuf);

impl Temporary {
    /// A new file in `folder`, of the mode that any new file gets (a file of the `tempfile` kind is its owner's alone).
    fn create(folder: &Path) -> io::Result<(Self, File)> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let mut under_way = under_way();
        loop {
            let number = NEXT.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!(".penumbra-{}-{number}.tmp", std::process::id()));
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => {
                    under_way.insert(path.clone());
                    return Ok((Temporary(path), file));
                }
                // Left by a process of this number that was killed.
                Err(problem) if problem.kind() == ErrorKind::AlreadyExists => continue,
                Err(problem) => return Err(problem),
            }
        }
    }
}

impl Temporary {
    /// Puts it in the place of `target`.
    fn rename(self, target: &Path) -> io::Result<()> {
        let mut under_way = under_way();
        if let Err(problem) = fs::rename(&self.0, target) {
            // To be dropped without the lock, which it takes itself.
            drop(under_way);
            return Err(problem);
        }
        under_way.remove(&self.0);
        // The name is gone with the rename, so there is nothing to remove.
        std::mem::forget(self);
        Ok(())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let mut under_way = under_way();
        under_way.remove(&self.0);
        // Nothing more can be done where this fails, and the error that led here is the one to report.
        let _ = fs::remove_file(&self.0);
    }
}
