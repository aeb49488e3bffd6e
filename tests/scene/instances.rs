//! Nodes that are hidden, meshes that are repeated, and variants of materials.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3, Vec4};
use penumbra::internal::scene::{ImportOptions, LightKind, Scene};
use serde_json::{Value, json};

use crate::bad_input::refused_at;
use crate::builder::{File, I16, world};

#[test]
fn hidden_nodes_keep_only_their_camera() {
    let mut file = File::triangle();
    let second = file.mesh(&[[0., 0., 5.], [1., 0., 5.], [0., 1., 5.]], json!({}));
    let lights = json!({ "lights": [{ "type": "point" }] });
    file.json["extensions"] = json!({ "KHR_lights_punctual": lights });
    file.json["extensionsRequired"] = json!(["KHR_node_visibility"]);
    file.add(
        "cameras",
        json!({ "type": "orthographic",
        "orthographic": { "xmag": 1, "ymag": 1, "znear": 0, "zfar": 1 } }),
    );
    let child = json!({
        "camera": 0, "mesh": 0,
        "extensions": { "KHR_lights_punctual": { "light": 0 }, "KHR_node_visibility": { "visible": true } },
    });
    let child = file.add("nodes", child);
    let parent = |visible: Value| {
        json!({
            "mesh": 0, "children": [child], "extensions": { "KHR_node_visibility": visible },
        })
    };
    let parent_index = file.add("nodes", parent(json!({})));
    let counts = |scene: &Scene| (scene.triangles.len(), scene.lights.len(), scene.cameras.len());
    // The mesh is also that of the first node, and of none with a parent that could hide it.
    assert_eq!(counts(&file.load()), (4, 1, 1));
    file.json["nodes"][parent_index] = parent(json!({ "visible": true }));
    assert_eq!(counts(&file.load()), (4, 1, 1));
    file.json["nodes"][parent_index] = parent(json!({ "visible": false }));
    let scene = file.load();
    assert_eq!(counts(&scene), (2, 0, 1));
    assert!(!scene.notes.iter().any(|note| note.contains("visibility")), "{:?}", scene.notes);
    file.json["nodes"][parent_index] = parent(json!({ "visible": 0 }));
    assert_eq!(refused_at(&file), format!("/nodes/{parent_index}/extensions/KHR_node_visibility/visible"));
    // Also where no scene shows the node.
    file.json["scenes"] = json!([{ "nodes": [second] }]);
    assert_eq!(refused_at(&file), format!("/nodes/{parent_index}/extensions/KHR_node_visibility/visible"));
}

