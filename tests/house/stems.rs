//! Names: a pass is one host file, one kernel and one test file of the same stem.

use std::collections::BTreeSet;

use crate::sources;

/// Stems of the files that lie in `folder` itself.
fn stems(folder: &str, extension: &str) -> BTreeSet<String> {
    let files = sources(folder, &[extension]);
    let own = files.iter().filter(|(path, _)| path.parent().is_some_and(|parent| parent.ends_with(folder)));
    let stems = own.map(|(path, _)| path.file_stem().unwrap().to_str().unwrap().to_owned());
    stems.filter(|stem| stem != "mod").collect()
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

/// The composer reads the exponent of a hexadecimal float as a hexadecimal number: `0x1p-24` would be 2^-144. No shader
/// may have one.
#[test]
fn no_shader_has_hexadecimal_floats() {
    for (path, text) in sources("shaders", &["wgsl"]) {
        let mut words = text.split(|c: char| !c.is_ascii_alphanumeric());
        let wrong = words.find(|word| word.starts_with("0x") && word.contains(['p', 'P']));
        assert_eq!(wrong, None, "{}", path.display());
    }
}

/// Vulkan allows sine, cosine and arc tangent large errors: `circle_point` and `angle_of` of `shaders/lib/math.wgsl`
/// have small ones on every device. No shader may call the device's own.
#[test]
fn no_shader_calls_the_devices_trigonometry() {
    for (path, text) in sources("shaders", &["wgsl"]) {
        let code = text.lines().map(|line| line.split("//").next().unwrap());
        let mut calls = code.flat_map(|line| {
            let heads = line.split('(').rev().skip(1);
            heads.filter_map(|head| head.rsplit(|c: char| !c.is_ascii_alphanumeric() && c != '_').next())
        });
        let wrong = calls.find(|name| ["sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sincos"].contains(name));
        assert_eq!(wrong, None, "{}", path.display());
    }
}
