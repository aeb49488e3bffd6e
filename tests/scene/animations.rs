//! Animations: what they move and when, and the errors of malformed ones.

use glam::{DVec3, Vec3};
use penumbra::Error;
use penumbra::internal::scene::{ImportOptions, LightKind, Projection, Scene};
use serde_json::{Value, json};

use crate::bad_input::refused_at;
use crate::builder::{F32, File, I16, U8, U32, bytes_of, world};

/// Where the only channel of a file is.
const CHANNEL: &str = "/animations/0/channels/0";

/// Adds an animation of one channel with those keys, and returns its index.
fn animate<const N: usize>(file: &mut File, times: &[f32], values: &[[f32; N]], mode: &str, target: Value) -> usize {
    let times: Vec<[f32; 1]> = times.iter().map(|time| [*time]).collect();
    let (input, output) = (file.floats(&times), file.floats(values));
    let sampler = json!({ "input": input, "output": output, "interpolation": mode });
    file.add("animations", json!({ "samplers": [sampler], "channels": [{ "sampler": 0, "target": target }] }))
}

fn pointer(pointer: &str) -> Value {
    json!({ "path": "pointer", "extensions": { "KHR_animation_pointer": { "pointer": pointer } } })
}

fn at(time: f64) -> ImportOptions {
    ImportOptions { time: Some(time), ..Default::default() }
}

fn load(file: &File, time: f64) -> Scene {
    file.load_with(&at(time)).unwrap_or_else(|e| panic!("{e}"))
}

/// Where the origin of the triangle is. The first corner of the triangle is its origin.
fn origin(scene: &Scene) -> DVec3 {
    DVec3::from(world(scene)[0][0])
}

/// Positions are f32, of size 1 in normalised space and below 16 in the world.
const ROUNDING: f64 = 2e-6;

#[test]
fn keys_hold_step_and_interpolate() {
    // Keys at 1, 2 and 4 s; the last mode has tangents before and after each value.
    let keys = [[0f32, 0., 0.], [4., 0., 2.], [4., 8., 2.]];
    let (before, after) = ([1f32, 2., 0.], [-1f32, 0., 3.]);
    let spline: Vec<[f32; 3]> = keys.iter().flat_map(|key| [before, *key, after]).collect();
    let expected = |mode: &str, time: f64| -> DVec3 {
        let [a, b, c] = keys.map(|key| Vec3::from(key).as_dvec3());
        let (from, to, start, span) = if time < 2.0 { (a, b, 1.0, 1.0) } else { (b, c, 2.0, 2.0) };
        let t = (time - start) / span;
        match mode {
            _ if time <= 1.0 => a,
            _ if time >= 4.0 => c,
            "STEP" => from,
            "LINEAR" => from + t * (to - from),
            _ => {
                // The cubic of Bezier, whose inner points lie a third of the span along the tangents.
                let third = span / 3.0;
                let inner = [from + third * Vec3::from(after).as_dvec3(), to - third * Vec3::from(before).as_dvec3()];
                let u = 1.0 - t;
                from * u.powi(3) + inner[0] * 3.0 * u * u * t + inner[1] * 3.0 * u * t * t + to * t.powi(3)
            }
        }
    };
    for mode in ["STEP", "LINEAR", "CUBICSPLINE"] {
        let mut file = File::triangle();
        let values = if mode == "CUBICSPLINE" { spline.clone() } else { keys.to_vec() };
        animate(&mut file, &[1., 2., 4.], &values, mode, json!({ "node": 0, "path": "translation" }));
        for time in [-1.0, 0.0, 1.0, 1.25, 1.999, 2.0, 3.0, 3.5, 4.0, 1e9] {
            let found = origin(&load(&file, time));
            assert!(found.distance(expected(mode, time)) < ROUNDING, "{mode} at {time}: {found}");
        }
        // The animation repeats after its last key, also before its beginning.
        for (time, same) in [(5.5, 1.5), (-0.5, 3.5), (400.25, 0.25), (4.0, 0.0)] {
            let scene = file.load_with(&ImportOptions { repeat: true, ..at(time) }).unwrap();
            assert!(origin(&scene).distance(expected(mode, same)) < ROUNDING, "{mode} at {time}");
        }
        // Without a time the file's own pose is shown, with a note.
        let still = file.load();
        assert_eq!(origin(&still), DVec3::ZERO);
        assert!(still.notes.iter().any(|note| note.contains("the animation is not played")), "{:?}", still.notes);
    }
}