/// A file with `transforms` of one triangle, either as nodes or as instances of one node that has a transform itself.
fn repeated(transforms: &[(DVec3, DQuat, DVec3)], as_nodes: bool) -> File {
    let mut file = File::triangle();
    let base = json!({ "translation": [1, 2, 3], "scale": [2, 2, -2] });
    if as_nodes {
        let nodes: Vec<Value> = transforms
            .iter()
            .map(|(t, r, s)| {
                json!({ "mesh": 0, "translation": t.to_array(), "rotation": r.to_array(), "scale": s.to_array() })
            })
            .collect();
        file.json["nodes"] = json!([]);
        let children: Vec<usize> = nodes.into_iter().map(|node| file.add("nodes", node)).collect();
        let mut base = base;
        base["children"] = json!(children);
        file.add("nodes", base);
    } else {
        let single = |v: DVec3| v.as_vec3().to_array();
        let translations = file.floats(&transforms.iter().map(|(t, ..)| single(*t)).collect::<Vec<_>>());
        let rotations = file.floats(&transforms.iter().map(|(_, r, _)| r.as_quat().to_array()).collect::<Vec<_>>());
        let scales = file.floats(&transforms.iter().map(|(.., s)| single(*s)).collect::<Vec<_>>());
        let attributes = json!({ "TRANSLATION": translations, "ROTATION": rotations, "SCALE": scales });
        let mut base = base;
        base["mesh"] = json!(0);
        base["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
        file.json["nodes"] = json!([base]);
        file.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    }
    file
}

#[test]
fn instances_are_nodes() {
    // More than are read at once, with numbers that f32 holds exactly.
    let transforms: Vec<_> = (0..1500)
        .map(|i| {
            let i = f64::from(i);
            let quarter = DQuat::from_xyzw(0.0, 0.6, 0.0, 0.8);
            (DVec3::new(i, 0.5 * i, -i), quarter.as_quat().as_dquat(), DVec3::new(1.0, 1.0 + i, 0.5))
        })
        .collect();
    let (nodes, instances) = (repeated(&transforms, true).load(), repeated(&transforms, false).load());
    assert_eq!(instances.triangles.len(), 1500);
    // Without the lists, which have thousands of numbers.
    assert!(nodes.vertices == instances.vertices && nodes.triangles == instances.triangles);
    assert!(!instances.notes.iter().any(|note| note.contains("instancing")), "{:?}", instances.notes);
}

/// Attributes may be absent or of integers. Lights and cameras of the node are there once, emissive meshes often.
#[test]
fn parts_of_instances() {
    let mut file = File::triangle();
    let translations = file.floats(&[[0f32, 0., 0.], [8., 0., 0.], [16., 0., 0.]]);
    let words: Vec<u8> = [[0i16, 0, 0, 32767], [0, 0, 32767, 0], [0, 0, -32767, 0]]
        .as_flattened()
        .iter()
        .flat_map(|word| word.to_le_bytes())
        .collect();
    let rotations = file.accessor(&words, I16, "VEC4", 3);
    file.json["accessors"][rotations]["normalized"] = json!(true);
    file.add(
        "cameras",
        json!({ "type": "orthographic",
        "orthographic": { "xmag": 1, "ymag": 1, "znear": 0, "zfar": 1 } }),
    );
    file.add("materials", json!({ "emissiveFactor": [1, 1, 1] }));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    file.json["nodes"][0] = json!({ "mesh": 0, "camera": 0, "extensions": {
        "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": translations, "ROTATION": rotations } },
    } });
    let scene = file.load();
    assert_eq!((scene.triangles.len(), scene.cameras.len(), scene.lights.len()), (3, 1, 3));
    assert!(scene.lights.iter().all(|light| matches!(light.kind, LightKind::Mesh { .. })));
    let turned = DAffine3::from_scale_rotation_translation(DVec3::ONE, DQuat::from_xyzw(0., 0., 1., 0.), DVec3::X * 8.);
    for (corner, expected) in world(&scene)[1].iter().zip([[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]]) {
        let expected = turned.transform_point3(DVec3::from_array(expected));
        // Positions are f32 below 1 in normalised space, of which 1 is 16 here: each is rounded by 5e-7 or less.
        assert!(DVec3::from_array(*corner).distance(expected) < 1e-5, "{corner:?} {expected}");
    }
}

