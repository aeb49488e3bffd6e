//! Skins and morph targets: closed forms, and the errors of malformed ones.

use glam::{DVec3, Vec3, Vec4};
use penumbra::internal::scene::{ImportOptions, Scene};
use serde_json::{Value, json};

use crate::bad_input::refused_at;
use crate::builder::{F32, File, U8, U16, bytes_of, world};

/// Positions are f32, of size 1 in normalised space and below 16 in the world.
const ROUNDING: f64 = 2e-6;

/// A triangle whose corners follow joint 0, joint 1 and both. Joint 1 is a child of joint 0, at (0, 2, 0) when bound.
/// Node 0 has the mesh, nodes 1 and 2 are the joints.
fn skinned() -> File {
    let mut file = File::new();
    let joints = file.accessor(&[0, 9, 9, 9, 1, 0, 0, 0, 0, 1, 0, 0], U8, "VEC4", 3);
    // The joints without weight do not exist.
    let weights = file.floats(&[[1f32, 0., 0., 0.], [1., 0., 0., 0.], [0.25, 0.75, 0., 0.]]);
    let attributes = json!({ "JOINTS_0": joints, "WEIGHTS_0": weights });
    file.mesh(&[[0., 0., 0.], [0., 4., 0.], [2., 2., 0.]], json!({ "attributes": attributes }));
    let bind = |y: f32| [[1f32, 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.], [0., -y, 0., 1.]];
    let matrices: Vec<u8> = [0.0, 2.0].iter().flat_map(|y| bytes_of(&bind(*y))).collect();
    let inverse = file.accessor(&matrices, F32, "MAT4", 2);
    file.add("skins", json!({ "joints": [1, 2], "inverseBindMatrices": inverse }));
    file.json["nodes"][0]["skin"] = json!(0);
    file.add("nodes", json!({ "children": [2] }));
    file.add("nodes", json!({ "translation": [0, 2, 0] }));
    file
}

fn corners(scene: &Scene) -> [DVec3; 3] {
    world(scene)[0].map(DVec3::from)
}

#[track_caller]
fn assert_corners(scene: &Scene, expected: [[f64; 3]; 3]) {
    let found = corners(scene);
    let near = found.iter().zip(expected).all(|(found, expected)| found.distance(expected.into()) < ROUNDING);
    assert!(near, "{found:?} for {expected:?}");
}

#[test]
fn two_joints_move_a_triangle() {
    // As bound, wherever the mesh's own node is.
    let mut file = skinned();
    let bound = [[0., 0., 0.], [0., 4., 0.], [2., 2., 0.]];
    assert_corners(&file.load(), bound);
    file.json["nodes"][0]["translation"] = json!([5, 6, 7]);
    file.json["nodes"][0]["scale"] = json!([-3, 1, 1]);
    assert_corners(&file.load(), bound);
    // Joint 1 turned by 90 degrees about z maps (x, y) to (2 - y, 2 + x) - the corner at (0, 4) comes to (-2, 2), and
    // (2, 2) to (0, 4), of which it takes three quarters.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    file.json["nodes"][2]["rotation"] = json!([0, 0, half, half]);
    assert_corners(&file.load(), [[0., 0., 0.], [-2., 2., 0.], [0.5, 3.5, 0.]]);
    // What moves the root moves all.
    file.json["nodes"][1]["translation"] = json!([1, 0, -1]);
    assert_corners(&file.load(), [[1., 0., -1.], [-1., 2., -1.], [1.5, 3.5, -1.]]);
    // Without inverse bind matrices the mesh is in the space of its joints.
    file.json["skins"][0].as_object_mut().unwrap().remove("inverseBindMatrices");
    file.json["nodes"][1] = json!({ "children": [2] });
    file.json["nodes"][2] = json!({ "translation": [0, 2, 0] });
    assert_corners(&file.load(), [[0., 0., 0.], [0., 6., 0.], [2., 3.5, 0.]]);
}

