//! The house: one pass, one host file, one kernel, one test file, the same stem.

use std::collections::BTreeSet;
use std::path::Path;

use penumbra::internal::gpu::compose::SHADERS;

fn stems(folder: &str, extension: &str) -> BTreeSet<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    std::fs::read_dir(&folder)
        .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == extension))
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
        .filter(|stem| stem != "mod")
        .collect()
}

/// Every pass has its kernel and its test, and every kernel its pass.
#[test]
fn passes_kernels_and_tests_go_together() {
    let passes = stems("src/passes", "rs");
    assert_eq!(passes, stems("shaders", "wgsl"), "src/passes against shaders");
    let tests = stems("tests/kernels", "rs");
    let untested: Vec<_> = passes.difference(&tests).collect();
    assert!(untested.is_empty(), "no file in tests/kernels for {untested:?}");
}

/// Every shader on disk is in the binary.
#[test]
fn every_shader_is_embedded() {
    let mut on_disk = stems("shaders", "wgsl");
    on_disk.extend(stems("shaders/lib", "wgsl").into_iter().map(|stem| format!("lib/{stem}")));
    assert_eq!(on_disk, SHADERS.iter().map(|(path, _)| (*path).to_owned()).collect());
}

/// The composer reads the exponent of a hexadecimal float as a hexadecimal number: `0x1p-24` would be 2^-144. None of
/// the shaders may have one.
#[test]
fn no_shader_has_hexadecimal_floats() {
    for (path, text) in SHADERS {
        let mut words = text.split(|c: char| !c.is_ascii_alphanumeric());
        let wrong = words.find(|word| word.starts_with("0x") && word.contains(['p', 'P']));
        assert_eq!(wrong, None, "{path}");
    }
}