#[test]
fn rotations_turn_at_constant_speed_the_shorter_way() {
    // From 0 to 90 degrees about z, written as its negative: a third of the time is 30 degrees.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let keys = [[0f32, 0., 0., 1.], [0., 0., -half, -half]];
    let mut file = File::triangle();
    animate(&mut file, &[0., 3.], &keys, "LINEAR", json!({ "node": 0, "path": "rotation" }));
    for (time, degrees) in [(1.0f64, 30f64), (1.5, 45.0), (2.0, 60.0)] {
        let corner = DVec3::from(world(&load(&file, time))[0][1]);
        let expected = 4.0 * DVec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), 0.0);
        assert!(corner.distance(expected) < ROUNDING, "{time}: {corner} for {expected}");
    }
    // As normalised shorts: a component is off by 3e-5, an angle by twice that, and the corner by 4 times the angle.
    let shorts: Vec<u8> = keys.iter().flatten().flat_map(|x| ((x * 32767.0) as i16).to_le_bytes()).collect();
    let output = file.accessor(&shorts, I16, "VEC4", 2);
    file.json["accessors"][output]["normalized"] = json!(true);
    file.json["animations"][0]["samplers"][0]["output"] = json!(output);
    let corner = DVec3::from(world(&load(&file, 1.5))[0][1]);
    assert!(corner.distance(8f64.sqrt() * DVec3::new(1.0, 1.0, 0.0)) < 2.5e-4, "{corner}");
}

#[test]
fn animations_are_selected_by_name_or_index() {
    let mut file = File::triangle();
    for (x, name) in [(1f32, "trot"), (2., "run"), (3., "0")] {
        let index = animate(&mut file, &[0.], &[[x, 0., 0.]], "STEP", json!({ "node": 0, "path": "translation" }));
        file.json["animations"][index]["name"] = json!(name);
    }
    let with = |name: &str| file.load_with(&ImportOptions { animation: Some(name.into()), ..at(0.0) });
    for (name, expected) in [("run", 2.0), ("1", 2.0), ("0", 3.0), ("trot", 1.0)] {
        assert_eq!(origin(&with(name).unwrap()).x, expected, "{name}");
    }
    assert_eq!(origin(&load(&file, 0.0)).x, 1.0, "the first one by default");
    for name in ["jump", "3"] {
        let error = with(name).unwrap_err();
        assert!(matches!(&error, Error::Usage(text) if text.contains("trot, run, 0")), "{error}");
    }
    for (file, time) in [(&File::triangle(), 0.0), (&file, f64::NAN)] {
        let error = file.load_with(&at(time)).unwrap_err();
        assert!(matches!(&error, Error::Setting { name: "time", .. }), "{error}");
    }
}

/// A file with a camera, a spot light and a material, all at node 1.
fn stage() -> File {
    let mut file = File::triangle();
    let lens = json!({ "yfov": 0.5, "znear": 0.25 });
    file.add("cameras", json!({ "type": "perspective", "perspective": lens }));
    let spot = json!({ "type": "spot", "spot": { "outerConeAngle": 0.5 }, "intensity": 2.0 });
    file.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [spot] } });
    let light = json!({ "KHR_lights_punctual": { "light": 0 } });
    file.add("nodes", json!({ "camera": 0, "translation": [0, 0, 8], "extensions": light }));
    file.add("materials", json!({ "pbrMetallicRoughness": { "metallicFactor": 0.0 } }));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    file
}

#[test]
fn cameras_and_lights_move_with_their_nodes() {
    let mut file = stage();
    let target = json!({ "node": 1, "path": "translation" });
    animate(&mut file, &[0., 1.], &[[0., 0., 8.], [2., 4., 8.]], "LINEAR", target);
    let scene = load(&file, 0.5);
    let expected = scene.normalisation.apply(DVec3::new(1.0, 2.0, 8.0));
    assert_eq!(scene.cameras[0].position, expected);
    let LightKind::Spot { position, .. } = scene.lights[0].kind else { panic!("{:?}", scene.lights) };
    assert_eq!(position, expected);
}