#[test]
fn normals_and_tangents_follow_the_joints_and_a_mirror_flips_the_winding() {
    let mut file = skinned();
    let (normals, tangents) = (file.floats(&[[0f32, 0., 1.]; 3]), file.floats(&[[1f32, 0., 0., 1.]; 3]));
    file.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(normals);
    file.json["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = json!(tangents);
    file.json["nodes"][1]["rotation"] = json!([0, std::f64::consts::FRAC_1_SQRT_2, 0, std::f64::consts::FRAC_1_SQRT_2]);
    for vertex in file.load().vertices.iter() {
        // Roundings of unit vectors in f32.
        assert!((vertex.normal - Vec3::X).length() < 1e-6, "{}", vertex.normal);
        assert!((vertex.tangent - Vec4::new(0.0, 0.0, -1.0, 1.0)).length() < 1e-6, "{}", vertex.tangent);
    }
    file.json["nodes"][1] = json!({ "children": [2], "scale": [-1, 1, 1] });
    let scene = file.load();
    assert_corners(&scene, [[0., 0., 0.], [-2., 2., 0.], [0., 4., 0.]]);
    for vertex in scene.vertices.iter() {
        assert_eq!((vertex.normal, vertex.tangent), (Vec3::Z, Vec4::new(-1.0, 0.0, 0.0, -1.0)));
    }
}

#[test]
fn weights_are_divided_by_their_sum() {
    let mut file = skinned();
    file.json["nodes"][1]["translation"] = json!([8, 0, 0]);
    let expected = corners(&file.load()).map(|p| p.to_array());
    let notes = |scene: &Scene| scene.notes.iter().filter(|note| note.contains("sum is not 1")).count();
    assert_eq!(notes(&file.load()), 0);
    let double = file.floats(&[[2f32, 0., 0., 0.], [2., 0., 0., 0.], [0.5, 1.5, 0., 0.]]);
    file.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(double);
    let scene = file.load();
    assert_corners(&scene, expected);
    assert_eq!(notes(&scene), 1);
    // As normalised bytes in a second set; the first has no weights. A vertex without any stays.
    let nothing = file.floats(&[[0f32; 4]; 3]);
    let bytes = file.accessor(&[255, 0, 0, 0, 0, 0, 0, 0, 51, 204, 0, 0], U8, "VEC4", 3);
    file.json["accessors"][bytes]["normalized"] = json!(true);
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["WEIGHTS_0"] = json!(nothing);
    attributes["WEIGHTS_1"] = json!(bytes);
    attributes["JOINTS_1"] = attributes["JOINTS_0"].clone();
    assert_corners(&file.load(), [[8., 0., 0.], [0., 4., 0.], [10., 2., 0.]]);
}

#[test]
fn malformed_skins_are_refused() {
    let refused = |edit: &dyn Fn(&mut File)| {
        let mut file = skinned();
        edit(&mut file);
        refused_at(&file)
    };
    const ATTRIBUTES: &str = "/meshes/0/primitives/0/attributes";
    let attribute = |f: &mut File, name: &str, value: Value| {
        f.json["meshes"][0]["primitives"][0]["attributes"][name] = value;
    };
    let with = |name: &'static str, bytes: &'static [u8], component: u32| {
        refused(&|f| {
            let accessor = f.accessor(bytes, component, "VEC4", 3);
            attribute(f, name, json!(accessor));
        })
    };
    assert_eq!(with("JOINTS_0", &[2; 12], U8), format!("{ATTRIBUTES}/JOINTS_0"), "there is no joint 2");
    assert_eq!(with("JOINTS_0", &[0; 48], F32), format!("{ATTRIBUTES}/JOINTS_0"));
    assert_eq!(with("WEIGHTS_0", &[0; 24], U16), format!("{ATTRIBUTES}/WEIGHTS_0"), "not normalised");
    assert_eq!(with("JOINTS_1", &[0; 12], U8), format!("{ATTRIBUTES}/JOINTS_1"), "without weights");
    for wrong in [-0.5, f32::NAN] {
        let edit = |f: &mut File| {
            let weights = f.floats(&[[1f32, 0., 0., 0.], [1., wrong, 0., 0.], [1., 0., 0., 0.]]);
            attribute(f, "WEIGHTS_0", json!(weights));
        };
        assert_eq!(refused(&edit), format!("{ATTRIBUTES}/WEIGHTS_0"));
    }
    let many = |f: &mut File| {
        let own = f.json["meshes"][0]["primitives"][0]["attributes"].clone();
        for set in 0..9 {
            attribute(f, &format!("JOINTS_{set}"), own["JOINTS_0"].clone());
            attribute(f, &format!("WEIGHTS_{set}"), own["WEIGHTS_0"].clone());
        }
    };
    assert_eq!(refused(&many), format!("{ATTRIBUTES}/JOINTS_8"));
    // Skins.
    assert_eq!(refused(&|f| f.json["skins"][0]["joints"] = json!([])), "/skins/0/joints");
    assert_eq!(refused(&|f| f.json["skins"][0]["joints"] = json!([1, 9])), "/skins/0/joints/1");
    assert_eq!(refused(&|f| f.json["skins"][0]["skeleton"] = json!(9)), "/skins/0/skeleton");
    assert_eq!(refused(&|f| f.json["skins"][0]["joints"] = json!([1, 2, 0])), "/skins/0/inverseBindMatrices");
    assert_eq!(refused(&|f| f.json["skins"][0]["inverseBindMatrices"] = json!(0)), "/skins/0/inverseBindMatrices");
    for (at, value) in [(3, 1f32), (5, f32::NAN)] {
        let edit = |f: &mut File| {
            let mut bytes = vec![0; 128];
            for (i, one) in [(at, value), (15, 1.0), (31, 1.0)] {
                bytes[4 * i..4 * i + 4].copy_from_slice(&one.to_le_bytes());
            }
            f.json["skins"][0]["inverseBindMatrices"] = json!(f.accessor(&bytes, F32, "MAT4", 2));
        };
        assert_eq!(refused(&edit), "/skins/0/inverseBindMatrices");
    }
    assert_eq!(refused(&|f| f.json["scenes"] = json!([{ "nodes": [0] }])), "/skins/0", "joints elsewhere");
    // Nodes.
    assert_eq!(refused(&|f| f.json["nodes"][0]["skin"] = json!(1)), "/nodes/0/skin");
    assert_eq!(refused(&|f| f.json["nodes"][2]["skin"] = json!(0)), "/nodes/2/skin", "without a mesh");
    let bare = |f: &mut File| {
        f.mesh(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]], json!({}));
        f.json["nodes"][3]["skin"] = json!(0);
    };
    assert_eq!(refused(&bare), "/nodes/3", "without joints");
}

