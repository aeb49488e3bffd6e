//! The extension PENUMBRA_procedural: placement of objects, and errors.

use glam::{DVec3, Vec3};
use penumbra::Error;
use penumbra::internal::scene::{ImportOptions, Scene};
use penumbra::internal::specialisation::features::Feature;
use serde_json::{Value, json};

use crate::builder::{File, temporary};

const SPHERE: &str = include_str!("../../scenes/procedural/sphere.wgsl");

fn data(source: &str) -> String {
    let escaped: String = source.bytes().map(|byte| format!("%{byte:02x}")).collect();
    format!("data:text/plain,{escaped}")
}

/// The extension of a sphere with some members changed.
fn sphere(changes: Value) -> Value {
    let mut extension = json!({
        "source": data(SPHERE), "function": "sphere", "kind": "intersection", "parameters": [1],
        "min": [-1, -1, -1], "max": [1, 1, 1],
    });
    for (key, value) in changes.as_object().unwrap() {
        extension[key] = value.clone();
    }
    extension
}

fn file(extension: Value, node: Value) -> File {
    let mut file = File::new();
    let mut node = node;
    node["extensions"] = json!({ "PENUMBRA_procedural": extension });
    file.add("nodes", node);
    file
}

fn refused(extension: Value) -> String {
    let outcome = file(extension, json!({})).load_with(&ImportOptions::default());
    let error = outcome.expect_err("must be refused");
    assert!(matches!(error, Error::Input { .. }), "{error}");
    let text = error.to_string();
    assert!(!text.contains('\n') && text.contains("/nodes/0"), "{text}");
    text
}

/// The node's matrix places an object. The bounds of the scene are those of its box.
#[test]
fn objects_stand_where_their_nodes_are() {
    let extension = sphere(json!({ "min": [-1, -2, -3], "max": [1, 2, 3], "colour": {
        "source": data("fn grey(base: vec3f, position: vec3f, parameters: vec4f) -> vec3f { return parameters.xxx; }"),
        "function": "grey", "parameters": [0.25, 7],
    } }));
    let scene = file(extension, json!({ "translation": [100, 0, 0], "scale": [2, 1, 1] })).load();
    let [object] = &scene.procedurals[..] else { panic!("{:?}", scene.procedurals) };
    let [low, high] = scene.bounds().unwrap().map(|p| scene.normalisation.undo(p));
    // Positions about the centre are f32 below 1 in normalised space, of which 1 is 8 here: a rounding is 2.4e-7.
    let near = |a: DVec3, b: DVec3| a.distance(b) < 1e-5;
    assert!(near(low, DVec3::new(98.0, -2.0, -3.0)) && near(high, DVec3::new(102.0, 2.0, 3.0)), "{low} {high}");
    let own = object.to_own.transform_point3(scene.normalisation.apply(DVec3::new(101.0, 0.5, -1.0)).as_dvec3());
    assert!(near(own, DVec3::new(0.5, 0.5, -1.0)), "{own}");
    assert_eq!(object.bounds, [Vec3::new(-1.0, -2.0, -3.0), Vec3::new(1.0, 2.0, 3.0)]);
    assert_eq!((object.parameters, object.colour), ([1.0, 0.0, 0.0, 0.0], Some((0, [0.25, 7.0, 0.0, 0.0]))));
}

/// The text of a function is a part of the fingerprint, so that checkpoints and references of another function are not
/// used.
#[test]
fn sources_are_in_the_fingerprint() {
    let of = |source: &str| file(sphere(json!({ "source": data(source) })), json!({})).load().fingerprint(&());
    let other = SPHERE.replace("along - half, along", "along - 0.5 * half, along");
    assert_ne!(SPHERE, other);
    assert_eq!(of(SPHERE), of(SPHERE));
    assert_ne!(of(SPHERE), of(&other));
}

/// Properties of a material that objects do not have are ignored, with a note.
#[test]
fn materials_are_plain() {
    let mut lamp = file(sphere(json!({ "material": 0 })), json!({}));
    lamp.add("materials", json!({ "name": "lamp", "emissiveFactor": [1, 1, 1], "alphaMode": "BLEND" }));
    let scene = lamp.load();
    let material = &scene.materials[scene.procedurals[0].material as usize];
    assert_eq!(material.emissive, Vec3::ZERO);
    for word in ["no emission", "no alpha"] {
        assert_eq!(
            scene.notes.iter().filter(|n| n.contains(word) && n.contains("\"lamp\"")).count(),
            1,
            "{:?}",
            scene.notes
        );
    }
}

