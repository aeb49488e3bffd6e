//! Files of others, found through `PENUMBRA_SHARED`: the validator's malformed and odd files, and models.

use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use penumbra::Error;
use penumbra::scene::{ImportOptions, Scene};
use serde_json::Value;

/// Files with one of these extensions below the folder `name` of the shared files. None, and a
/// line that says so, where there are no shared files.
fn shared_files(name: &str, extensions: &[&str]) -> Option<Vec<PathBuf>> {
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

/// Errors of the validator that do not change what is seen: how the code starts, a part of the
/// pointer (all of it after `=`), and why.
const DOES_NOT_MATTER: &[(&str, &str, &str)] = &[
    ("ACCESSOR_ANIMATION", "", "animation"),
    ("ACCESSOR_ELEMENT_OUT_OF", "", "declared bounds are not used: positions are"),
    ("ACCESSOR_JOINTS", "", "skin"),
    ("ACCESSOR_MATRIX_ALIGNMENT", "", "matrices only occur in skins"),
    ("ACCESSOR_MAX_MISMATCH", "", "declared bounds are not used: positions are"),
    ("ACCESSOR_MIN_MISMATCH", "", "declared bounds are not used: positions are"),
    ("ACCESSOR_WEIGHTS", "", "skin"),
    ("ANIMATION", "", "animation"),
    ("BUFFER_DATA_URI_MIME_TYPE_INVALID", "", "bytes are bytes, whatever they are called"),
    ("BUFFER_VIEW_INVALID_BYTE_STRIDE", "", "a stride that is stated can be followed"),
    ("DUPLICATE_ELEMENTS", "extensions", "said twice, meant once"),
    ("EMPTY_ENTITY", "/animations", "animation"),
    ("EMPTY_ENTITY", "=/buffers", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/cameras", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/images", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/meshes", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/nodes", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "/skins", "skin"),
    ("EMPTY_ENTITY", "KHR_materials_variants", "variants are not shown"),
    ("IMAGE_MIME_TYPE_INVALID", "", "an image is what its bytes say"),
    ("IMAGE_NON_ENABLED_MIME_TYPE", "", "nothing shows the image"),
    ("INVALID_IBM_ACCESSOR_COUNT", "", "skin"),
    ("INVALID_URI", "/images/0/uri", "a wrong media type only: an image is what its bytes say"),
    ("MESH_INVALID_WEIGHTS_COUNT", "", "morph targets"),
    ("MESH_PRIMITIVE_ACCESSOR_WITHOUT_BYTESTRIDE", "", "elements without a stride are tightly packed"),
    ("MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_UNSIGNED_INT", "_CUSTOM_ATTR", "custom attribute"),
    ("MESH_PRIMITIVE_INVALID_ATTRIBUTE", "UNKNOWN", "custom attribute"),
    ("MESH_PRIMITIVE_NO_TANGENT_SPACE", "", "tangent space of an extension that is not shown"),
    ("MESH_PRIMITIVE_TOO_FEW_TEXCOORDS", "", "the textures of these files have no image"),
    ("MESH_PRIMITIVE_POSITION_ACCESSOR_WITHOUT_BOUNDS", "targets", "morph targets"),
    ("NODE_SKIN", "", "skin"),
    ("NON_REQUIRED_EXTENSION", "", "the extension is supported, required or not"),
    ("PATTERN_MISMATCH", "KHR_animation_pointer", "animation"),
    ("SCENE_NON_ROOT_NODE", "", "the scene starts at the node it lists, and a note says so"),
    ("SKIN_", "", "skin"),
    ("TEXTURE_INVALID_IMAGE_MIME_TYPE", "EXT_texture_webp", "the extension is not shown"),
    ("TYPE_MISMATCH", "/extensions/KHR_invalid", "payload of an unknown extension"),
    ("UNDECLARED_EXTENSION", "", "what is there and known is shown, declared or not"),
    ("UNDEFINED_PROPERTY", "/animations", "animation"),
    ("UNDEFINED_PROPERTY", "KHR_materials_variants", "variants are not shown"),
    ("UNEXPECTED_EXTENSION_OBJECT", "", "an extension in a place where it means nothing"),
    ("UNRESOLVED_REFERENCE", "/skins", "skin"),
    ("UNRESOLVED_REFERENCE", "EXT_texture_webp", "the extension is not shown"),
    ("UNSATISFIED_DEPENDENCY", "/skin", "skin"),
    ("VALUE_NOT_IN_RANGE", "KHR_materials_dispersion", "the extension is not shown"),
    ("VALUE_NOT_IN_RANGE", "KHR_materials_volume", "the extension is not shown"),
];

fn matters(message: &Value) -> bool {
    let (code, pointer) = (message["code"].as_str().unwrap(), message["pointer"].as_str().unwrap_or(""));
    let is_at = |place: &str| place.strip_prefix('=').map_or(pointer.contains(place), |whole| pointer == whole);
    message["severity"] == 0 && !DOES_NOT_MATTER.iter().any(|(c, place, _)| code.starts_with(c) && is_at(place))
}

#[test]
fn malformed_files_are_refused_and_legal_ones_load() {
    let Some(files) = shared_files("malformed", &["gltf", "glb"]) else { return };
    let mut failures = Vec::new();
    for file in files {
        let mut report = file.clone().into_os_string();
        report.push(".report.json");
        let Ok(report) = std::fs::read(&report) else { continue };
        let report: Value = serde_json::from_slice(&report).unwrap();
        let errors: Vec<&Value> =
            report["issues"]["messages"].as_array().unwrap().iter().filter(|m| matters(m)).collect();
        let start = Instant::now();
        let outcome = catch_unwind(|| Scene::load(&file, &ImportOptions::default()));
        // A guard against loops and bombs, a thousand times what any of these small files needs.
        if start.elapsed() > Duration::from_secs(1) {
            failures.push(format!("{}: took {:?}", file.display(), start.elapsed()));
        }
        let legal = report["issues"]["numErrors"] == 0;
        match outcome {
            Err(_) => failures.push(format!("{}: panicked", file.display())),
            Ok(Err(error)) if legal => failures.push(format!("legal, but: {error}")),
            Ok(Ok(_)) if !errors.is_empty() => {
                failures.push(format!("{}: loaded in spite of {errors:?}", file.display()))
            }
            Ok(Err(Error::Input { file: named, place, problem })) => {
                if named != file || place.is_empty() || problem.contains('\n') {
                    failures.push(format!("{}: names {} {place}: {problem}", file.display(), named.display()));
                }
                println!(
                    "{place}: {problem}   <- {} {:?}",
                    file.display(),
                    errors.iter().map(|e| format!("{} {}", e["code"], e["pointer"])).collect::<Vec<_>>()
                );
            }
            Ok(Err(error)) => failures.push(format!("{}: not an input error: {error}", file.display())),
            Ok(Ok(_)) => {}
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn models_load() {
    let Some(files) = shared_files("models", &["gltf", "glb"]) else { return };
    for file in files {
        let scene = Scene::load(&file, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert!(!scene.triangles.is_empty(), "{}", file.display());
        println!(
            "{}: {} tri {} tex {:?} {:?}",
            file.display(),
            scene.triangles.len(),
            scene.textures.len(),
            scene.normalisation,
            scene.notes
        );
    }
}