#[test]
fn bad_instances_are_refused() {
    let good = repeated(&[(DVec3::ZERO, DQuat::IDENTITY, DVec3::ONE); 4], false);
    assert_eq!(good.load().triangles.len(), 4);
    const PLACE: &str = "/nodes/0/extensions/EXT_mesh_gpu_instancing";
    let refused = |edit: &dyn Fn(&mut File)| {
        let mut file = good.clone();
        edit(&mut file);
        refused_at(&file)
    };
    fn extension(file: &mut File) -> &mut Value {
        &mut file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]
    }
    assert_eq!(refused(&|f| *extension(f) = json!({})), PLACE);
    assert_eq!(refused(&|f| extension(f)["attributes"] = json!([])), format!("{PLACE}/attributes"));
    let attribute = |name: &str| format!("{PLACE}/attributes/{name}");
    assert_eq!(refused(&|f| extension(f)["attributes"]["SCALE"] = json!(99)), attribute("SCALE"));
    assert_eq!(refused(&|f| extension(f)["attributes"]["ROTATION"] = json!(1)), attribute("ROTATION"));
    let fewer = |f: &mut File| {
        let fewer = f.floats(&[[1f32; 3]; 3]);
        extension(f)["attributes"]["SCALE"] = json!(fewer);
    };
    assert_eq!(refused(&fewer), attribute("SCALE"));
    let infinite = |f: &mut File| {
        let scales = f.floats(&[[1f32, 1., f32::INFINITY]; 4]);
        extension(f)["attributes"]["SCALE"] = json!(scales);
    };
    assert_eq!(refused(&infinite), PLACE);
    let no_rotation = |f: &mut File| {
        let rotations = f.floats(&[[0f32; 4]; 4]);
        extension(f)["attributes"]["ROTATION"] = json!(rotations);
    };
    assert_eq!(refused(&no_rotation), PLACE);
    // A hundred nodes of half a million copies are refused before they are made: their counts are summed, and the 23rd
    // node exceeds 2^25 vertices.
    let mut file = File::triangle();
    file.bin.resize(1 << 20, 0);
    let many = file.add("accessors", json!({ "componentType": 5126, "type": "VEC3", "count": 500_000 }));
    let attributes = json!({ "TRANSLATION": many });
    let node = json!({ "mesh": 0, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": attributes } } });
    file.json["nodes"] = json!(vec![node; 100]);
    assert_eq!(refused_at(&file), "/nodes/22");
}

#[test]
fn variants() {
    let mut file = File::triangle();
    for colour in [0.25, 0.5, 0.75] {
        let base = json!({ "baseColorFactor": [colour, colour, colour, 1] });
        file.add("materials", json!({ "pbrMetallicRoughness": base }));
    }
    let list = json!({ "variants": [{ "name": "red" }, { "name": "blue" }, { "name": "green" }] });
    file.json["extensions"] = json!({ "KHR_materials_variants": list });
    file.json["extensionsUsed"] = json!(["KHR_materials_variants"]);
    let mappings = json!([{ "material": 1, "variants": [1, 2] }, { "material": 2, "variants": [0] }]);
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let plain = file.clone();
    file.json["meshes"][0]["primitives"][0]["extensions"] =
        json!({ "KHR_materials_variants": { "mappings": mappings } });
    let load = |file: &File, name: Option<&str>| {
        file.load_with(&ImportOptions { variant: name.map(str::to_owned), ..Default::default() })
    };
    let colour = |file: &File, name: Option<&str>| {
        let scene = load(file, name).unwrap();
        scene.materials[scene.triangles[0].material as usize].base_colour
    };
    let grey = |x: f32| Vec4::new(x, x, x, 1.0);
    assert_eq!(colour(&file, None), grey(0.25));
    assert_eq!(colour(&file, Some("red")), grey(0.75));
    assert_eq!(colour(&file, Some("blue")), grey(0.5));
    assert_eq!(colour(&file, Some("green")), grey(0.5));
    // A primitive without variants keeps its material.
    assert_eq!(colour(&plain, Some("red")), grey(0.25));
    let note = "available: red, blue, green";
    assert!(load(&file, None).unwrap().notes.iter().any(|n| n.contains(note)));
    assert!(!load(&file, Some("red")).unwrap().notes.iter().any(|n| n.contains("variant")));
    let error = load(&file, Some("pink")).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("'pink'") && error.to_string().contains(note), "{error}");
    // Names reach the terminal.
    let mut escaping = file.clone();
    escaping.json["extensions"]["KHR_materials_variants"]["variants"][1]["name"] = json!("\u{1b}[2Jblue\n");
    let error = load(&escaping, Some("pink")).unwrap_err().to_string();
    assert!(error.contains("\u{fffd}[2Jblue\u{fffd}") && !error.contains(char::is_control), "{error:?}");
    let error = load(&File::triangle(), Some("pink")).unwrap_err();
    assert!(error.to_string().contains("available: none"), "{error}");

    const PLACE: &str = "/meshes/0/primitives/0/extensions/KHR_materials_variants";
    let refused = |mappings: Value| {
        let mut file = file.clone();
        file.json["meshes"][0]["primitives"][0]["extensions"]["KHR_materials_variants"] = mappings;
        refused_at(&file)
    };
    assert_eq!(refused(json!({})), PLACE);
    assert_eq!(refused(json!({ "mappings": [] })), format!("{PLACE}/mappings"));
    let mapping = |mapping: Value| refused(json!({ "mappings": [mapping] }));
    assert_eq!(mapping(json!({ "variants": [0] })), format!("{PLACE}/mappings/0"));
    assert_eq!(mapping(json!({ "material": 3, "variants": [0] })), format!("{PLACE}/mappings/0/material"));
    assert_eq!(mapping(json!({ "material": 0, "variants": [] })), format!("{PLACE}/mappings/0/variants"));
    assert_eq!(mapping(json!({ "material": 0, "variants": [3] })), format!("{PLACE}/mappings/0/variants/0"));
    let mut nameless = file.clone();
    nameless.json["extensions"]["KHR_materials_variants"]["variants"][1] = json!({});
    assert_eq!(refused_at(&nameless), "/extensions/KHR_materials_variants/variants/1");
}