#[test]
fn pointers_move_cameras_lights_and_materials() {
    let light = "/extensions/KHR_lights_punctual/lights/0";
    let load = |target: &str, values: &[[f32; 1]]| {
        let mut file = stage();
        animate(&mut file, &[0., 1.], values, "LINEAR", pointer(target));
        load(&file, 0.5)
    };
    let scene = load("/cameras/0/perspective/yfov", &[[0.5], [1.0]]);
    assert_eq!(scene.cameras[0].projection, Projection::Perspective { yfov: 0.75, aspect: None });
    let strength = |scene: &Scene| match &scene.lights[0].kind {
        LightKind::Spot { intensity, cos_inner, .. } => (intensity.x, *cos_inner),
        other => panic!("{other:?}"),
    };
    let still = strength(&stage().load());
    assert_eq!(strength(&load(&format!("{light}/intensity"), &[[2.0], [6.0]])).0, 2.0 * still.0);
    let (_, inner) = strength(&load(&format!("{light}/spot/innerConeAngle"), &[[0.0], [0.5]]));
    // An angle and its cosine in f32, each rounded by less than 6e-8.
    assert!((inner - 0.25f32.cos()).abs() < 1e-6 && still.1 == 1.0, "{inner}");
    let pbr = "/materials/0/pbrMetallicRoughness";
    assert_eq!(load(&format!("{pbr}/roughnessFactor"), &[[0.25], [0.5]]).materials[0].roughness, 0.375);
    // Beyond its range a value is limited to it, as splines may leave that of their keys.
    assert_eq!(load(&format!("{pbr}/metallicFactor"), &[[1.0], [2.0]]).materials[0].metallic, 1.0);
    let coat = "/materials/0/extensions/KHR_materials_clearcoat/clearcoatFactor";
    assert_eq!(load(coat, &[[0.0], [1.0]]).materials[0].clearcoat.factor, 0.5);

    let mut file = stage();
    let colour = pointer("/materials/0/pbrMetallicRoughness/baseColorFactor");
    animate(&mut file, &[0., 1.], &[[0f32, 0., 1., 1.], [1., 0., 0., 1.]], "LINEAR", colour);
    assert_eq!(file.load_with(&at(0.5)).unwrap().materials[0].base_colour, glam::Vec4::new(0.5, 0.0, 0.5, 1.0));

    // A property that import does not support gives a note, if the animation is played.
    let target = "/materials/0/extensions/ACME_glow/power";
    let noted = |scene: &Scene| scene.notes.iter().any(|note| note.contains(target));
    assert!(noted(&load(target, &[[0.0], [1.0]])));
    let mut file = stage();
    animate(&mut file, &[0.], &[[0f32]], "LINEAR", pointer(target));
    assert!(!noted(&file.load()));
}

