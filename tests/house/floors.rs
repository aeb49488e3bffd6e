//! Floors: a file imports from its own floor or from below, and no files import each other in a circle.

use std::path::{Path, PathBuf};

use crate::imports::{self, Uses};
use crate::{shaders, sources};

/// Where each file or folder of `src` lives, from the ground up. The first entry that a path begins with counts.
const FLOORS: &[(u32, &[&str])] = &[
    (
        1,
        &[
            "src/settings",
            "src/statistics",
            "src/error",
            "src/input",
            "src/fingerprint",
            "src/random",
            "src/count",
            "src/memory",
        ],
    ),
    (2, &["src/scene", "src/bvh", "src/procedural"]),
    (3, &["src/specialisation", "src/kernels"]),
    (4, &["src/gpu_scene"]),
    (5, &["src/passes"]),
    (6, &["src/light_transport"]),
    (7, &["src/techniques"]),
    (8, &["src/render"]),
    (9, &["src/report", "src/stress"]),
    (10, &["src/lib.rs", "src/main.rs", "src/cli", "src/view"]),
];

fn floor(file: &Path) -> u32 {
    let found = FLOORS
        .iter()
        .find(|(_, names)| names.iter().any(|name| file.starts_with(name) || file == Path::new(&format!("{name}.rs"))));
    found.unwrap_or_else(|| panic!("{}: on no floor; give it one in tests/house/floors.rs", file.display())).0
}

/// Imports that go up.
fn upward(uses: &Uses) -> Vec<String> {
    let arrows = uses.iter().flat_map(|(file, used)| used.iter().map(move |other| (file, other)));
    let up = arrows.filter(|(file, other)| floor(other) > floor(file));
    up.map(|(file, other)| format!("{} -> {}", file.display(), other.display())).collect()
}

fn penumbra() -> Uses {
    imports::rust(Path::new("src"), &sources("src", &["rs"]), &["crate", "penumbra"])
}

fn no_circles(uses: &Uses) {
    let circles: Vec<Vec<String>> = imports::circles(uses)
        .iter()
        .map(|circle| circle.iter().map(|file| file.display().to_string()).collect())
        .collect();
    assert!(circles.is_empty(), "files that import each other in a circle: {circles:#?}");
}

/// No file of the library imports from a floor above its own.
#[test]
fn nothing_imports_from_above() {
    let up = upward(&penumbra());
    assert!(up.is_empty(), "imports from a floor above: {up:#?}");
}

/// No Rust files import each other in a circle, neither here nor in the kernel kit.
#[test]
fn no_rust_files_form_a_circle() {
    no_circles(&penumbra());
    let kit = Path::new("crates/kernel-kit/src");
    no_circles(&imports::rust(kit, &sources("crates/kernel-kit/src", &["rs"]), &["crate"]));
}

/// Kernels import modules of `lib`, modules import modules, and no modules import each other in a circle.
#[test]
fn shaders_import_from_lib_alone() {
    let uses = imports::wgsl(&shaders());
    let lib = Path::new("shaders/lib");
    let arrows = uses.iter().flat_map(|(file, used)| used.iter().map(move |other| (file, other)));
    let wrong: Vec<_> = arrows.filter(|(_, other)| !other.starts_with(lib)).collect();
    assert!(wrong.is_empty(), "imports of kernels: {wrong:#?}");
    no_circles(&uses);
}

/// An import that goes up is found.
#[test]
fn a_planted_upward_import_is_found() {
    let files = [("src/scene/mesh.rs", "use crate::passes::grid::Grid;"), ("src/passes/grid.rs", "")];
    let files: Vec<_> = files.map(|(path, text)| (PathBuf::from(path), text.to_owned())).into();
    let up = upward(&imports::rust(Path::new("src"), &files, &["crate"]));
    assert_eq!(up, ["src/scene/mesh.rs -> src/passes/grid.rs"]);
}