#[test]
fn bad_extensions_are_refused_where_they_are_bad() {
    let with = |key: &str, value: Value| {
        let mut extension = sphere(json!({}));
        extension[key] = value;
        refused(extension)
    };
    let without = |key: &str| {
        let mut extension = sphere(json!({}));
        extension.as_object_mut().unwrap().remove(key);
        refused(extension)
    };
    for key in ["source", "function", "kind", "min", "max"] {
        assert!(without(key).contains(&format!("`{key}` is missing")), "{key}");
    }
    let cases = [
        ("source", json!("missing.wgsl"), "missing.wgsl: No such file"),
        ("source", json!("../sphere.wgsl"), "leaves the scene's folder"),
        ("source", json!("/dev/zero"), "leaves the scene's folder"),
        ("source", json!("https://example.org/sphere.wgsl"), "only data URIs and relative paths"),
        ("source", json!("data:text/plain,%0a%ff"), "line 2: is not text in UTF-8"),
        ("source", json!("."), "empty path"),
        ("source", json!(null), "not a string"),
        ("function", json!("cube"), "has no function \"cube\""),
        ("function", json!(7), "not a string"),
        ("kind", json!("distance"), "\"sphere\" is not of the form fn(position: vec3f, parameters: vec4f) -> f32"),
        ("kind", json!("mesh"), "\"mesh\" is neither"),
        ("min", json!([1, -1, -1]), "is not beyond `min`"),
        ("max", json!([1, -2, 1]), "is not beyond `min`"),
        ("max", json!([1, 1]), "2 numbers, not 3"),
        ("max", json!([1, 1e39, 1]), "out of range"),
        ("max", json!([1, null, 1]), "not a number"),
        ("parameters", json!([1, 2, 3, 4, 5]), "5 numbers"),
        ("parameters", json!([1e39]), "out of range"),
        ("material", json!(0), "material 0 of 0"),
        ("colour", json!({ "source": data(SPHERE), "function": "sphere" }), "not of the form fn(base"),
    ];
    for (key, value, expected) in cases {
        let problem = with(key, value.clone());
        assert!(problem.contains(expected), "{key} {value}: {problem}");
    }
    // A mesh without a material has another one than those of the file.
    let mut mesh = file(sphere(json!({ "material": 0 })), json!({}));
    mesh.mesh(&[[0.; 3], [4., 0., 0.], [0., 2., 0.]], json!({}));
    let error = mesh.load_with(&ImportOptions::default()).unwrap_err().to_string();
    assert!(error.contains("material 0 of 0"), "{error}");
    let flat = file(sphere(json!({})), json!({ "scale": [1, 0, 1] })).load_with(&ImportOptions::default());
    assert!(flat.unwrap_err().to_string().contains("scaled to nothing"));
    let boundless = refused(sphere(json!({ "min": [-3e38, -3e38, -3e38], "max": [3e38, 3e38, 3e38] })));
    assert!(boundless.contains("without bound"), "{boundless}");
    let mut many = File::new();
    for _ in 0..65 {
        many.add("nodes", json!({ "extensions": { "PENUMBRA_procedural": sphere(json!({})) } }));
    }
    let problem = many.load_with(&ImportOptions::default()).unwrap_err().to_string();
    assert!(problem.contains("more than 64 procedural objects") && problem.contains("/nodes/64"), "{problem}");
}

/// Files that are invalid, not pure functions, or too large are refused quickly with one line.
#[test]
fn bad_functions_are_refused() {
    let head = "fn sphere(origin: vec3f, direction: vec3f, nearest: f32, parameters: vec4f) -> vec4f";
    let with = |before: &str, body: &str| format!("{before}\n{head} {{ {body} }}");
    // Each function calls the previous one twice: more than a million calls when inlined.
    let mut doubling = "fn f0(x: f32) -> f32 { return x + 1.0; }".to_owned();
    for i in 1..30 {
        doubling += &format!("fn f{i}(x: f32) -> f32 {{ return f{}(x) + f{}(x + 1.0); }}", i - 1, i - 1);
    }
    let sum = format!("return vec4f({}1.0);", "nearest + ".repeat(5000));
    let cases = [
        (String::new(), "has no function \"sphere\""),
        (SPHERE.to_owned() + "\0", "line"),
        (SPHERE.to_owned() + SPHERE, "redefinition of \"sphere\""),
        ("/* ".to_owned() + SPHERE, "line 1: unterminated"),
        (SPHERE.replace("sphere", "target"), "line"),
        (with("", "return vec4f(1 / 0);"), "line 2"),
        ("fn sphere(".to_owned(), "line 1"),
        (with("", "return vec4f(1u);"), "line 2"),
        (with("import package::lib::bvh::trace_closest;", "return vec4f(0.0);"), "line 1"),
        (with("@if(glossy) const x = 1.0;", "return vec4f(0.0);"), "line 1"),
        (with("", "return sphere(origin, direction, nearest, parameters);"), "recursive"),
        (
            with("", "return other(nearest);")
                + "fn other(x: f32) -> vec4f { return sphere(vec3f(x), vec3f(x), x, vec4f(x)); }",
            "cyclic",
        ),
        (
            with("@group(0) @binding(0) var<storage, read_write> counters: array<u32>;", "return vec4f(0.0);"),
            "\"counters\"",
        ),
        (with("var<private> traversal_iterations: u32;", "return vec4f(0.0);"), "\"traversal_iterations\""),
        (with("var<workgroup> shared_by_all: u32;", "return vec4f(0.0);"), "\"shared_by_all\""),
        (with("override radius = 1.0;", "return vec4f(radius);"), "\"radius\""),
        (with("@compute @workgroup_size(1) fn main() {}", "return vec4f(0.0);"), "\"main\""),
        (with("", "workgroupBarrier(); return vec4f(0.0);"), "more than compute"),
        (with("", "if nearest > 1.0 { discard; } return vec4f(0.0);"), "more than compute"),
        (with("", "return vec4f(dpdx(nearest));"), "more than compute"),
        (with("", "var a: array<f32, 100000>; return vec4f(a[u32(nearest)]);"), "bytes"),
        (with(&doubling, "return vec4f(f29(nearest));"), "expressions"),
        (with("", &sum), "deep"),
        (with("", &format!("return vec4f({}1.0{});", "(".repeat(10_000), ")".repeat(10_000))), "deep"),
        (with("", &format!("{} return vec4f(0.0);", "{ ".repeat(1000) + &"}".repeat(1000))), "line 2"),
        (with("", &format!("{} {{}} return vec4f(0.0);", "if nearest > 0.0 {} else ".repeat(2000))), "deep"),
        (with(&"// nothing\n".repeat(10_000), "return vec4f(0.0);"), "at most 65536"),
    ];
    for (source, expected) in cases {
        let problem = refused(sphere(json!({ "source": data(&source) })));
        let start: String = source.chars().take(200).collect();
        assert!(problem.contains(expected), "{start}: {problem}");
    }
}

