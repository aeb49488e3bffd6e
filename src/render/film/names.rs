//! Names of files: no output overwrites an input, or another output.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Checks that each output has a name of its own.
///
/// # Errors
/// [`Error::Usage`] with the name of an output that is an input too, or another output.
pub fn check_names(
    inputs: impl IntoIterator<Item = impl AsRef<Path>>,
    outputs: impl IntoIterator<Item = impl AsRef<Path>>,
) -> Result<()> {
    let inputs: BTreeSet<PathBuf> = inputs.into_iter().map(|path| whole(path.as_ref())).collect();
    let mut written = BTreeSet::new();
    for path in outputs {
        let path = path.as_ref();
        let (whole, file) = (whole(path), path.display());
        if inputs.contains(&whole) {
            return Err(Error::Usage(format!("{file} is an input, which would be overwritten: name another output")));
        }
        if !written.insert(whole) {
            return Err(Error::Usage(format!("{file} is named twice: each output file needs its own name")));
        }
    }
    Ok(())
}

/// Whether two names are those of one file.
pub fn is_same_file(one: &Path, other: &Path) -> bool {
    whole(one) == whole(other)
}

/// The path without links; of a file that does not exist, that of its folder.
fn whole(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| {
        let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let folder = absolute.parent().and_then(|folder| fs::canonicalize(folder).ok());
        folder.zip(absolute.file_name()).map_or(absolute.clone(), |(folder, name)| folder.join(name))
    })
}