/// Each fault is found whether the animation is played or not.
#[test]
fn malformed_animations_are_refused() {
    let refused = |edit: &dyn Fn(&mut File)| {
        let mut file = File::triangle();
        let keys = [[0f32, 0., 0.], [1., 0., 0.]];
        animate(&mut file, &[0., 1.], &keys, "LINEAR", json!({ "node": 0, "path": "translation" }));
        file.load();
        edit(&mut file);
        refused_at(&file)
    };
    const SAMPLER: &str = "/animations/0/samplers/0";
    let input =
        |f: &mut File, times: &[[f32; 1]]| f.json["animations"][0]["samplers"][0]["input"] = json!(f.floats(times));
    for times in [[-1.0, 1.0], [0.0, 0.0], [1.0, 0.5], [0.0, f32::NAN], [0.0, f32::INFINITY]] {
        assert_eq!(refused(&|f| input(f, &times.map(|t| [t]))), format!("{SAMPLER}/input"), "{times:?}");
    }
    assert_eq!(refused(&|f| input(f, &[[0.0], [1.0], [2.0]])), format!("{CHANNEL}/sampler"));
    let set = |f: &mut File, pointer: &str, value: Value| *f.json.pointer_mut(pointer).unwrap() = value;
    let integers = |f: &mut File| {
        let times = f.accessor(&[0, 0, 0, 0, 1, 0, 0, 0], U32, "SCALAR", 2);
        set(f, "/animations/0/samplers/0/input", json!(times));
    };
    assert_eq!(refused(&integers), format!("{SAMPLER}/input"));
    assert_eq!(refused(&|f| set(f, "/animations/0/samplers/0/input", json!(9))), format!("{SAMPLER}/input"));
    assert_eq!(refused(&|f| set(f, "/animations/0/samplers/0/output", json!(9))), format!("{SAMPLER}/output"));
    let wrong = json!("SPHERICAL");
    assert_eq!(
        refused(&|f| set(f, "/animations/0/samplers/0/interpolation", wrong.clone())),
        format!("{SAMPLER}/interpolation")
    );
    // As a spline it needs three times as many values.
    let spline = json!("CUBICSPLINE");
    assert_eq!(
        refused(&|f| set(f, "/animations/0/samplers/0/interpolation", spline.clone())),
        format!("{CHANNEL}/sampler")
    );
    let output = |f: &mut File, bytes: &[u8], component: u32, kind: &str| {
        let output = f.accessor(bytes, component, kind, 2);
        set(f, "/animations/0/samplers/0/output", json!(output));
    };
    assert_eq!(refused(&|f| output(f, &[0; 32], F32, "VEC4")), format!("{CHANNEL}/sampler"));
    assert_eq!(refused(&|f| output(f, &[0; 16], I16, "VEC3")), format!("{CHANNEL}/sampler"));
    let nan = bytes_of(&[[0f32, 0., 0.], [0., f32::NAN, 0.]]);
    assert_eq!(refused(&|f| output(f, &nan, F32, "VEC3")), format!("{SAMPLER}/output"));
    let long = bytes_of(&[[0f32, 0., 0., 1.], [0., 1., 0., 1.]]);
    let rotation = |f: &mut File| {
        output(f, &long, F32, "VEC4");
        set(f, "/animations/0/channels/0/target/path", json!("rotation"));
    };
    assert_eq!(refused(&rotation), format!("{CHANNEL}/sampler"));
    // Targets.
    assert_eq!(
        refused(&|f| set(f, "/animations/0/channels/0/target/node", json!(1))),
        format!("{CHANNEL}/target/node")
    );
    assert_eq!(refused(&|f| set(f, "/animations/0/channels/0/sampler", json!(1))), format!("{CHANNEL}/sampler"));
    assert_eq!(
        refused(&|f| set(f, "/animations/0/channels/0/target/path", json!("weights"))),
        format!("{CHANNEL}/target")
    );
    let matrix = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    assert_eq!(refused(&|f| f.json["nodes"][0]["matrix"] = matrix.clone()), format!("{CHANNEL}/target"));
    let twice = |f: &mut File| {
        let channels = f.json["animations"][0]["channels"].as_array_mut().unwrap();
        channels.push(channels[0].clone());
    };
    assert_eq!(refused(&twice), format!("{CHANNEL}/target"));
    for key in ["channels", "samplers"] {
        assert_eq!(refused(&|f| f.json["animations"][0][key] = json!([])), format!("/animations/0/{key}"));
    }
    let at = format!("{CHANNEL}/target/extensions/KHR_animation_pointer/pointer");
    for wrong in ["nodes/0/scale", "/nodes/7/scale", "/materials/0/alphaCutoff"] {
        let edit = |f: &mut File| set(f, "/animations/0/channels/0/target", pointer(wrong));
        assert_eq!(refused(&edit), at, "{wrong}");
    }
}

/// A file has its times as f32; a frame at the time of a key shows the key.
#[test]
fn steps_are_not_late_by_a_rounding() {
    for frame in 1..24 {
        let time = f64::from(frame) / 24.0;
        let mut file = File::triangle();
        let target = json!({ "node": 0, "path": "translation" });
        animate(&mut file, &[0., time as f32], &[[0f32; 3], [1., 0., 0.]], "STEP", target);
        assert_eq!(origin(&load(&file, time)).x, 1.0, "frame {frame}");
        // A microsecond is more than the rounding of a time below 1 s to f32, which is 3e-8 s.
        assert_eq!(origin(&load(&file, time - 1e-6)).x, 0.0, "frame {frame}");
    }
}

/// The file, with an animation of a pointer whose values are plain bytes, at 0, 1 and 2 s.
fn with_bytes(mut file: File, target: &str, values: [u8; 3], mode: &str) -> File {
    animate(&mut file, &[0., 1., 2.], &[[0f32]; 3], mode, pointer(target));
    let output = file.accessor(&values, U8, "SCALAR", 3);
    file.json["animations"][0]["samplers"][0]["output"] = json!(output);
    file
}