/// A file may use names of the kernels and of WGSL's functions.
#[test]
fn names_of_the_kernels_may_be_used() {
    let source = "
        const PI = 3.0;
        struct Hit { t: f32, normal: vec3f }
        fn trace_closest(tile: f32) -> Hit { return Hit(tile, vec3f(PI)); }
        fn max(a: f32, b: f32) -> f32 { return a + b; }
        fn sphere(origin: vec3f, direction: vec3f, nearest: f32, parameters: vec4f) -> vec4f {
            var procedural_iterations = 1.0;
            let procedural_function_aa = 2.0;
            for (var i1 = 0; i1 < 3; i1++) { procedural_iterations = max(procedural_iterations, trace_closest(1.0).t); }
            return vec4f(trace_closest(procedural_function_aa).normal, procedural_iterations);
        }";
    let scene = file(sphere(json!({ "source": data(source) })), json!({})).load();
    let features = penumbra::internal::specialisation::features::Features::default()
        .with(Feature::Procedurals, true)
        .with_functions(scene.functions);
    penumbra::internal::kernels::compose("primary", &features).unwrap();
}

/// Files beside the scene are read, and several nodes may use the same function.
#[test]
fn files_beside_the_scene_are_read() {
    let path = temporary("gltf");
    let source = path.with_extension("wgsl");
    std::fs::write(&source, SPHERE).unwrap();
    let name = source.file_name().unwrap().to_str().unwrap();
    let object = || json!({ "PENUMBRA_procedural": sphere(json!({ "source": name })) });
    let node = |x: i32| json!({ "translation": [x, 0, 0], "extensions": object() });
    let file = json!({ "asset": { "version": "2.0" }, "nodes": [node(0), node(3)] });
    std::fs::write(&path, file.to_string()).unwrap();
    let scene = Scene::load(&path, &ImportOptions::default()).unwrap();
    assert_eq!(scene.procedurals.iter().map(|object| object.function).collect::<Vec<_>>(), [0, 0]);
    assert_eq!(scene.notes, ["no camera in the scene", "no light in the file: `default_light` adds one"]);
}

/// The functions of a hidden object are among the scene's files, because an animation may show it. They need not be
/// there.
#[test]
fn files_of_hidden_objects_are_known() {
    let path = temporary("gltf");
    let [source, colour] = ["wgsl", "colour.wgsl"].map(|extension| path.with_extension(extension));
    for file in [&source, &colour] {
        std::fs::write(file, SPHERE).unwrap();
    }
    let name = |path: &std::path::Path| path.file_name().unwrap().to_str().unwrap().to_owned();
    let hidden = |changes: Value| {
        let extensions = json!({ "PENUMBRA_procedural": sphere(changes), "KHR_node_visibility": { "visible": false } });
        json!({ "extensions": extensions })
    };
    let here = json!({ "source": name(&source), "colour": { "source": name(&colour), "function": "grey" } });
    let nodes = [hidden(here), hidden(json!({ "source": "missing.wgsl" }))];
    let file = json!({ "asset": { "version": "2.0" }, "nodes": nodes });
    std::fs::write(&path, file.to_string()).unwrap();
    let scene = Scene::load(&path, &ImportOptions::default()).unwrap();
    assert!(scene.procedurals.is_empty());
    assert_eq!(scene.files, [colour, source, path.with_file_name("missing.wgsl")]);
}
