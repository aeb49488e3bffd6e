//! The house: floors, circles, names, words, features, exports and documents, read from the sources themselves.

mod cases;
mod documents;
mod exports;
mod features;
mod flags;
mod floors;
mod imports;
mod lines;
mod stems;
mod words;

use std::path::{Path, PathBuf};

use penumbra::internal::kernels::expand_each;

/// The repository.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All files below `folder` whose names end in one of `extensions`, sorted, with their text.
fn sources(folder: &str, extensions: &[&str]) -> Vec<(PathBuf, String)> {
    let mut files = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        let entries = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
        for path in entries.map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                // Build outputs, and files that fuzzing has found.
                let built = path.file_name().is_some_and(|name| name == "target" || name == "corpus");
                if !built {
                    folders.push(path);
                }
            } else if path.extension().is_some_and(|e| extensions.iter().any(|wanted| e == *wanted)) {
                let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
                files.push((path.strip_prefix(root()).unwrap().to_owned(), text));
            }
        }
    }
    files.sort();
    assert!(!files.is_empty(), "no {extensions:?} in {folder}");
    files
}

/// The shaders, with all lobes in place of `@each`, as kernels are composed of them.
fn shaders() -> Vec<(PathBuf, String)> {
    let written = sources("shaders", &["wgsl"]).into_iter();
    written.map(|(path, text)| (path, expand_each(&text))).collect()
}
