//! `penumbra render` at the limits of its input, with the technique that it takes by itself: views of nothing, one
//! pixel, one sample, no light, an environment alone, a hundred thousand lights.

use std::f64::consts::PI;
use std::fs;
use std::path::{Path, PathBuf};

use penumbra::Image;
use serde_json::{Value, json};

use crate::program::{Answer, BOX, device, folder, lacks, run};

/// Albedo of the wall, and its radiance under the irradiance pi or in an environment of radiance 1.
const ALBEDO: f64 = 0.5;

/// Relative error of an image without noise: its values are rounded to f32 some tens of times.
const ROUNDING: f64 = 1e-5;

/// The light of all suns, with the irradiance that each gives to a surface perpendicular to its rays.
fn suns(irradiance: f64) -> Value {
    json!([{ "type": "directional", "intensity": irradiance }])
}

/// The node of a sun, turned about the Y axis.
fn sun(degrees: f64) -> Value {
    let half = 0.5 * degrees.to_radians();
    json!({ "rotation": [0.0, half.sin(), 0.0, half.cos()], "extensions": { "KHR_lights_punctual": { "light": 0 } } })
}

/// The node of the camera.
fn eye(position: [f64; 3]) -> Value {
    json!({ "camera": 0, "translation": position })
}

/// A Lambertian wall of 2 m x 2 m around the origin that faces +Z, and a camera that looks along -Z. From 1 m away the
/// wall fills its view.
fn wall(folder: &Path, lights: &Value, nodes: Vec<Value>) -> PathBuf {
    let (scene, buffer) = (folder.join("wall.gltf"), folder.join("wall.bin"));
    let corners = [[-1f32, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]];
    let triangles = [0, 1, 2, 0, 2, 3].map(|i: usize| corners[i]);
    fs::write(&buffer, triangles.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
    let nodes: Vec<Value> = [json!({ "mesh": 0 })].into_iter().chain(nodes).collect();
    let document = json!({
        "asset": { "version": "2.0" },
        "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_specular"],
        "extensions": { "KHR_lights_punctual": { "lights": lights } },
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "cameras": [{ "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1, "zfar": 1000 } }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "material": 0 }] }],
        "materials": [{
            "pbrMetallicRoughness": { "baseColorFactor": [ALBEDO, ALBEDO, ALBEDO, 1], "metallicFactor": 0 },
            "extensions": { "KHR_materials_specular": { "specularFactor": 0 } }
        }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3", "min": [-1, -1, 0], "max": [1, 1, 0] }
        ],
        "bufferViews": [{ "buffer": 0, "byteLength": 72 }],
        "buffers": [{ "uri": "wall.bin", "byteLength": 72 }]
    });
    fs::write(&scene, document.to_string()).unwrap();
    scene
}

/// A finished render.
struct Rendered {
    answer: Answer,
    image: Image,
    statistics: Value,
}

impl Rendered {
    /// Renders to an EXR and a PNG, both of the requested shape.
    #[track_caller]
    fn new(folder: &Path, scene: &Path, arguments: &str) -> Rendered {
        let [exr, png, stats] = ["a.exr", "a.png", "a.json"].map(|name| folder.join(name));
        let arguments = format!("render --device {} {arguments} -o", device());
        let answer = run(&arguments, &[&exr, &"-o", &png, &"--stats", &stats, &scene]);
        answer.assert_done();
        let image = Image::read(&exr).unwrap();
        assert_eq!(image::image_dimensions(&png).unwrap(), (image.width, image.height));
        Rendered { answer, image, statistics: serde_json::from_slice(&fs::read(&stats).unwrap()).unwrap() }
    }

    /// The notes, which are printed and kept in the statistics.
    fn notes(&self) -> Vec<&str> {
        let notes: Vec<&str> =
            self.statistics["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap()).collect();
        let said: Vec<&str> = self.answer.stderr.lines().filter_map(|line| line.strip_prefix("note: ")).collect();
        assert_eq!(notes, said);
        notes
    }

    /// The notes that the image shows nothing.
    fn notes_on_nothing(&self) -> Vec<&str> {
        let is_on_nothing = |note: &&str| note.starts_with("the camera sees") || note.starts_with("the image is");
        self.notes().into_iter().filter(is_on_nothing).collect()
    }

    /// Every value of the channels is `expected`, with an absolute error of `tolerance` at most.
    #[track_caller]
    fn assert_is(&self, channels: &[&str], expected: f64, tolerance: f64) {
        for name in channels {
            let values = self.image.channel(name).unwrap_or_else(|| panic!("{name} is missing"));
            let worst = values.iter().map(|x| (f64::from(*x) - expected).abs()).fold(0.0, f64::max);
            assert!(worst <= tolerance, "{name} is off by {worst} from {expected}: {:?}", self.answer);
        }
    }

    #[track_caller]
    fn assert_technique(&self, technique: &str) {
        assert_eq!(self.statistics["settings"]["technique"], technique, "{:?}", self.answer);
        let is_path = technique == "path";
        let gives_reason = self.notes().iter().any(|note| note.starts_with("using --technique path, because photons"));
        assert_eq!(gives_reason, is_path, "{:?}", self.answer);
    }

    /// The technique of a render without time for photons: a GPU has it always.
    #[track_caller]
    fn assert_technique_of_no_time(&self) {
        let is_software = self.statistics["device"]["kind"] == "software";
        self.assert_technique(if is_software { "path" } else { "shadow-photons" });
    }
}

const RGB: [&str; 3] = ["R", "G", "B"];

/// If the camera misses everything, a note says so with the reason, before the render and in the plan, and the image is
/// empty.
#[test]
fn a_camera_that_sees_nothing_says_why() {
    let folder = folder();
    let beyond = "the camera sees nothing: all of the scene is beyond its zfar of 1000";
    let missed = "the camera sees nothing: no ray from it has met a surface";
    for (position, reason) in [([0.0, 0.0, 2000.0], beyond), ([90.0, 0.0, 1.0], missed)] {
        let scene = wall(folder.path(), &suns(PI), vec![eye(position), sun(0.0)]);
        for (arguments, is_late) in [("--spp 2", false), ("--time 60 --spp 2", false), ("--time 0.001", true)] {
            let rendered = Rendered::new(folder.path(), &scene, &format!("--width 8 --height 8 {arguments}"));
            assert_eq!(rendered.notes_on_nothing(), [reason], "{arguments}");
            rendered.assert_is(&["R", "G", "B", "A", "denoised.R"][..if is_late { 4 } else { 5 }], 0.0, 0.0);
            assert_eq!(rendered.statistics["points"]["total"], 0);
            match is_late {
                true => rendered.assert_technique_of_no_time(),
                false => rendered.assert_technique("shadow-photons"),
            }
        }
        // A part of an image may well be empty.
        let cropped = Rendered::new(folder.path(), &scene, "--width 8 --height 8 --crop 0,0,4,4 --spp 1");
        assert_eq!(cropped.notes_on_nothing().is_empty(), reason == missed);
        let plan = run("plan --json", &[&scene]).json();
        assert_eq!(plan["notes"].as_array().unwrap().iter().any(|note| note == beyond), reason == beyond, "{plan}");
    }
}

/// A wall that is lit from behind is black, and a note says so; a lit wall has no such note.
#[test]
fn a_camera_in_the_dark_says_so() {
    let folder = folder();
    let render = |degrees: f64, arguments: &str| {
        let scene = wall(folder.path(), &suns(PI), vec![eye([0.0, 0.0, 1.0]), sun(degrees)]);
        Rendered::new(folder.path(), &scene, &format!("--width 8 --height 8 {arguments}"))
    };
    for arguments in ["--spp 2", "--time 0.001"] {
        let dark = render(180.0, arguments);
        dark.assert_is(&RGB, 0.0, 0.0);
        dark.assert_is(&["A"], 1.0, 0.0);
        assert_eq!(dark.notes_on_nothing(), ["the image is black: no sample has found light"]);
    }
    let lit = render(0.0, "--spp 2");
    lit.assert_is(&RGB, ALBEDO, ROUNDING);
    assert!(lit.notes_on_nothing().is_empty());
}

/// One pixel of one sample is rendered, denoised and written.
#[test]
fn one_pixel_of_one_sample() {
    let folder = folder();
    let scene = wall(folder.path(), &suns(PI), vec![eye([0.0, 0.0, 1.0]), sun(0.0)]);
    let render = |arguments: &str| {
        let rendered = Rendered::new(folder.path(), &scene, &format!("--width 1 --height 1 {arguments}"));
        assert_eq!(rendered.image.pixels(), 1);
        rendered.assert_is(&RGB, ALBEDO, ROUNDING);
        rendered.assert_is(&["A"], 1.0, 0.0);
        assert_eq!((&rendered.statistics["samples"], &rendered.statistics["rays"]["camera"]), (&1.into(), &1.into()));
        rendered
    };
    for arguments in ["--spp 1", "--time 60 --spp 1"] {
        let rendered = render(arguments);
        rendered.assert_technique("shadow-photons");
        rendered.assert_is(&["denoised.R", "denoised.G", "denoised.B"], ALBEDO, ROUNDING);
        let unknown = "error unknown: it cannot be estimated from a single sample";
        assert!(rendered.answer.stderr.contains(unknown), "{:?}", rendered.answer);
    }
    render("--samples 0..1").assert_technique("shadow-photons");
    render("--time 0.001").assert_technique_of_no_time();
}

/// An image that no memory can hold is refused before the render begins.
#[test]
fn an_image_that_does_not_fit_the_memory() {
    // The sums of thirteen quantities in 32 bytes, 24 channels in 4, and what denoisers take.
    let needed = 16_384 * 16_384 * (13 * 32 + 24 * 4);
    if !lacks(needed) {
        return;
    }
    let folder = folder();
    let output = folder.path().join("a.exr");
    let aovs = "--aov direct,indirect,albedo,N,P,Z,variance,samples";
    let render = format!("render --device {} --width 16384 --height 16384 --denoise statistical {aovs} -o", device());
    let answer = run(&render, &[&output, &BOX]);
    let size = "an image of 16384 x 16384 pixels needs at least ";
    answer.assert_refused(1, &[size, "GB are available", "--width", "--crop", "fewer --aov", "--denoise none"]);
    let stated = answer.stderr.split_once(size).and_then(|(_, rest)| rest.split(' ').next()?.parse::<f64>().ok());
    assert!(stated.is_some_and(|gigabytes| gigabytes * 1e9 >= needed as f64), "{answer:?}");
    assert!(!output.exists());
}

/// Light of any scale has its variance, which is proportional to the scale's square, until squares leave the range of
/// single precision: then a note says so, and only if something depends on it.
#[test]
fn light_too_dim_for_its_variance() {
    let folder = folder();
    let render = |scale: f64, arguments: &str| {
        let common = "--width 16 --height 16 --spp 8 --technique two-pass --max-bounces 0";
        Rendered::new(folder.path(), BOX.as_ref(), &format!("{common} --light-scale {scale:e} {arguments}"))
    };
    let sum = |rendered: &Rendered, name: &str| -> f64 {
        rendered.image.channel(name).unwrap().iter().map(|x| f64::from(*x)).sum()
    };
    let is_noted = |rendered: &Rendered| rendered.notes().iter().any(|note| note.contains("the channel variance"));
    let bright = render(1.0, "--aov variance");
    // Powers of two change no digits.
    let dim = render(2f64.powi(-40), "--aov variance");
    assert!(!is_noted(&bright) && !is_noted(&dim));
    let ratio = |name: &str| sum(&dim, name) / sum(&bright, name);
    assert!((ratio("R") * 2f64.powi(40) - 1.0).abs() < ROUNDING, "{}", ratio("R"));
    assert!((ratio("variance.R") * 2f64.powi(80) - 1.0).abs() < ROUNDING, "{}", ratio("variance.R"));
    let dimmest = render(2f64.powi(-80), "--aov variance");
    assert!(is_noted(&dimmest) && sum(&dimmest, "variance.R") == 0.0 && sum(&dimmest, "R") > 0.0);
    // The PNG is denoised.
    assert!(is_noted(&render(2f64.powi(-80), "")) && !is_noted(&render(2f64.powi(-80), "--denoise none")));
}

/// A black image says what made it black.
#[test]
fn lights_that_are_scaled_to_nothing_or_beyond_all_numbers() {
    let folder = folder();
    let render =
        |scale: &str| Rendered::new(folder.path(), BOX.as_ref(), &format!("--width 16 --height 16 --spp 1 {scale}"));
    let notes = |rendered: &Rendered| rendered.notes_on_nothing().join("; ");
    assert_eq!(notes(&render("--light-scale 0")), "the image is black: --light-scale is 0");
    let beyond = render("--light-scale 1e38");
    assert_eq!(notes(&beyond), "");
    assert!(beyond.notes().iter().any(|note| note.contains("infinite or not a number")), "{:?}", beyond.answer);
}

/// Without a light the image is black, and the note is on the cause.
#[test]
fn no_light_at_all() {
    let folder = folder();
    let scene = wall(folder.path(), &suns(PI), vec![eye([0.0, 0.0, 1.0])]);
    for arguments in ["--spp 2", "--time 60 --spp 2", "--time 0.001"] {
        let rendered = Rendered::new(folder.path(), &scene, &format!("--width 8 --height 8 {arguments}"));
        rendered.assert_is(&RGB, 0.0, 0.0);
        rendered.assert_is(&["A"], 1.0, 0.0);
        assert_eq!(rendered.statistics["scene"]["lights"], 0);
        assert!(rendered.notes().contains(&"no light in the file: --default-light adds one"));
        assert!(rendered.notes_on_nothing().is_empty());
    }
}

/// In an environment of radiance 1 that is the only light, a wall shows its albedo.
#[test]
fn an_environment_alone() {
    let folder = folder();
    let scene = wall(folder.path(), &suns(PI), vec![eye([0.0, 0.0, 1.0])]);
    let sky = folder.path().join("sky.exr");
    let mut panorama = Image::new(4, 2);
    RGB.into_iter().for_each(|name| panorama.add_channel(name, vec![1.0; 8]));
    panorama.write_exr(&sky).unwrap();
    for arguments in ["--spp 64", "--time 60 --spp 64"] {
        let arguments = format!("--width 8 --height 8 {arguments} --environment {}", sky.display());
        let rendered = Rendered::new(folder.path(), &scene, &arguments);
        rendered.assert_technique("shadow-photons");
        rendered.assert_is(&["A"], 1.0, 0.0);
        // Pixels of 64 samples deviate by 0.0017: this is nearly ten times as much.
        rendered.assert_is(&RGB, ALBEDO, 0.016);
        assert_eq!(rendered.statistics["scene"]["lights"], 1);
        assert!(rendered.notes_on_nothing().is_empty());
    }
}

/// Adaptive shadow testing adds all lights at once. On lavapipe 100 of them with 1,024 light points each are more
/// iterations than an invocation has, which would end without an error and lose light.
#[test]
fn too_many_lights_for_adaptive_shadow_testing() {
    let folder = folder();
    let render = |samples: u32| {
        let nodes = std::iter::repeat_n(sun(0.0), 100).chain([eye([0.0, 0.0, 1.0])]).collect();
        let scene = wall(folder.path(), &suns(PI / 100.0), nodes);
        let arguments = format!(
            "render --device {} --width 16 --height 16 --spp 1 --technique ward-adaptive --shadow-samples {samples} \
             --max-bounces 0 -o",
            device()
        );
        run(&arguments, &[&folder.path().join("a.exr"), &scene])
    };
    render(64).assert_done();
    let answer = render(1024);
    if device() == "software" {
        answer.assert_refused(2, &["all 100 lights at once", "--shadow-samples", "--technique"]);
    } else {
        answer.assert_done();
    }
}

/// A hundred thousand suns, every second one at 60 degrees, together give the irradiance pi. A few of them are sampled
/// at each point, so that there is time for photons.
#[test]
fn a_hundred_thousand_lights() {
    const LIGHTS: usize = 100_000;
    let folder = folder();
    // The mean cosine is 0.75.
    let lights = suns(PI / (0.75 * LIGHTS as f64));
    let places = [sun(0.0), sun(60.0)];
    let nodes = places.iter().cycle().take(LIGHTS).cloned().chain([eye([0.0, 0.0, 1.0])]).collect();
    let scene = wall(folder.path(), &lights, nodes);
    for (arguments, technique) in [
        ("--spp 4", "shadow-photons"),
        ("--time 60 --spp 4", "shadow-photons"),
        ("--spp 4 --technique path", "path"),
        // It evaluates all lights: more in one invocation than lavapipe has iterations.
        ("--spp 1 --technique negative-photons --crop 0,0,8,8", "negative-photons"),
    ] {
        let rendered = Rendered::new(folder.path(), &scene, &format!("--width 64 --height 64 {arguments}"));
        assert_eq!(rendered.statistics["scene"]["lights"], LIGHTS);
        assert_eq!(rendered.statistics["settings"]["technique"], technique, "{:?}", rendered.answer);
        // Each has a position, a direction and a colour of 4 bytes a number.
        assert!(rendered.statistics["memory"]["scene"].as_u64().unwrap() >= 36 * LIGHTS as u64, "{arguments}");
        let values = rendered.image.channel("G").unwrap();
        let mean = values.iter().map(|x| f64::from(*x)).sum::<f64>() / values.len() as f64;
        // Paths sample one light for each of 16,384 samples, whose contributions deviate by a third of their mean: the
        // standard error is 0.26 %.
        assert!((mean / ALBEDO - 1.0).abs() < 0.01, "{arguments}: {mean} for {ALBEDO}");
    }
}
