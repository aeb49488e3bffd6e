//! Folders for outputs.

use std::fs;
use std::path::Path;

use penumbra::{Error, Result};

/// Makes a folder for outputs, with those that it is in, unless it is there.
///
/// # Errors
/// [`Error::Output`] if it cannot be made, or is something else.
pub fn make_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(|problem| match path.exists() {
        true => Error::output(path, "it is not a folder"),
        false => Error::output(path, problem),
    })
}
