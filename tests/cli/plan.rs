//! `penumbra plan` and `penumbra devices`.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use kernel_kit::{DeviceChoice, Feature as _, Gpu};
use penumbra::internal::specialisation::features::Feature;
use penumbra::settings::{Aov, Denoise, Technique};
use penumbra::{ImportOptions, Renderer, Scene, Settings};
use serde_json::Value;

use crate::program::{BOX, STILL_LIFE, folder, penumbra, run};
use crate::schema;

const SPHERE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/sphere.glb");

fn names(items: &Value) -> BTreeSet<&str> {
    items.as_array().unwrap().iter().map(|item| item["name"].as_str().unwrap()).collect()
}

#[test]
fn the_plan_has_every_part_once_with_a_reason_and_a_cost() {
    let (plain, rich) = (run("plan --json", &[&BOX]).json(), run("plan --json", &[&STILL_LIFE]).json());
    for plan in [&plain, &rich] {
        schema::assert_documented("Plan", plan);
        for item in [&plan["kept"], &plan["left_out"]].iter().flat_map(|list| list.as_array().unwrap()) {
            assert!(["name", "reason", "cost"].iter().all(|key| !item[key].as_str().unwrap().is_empty()), "{item}");
        }
        assert!(names(&plan["kept"]).is_disjoint(&names(&plan["left_out"])));
    }
    let all = |plan: &Value| {
        let lists = ["kept", "left_out", "deferred"].map(|list| names(&plan[list]));
        lists.iter().flatten().map(|name| name.to_string()).collect::<Vec<_>>()
    };
    // Every feature that kernels know is in one list.
    let features: BTreeSet<String> = Feature::ALL.iter().map(|feature| feature.name().to_owned()).collect();
    for plan in [&plain, &rich] {
        let listed = all(plan);
        assert_eq!(listed.len(), listed.iter().collect::<BTreeSet<_>>().len(), "a part is listed twice");
        let parts: BTreeSet<String> = listed.into_iter().collect();
        assert!(parts.is_superset(&features), "{:?}", features.difference(&parts).collect::<Vec<_>>());
    }
    // The box has one Lambertian light and plain Lambertian surfaces; the still life has the features that the box
    // leaves out.
    for part in ["textures", "alpha_test", "glossy", "point_lights", "light_tags"] {
        assert!(names(&plain["left_out"]).contains(part) && names(&rich["kept"]).contains(part), "{part}");
    }
    assert_eq!(plain["scene"]["triangles"], 24);
    assert_eq!(plain["scene"]["lights"], 1);
}

#[test]
fn the_plan_follows_the_settings() {
    let plan = |arguments: &str| run(&format!("plan --json {arguments}"), &[&BOX]).json();
    assert!(names(&plan("")["kept"]).contains("visibility_map"));
    for technique in ["two-pass", "path"] {
        let plan = plan(&format!("--technique {technique}"));
        assert!(names(&plan["left_out"]).contains("visibility_map"), "{technique}");
        assert_eq!(plan["settings"]["technique"], technique);
    }
    assert!(names(&plan("--audit 0")["left_out"]).contains("audit"));
    // Photons would take longer than the shadow rays of a small image, or of a scene that fills a part of it: 8 samples
    // are 2.1 million rays, but where the ball's camera sees no surface there are none.
    let few = "--width 256 --height 256 --spp 4";
    assert!(names(&plan(few)["left_out"]).contains("visibility_map"));
    assert!(names(&plan(&format!("{few} --photons 4096"))["kept"]).contains("visibility_map"));
    let ball = |spp: u32| run(&format!("plan --json --width 256 --height 256 --spp {spp}"), &[&SPHERE]).json();
    assert!(names(&ball(8)["left_out"]).contains("visibility_map"));
    assert!(names(&ball(16)["kept"]).contains("visibility_map"));
    for (technique, kept, left_out) in [
        ("voxel-tags", &["cells", "voxel_tags"][..], &["visibility_map", "ward"][..]),
        ("visibility-cells", &["cells"], &["visibility_map", "voxel_tags", "ward"]),
        ("light-buffer", &["light_buffer"], &["visibility_map", "cells", "ward"]),
        // The only light of the box is always tested.
        ("ward-adaptive", &[], &["cells", "ward", "visibility_estimate"]),
        ("shadow-photons", &["visibility_map"], &["cells", "voxel_tags", "ward"]),
    ] {
        let plan = plan(&format!("--technique {technique}"));
        assert!(kept.iter().all(|part| names(&plan["kept"]).contains(part)), "{technique}");
        assert!(left_out.iter().all(|part| names(&plan["left_out"]).contains(part)), "{technique}");
    }
    // On request the still life samples a few of its lights, by zones and without a map.
    let plan = run("plan --json --sampled-lights 2 --light-sampling zones", &[&STILL_LIFE]).json();
    assert!(["light_sampling", "zones"].iter().all(|part| names(&plan["kept"]).contains(part)));
    assert!(names(&plan["left_out"]).contains("visibility_map"));
    let plan = run("plan --json --sampled-lights 2 --light-sampling power --technique two-pass", &[&STILL_LIFE]).json();
    assert!(names(&plan["kept"]).contains("light_sampling") && names(&plan["left_out"]).contains("zones"));
    assert!(names(&run("plan --json", &[&STILL_LIFE]).json()["left_out"]).contains("light_sampling"));
    let plan = run("plan --json --technique ward-adaptive", &[&STILL_LIFE]).json();
    assert!(["ward", "visibility_estimate"].iter().all(|part| names(&plan["kept"]).contains(part)));
}

