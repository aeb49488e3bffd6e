//! Names of files: no output overwrites an input, or another output.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use penumbra::{Error, Result};

/// Checks that each output has a name of its own.
///
/// # Errors
/// [`Error::Usage`] with the name of an output that is an input too, or another output.
pub fn check_names<'a>(
    inputs: impl IntoIterator<Item = &'a PathBuf>,
    outputs: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<()> {
    let inputs: BTreeSet<PathBuf> = inputs.into_iter().map(|path| whole(path)).collect();
    let mut written = BTreeSet::new();
    for path in outputs {
        let whole = whole(path);
        let file = path.display();
        if inputs.contains(&whole) {
            return Err(Error::Usage(format!("{file} is an input, which would be overwritten: name another output")));
        }
        if !written.insert(whole) {
            return Err(Error::Usage(format!("{file} is named twice: each output file needs its own name")));
        }
    }
    Ok(())
}

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

/// The path without links, as far as it exists.
fn whole(path: &Path) -> PathBuf {
    fs::canonicalize(path).or_else(|_| std::path::absolute(path)).unwrap_or_else(|_| path.to_owned())
}