/// A file of a pyramid, beside a triangle that shines, and nodes with the members.
fn pyramids(nodes: &[Value]) -> File {
    let mut file = File::new();
    let corners = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
    let faces: Vec<[f32; 3]> =
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].as_flattened().iter().map(|i| corners[*i]).collect();
    let normals = file.floats(&[[0.6f32, 0.0, 0.8]; 12]);
    let tangents = file.floats(&[[0.8f32, 0.0, -0.6, -1.0]; 12]);
    file.mesh(&faces, json!({ "attributes": { "NORMAL": normals, "TANGENT": tangents } }));
    let glow = file.add("materials", json!({ "emissiveFactor": [1, 1, 1] }));
    file.mesh(&[[0., 9., 0.], [1., 9., 0.], [0., 9., 1.]], json!({ "material": glow }));
    for node in nodes {
        let mut node = node.clone();
        if node["mesh"].is_null() {
            node["mesh"] = json!(0);
        }
        file.add("nodes", node);
    }
    file
}

fn load_sharing(file: &File, max_copied_triangles: usize) -> Scene {
    let options = ImportOptions { max_copied_triangles: Some(max_copied_triangles), ..Default::default() };
    file.load_with(&options).unwrap_or_else(|e| panic!("{e}"))
}

/// Triangles in the scene with their normals and tangents, sorted by their corners.
fn surfaces(scene: &Scene) -> Vec<[[f64; 3]; 9]> {
    let mut all = Vec::new();
    let mut add = |triangle: usize, place: &dyn Fn(Vec3) -> DVec3, linear: DMat3| {
        let corners = scene.triangles[triangle].vertices.map(|v| scene.vertices[v as usize]);
        let normals = corners.map(|c| linear.inverse().transpose() * c.normal.as_dvec3());
        let tangents = corners.map(|c| linear * c.tangent.truncate().as_dvec3());
        let positions = corners.map(|c| scene.normalisation.undo_f64(place(c.position)));
        let directions = normals.into_iter().chain(tangents).map(|v| v.normalize_or_zero().to_array());
        let mut of_triangle = positions.map(|p| p.to_array()).into_iter().chain(directions);
        all.push(std::array::from_fn(|_| of_triangle.next().unwrap()));
    };
    for triangle in 0..scene.unshared_triangles() {
        add(triangle, &|p| p.as_dvec3(), DMat3::IDENTITY);
    }
    for instance in &scene.instances {
        for triangle in scene.shared_meshes[instance.mesh].triangles.clone() {
            add(triangle, &|p| instance.apply_f64(p), instance.linear.as_dmat3());
        }
    }
    // Corners differ by more than roundings.
    all.sort_by_key(|surface: &[[f64; 3]; 9]| {
        [surface[0], surface[1], surface[2]].map(|p| p.map(|x| (x * 64.0).round() as i64))
    });
    all
}