/// Photons and gather rays grow with the samples; numbers that were requested grow less.
#[test]
fn the_plan_says_how_many_rays_there_are() {
    let reasons = |arguments: &str| {
        let plan = run(&format!("plan --json {arguments}"), &[&BOX]).json();
        let kept = plan["kept"].as_array().unwrap().clone();
        ["global_map", "irradiance_cache"].map(|name| {
            let item = kept.iter().find(|item| item["name"] == name).unwrap();
            item["reason"].as_str().unwrap().split(" rays").next().unwrap().to_owned()
        })
    };
    assert_eq!(reasons(""), ["4096 to 1048576", "records of 16 to 4096"]);
    assert_eq!(reasons("--spp 1"), ["4096", "records of 16"]);
    assert_eq!(reasons("--gather-rays 100"), ["65536", "records of 128"]);
    assert_eq!(reasons("--gather-rays 100 --spp 64"), ["65536 to 262144", "records of 128 to 512"]);
}

#[test]
fn the_text_says_what_the_json_says() {
    let (text, json) = (run("plan", &[&STILL_LIFE]), run("plan --json", &[&STILL_LIFE]).json());
    let (kept, left_out) = text.assert_done().stdout.split_once("\nleft out\n").unwrap();
    for (part, items) in [(kept, &json["kept"]), (left_out, &json["left_out"])] {
        for item in items.as_array().unwrap() {
            let line =
                |line: &str| ["name", "reason", "cost"].iter().all(|key| line.contains(item[key].as_str().unwrap()));
            assert!(part.lines().any(line), "{item}");
        }
    }
}

/// The film of a plan is that of the render: one more row of an image whose tiles are full takes what the plan says,
/// for all quantities that are summed. Without a denoiser it is less.
#[test]
fn the_plan_says_how_much_memory_the_image_takes() {
    let gpu = Gpu::open(&DeviceChoice::Software).unwrap();
    let scene = Scene::load(Path::new(BOX), &ImportOptions::default()).unwrap();
    // 32 rows fill a tile, so that all other buffers have the same size.
    let of = |rows: u32| -> [u64; 2] {
        let arguments = format!(
            "--device software --width 16384 --height {rows} --spp 2 --technique path --max-bounces 1 \
             --aov albedo,N,P,Z,variance"
        );
        let plan = run(&format!("plan --json {arguments}"), &[&BOX]).json();
        let memory = |name: &str, key: &str| plan["memory"][name][key].as_u64().unwrap();
        assert!(
            memory("raw", "film") < memory("denoised", "film") && memory("raw", "host") < memory("denoised", "host")
        );
        let aovs = [Aov::Albedo, Aov::Normal, Aov::Position, Aov::Depth, Aov::Variance];
        let settings = Settings::builder().technique(Technique::PATH).max_bounces(1).size(16_384, rows).spp(2);
        let settings = settings.aovs(aovs).denoise(Denoise::Statistical).build().unwrap();
        let renderer = Renderer::new(&gpu, scene.clone(), &scene.cameras[0], &settings).unwrap();
        [memory("denoised", "film"), renderer.statistics().unwrap().memory.frame]
    };
    let ([planned, frame], [more_planned, more_frame]) = (of(32), of(33));
    assert_eq!(more_planned - planned, more_frame - frame);
    // Direct and indirect light, albedo, normal, position, squares; three guides; of both parts squares and snapshots.
    assert_eq!(planned, 16_384 * 32 * (6 + 3 + 2 * 3) * 32);
}