/// Any byte but 0 shows a node. There is nothing between shown and hidden.
#[test]
fn nodes_appear_and_vanish() {
    const VISIBLE: &str = "/nodes/0/extensions/KHR_node_visibility/visible";
    let mut file = with_bytes(File::triangle(), VISIBLE, [0, 2, 0], "STEP");
    // Only a transform cannot be animated beside a matrix.
    file.json["nodes"][0]["matrix"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    for (time, triangles) in [(0.0, 0), (0.999, 0), (1.0, 1), (1.999, 1), (2.0, 0)] {
        let scene = load(&file, time);
        assert_eq!(scene.triangles.len(), triangles, "{time}");
        assert!(!scene.notes.iter().any(|note| note.contains("not played")), "{:?}", scene.notes);
    }
    let mut normalised = with_bytes(File::triangle(), VISIBLE, [0, 2, 0], "STEP");
    normalised.json["accessors"].as_array_mut().unwrap().last_mut().unwrap()["normalized"] = json!(true);
    let mut floats = File::triangle();
    animate(&mut floats, &[0., 1.], &[[0f32], [1.]], "STEP", pointer(VISIBLE));
    for file in [with_bytes(File::triangle(), VISIBLE, [0, 1, 0], "LINEAR"), normalised, floats] {
        assert_eq!(refused_at(&file), format!("{CHANNEL}/sampler"));
    }
}

/// By a pointer, integers that are not normalised are the numbers themselves, and are interpolated as such.
#[test]
fn pointers_lead_to_whole_numbers() {
    let target = "/extensions/KHR_lights_punctual/lights/0/intensity";
    let file = with_bytes(stage(), target, [1, 3, 2], "LINEAR");
    let intensity = |scene: &Scene| match scene.lights[0].kind {
        LightKind::Spot { intensity, .. } => intensity.x,
        ref other => panic!("{other:?}"),
    };
    // That of the stage is 2.
    let one = intensity(&stage().load()) / 2.0;
    for (time, expected) in [(0.0, 1.0), (0.5, 2.0), (1.0, 3.0), (1.5, 2.5)] {
        assert_eq!(intensity(&load(&file, time)), expected * one, "{time}");
    }
}

/// Properties of an unknown extension are noted, and none is refused.
#[test]
fn animations_of_unknown_properties_are_noted() {
    let file = with_bytes(File::triangle(), "/nodes/0/extensions/ACME_switch/on", [0, 1, 1], "STEP");
    assert!(load(&file, 1.0).notes.iter().any(|note| note.contains("ACME_switch/on\" is not played")));
}

/// A channel without a node is for extensions, and is left out.
#[test]
fn a_channel_without_a_node_moves_nothing() {
    let mut file = File::triangle();
    animate(&mut file, &[0.], &[[5f32, 0., 0.]], "LINEAR", json!({ "path": "translation" }));
    assert_eq!(origin(&load(&file, 0.0)), DVec3::ZERO);
}

/// A thousand samplers over the same long keys are checked once each accessor, and their sum is limited.
#[test]
fn shared_keys_are_checked_once() {
    let mut file = File::triangle();
    let count = 1 << 17;
    let times: Vec<[f32; 1]> = (0..count).map(|i| [i as f32]).collect();
    let (input, output) = (file.floats(&times), file.floats(&vec![[0f32; 3]; count]));
    let samplers = vec![json!({ "input": input, "output": output }); 1000];
    let channels: Vec<Value> =
        (0..1000).map(|i| json!({ "sampler": i, "target": { "node": i, "path": "scale" } })).collect();
    file.json["nodes"] = json!(vec![json!({ "mesh": 0 }); 1000]);
    file.json["animations"] = json!([{ "samplers": samplers, "channels": channels }]);
    assert_eq!(file.load().triangles.len(), 1000);
    // As many accessors of their own over the same bytes.
    let accessor = file.json["accessors"][output].clone();
    for i in 0..1000 {
        let index = file.add("accessors", accessor.clone());
        file.json["animations"][0]["samplers"][i]["output"] = json!(index);
    }
    let error = file.load_with(&ImportOptions::default()).unwrap_err();
    assert!(error.to_string().contains("keys and values"), "{error}");
}
