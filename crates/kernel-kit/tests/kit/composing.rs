//! Kernels are composed of modules, with typed features.

use kernel_kit::{Composer, Error, Feature, Features, Gpu, constants_module, embed, features};

features! {
    /// What the tests' kernels can have.
    pub enum DeviceFeature {
        /// Device: tables are textures,
        /// as software devices have it.
        TextureLoads,
        /// Test: the second set of coordinates.
        Uv1,
        /// Test: a name of its own.
        Renamed = "other_name",
    }
}

/// What the device adds to the features.
pub fn device_features(gpu: &Gpu) -> Features<DeviceFeature> {
    Features::new().with(DeviceFeature::TextureLoads, gpu.texture_loads)
}

/// Names are those of the variants in snake case, or given; reasons are the doc comments.
#[test]
fn features_have_names_and_reasons() {
    assert_eq!(DeviceFeature::ALL.iter().map(|f| f.name()).collect::<Vec<_>>(), ["texture_loads", "uv1", "other_name"]);
    assert_eq!(DeviceFeature::TextureLoads.why(), "Device: tables are textures, as software devices have it.");
    let set = Features::all().with(DeviceFeature::Uv1, false);
    assert!(set.has(DeviceFeature::Renamed) && !set.has(DeviceFeature::Uv1));
    assert_eq!(set.names().collect::<Vec<_>>(), ["texture_loads", "other_name"]);
    assert_eq!(set.iter().collect::<Features<_>>(), set);
    assert_ne!(set, Features::all());
}

const KERNEL: &str = "
import package::lib::scale::scaled;
@group(0) @binding(0) var<storage, read_write> values: array<u32>;
@compute @workgroup_size(1) fn scale() {
    values[0] = scaled(values[0]);
    @if(uv1) { values[1] = 77u; }
    @if(other_name && !uv1) { values[1] = 88u; }
}";

/// Embedded folders, generated constants and features: what a kernel does not use is not in it.
#[test]
fn kernels_hold_what_they_use() {
    let composer = Composer::new()
        .with_folder(embed!("$CARGO_MANIFEST_DIR/tests/kit/shaders"))
        .with_module("lib/constants", constants_module(&[("SCALE", 5), ("UNUSED", 6)]));
    let paths: Vec<&str> = composer.modules().map(|(path, _)| path).collect();
    assert_eq!(paths, ["double", "kit", "lib/constants", "lib/scale"]);
    let composed = composer.compose_source("scale", KERNEL, &Features::new().with(DeviceFeature::Uv1, true)).unwrap();
    assert!(composed.wgsl.contains("SCALE: u32 = 5") && composed.wgsl.contains("77"), "{}", composed.wgsl);
    assert!(
        ["88", "UNUSED", "unused", "MAX_GROUPS"].iter().all(|text| !composed.wgsl.contains(text)),
        "{}",
        composed.wgsl
    );
    assert_eq!(composed.kernel, "scale");
    let renamed = Features::new().with(DeviceFeature::Renamed, true);
    assert!(composer.compose_source("scale", KERNEL, &renamed).unwrap().wgsl.contains("88"));
    let double = composer.compose("double", &Features::none()).unwrap();
    assert_eq!(double.module.entry_points[0].name, "double");
    assert_eq!(double.overrides(&[("other", 1.0), ("times", 2.0)]), [("times", 2.0)]);
    // A module of the same path is replaced, in that composer alone.
    let seven = composer.clone().with_module("lib/constants", constants_module(&[("SCALE", 7)]));
    assert!(seven.compose("double", &Features::none()).unwrap().wgsl.contains("7u"));
    assert!(composer.compose("double", &Features::none()).unwrap().wgsl.contains("5u"));
}

/// An `@if` on a feature that does not exist fails: a misspelt feature would silently leave code out.
#[test]
fn unknown_features_fail_to_compose() {
    let source = "@compute @workgroup_size(1) fn nothing() { @if(texture_lods) { return; } }";
    let outcome = Composer::new().compose_source("typo", source, &Features::<DeviceFeature>::new());
    let problem = outcome.unwrap_err().to_string();
    assert!(problem.contains("typo") && problem.contains("texture_lods"), "{problem}");
    assert!(Composer::new().compose_source("typo", source, &Features::none()).is_err());
}

/// A kernel and a module that there is not, and WGSL that is wrong, are errors of one line that name the kernel.
#[test]
fn what_does_not_compose_is_named() {
    let composer = Composer::new();
    let error = |outcome: kernel_kit::Result<_>| -> Error { outcome.map(|_: kernel_kit::Composed| ()).unwrap_err() };
    let compose = |source: &str| error(composer.compose_source("wrong/kernel", source, &Features::none()));
    let errors = [
        error(composer.compose("wrong/kernel", &Features::none())),
        compose("import package::lib::none::item; @compute @workgroup_size(1) fn nothing() { item(); }"),
        compose("@compute @workgroup_size(1) fn nothing() { let x: u32 = 1.0; }"),
        compose("@compute @workgroup_size(1) fn nothing( {"),
    ];
    for error in errors {
        let text = error.to_string();
        assert!(text.starts_with("kernel wrong/kernel: "), "{text}");
        assert!(!text.contains('\n') && !text.contains('\u{1b}'), "{text}");
    }
}

/// Hexadecimal floats, which the composer would misread, are refused in kernels and in modules; comments may have them.
#[test]
fn hexadecimal_floats_are_refused() {
    let kernel =
        |number: &str| format!("@compute @workgroup_size(1) fn nothing() {{ let x: f32 = {number}; }} // 0x1p-3");
    let composer = Composer::new().with_module("lib/half", "fn half() -> f32 { return 0X.8p0f; }");
    let compose = |source: &str| composer.compose_source("hex", source, &Features::none()).map(drop);
    compose(&kernel("0x12")).unwrap();
    for number in ["0x1p-24", "0x1.8P3", "0X1p1f"] {
        let problem = compose(&kernel(number)).unwrap_err().to_string();
        assert!(problem.starts_with("kernel hex: ") && problem.contains("decimal"), "{problem}");
    }
    assert!(compose(&format!("import package::lib::half::half; {}", kernel("half()"))).is_err());
    compose(&kernel("0.5")).unwrap();
}

/// A kernel of several entry points, each with modules of its own, is composed to the same text every time: drivers
/// identify programs by their bits.
#[test]
fn composing_is_repeatable() {
    let numbers = || 0..6u32;
    let module = |n| {
        format!("import package::kit::group_index; fn f{n}(a: vec3u) -> u32 {{ return group_index(a, a) + {n}u; }}")
    };
    let composer = numbers().fold(Composer::new(), |composer, n| composer.with_module(format!("lib/m{n}"), module(n)));
    let imports: String = numbers().map(|n| format!("import package::lib::m{n}::f{n};")).collect();
    let entry = |n| format!("@compute @workgroup_size(1) fn e{n}() {{ let a = f{n}(vec3u(1u)); }}");
    let source = imports + &numbers().map(entry).collect::<String>();
    let texts = (0..20).map(|_| composer.compose_source("many", &source, &Features::none()).unwrap().wgsl);
    assert_eq!(texts.collect::<std::collections::BTreeSet<_>>().len(), 1);
}