/// A triangle with two targets, the second of which moves one corner. Base and targets have normals and tangents.
fn morphed() -> File {
    let mut file = File::new();
    let normals = file.floats(&[[0f32, 0., 1.]; 3]);
    let tangents = file.floats(&[[1f32, 0., 0., -1.]; 3]);
    let first = json!({
        "POSITION": file.floats(&[[1f32, 0., 0.], [0., 1., 0.], [0., 0., 2.]]),
        "NORMAL": file.floats(&[[1f32, 0., 0.]; 3]),
        "TANGENT": file.floats(&[[0f32, 0., -1.]; 3]),
    });
    let second = json!({ "POSITION": file.floats(&[[0f32, 0., 0.], [0., 0., 0.], [0., 4., 0.]]) });
    let members = json!({ "attributes": { "NORMAL": normals, "TANGENT": tangents }, "targets": [first, second] });
    file.mesh(&[[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]], members);
    file
}

#[test]
fn targets_displace_positions_normals_and_tangents() {
    let mut file = morphed();
    assert_corners(&file.load(), [[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]]);
    file.json["meshes"][0]["weights"] = json!([0.5, 0.0]);
    let scene = file.load();
    assert_corners(&scene, [[0.5, 0., 0.], [4., 0.5, 0.], [0., 2., 1.]]);
    // (0, 0, 1) + (1, 0, 0) / 2 and (1, 0, 0) - (0, 0, 1) / 2, of unit length; the handedness stays.
    let (normal, tangent) = (Vec3::new(0.5, 0.0, 1.0).normalize(), Vec3::new(1.0, 0.0, -0.5).normalize());
    for vertex in scene.vertices.iter() {
        // Roundings of unit vectors in f32.
        assert!((vertex.normal - normal).length() < 1e-6, "{}", vertex.normal);
        assert!((vertex.tangent - tangent.extend(-1.0)).length() < 1e-6, "{}", vertex.tangent);
    }
    // The node's weights take the place of the mesh's; targets add up, and may be subtracted or exaggerated.
    file.json["nodes"][0]["weights"] = json!([-1.0, 1.5]);
    assert_corners(&file.load(), [[-1., 0., 0.], [4., -1., 0.], [0., 8., -2.]]);
    // A primitive that uses some of the vertices takes their displacements.
    let indices = file.accessor(&[2, 1, 0], U8, "SCALAR", 3);
    file.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    assert_corners(&file.load(), [[0., 8., -2.], [4., -1., 0.], [-1., 0., 0.]]);
    // Without colours of its own there is nothing to displace, which is noted.
    file.json["meshes"][0]["primitives"][0]["targets"][0]["COLOR_0"] = json!(0);
    assert!(file.load().notes.iter().any(|note| note.contains("morph targets for missing attributes")));
}

