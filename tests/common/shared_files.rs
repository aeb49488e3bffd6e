//! Files that are too large for the repository, in the folder named by the variable `PENUMBRA_SHARED`.

use std::path::{Path, PathBuf};

/// The files with one of these extensions in the folder `name` and its subfolders. Prints a line and returns `None` if
/// `PENUMBRA_SHARED` is not set.
pub fn shared_files(name: &str, extensions: &[&str]) -> Option<Vec<PathBuf>> {
    let Some(root) = std::env::var_os("PENUMBRA_SHARED") else {
        eprintln!("left out: {name}, as PENUMBRA_SHARED is not set");
        return None;
    };
    let mut files = Vec::new();
    let mut open = vec![Path::new(&root).join(name)];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| extensions.iter().any(|x| e == *x)) {
                files.push(path);
            }
        }
    }
    files.sort();
    assert!(!files.is_empty(), "{name} holds no files");
    Some(files)
}
