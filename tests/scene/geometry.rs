//! Primitives, accessors, node matrices and normalisation.

use glam::{DVec3, Vec2, Vec3, Vec4};
use penumbra::internal::scene::ImportOptions;
use serde_json::json;

use crate::bad_input::refused_at;
use crate::builder::{F32, File, I16, U8, U16, U32, bytes_of, world};

const FIVE: [[f32; 3]; 5] = [[0., 0., 0.], [2., 0., 0.], [0., 2., 0.], [2., 2., 0.], [0., 4., 0.]];

/// The triangles of the scene as indices of the five points above.
fn indices_of(file: &File) -> Vec<[usize; 3]> {
    let index = |p: [f64; 3]| FIVE.iter().position(|q| q.map(f64::from) == p).unwrap();
    world(&file.load()).into_iter().map(|triangle| triangle.map(index)).collect()
}

#[test]
fn lists_strips_and_fans_wind_as_specified() {
    // glTF 3.7.2.1: strip p_i = {v_i, v_(i+1+i%2), v_(i+2-i%2)}, fan p_i = {v_(i+1), v_(i+2), v_0}.
    for (mode, expected) in [
        (4, vec![[0, 1, 2]]),
        (5, vec![[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        // The triangles 2 3 0 and 3 4 0 of the fan have an area.
        (6, vec![[1, 2, 0], [2, 3, 0], [3, 4, 0]]),
    ] {
        let mut file = File::new();
        file.mesh(&FIVE, json!({ "mode": mode }));
        assert_eq!(indices_of(&file), expected, "mode {mode}");
    }
}

#[test]
fn points_and_lines_are_left_out_with_a_note() {
    for mode in 0..4 {
        let mut file = File::triangle();
        file.json["meshes"][0]["primitives"][0]["mode"] = json!(mode);
        let scene = file.load();
        assert!(scene.triangles.is_empty());
        assert_eq!(scene.notes.iter().filter(|n| n.contains("points or lines")).count(), 1);
    }
}

#[test]
fn indices_of_all_types() {
    let indices = [2u32, 3, 1, 0, 1, 2];
    for (component, size) in [(U8, 1), (U16, 2), (U32, 4)] {
        let mut file = File::new();
        let bytes: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes()[..size].to_vec()).collect();
        let accessor = file.accessor(&bytes, component, "SCALAR", 6);
        file.mesh(&FIVE, json!({ "indices": accessor }));
        assert_eq!(indices_of(&file), [[2, 3, 1], [0, 1, 2]], "component type {component}");
    }
}

#[test]
fn sparse_values_replace_single_elements() {
    // With data, and without data, which counts as zeros.
    for zero_filled in [false, true] {
        let mut file = File::triangle();
        let indices = file.view(&[1, 2]);
        let values = file.view(&bytes_of(&[[0., 0., 6.], [8., 0., 0.]]));
        let accessor = &mut file.json["accessors"][0];
        accessor["sparse"] = json!({
            "count": 2, "values": { "bufferView": values }, "indices": { "bufferView": indices, "componentType": U8 }
        });
        if zero_filled {
            accessor.as_object_mut().unwrap().remove("bufferView");
        }
        assert_eq!(world(&file.load()), [[[0., 0., 0.], [0., 0., 6.], [8., 0., 0.]]]);
    }
}

#[test]
fn strides_interleave() {
    let mut file = File::triangle();
    let interleaved = bytes_of(&[[0., 0., 0., 0.25, 0.5], [4., 0., 0., 1., 0.], [0., 2., 0., 0., 1.]]);
    let view = file.view(&interleaved);
    file.json["bufferViews"][view]["byteStride"] = json!(20);
    let accessor = |kind: &str, offset: u32| {
        json!({
            "bufferView": view, "byteOffset": offset, "componentType": F32, "type": kind, "count": 3,
        })
    };
    let position = file.add("accessors", accessor("VEC3", 0));
    let uv = file.add("accessors", accessor("VEC2", 12));
    file.json["meshes"][0]["primitives"][0]["attributes"] = json!({ "POSITION": position, "TEXCOORD_0": uv });
    let scene = file.load();
    assert_eq!(world(&scene), [[[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]]]);
    assert_eq!(scene.vertices.iter().map(|v| v.uv[0]).collect::<Vec<_>>(), [Vec2::new(0.25, 0.5), Vec2::X, Vec2::Y]);
}

#[test]
fn quantised_attributes() {
    // KHR_mesh_quantization: f = max(c / 32767, -1) for normalised shorts, f = c otherwise.
    let shorts = |values: &[i16]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    // Padded to 8 bytes, as vertex strides are multiples of 4.
    let values = shorts(&[-32768, -32767, 0, 0, 32767, 0, 0, 0, 0, 32767, 32767, 0]);
    for (normalised, expected) in [
        (true, [[-1., -1., 0.], [1., 0., 0.], [0., 1., 1.]]),
        (false, [[-32768., -32767., 0.], [32767., 0., 0.], [0., 32767., 32767.]]),
    ] {
        let mut file = File::triangle();
        let accessor = file.accessor(&values, I16, "VEC3", 3);
        file.json["bufferViews"][1]["byteStride"] = json!(8);
        file.json["accessors"][accessor]["normalized"] = json!(normalised);
        file.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(accessor);
        file.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
        file.json["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
        assert_eq!(world(&file.load()), [expected]);
    }
}

#[test]
fn a_mirror_flips_the_winding_once() {
    let a_b_c = [[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]];
    // One mirror: the corners move to -x and their order is reversed.
    let mut file = File::triangle();
    file.json["nodes"][0]["scale"] = json!([-1, 1, 1]);
    assert_eq!(world(&file.load()), [[[0., 0., 0.], [0., 2., 0.], [-4., 0., 0.]]]);
    // Two mirrors cancel.
    file.add("nodes", json!({ "children": [0], "scale": [-1, 1, 1] }));
    assert_eq!(world(&file.load()), [a_b_c]);
    // As a matrix.
    let mut file = File::triangle();
    file.json["nodes"][0]["matrix"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1]);
    assert_eq!(world(&file.load()), [[a_b_c[0], a_b_c[2], a_b_c[1]]]);
    // What the inversion of a matrix in f32 leaves in the last row is no projection; a tenth is one.
    file.json["nodes"][0]["matrix"][3] = json!(1.2e-7);
    file.json["nodes"][0]["matrix"][15] = json!(0.9999999);
    assert_eq!(world(&file.load()), [[a_b_c[0], a_b_c[2], a_b_c[1]]]);
    file.json["nodes"][0]["matrix"][3] = json!(0.1);
    assert_eq!(refused_at(&file), "/nodes/0/matrix");
}

#[test]
fn shading_normals_stay_on_the_front() {
    let sloped = Vec3::new(1.0, 1.0, 0.0).normalize();
    // Normals transform with the inverse transpose: (1/2, 1, 0) for a scale of 2 along x. A mirrored normal stays on
    // the front of the flipped triangle. A scale of zero leaves the normal along the remaining axis.
    for (scale, expected) in [
        ([2.0, 1.0, 1.0], Vec3::new(0.5, 1.0, 0.0).normalize()),
        ([-2.0, 1.0, 1.0], Vec3::new(-0.5, 1.0, 0.0).normalize()),
        ([1e-100, 1e-100, 1e-100], sloped),
        ([1.0, 0.0, 1.0], Vec3::Y),
    ] {
        let mut file = File::new();
        let normals = file.floats(&[sloped.to_array(); 3]);
        file.mesh(&[[0., 0., 0.], [0., 0., 4.], [4., -4., 0.]], json!({ "attributes": { "NORMAL": normals } }));
        file.json["nodes"][0]["scale"] = json!(scale);
        let scene = file.load();
        for vertex in scene.vertices.iter() {
            // Rounding of three f32 components.
            assert!((vertex.normal - expected).length() < 1e-6, "scale {scale:?} gives {}", vertex.normal);
        }
        for i in 0..scene.triangles.len() {
            let [a, b, c] = scene.triangle_positions(i);
            let geometric = (b - a).cross(c - a);
            assert!(geometric.dot(expected) > 0.0, "scale {scale:?}: {geometric} against {expected}");
        }
    }
}

#[test]
fn tangents_follow_the_surface_and_a_mirror_flips_their_handedness() {
    let mut file = File::new();
    let tangents = file.floats(&[[1., 0., 0., 1.], [1., 0., 0., 1.], [0., 1., 0., -1.]]);
    let attributes = json!({ "NORMAL": file.floats(&[[0f32, 0., 1.]; 3]), "TANGENT": tangents });
    file.mesh(&[[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]], json!({ "attributes": attributes }));
    file.json["nodes"][0]["scale"] = json!([-3, 1, 1]);
    let tangents: Vec<Vec4> = file.load().vertices.iter().map(|v| v.tangent).collect();
    // Vertices are in the order of their first use, which the mirror reverses.
    assert_eq!(tangents, [Vec4::new(-1., 0., 0., -1.), Vec4::new(0., 1., 0., 1.), Vec4::new(-1., 0., 0., -1.)]);
    // Without normals they must be ignored (glTF 3.7.2.1).
    let attributes = file.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap();
    attributes.remove("NORMAL");
    assert!(file.load().vertices.iter().all(|vertex| vertex.tangent == Vec4::ZERO));
}

#[test]
fn zero_scales_flatten_and_what_has_no_area_is_dropped() {
    // A scale of zero along the normal keeps the triangle.
    let mut file = File::triangle();
    file.json["nodes"][0]["scale"] = json!([1, 1, 0]);
    assert_eq!(world(&file.load()), [[[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]]]);
    // A triangle that becomes a line or a point is dropped, with one note.
    for scale in [json!([1, 0, 1]), json!([0, 0, 0])] {
        file.json["nodes"][0]["scale"] = scale;
        let scene = file.load();
        assert!(scene.triangles.is_empty() && scene.vertices.is_empty());
        assert_eq!(scene.notes.iter().filter(|n| n.contains("1 triangle has no area")).count(), 1);
    }
}

#[test]
fn slivers_stay_and_degenerate_triangles_go() {
    // An aspect of 1e6; then a repeated corner, and three corners on one line.
    let mut file = File::new();
    file.mesh(
        &[
            [0., 0., 0.],
            [1., 0., 0.],
            [0.5, 1e-6, 0.],
            [0., 0., 0.],
            [0., 0., 0.],
            [1., 0., 0.],
            [0., 0., 0.],
            [1., 1., 1.],
            [2., 2., 2.],
        ],
        json!({}),
    );
    let scene = file.load();
    assert_eq!(scene.triangles.len(), 1);
    assert!(scene.notes.iter().any(|n| n.contains("2 triangles have no area")), "{:?}", scene.notes);
    let [a, b, c] = scene.triangle_positions(0);
    assert!((b - a).cross(c - a).normalize().is_finite());
}

/// Two triangles of size 1 at a large distance. There are notes on objects that are small for their scene, and on
/// triangles that are rounded to nothing. Small lamps are fine.
#[test]
fn objects_too_small_for_their_scene_are_noted() {
    let noted = |apart: f64, emits: bool| {
        let mut file = File::triangle();
        file.json["nodes"][0]["scale"] = json!([0.25, 0.25, 0.25]);
        let mut second = file.json["nodes"][0].clone();
        second["translation"] = json!([apart, 0.0, 0.0]);
        file.add("nodes", second);
        if emits {
            file.json["materials"] = json!([{ "emissiveFactor": [1, 1, 1] }]);
            file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
        }
        let notes = file.load().notes;
        let has = |text: &str| notes.iter().any(|note| note.starts_with(text));
        [has("2 objects are less than 1e-4"), has("2 triangles are below 6e-8"), has("2 triangles have no area")]
    };
    assert_eq!(noted(1e3, false), [false; 3]);
    assert_eq!(noted(1e5, false), [true, false, false]);
    assert_eq!(noted(1e12, false), [true, true, false]);
    assert_eq!(noted(1e5, true), [false; 3]);
}

/// World coordinates end before the scale of normalisation does.
#[test]
fn scenes_beyond_normalisation_are_refused() {
    let mut file = File::triangle();
    file.json["nodes"][0]["scale"] = json!([1e290, 1e290, 1e290]);
    let corners = file.load().triangle_positions(0);
    assert!(corners.iter().all(|corner| corner.length() <= 1.0), "{corners:?}");
    file.json["nodes"][0]["scale"] = json!([1e305, 1e305, 1e305]);
    assert_eq!(refused_at(&file), "/nodes/0");
}

#[test]
fn normalisation_is_independent_of_position_and_scale() {
    let mut file = File::new();
    file.mesh(&[[-1., -2., 0.5], [3., 0.25, 0.], [0., 2., 7.]], json!({}));
    let plain = file.load();
    let radius = plain.vertices.iter().map(|v| v.position.length()).fold(0.0, f32::max);
    assert!(radius > 0.5 && radius <= 1.0, "{radius}");
    // Scales by powers of two keep all bits, and so does a translation by 2^20 m, which is exact in f64.
    for node in [
        json!({ "mesh": 0, "scale": [1048576, 1048576, 1048576] }),
        json!({ "mesh": 0, "scale": [2f64.powi(-40), 2f64.powi(-40), 2f64.powi(-40)] }),
        json!({ "mesh": 0, "translation": [1048576.0, -1048576.0, 1048576.0] }),
    ] {
        file.json["nodes"][0] = node.clone();
        let moved = file.load();
        assert_eq!(moved.vertices, plain.vertices, "{node}");
    }
    // 1e6 m and 0.1: f32 would round the translation to 1/16.
    file.json["nodes"][0] = json!({ "mesh": 0, "translation": [1e6 + 0.1, 0, 0] });
    let centre = file.load().normalisation.centre;
    // A unit in the last place of f64 is 1.2e-10 at 1e6.
    assert!((centre - DVec3::new(1e6 + 1.1, 0.0, 3.5)).length() < 1e-9, "{centre}");
}

#[test]
fn a_radius_that_is_a_power_of_two_becomes_one() {
    for radius in [1.0f32, 2.0, 1024.0, 2f32.powi(-30)] {
        let mut file = File::new();
        file.mesh(
            &[[-radius, 0., 0.], [radius, 0., 0.], [0., radius / 2., 0.], [0., -radius / 2., 0.]],
            json!({ "mode": 5 }),
        );
        let scene = file.load();
        assert_eq!(scene.normalisation.scale() * f64::from(radius), 1.0);
    }
}

#[test]
fn only_the_selected_scene_is_rendered() {
    let mut file = File::triangle();
    file.mesh(&[[0., 0., 0.], [8., 0., 0.], [0., 8., 0.]], json!({}));
    let far = |file: &File| world(&file.load()).iter().map(|t| t[1][0]).collect::<Vec<_>>();
    // Without scenes all roots are rendered, otherwise `scene` or the first scene.
    assert_eq!(far(&file), [4., 8.]);
    file.json["scenes"] = json!([{ "nodes": [1] }, { "nodes": [0] }]);
    assert_eq!(far(&file), [8.]);
    file.json["scene"] = json!(1);
    assert_eq!(far(&file), [4.]);
    assert!(file.load().notes.iter().any(|n| n.contains("scene 1 of 2")));
}

#[test]
fn a_mesh_is_instanced_and_vertices_are_shared() {
    let mut file = File::new();
    let indices = file.accessor(&[0, 1, 2, 1, 3, 2], U8, "SCALAR", 6);
    // The fifth vertex belongs to no triangle.
    file.mesh(&FIVE, json!({ "indices": indices }));
    file.add("nodes", json!({ "mesh": 0, "translation": [0, 0, 1] }));
    let scene = file.load();
    assert_eq!((scene.triangles.len(), scene.vertices.len()), (4, 8));
    assert_eq!(world(&scene)[2], [[0., 0., 1.], [2., 0., 1.], [0., 2., 1.]]);
}

#[test]
fn primitives_that_share_vertices_copy_only_their_own() {
    let mut file = File::triangle();
    let positions: Vec<[f32; 3]> = (0..20_000u32).map(|i| [i as f32, (i * i % 7) as f32, 0.0]).collect();
    let shared = file.floats(&positions);
    // Three consecutive vertices are never collinear: i^2 has second difference 2.
    let corners = |i: u16| [3 * i + 2, 3 * i, 3 * i + 1];
    let primitives: Vec<_> = (0..5_000)
        .map(|i| {
            let bytes: Vec<u8> = corners(i).iter().flat_map(|c| c.to_le_bytes()).collect();
            let indices = file.accessor(&bytes, U16, "SCALAR", 3);
            json!({ "attributes": { "POSITION": shared }, "indices": indices })
        })
        .collect();
    file.json["meshes"][0]["primitives"] = json!(primitives);
    let scene = file.load();
    let expected = |i: u16| corners(i).map(|c| positions[c as usize].map(f64::from));
    for (i, triangle) in world(&scene).into_iter().enumerate() {
        // Positions of up to 2e4 in f32: half a unit in the last place is 1e-3, for each of two roundings.
        let distance = |c: usize| DVec3::from(triangle[c]).distance(expected(i as u16)[c].into());
        assert!((0..3).all(|c| distance(c) < 2e-3), "triangle {i}: {triangle:?}");
    }
    assert_eq!((scene.triangles.len(), scene.vertices.len()), (5_000, 15_000));
}

#[test]
fn scenes_without_geometry_are_empty() {
    let mut file = File::new();
    assert!(file.load().triangles.is_empty());
    file.add("nodes", json!({}));
    file.add("scenes", json!({ "nodes": [0] }));
    let scene = file.load();
    assert!(scene.triangles.is_empty() && scene.bounds().is_none());
    assert_eq!(scene.normalisation.scale(), 1.0);
    assert!(scene.notes.iter().any(|n| n == "no camera in the scene"));
    assert!(scene.notes.iter().any(|n| n == "no light in the file: `default_light` adds one"));
    let scene = file.load_with(&ImportOptions { default_light: true, ..Default::default() }).unwrap();
    let note = "no light in the file, and `default_light` adds none because nothing would be lit";
    assert!(scene.notes.iter().any(|n| n == note));
}
