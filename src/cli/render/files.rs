//! The files of an image: whether they are complete, and how they are written.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::{env, fs, process};

use penumbra::internal::render::film::{self, View};
use penumbra::{Error, Image, Result, Statistics};

use crate::cli::{json, say};

/// The files of an image.
pub struct Files {
    pub outputs: Vec<PathBuf>,
    pub stats: Option<PathBuf>,
}

impl Files {
    /// Whether all files exist, and the images are complete and have this fingerprint.
    pub fn are_complete(&self, fingerprint: &str) -> bool {
        let is_same = |path: &PathBuf| film::fingerprint(path).is_some_and(|found| found == fingerprint);
        self.outputs.iter().all(is_same) && self.stats.iter().all(|path| path.exists())
    }

    /// Writes all output images. If one fails, the image is saved in the folder for temporary files, so that a full
    /// disk does not lose the render.
    pub fn write_images(&self, image: &Image, view: View, exposure: f32, quiet: bool) -> Result<()> {
        let mut result = Ok(());
        for path in &self.outputs {
            let outcome = write_in_folder(path, || image.write_shown(path, view, exposure));
            if outcome.is_ok() && !quiet {
                say(format_args!("wrote {}", path.display()));
            }
            result = both(result, outcome);
        }
        result.map_err(|error| {
            let remark = rescue("image is", "exr", |path| image.write_exr(path)).unwrap_or_default();
            with_remark(error, &remark)
        })
    }

    /// Writes the statistics, if they are requested.
    pub fn write_statistics(&self, statistics: &Statistics) -> Result<()> {
        let Some(path) = &self.stats else { return Ok(()) };
        let text = json(statistics).map_err(|problem| Error::output(path, problem))?;
        write_in_folder(path, || film::write_atomically(path, |file| Ok(writeln!(file, "{text}")?)))
    }
}

/// Makes a new folder in that for temporary files, where other users may have put links under any name that they can
/// guess.
///
/// # Errors
/// [`Error::Output`] if there is no room or no such folder.
pub fn temporary_folder() -> Result<PathBuf> {
    let mut number = 0u64;
    loop {
        let folder = env::temp_dir().join(format!("penumbra-{}-{number}", process::id()));
        match fs::create_dir(&folder) {
            Ok(()) => return Ok(folder),
            Err(problem) if problem.kind() == ErrorKind::AlreadyExists => number += 1,
            Err(problem) => return Err(Error::output(&folder, problem)),
        }
    }
}

/// Saves in the folder for temporary files what could not be written to its own file. `saved` names it, with a verb:
/// "image is". Returns a remark for the error, which says where it is now; `None` if it cannot be written there either.
pub fn rescue(saved: &str, extension: &str, write: impl Fn(&Path) -> Result<()>) -> Option<String> {
    let folder = temporary_folder().ok()?;
    let file = folder.join(format!("rescued.{extension}"));
    if write(&file).is_err() {
        // An empty folder for temporary files does no harm.
        let _ = fs::remove_dir(&folder);
        return None;
    }
    Some(format!("; the {saved} in {}", file.display()))
}

/// The error of a file that could not be written, with a remark.
pub fn with_remark(error: Error, remark: &str) -> Error {
    match error {
        Error::Output { file, problem } => Error::Output { file, problem: problem + remark },
        other => other,
    }
}

/// Writes a file. If its folder has been removed since the start, it is created again.
pub fn write_in_folder(path: &Path, write: impl Fn() -> Result<()>) -> Result<()> {
    write().or_else(|problem| match path.parent() {
        Some(folder) if !folder.exists() && fs::create_dir_all(folder).is_ok() => write(),
        _ => Err(problem),
    })
}

/// The outcome of writing two files. If both failed, the error names both.
pub fn both(first: Result<()>, second: Result<()>) -> Result<()> {
    match (first, second) {
        (Err(Error::Output { file, problem }), Err(Error::Output { file: other, .. })) => {
            Err(Error::Output { file, problem: format!("{problem}; {} is not written either", other.display()) })
        }
        (first, second) => first.and(second),
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    /// A link that another user has put in the place of the folder is not followed.
    #[test]
    fn a_temporary_folder_is_new() {
        let own = tempfile::tempdir().unwrap();
        let planted = env::temp_dir().join(format!("penumbra-{}-0", process::id()));
        std::os::unix::fs::symlink(own.path(), &planted).unwrap();
        let folder = temporary_folder().unwrap();
        fs::remove_file(&planted).unwrap();
        assert!(!folder.is_symlink() && folder.is_dir(), "{}", folder.display());
        fs::remove_dir(folder).unwrap();
    }
}
