//! Documents: every file and folder that they name exists.

use std::path::{Path, PathBuf};

use crate::{root, sources};

/// What names of files in this repository begin with.
const FOLDERS: [&str; 11] = [
    "src/",
    "shaders/",
    "tests/",
    "docs/",
    "crates/",
    "scenes/",
    "scripts/",
    "examples/",
    "benches/",
    "fuzz/",
    "python/",
];

/// What stands for a name that the reader gives.
const PLACEHOLDERS: [&str; 3] = ["NAME", "KIND", "FORMAT"];

/// A file of the reader's own project, in the tutorial of the kernel kit.
const EXAMPLES: [&str; 1] = ["shaders/lib/noise.wgsl"];

/// The names between backticks that begin with one of [`FOLDERS`], and the files that links lead to, with what they are
/// relative to.
fn names(document: &Path, text: &str) -> Vec<(PathBuf, String)> {
    let folder = document.parent().unwrap();
    let mut names = Vec::new();
    for line in text.lines() {
        let quoted = line.split('`').skip(1).step_by(2).flat_map(str::split_whitespace);
        let quoted = quoted.filter(|name| FOLDERS.iter().any(|prefix| name.starts_with(prefix)));
        names.extend(quoted.map(|name| (PathBuf::new(), name.trim_end_matches([',', '.', ':']).to_owned())));
        let links = line.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
        let links = links.filter(|link| !link.is_empty() && !link.contains("://"));
        names.extend(links.map(|link| (folder.to_owned(), link.to_owned())));
    }
    names
}

/// `a/{b,c}.rs` as `a/b.rs` and `a/c.rs`.
fn alternatives(name: &str) -> Vec<String> {
    let Some((before, rest)) = name.split_once('{') else { return vec![name.to_owned()] };
    let (inner, after) = rest.split_once('}').unwrap_or((rest, ""));
    inner.split(',').flat_map(|part| alternatives(&format!("{before}{}{after}", part.trim()))).collect()
}

/// Whether there is a file or a folder of that name. `*` and the placeholders stand for any part of a name; `.rs` may
/// be left out.
fn exists(from: &Path, name: &str) -> bool {
    let name = PLACEHOLDERS.iter().fold(name.to_owned(), |name, placeholder| name.replace(placeholder, "*"));
    let mut found = vec![root().join(from)];
    for part in name.split('/').filter(|part| !part.is_empty()) {
        let matching = |folder: PathBuf| -> Vec<PathBuf> {
            let Some((before, after)) = part.split_once('*') else {
                let source = folder.join(format!("{part}.rs"));
                return [folder.join(part), source].into_iter().filter(|path| path.exists()).collect();
            };
            let entries = std::fs::read_dir(&folder).into_iter().flatten().map(|entry| entry.unwrap().path());
            let fits = |path: &PathBuf| {
                let name = path.file_name().unwrap().to_string_lossy();
                name.len() >= before.len() + after.len() && name.starts_with(before) && name.ends_with(after)
            };
            entries.filter(fits).collect()
        };
        found = found.into_iter().flat_map(matching).collect();
    }
    !found.is_empty()
}

/// The names in a document of what does not exist.
fn missing(document: &Path, text: &str) -> Vec<String> {
    let expanded = names(document, text).into_iter().flat_map(|(from, name)| {
        let alternatives = alternatives(&name);
        alternatives.into_iter().map(move |name| (from.clone(), name))
    });
    let wrong = expanded.filter(|(from, name)| !EXAMPLES.contains(&name.as_str()) && !exists(from, name));
    wrong.map(|(_, name)| format!("{}: {name}", document.display())).collect()
}

/// The documents of the repository: the pages at its root but the history, those of `docs`, and those of crates,
/// fuzz targets and scenes.
fn documents() -> Vec<(PathBuf, String)> {
    let top = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"];
    let top = top.map(|name| (PathBuf::from(name), std::fs::read_to_string(root().join(name)).unwrap()));
    let folders =
        ["docs", "crates", "fuzz", "python", "scenes"].into_iter().flat_map(|folder| sources(folder, &["md"]));
    top.into_iter().chain(folders).collect()
}

/// Every file and folder that a document names in backticks or links to exists.
#[test]
fn documents_name_files_that_exist() {
    let documents = documents();
    let count: usize = documents.iter().map(|(path, text)| names(path, text).len()).sum();
    assert!(count > 100, "{count} names are too few: they are not found");
    let missing: Vec<String> = documents.iter().flat_map(|(path, text)| missing(path, text)).collect();
    assert!(missing.is_empty(), "documents name what does not exist: {missing:#?}");
}

/// A name of nothing is found: in backticks, in a command, in a list, with a star or a placeholder, in a link.
#[test]
fn planted_names_of_files_are_found() {
    let right = "`src/lib.rs`, `src/{error,input}.rs`, `src/settings`, `tests/house/`, `src/passes/NAME.rs`, \
                 `scenes/*.glb`, `scripts/with-vulkan cargo test`, [decisions](docs/decisions.md#one), `other/x.rs`, \
                 [page](https://example.org/src/x.rs)";
    assert_eq!(missing(Path::new("README.md"), right), Vec::<String>::new());
    let wrong = "`src/planted.rs`, `scripts/planted cargo test`, `src/{error,planted}.rs`, `scenes/planted*.glb`, \
                 `shaders/NAME.rs`, [decisions](src/decisions.md#one)";
    let expected = [
        "src/planted.rs",
        "scripts/planted",
        "src/planted.rs",
        "scenes/planted*.glb",
        "shaders/*.rs",
        "src/decisions.md",
    ];
    let found = missing(Path::new("README.md"), wrong);
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(found.replace("NAME", "*"), format!("README.md: {expected}"));
    }
}