#[test]
fn targets_displace_colours_and_coordinates() {
    let mut file = morphed();
    let colours = file.floats(&[[0.25f32, 0.5, 0.75, 0.5]; 3]);
    let coordinates = file.floats(&[[0f32, 0.], [1., 0.], [0., 1.]]);
    let (red, all) = (file.floats(&[[0.5f32, 0., -1.]; 3]), file.floats(&[[0f32, 0.25, 0., 1.]; 3]));
    let moved = file.floats(&[[0.5f32, 0.], [0., 0.], [0., -2.]]);
    let primitive = &mut file.json["meshes"][0]["primitives"][0];
    for (name, accessor) in [("COLOR_0", colours), ("TEXCOORD_0", coordinates), ("TEXCOORD_1", coordinates)] {
        primitive["attributes"][name] = json!(accessor);
    }
    primitive["targets"][0]["COLOR_0"] = json!(red);
    primitive["targets"][1]["COLOR_0"] = json!(all);
    primitive["targets"][0]["TEXCOORD_0"] = json!(moved);
    primitive["targets"][1]["TEXCOORD_1"] = json!(moved);
    let state = |file: &File, corner: usize| {
        let scene = file.load();
        let vertex = scene.vertices[scene.triangles[0].vertices[corner] as usize];
        (vertex.colour.to_array(), vertex.uv.map(|uv| uv.to_array()))
    };
    assert_eq!(state(&file, 0), ([0.25, 0.5, 0.75, 0.5], [[0.0, 0.0]; 2]));
    // Three components leave alpha; the sum stays within 0 and 1.
    file.json["meshes"][0]["weights"] = json!([1.0, 0.0]);
    assert_eq!(state(&file, 0), ([0.75, 0.5, 0.0, 0.5], [[0.5, 0.0], [0.0, 0.0]]));
    file.json["meshes"][0]["weights"] = json!([0.5, 1.0]);
    assert_eq!(state(&file, 2), ([0.5, 0.75, 0.25, 1.0], [[0.0, 0.0], [0.0, -1.0]]));
    assert!(!file.load().notes.iter().any(|note| note.contains("morph targets")));
    // Two components are no colour.
    file.json["meshes"][0]["primitives"][0]["targets"][0]["COLOR_0"] = json!(moved);
    assert_eq!(refused_at(&file), "/meshes/0/primitives/0/targets/0/COLOR_0");
}

#[test]
fn animated_weights_come_before_all_others() {
    let mut file = morphed();
    file.json["meshes"][0]["weights"] = json!([1.0, 1.0]);
    let (input, output) = (file.floats(&[[0f32], [2.]]), file.floats(&[[0f32], [0.], [1.], [0.5]]));
    let target = json!({ "node": 0, "path": "weights" });
    let sampler = json!({ "input": input, "output": output });
    file.json["animations"] = json!([{ "samplers": [sampler], "channels": [{ "sampler": 0, "target": target }] }]);
    let scene = file.load_with(&ImportOptions { time: Some(1.0), ..Default::default() }).unwrap();
    assert_corners(&scene, [[0.5, 0., 0.], [4., 0.5, 0.], [0., 3., 1.]]);
    // One weight alone, by a pointer: the other is that of the mesh.
    let extension = json!({ "KHR_animation_pointer": { "pointer": "/nodes/0/weights/0" } });
    file.json["animations"][0]["channels"][0]["target"] = json!({ "path": "pointer", "extensions": extension });
    file.json["animations"][0]["samplers"][0]["output"] = json!(file.floats(&[[0f32], [1.]]));
    let scene = file.load_with(&ImportOptions { time: Some(1.0), ..Default::default() }).unwrap();
    assert_corners(&scene, [[0.5, 0., 0.], [4., 0.5, 0.], [0., 6., 1.]]);
}