/// Turned, stretched, mirrored and nested copies are at the same places whether their mesh is stored once or not, with
/// the same winding, normals and tangents; what cannot be shared is copied.
#[test]
fn meshes_are_stored_once() {
    let turned = [0.5, 0.5, 0.5, 0.5];
    let file = pyramids(&[
        json!({ "translation": [10, 0, 0], "rotation": turned }),
        json!({ "translation": [-10, 2, 0], "scale": [1, 3, 1] }),
        json!({ "translation": [0, 5, 10], "scale": [-1, 1, 2], "rotation": turned }),
        json!({ "translation": [0, 5, -10], "scale": [-1, -1, -1] }),
        // Too much of a stretch.
        json!({ "translation": [3, 3, 3], "scale": [1, 40, 1] }),
        // Flat.
        json!({ "translation": [5, 3, 3], "scale": [0, 1, 1] }),
        // Lights.
        json!({ "mesh": 1, "translation": [0, 1, 0] }),
        json!({ "mesh": 1, "translation": [0, 2, 0] }),
        json!({ "translation": [0, 0, 20], "scale": [2, 2, 2], "children": [11] }),
        json!({ "translation": [0, 0, 0.25], "scale": [0.125, 0.125, 0.125], "rotation": turned }),
    ]);
    let (copied, shared) = (load_sharing(&file, usize::MAX), load_sharing(&file, 0));
    assert_eq!((copied.instances.len(), copied.unshared_triangles()), (0, copied.triangles.len()));
    // One mesh and its mirror image.
    assert_eq!((shared.instances.len(), shared.shared_meshes.len(), shared.triangles.len()), (7, 2, 4 + 2 + 3 + 8));
    assert_eq!((shared.lights.len(), shared.normalisation), (copied.lights.len(), copied.normalisation));
    assert!(shared.instances.iter().all(|instance| instance.linear.determinant() > 0.0));
    let [a, b] = [&copied, &shared].map(surfaces);
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(&b) {
        for (a, b) in a.iter().zip(b) {
            // Positions are f32 below 1 in normalised space, of which 1 is at most 64 here: roundings of 1.9e-6.
            assert!(DVec3::from(*a).distance(DVec3::from(*b)) < 1e-5, "{a:?} {b:?}");
        }
    }
    // Handedness of the tangents is with the vertices.
    let mirrored = |i: usize| shared.vertices[shared.shared_meshes[i].vertices.start].tangent.w;
    assert_eq!([mirrored(0), mirrored(1)], [-1.0, 1.0]);
    let corners = |scene: &Scene| scene.bounds().unwrap().map(|p| scene.normalisation.undo(p));
    let [[low, high], [shared_low, shared_high]] = [&copied, &shared].map(corners);
    // The same roundings.
    assert!(low.distance(shared_low) < 1e-5 && high.distance(shared_high) < 1e-5);
    let framed = |scene: &Scene| scene.frame_camera().position;
    assert!(framed(&copied).distance(framed(&shared)) < 1e-5);
    assert_ne!(copied.fingerprint(&()), shared.fingerprint(&()));
    // The comparison sees another winding.
    let mut wrong = shared.clone();
    let first = wrong.shared_meshes[1].triangles.start;
    wrong.triangles[first].vertices.swap(1, 2);
    assert!(surfaces(&wrong).iter().zip(&a).any(|(w, a)| DVec3::from(w[1]).distance(DVec3::from(a[1])) > 0.1));
}

/// Only as many meshes are shared as the limit requires, the ones with most triangles first.
#[test]
fn few_copies_stay_copies() {
    let copies = 100;
    let mut nodes: Vec<Value> = (0..copies).map(|i| json!({ "translation": [2 * i, 0, 0] })).collect();
    nodes.extend((0..10).map(|i| json!({ "mesh": 2, "translation": [2 * i, 5, 0] })));
    let mut file = pyramids(&nodes);
    let pyramid = file.json["meshes"][0].clone();
    file.json["meshes"].as_array_mut().unwrap().push(pyramid);
    let counts = |limit: usize| {
        let scene = load_sharing(&file, limit);
        (scene.shared_meshes.len(), scene.instances.len(), scene.triangles.len())
    };
    // 101 pyramids, and 10 of another mesh, and the triangle that shines.
    assert_eq!(counts(445), (0, 0, 445));
    assert_eq!(counts(444), (1, 101, 4 + 40 + 1));
    assert_eq!(counts(45), (1, 101, 4 + 40 + 1));
    assert_eq!(counts(44), (2, 111, 4 + 4 + 1));
    assert_eq!(load_sharing(&file, 44).triangles, load_sharing(&file, 0).triangles);
    assert!(file.load().instances.is_empty());
}

/// A mesh of fifty triangles may be there a hundred thousand times. Copies that are too small to matter are left
/// out, with a note.
#[test]
fn copies_by_the_hundred_thousand() {
    let mut file = File::new();
    let triangle = |i: usize| [[i as f32, 0.0, 0.0], [i as f32 + 1.0, 0.0, 0.0], [i as f32, 1.0, 0.0]];
    let positions: Vec<[f32; 3]> = (0..50).flat_map(triangle).collect();
    file.mesh(&positions, json!({}));
    let translations: Vec<[f32; 3]> =
        (0..100_000).map(|i| [0.0, 2.0 * (i / 300) as f32, 2.0 * (i % 300) as f32]).collect();
    let mut scales = vec![[1f32; 3]; 100_000];
    scales[7] = [1e-8; 3];
    let (translations, scales) = (file.floats(&translations), file.floats(&scales));
    let attributes = json!({ "TRANSLATION": translations, "SCALE": scales });
    file.json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    let scene = file.load();
    assert_eq!((scene.instances.len(), scene.triangles.len(), scene.vertices.len()), (99_999, 50, 150));
    let note = scene.notes.iter().find(|note| note.contains("left out")).unwrap();
    assert!(note.starts_with("1 copy of a mesh is below 4e-6"), "{note}");
}