/// Predictions are of an image of the requested samples, each by a technique that the settings allow. The noise of
/// `path`, whose samples share nothing, falls with their number. Without `--predict` no device is opened.
#[test]
fn the_plan_predicts_what_techniques_cost() {
    let plan = |arguments: &str| {
        run(&format!("plan --json --width 40 --height 30 --device software {arguments}"), &[&BOX]).json()
    };
    let of = |plan: &Value, key: &str| -> Vec<f64> {
        plan["predictions"].as_array().unwrap().iter().map(|item| item[key].as_f64().unwrap()).collect()
    };
    let (few, many) = (plan("--predict --spp 24"), plan("--predict --spp 96"));
    for (plan, spp) in [(&few, 24.0), (&many, 96.0)] {
        schema::assert_documented("Plan", plan);
        let names = plan["predictions"].as_array().unwrap().iter().map(|item| item["technique"].as_str().unwrap());
        assert_eq!(names.collect::<Vec<_>>(), ["path", "two-pass", "shadow-photons"]);
        let [first, sample, all] = ["first_sample", "sample", "all"].map(|key| of(plan, key));
        for (i, all) in all.iter().enumerate() {
            assert!(first[i] > 0.0 && sample[i] > 0.0, "{plan}");
            // What comes before sample 8 is at least as long as the first one.
            assert!(*all >= first[i] + (spp - 8.0) * sample[i], "{plan}");
        }
    }
    let (few_noise, noise) = (of(&few, "noise"), of(&many, "noise"));
    // The noise of one sample of the same small image, over either number of samples: roundings alone.
    assert!((few_noise[0] / noise[0] - 4.0).abs() < 1e-6, "{} and {}", few_noise[0], noise[0]);
    // Paths find the light of the walls one by one.
    assert!(noise[0] > 2.0 * noise[1] && noise[1] > 0.0, "{noise:?}");
    // A piece costs what its own samples cost.
    let piece = plan("--predict --spp 96 --samples 8..32");
    assert_eq!(of(&piece, "noise")[0], few_noise[0]);
    for (all, sample) in of(&piece, "all").into_iter().zip(of(&piece, "sample")) {
        assert!(all < 96.0 * sample, "{piece}");
    }
    let every_light = plan("--predict --spp 4 --light-sampling all");
    assert_eq!(of(&every_light, "all").len(), 2, "a path samples one light at a vertex: {every_light}");
    run("plan --predict --device none-such", &[&BOX]).assert_refused(4, &["none-such"]);
    run("plan --predict --noise 0.01", &[&BOX]).assert_refused(2, &["--predict", "--noise"]);
    assert_eq!(run("plan --json --device none-such", &[&BOX]).json()["predictions"], Value::Array(Vec::new()));
    // A single sample has no variance.
    let text = run("plan --predict --width 8 --height 8 --spp 1 --device software", &[&BOX]);
    let (_, predicted) = text.assert_done().stdout.split_once("\npredicted\n").unwrap();
    assert_eq!(predicted.matches("unknown").count(), 3, "{predicted}");
    let arguments = "plan --predict --width 8 --height 8 --spp 16 --samples 8..16 --device software";
    assert!(run(arguments, &[&BOX]).assert_done().stdout.contains(" 8 spp "));
}

/// The aspect ratio of the image is that of the camera: the first of the file, or the one selected by name or index.
#[test]
fn the_camera_gives_the_shape_of_the_image() {
    let folder = folder();
    let file = folder.path().join("cameras.gltf");
    let camera = |aspect: f32| {
        format!(r#"{{"type": "perspective", "perspective": {{"aspectRatio": {aspect}, "yfov": 1, "znear": 0.1}}}}"#)
    };
    let text = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0, 1]}}],
        "nodes": [{{"camera": 0, "name": "wide"}}, {{"camera": 1, "name": "tall"}}],
        "cameras": [{}, {}]}}"#,
        camera(2.5),
        camera(0.5)
    );
    fs::write(&file, text).unwrap();
    let size = |arguments: &str| {
        let settings = &run(&format!("plan --json {arguments}"), &[&file]).json()["settings"];
        [&settings["width"], &settings["height"]].map(|side| side.as_u64().unwrap())
    };
    assert_eq!(size(""), [1280, 512]);
    assert_eq!(size("--camera wide"), [1280, 512]);
    assert_eq!(size("--camera tall"), [256, 512]);
    assert_eq!(size("--camera 1"), [256, 512]);
    assert_eq!(size("--width 100"), [100, 40]);
    assert_eq!(size("--height 100"), [250, 100]);
    assert_eq!(size("--width 30 --height 20"), [30, 20]);
    assert_eq!(size("--width 1"), [1, 1]);
    // 16384 high would be 40960 wide.
    run("plan --height 16384", &[&file]).assert_refused(2, &["--width", "40960"]);
}

#[test]
fn a_scene_without_a_camera_says_so() {
    let folder = folder();
    let file = folder.path().join("nothing.gltf");
    fs::write(&file, r#"{"asset": {"version": "2.0"}}"#).unwrap();
    let plan = run("plan --json", &[&file]).json();
    let notes: Vec<_> = plan["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap()).collect();
    assert!(notes.contains(&"no camera in the scene"), "{notes:?}");
    assert_eq!(plan["scene"]["cameras"], 0);
}

#[test]
fn a_reader_that_leaves_is_no_error() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let mut child = penumbra("plan", &[&BOX]).stdout(writer).stderr(std::process::Stdio::piped()).spawn().unwrap();
    let mut stderr = String::new();
    std::io::Read::read_to_string(child.stderr.as_mut().unwrap(), &mut stderr).unwrap();
    assert_eq!((child.wait().unwrap().code(), stderr.as_str()), (Some(0), ""));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error() {
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    crate::program::Answer::of(penumbra("plan", &[&BOX]).stdout(full)).assert_refused(3, &["stdout"]);
}

#[test]
fn devices_are_listed() {
    let devices = run("devices --json", &[]).json();
    schema::assert_documented("Devices", &devices);
    let text = run("devices", &[]);
    for device in devices.as_array().unwrap() {
        assert!(text.assert_done().stdout.contains(device["name"].as_str().unwrap()), "{text:?}");
    }
}
