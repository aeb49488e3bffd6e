//! Files that cannot be used: exit code 3, one line that names the file and the location in it, and no output touched.

use std::fs;
use std::path::{Path, PathBuf};

use crate::program::{BOX, device, folder, run};

/// Renders and plans `scene`, which must be refused; an existing output must not change.
#[track_caller]
fn assert_refused(folder: &Path, scene: &Path, words: &[&str]) {
    let output = folder.join("old.png");
    let statistics = folder.join("old.json");
    for file in [&output, &statistics] {
        fs::write(file, "old").unwrap();
    }
    let words = [&[scene.to_str().unwrap()], words].concat();
    let arguments = format!("render --width 4 --height 4 --spp 1 --device {} -o", device());
    run(&arguments, &[&output, &"--stats", &statistics, &scene]).assert_refused(3, &words);
    run("plan", &[&scene]).assert_refused(3, &words);
    for file in [&output, &statistics] {
        assert_eq!(fs::read_to_string(file).unwrap(), "old");
    }
}

/// A scene in `folder` of these bytes.
fn scene(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn scenes_that_are_none() {
    let folder = folder();
    let folder = folder.path();
    assert_refused(folder, &folder.join("missing.glb"), &["No such file"]);
    assert_refused(folder, folder, &["is a folder"]);
    assert_refused(folder, &scene(folder, "empty.glb", ""), &["empty"]);
    assert_refused(folder, &scene(folder, "empty.gltf", ""), &[]);
    assert_refused(folder, &scene(folder, "text.glb", "not a scene"), &[]);
    assert_refused(folder, &scene(folder, "text.gltf", "{ not JSON"), &["JSON"]);
}

#[test]
fn truncated_scenes() {
    let folder = folder();
    let whole = fs::read(BOX).unwrap();
    // Within the header, the first chunk's header, the JSON and the binary chunk.
    for length in [3, 11, 12, 19, 40, whole.len() - 1] {
        assert_refused(folder.path(), &scene(folder.path(), "cut.glb", &whole[..length]), &[]);
    }
}

#[test]
fn errors_of_scenes_say_where_the_fault_is() {
    let folder = folder();
    let folder = folder.path();
    let gltf = |name: &str, rest: &str| scene(folder, name, format!(r#"{{"asset": {{"version": "2.0"}}, {rest}}}"#));
    let loops = gltf("loop.gltf", r#""nodes": [{"children": [1]}, {"children": [0]}], "scenes": [{"nodes": [0]}]"#);
    assert_refused(folder, &loops, &["/nodes/"]);
    let escape = gltf("escape.gltf", r#""buffers": [{"uri": "../../secret.bin", "byteLength": 4}]"#);
    assert_refused(folder, &escape, &["/buffers/0"]);
    let required = gltf("required.gltf", r#""extensionsRequired": ["EXT_no_such"], "extensionsUsed": ["EXT_no_such"]"#);
    assert_refused(folder, &required, &["EXT_no_such"]);
    let range = gltf("range.gltf", r#""nodes": [{"mesh": 7}], "scenes": [{"nodes": [0]}]"#);
    assert_refused(folder, &range, &["/nodes/0/mesh"]);
}

/// A file without its image is refused, with the way out; a lenient import renders it. A variant must exist.
#[test]
fn images_that_are_missing_and_variants_that_do_not_exist() {
    let folder = folder();
    let uvs = r#""bufferViews": [{"buffer": 0, "byteLength": 36}], "accessors": [
        {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3},
        {"componentType": 5126, "type": "VEC2", "count": 3}],"#;
    // Corners at 0 0 0, 1 0 0 and 0 1 0.
    let buffer = "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    let with_image = |uri: &str| {
        scene(
            folder.path(),
            "image.gltf",
            format!(
                r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{"byteLength": 36, "uri": "{buffer}"}}], {uvs}
            "extensions": {{"KHR_materials_variants": {{"variants": [{{"name": "red"}}, {{"name": "blue"}}]}}}},
            "images": [{{"uri": "{uri}"}}], "textures": [{{"source": 0}}],
            "materials": [{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}}}}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "TEXCOORD_0": 1}}, "material": 0}}]}}],
            "nodes": [{{"mesh": 0}}]}}"#
            ),
        )
    };
    // A name that a setting has too, which would be replaced by its flag.
    let named = run("plan --lenient", &[&with_image("time")]);
    assert!(named.assert_done().stdout.contains("image \"time\" is left out"), "{named:?}");
    let scene = with_image("not there.png");
    assert_refused(folder.path(), &scene, &["/images/0/uri", "not there.png", "--lenient"]);
    let lenient = run("plan --lenient", &[&scene]);
    let text = &lenient.assert_done().stdout;
    assert!(text.contains("image \"not there.png\" is left out") && text.contains("available: red, blue"), "{text}");
    let text = run("plan --lenient --variant blue", &[&scene]);
    assert!(!text.assert_done().stdout.contains("variant"), "{text:?}");
    run("plan --lenient --variant pink", &[&scene]).assert_refused(2, &["'pink'", "red, blue"]);
}

#[test]
fn outputs_that_cannot_be_written() {
    let folder = folder();
    let folder = folder.path();
    let kept = scene(folder, "kept.png", "old");
    let (missing, below, dir) = (folder.join("no/x.png"), folder.join("kept.png/x.png"), folder.join("dir.png"));
    fs::create_dir(&dir).unwrap();
    let render = |output: &Path| run("render", &[&BOX, &"-o", &kept, &"-o", &output]);
    for output in [&missing, &below, &dir] {
        render(output).assert_refused(3, &[output.to_str().unwrap()]);
    }
    let statistics = folder.join("no/x.json");
    let answer = run("render", &[&BOX, &"-o", &kept, &"--stats", &statistics]);
    answer.assert_refused(3, &[statistics.to_str().unwrap()]);
    assert_eq!(fs::read_to_string(&kept).unwrap(), "old");
    assert_eq!(fs::read_dir(folder).unwrap().count(), 2, "something was left behind");
}
