//! `--environment`: its plan, its errors, and checkpoints that belong to it.

use std::fs;
use std::path::{Path, PathBuf};

use penumbra::Image;

use crate::program::{BOX, device, folder, run};

const SKY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/sky.exr");

/// A panorama of 4 x 2 texels of 1, but for the green of the one at (2, 1).
fn panorama(folder: &Path, green: f32) -> PathBuf {
    let file = folder.join("panorama.exr");
    let mut image = Image::new(4, 2);
    for channel in ["R", "G", "B"] {
        let mut samples = vec![1.0; 8];
        if channel == "G" {
            samples[6] = green;
        }
        image.add_channel(channel, samples);
    }
    image.write_exr(&file).unwrap();
    file
}

/// A scene of one triangle, without a light.
fn triangle(folder: &Path) -> PathBuf {
    let file = folder.join("triangle.gltf");
    let positions: Vec<u8> =
        [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    fs::write(folder.join("triangle.bin"), positions).unwrap();
    let text = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": "triangle.bin", "byteLength": 36}]}"#;
    fs::write(&file, text).unwrap();
    file
}

/// An environment without lamps has no visibility map, and the plan gives the reason; a lamp keeps its own.
#[test]
fn the_plan_gives_the_reason_why_the_environment_has_no_visibility_photons() {
    let folder = folder();
    let reason = |scene: &Path, list: &str, name: &str| {
        let plan = run("plan --json", &[&scene, &"--environment", &SKY]).json();
        let items = plan[list].as_array().unwrap();
        let item = items.iter().find(|item| item["name"] == name).unwrap_or_else(|| panic!("{name}: {plan}"));
        item["reason"].as_str().unwrap().to_owned()
    };
    let alone = triangle(folder.path());
    assert!(reason(&alone, "kept", "environment").contains("256 x 128"));
    assert!(reason(&alone, "left_out", "visibility_map").contains("the environment is the only light"));
    assert!(reason(BOX.as_ref(), "kept", "visibility_map").contains("none are of the environment"));
    let without = run("plan --json", &[&BOX]).json();
    let left_out = without["left_out"].as_array().unwrap();
    assert!(left_out.iter().any(|item| item["name"] == "environment"), "{without}");
}

#[test]
fn panoramas_that_are_none_are_refused() {
    let folder = folder();
    let folder = folder.path();
    let plan =
        |panorama: &Path, arguments: &str| run(&format!("plan {arguments}"), &[&BOX, &"--environment", &panorama]);
    let file = |name: &str, bytes: &[u8]| {
        fs::write(folder.join(name), bytes).unwrap();
        folder.join(name)
    };
    plan(&folder.join("missing.exr"), "").assert_refused(3, &["missing.exr", "No such file"]);
    for name in ["empty.exr", "empty.hdr"] {
        plan(&file(name, b""), "").assert_refused(3, &[name]);
    }
    plan(&file("text.hdr", b"not a panorama"), "").assert_refused(3, &["text.hdr"]);
    // A header of 2^30 x 2^30 pixels.
    plan(&file("huge.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1073741824 +X 1073741824\n"), "")
        .assert_refused(3, &["huge.hdr"]);
    plan(&file("view.png", b""), "").assert_refused(3, &["view.png", ".exr or .hdr"]);
    let mut grey = Image::new(2, 1);
    grey.add_channel("Y", vec![1.0; 2]);
    grey.write_exr(folder.join("grey.exr")).unwrap();
    plan(&folder.join("grey.exr"), "").assert_refused(3, &["grey.exr", "R", "no such channel"]);

    for wrong in [f32::NAN, f32::INFINITY, -0.5] {
        let file = panorama(folder, wrong);
        plan(&file, "").assert_refused(3, &["panorama.exr", "texel 2, 1", "G is", "--lenient"]);
        let lenient = plan(&file, "--lenient");
        let note = "1 texel of the panorama, at 2, 1, has values";
        assert!(lenient.assert_done().stdout.contains(note), "{lenient:?}");
    }

    let good = panorama(folder, 1.0);
    plan(&good, "--environment-strength -1").assert_refused(2, &["--environment-strength is -1"]);
    plan(&good, "--environment-strength 1e38").assert_refused(2, &["--environment-strength"]);
    plan(&good, "--environment-rotation inf").assert_refused(2, &["--environment-rotation"]);
    run("plan --environment-rotation 3", &[&BOX]).assert_refused(2, &["--environment"]);
}

/// A checkpoint belongs to its panorama, texel by texel, and to its rotation and strength.
#[test]
fn checkpoints_know_their_environment() {
    let folder = folder();
    let folder = folder.path();
    let [image, state] = ["a.exr", "state"].map(|name| folder.join(name));
    let scene = triangle(folder);
    let render = |arguments: &str| {
        let arguments = format!(
            "render --device {} --width 8 --height 8 --spp 2 --technique path --quiet --checkpoint {} {arguments} -o",
            device(),
            state.display()
        );
        run(&arguments, &[&image, &scene, &"--environment", &folder.join("panorama.exr")])
    };
    panorama(folder, 1.0);
    render("--environment-rotation -30").assert_done();
    // A pixel in the corner sees the environment alone.
    let image = Image::read(&image).unwrap();
    for channel in ["R", "G", "B", "A"] {
        // The texels are 1: interpolation and the mean of two samples round a few times in f32, by 6e-8 each.
        assert!((image.channel(channel).unwrap()[0] - 1.0).abs() < 1e-6, "{channel}");
    }
    render("--environment-rotation -30 --resume").assert_done();
    for other in ["--environment-rotation 30", "", "--environment-rotation -30 --environment-strength 2"] {
        render(&format!("{other} --resume")).assert_refused(3, &["state", "another scene"]);
    }
    panorama(folder, 1.5);
    render("--environment-rotation -30 --resume").assert_refused(3, &["state", "another scene"]);
}