#[test]
fn malformed_targets_are_refused() {
    let refused = |edit: &dyn Fn(&mut File)| {
        let mut file = morphed();
        edit(&mut file);
        refused_at(&file)
    };
    const TARGET: &str = "/meshes/0/primitives/0/targets/0";
    let set = |f: &mut File, name: &str, value: Value| {
        f.json["meshes"][0]["primitives"][0]["targets"][0][name] = value;
    };
    assert_eq!(refused(&|f| set(f, "POSITION", json!(99))), format!("{TARGET}/POSITION"));
    for values in [vec![[0f32; 3]; 2], vec![[0., f32::NAN, 0.]; 3]] {
        let edit = |f: &mut File| {
            let accessor = f.floats(&values);
            set(f, "NORMAL", json!(accessor));
        };
        assert_eq!(refused(&edit), format!("{TARGET}/NORMAL"));
    }
    let four = |f: &mut File| {
        let accessor = f.floats(&[[0f32; 4]; 3]);
        set(f, "TANGENT", json!(accessor));
    };
    assert_eq!(refused(&four), format!("{TARGET}/TANGENT"));
    let no_base = |f: &mut File| {
        f.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("NORMAL");
    };
    assert_eq!(refused(&no_base), format!("{TARGET}/NORMAL"));
    assert_eq!(refused(&|f| f.json["meshes"][0]["weights"] = json!([1])), "/meshes/0/weights");
    assert_eq!(refused(&|f| f.json["nodes"][0]["weights"] = json!([1, 2, 3])), "/nodes/0/weights");
    assert_eq!(refused(&|f| f.json["nodes"][0]["weights"] = json!([1, "x"])), "/nodes/0/weights/1");
    let uneven = |f: &mut File| {
        let primitives = f.json["meshes"][0]["primitives"].as_array_mut().unwrap();
        primitives.push(json!({ "attributes": { "POSITION": 0 } }));
    };
    assert_eq!(refused(&uneven), "/meshes/0/primitives/1");
    assert_eq!(
        refused(&|f| f.json["meshes"][0]["primitives"][0]["targets"] = json!([])),
        "/meshes/0/primitives/0/targets"
    );
    // Weights that f32 cannot hold, of coordinates that stay and of positions that leave the range.
    let mut file = morphed();
    let still = file.floats(&[[0f32; 2]; 3]);
    file.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(still);
    file.json["meshes"][0]["primitives"][0]["targets"] = json!([{ "TEXCOORD_0": still }, { "POSITION": 0 }]);
    file.json["meshes"][0]["weights"] = json!([1e39, 0.0]);
    assert!(file.load().vertices.iter().all(|vertex| vertex.uv[0] == glam::Vec2::ZERO));
    file.json["meshes"][0]["weights"] = json!([0.0, 1e308]);
    let error = file.load_with(&ImportOptions::default()).unwrap_err().to_string();
    assert!(error.contains("/accessors/0") && error.contains("out of range"), "{error}");
    // A lenient import leaves a primitive with NaN out.
    let mut file = morphed();
    let bad = file.floats(&[[f32::NAN; 3]; 3]);
    file.json["meshes"][0]["primitives"][0]["targets"][1]["POSITION"] = json!(bad);
    let scene = file.load_with(&ImportOptions { lenient: true, ..Default::default() }).unwrap();
    assert!(scene.triangles.is_empty() && scene.notes.iter().any(|note| note.contains("not finite")));
}

/// Many targets may share one accessor: their number times that of vertices is limited.
#[test]
fn shared_targets_are_counted() {
    let mut file = File::new();
    let positions: Vec<[f32; 3]> = (0..30_000u32).map(|i| [i as f32, (i * i % 7) as f32, 0.0]).collect();
    file.mesh(&positions, json!({}));
    file.json["meshes"][0]["primitives"][0]["targets"] = json!(vec![json!({ "POSITION": 0 }); 10_000]);
    assert_eq!(refused_at(&file), "/meshes/0/primitives/0");
    // One target at many nodes, each of which adds it.
    file.json["meshes"][0]["primitives"][0]["targets"] = json!(vec![json!({ "POSITION": 0 }); 20]);
    file.json["nodes"] = json!(vec![json!({ "mesh": 0, "weights": vec![1.0; 20] }); 1000]);
    assert_eq!(refused_at(&file), "/nodes/447");
}
