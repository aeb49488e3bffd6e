//! Files of other projects in `PENUMBRA_SHARED`: malformed and unusual files of the glTF validator, and models.

use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use glam::{DMat4, DVec3, Vec3};
use penumbra::Error;
use penumbra::internal::scene::{ImportOptions, LightKind, NO_LIGHT, Projection, Scene};
use serde_json::Value;

use crate::shared_files::shared_files;

/// Errors of the validator that do not affect the image: prefix of the code, part of the pointer (or, after `=`, the
/// whole pointer), and reason.
const IRRELEVANT: &[(&str, &str, &str)] = &[
    ("ACCESSOR_ELEMENT_OUT_OF", "", "declared bounds are not used: positions are"),
    ("ACCESSOR_JOINTS", "", "of points, which are not shown"),
    ("ACCESSOR_MATRIX_ALIGNMENT", "", "matrices only occur in skins, as floats"),
    ("ACCESSOR_MAX_MISMATCH", "", "declared bounds are not used: positions are"),
    ("ACCESSOR_MIN_MISMATCH", "", "declared bounds are not used: positions are"),
    ("ACCESSOR_WEIGHTS", "", "of points, which are not shown"),
    ("ANIMATION_SAMPLER_ACCESSOR_WITH_BYTESTRIDE", "", "a stride that is stated can be followed"),
    ("BUFFER_DATA_URI_MIME_TYPE_INVALID", "", "bytes are bytes, whatever they are called"),
    ("BUFFER_VIEW_INVALID_BYTE_STRIDE", "", "a stride that is stated can be followed"),
    ("DUPLICATE_ELEMENTS", "extensions", "said twice, meant once"),
    ("EMPTY_ENTITY", "=/animations", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/buffers", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/cameras", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/images", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/meshes", "an empty list of things is no thing"),
    ("EMPTY_ENTITY", "=/nodes", "an empty list of things is no thing"),
    ("IMAGE_MIME_TYPE_INVALID", "", "an image is what its bytes say"),
    ("IMAGE_NON_ENABLED_MIME_TYPE", "", "nothing shows the image"),
    ("INVALID_URI", "/images/0/uri", "a wrong media type only: an image is what its bytes say"),
    ("MESH_PRIMITIVE_ACCESSOR_WITHOUT_BYTESTRIDE", "", "elements without a stride are tightly packed"),
    ("MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_UNSIGNED_INT", "_CUSTOM_ATTR", "custom attribute"),
    ("MESH_PRIMITIVE_INVALID_ATTRIBUTE", "UNKNOWN", "custom attribute"),
    ("MESH_PRIMITIVE_NO_TANGENT_SPACE", "", "tangent space of an extension that is not shown"),
    ("MESH_PRIMITIVE_TOO_FEW_TEXCOORDS", "", "the textures of these files have no image"),
    ("MESH_PRIMITIVE_POSITION_ACCESSOR_WITHOUT_BOUNDS", "targets", "declared bounds are not used: positions are"),
    ("NON_REQUIRED_EXTENSION", "", "the extension is supported, required or not"),
    ("SCENE_NON_ROOT_NODE", "", "the scene starts at the node it lists, and a note says so"),
    ("SKIN_IBM_ACCESSOR_WITH_BYTESTRIDE", "", "a stride that is stated can be followed"),
    ("SKIN_NO_COMMON_ROOT", "", "a joint has its own matrix, whatever its root"),
    ("SKIN_SKELETON_INVALID", "", "a joint has its own matrix, whatever its root"),
    ("TYPE_MISMATCH", "/extensions/KHR_invalid", "payload of an unknown extension"),
    ("UNDECLARED_EXTENSION", "", "what is there and known is shown, declared or not"),
    ("UNEXPECTED_EXTENSION_OBJECT", "", "an extension in a place where it means nothing"),
    ("VALUE_NOT_IN_RANGE", "KHR_materials_volume", "the extension is not shown"),
];

fn matters(message: &Value) -> bool {
    let (code, pointer) = (message["code"].as_str().unwrap(), message["pointer"].as_str().unwrap_or(""));
    let is_at = |part: &str| part.strip_prefix('=').map_or(pointer.contains(part), |whole| pointer == whole);
    message["severity"] == 0 && !IRRELEVANT.iter().any(|(c, part, _)| code.starts_with(c) && is_at(part))
}

/// A file that takes longer than this to load is a loop or a decompression bomb. Each file needs milliseconds, but a
/// busy machine has been seen to pause for five seconds.
const HANGING: Duration = Duration::from_secs(120);

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
        let (sender, receiver) = channel();
        let loaded = file.clone();
        std::thread::spawn(move || {
            // Nobody waits any more for what comes too late.
            let _ = sender.send(Scene::load(&loaded, &ImportOptions::default()));
        });
        let legal = report["issues"]["numErrors"] == 0;
        match receiver.recv_timeout(HANGING) {
            Err(RecvTimeoutError::Disconnected) => failures.push(format!("{}: panicked", file.display())),
            Err(RecvTimeoutError::Timeout) => failures.push(format!("{}: loads without end", file.display())),
            Ok(Err(error)) if legal => failures.push(format!("legal, but: {error}")),
            Ok(Ok(_)) if !errors.is_empty() => failures.push(format!("{}: loaded despite {errors:?}", file.display())),
            Ok(Err(Error::Input { file: named, location, problem })) => {
                // The same location, a parent or a child of it. Locations in the container are byte offsets on both
                // sides.
                let is_at = |error: &&Value| match error["pointer"].as_str() {
                    Some(pointer) => location.starts_with(pointer) || pointer.starts_with(&location),
                    None => location == "file" || location.starts_with("byte "),
                };
                let right = errors.is_empty() || errors.iter().any(is_at);
                if named != file || location.is_empty() || problem.contains('\n') || !right {
                    failures.push(format!("{}: names {} {location}: {problem}", file.display(), named.display()));
                }
            }
            Ok(Err(error)) => failures.push(format!("{}: not an input error: {error}", file.display())),
            Ok(Ok(_)) => {}
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Triangles in world space, read by the `gltf` crate, in the order of nodes.
fn triangles_by_another_reader(path: &Path) -> Vec<[DVec3; 3]> {
    let gltf::Gltf { document, blob } = gltf::Gltf::open(path).unwrap();
    let read = |buffer: gltf::Buffer| match buffer.source() {
        gltf::buffer::Source::Bin => blob.clone().unwrap(),
        gltf::buffer::Source::Uri(uri) => std::fs::read(path.with_file_name(uri)).unwrap(),
    };
    let buffers: Vec<Vec<u8>> = document.buffers().map(read).collect();
    let mut world = vec![None; document.nodes().len()];
    let mut open: Vec<(gltf::Node, DMat4)> =
        document.default_scene().unwrap().nodes().map(|node| (node, DMat4::IDENTITY)).collect();
    while let Some((node, above)) = open.pop() {
        let columns = node.transform().matrix();
        let matrix = above * DMat4::from_cols_array_2d(&columns.map(|column| column.map(f64::from)));
        world[node.index()] = Some(matrix);
        open.extend(node.children().map(|child| (child, matrix)));
    }
    let mut triangles = Vec::new();
    let worlds = world;
    for (node, matrix) in document.nodes().zip(worlds.iter().copied()) {
        let (Some(mesh), Some(matrix)) = (node.mesh(), matrix) else { continue };
        for primitive in mesh.primitives() {
            assert_eq!(primitive.mode(), gltf::mesh::Mode::Triangles);
            let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
            let read = reader.read_positions().unwrap().map(|p| Vec3::from(p).as_dvec3());
            let positions: Vec<DVec3> = match node.skin() {
                None => read.map(|p| matrix.transform_point3(p)).collect(),
                Some(skin) => {
                    let bind = skin.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
                    let bind =
                        bind.read_inverse_bind_matrices().unwrap().map(|m| m.map(|column| column.map(f64::from)));
                    let joints = skin.joints().zip(bind);
                    let joints: Vec<DMat4> = joints
                        .map(|(joint, bind)| worlds[joint.index()].unwrap() * DMat4::from_cols_array_2d(&bind))
                        .collect();
                    let numbers = reader.read_joints(0).unwrap().into_u16();
                    let weights = reader.read_weights(0).unwrap().into_f32();
                    let influences = numbers.zip(weights);
                    read.zip(influences)
                        .map(|(p, (numbers, weights))| {
                            let parts = numbers.iter().zip(weights);
                            let part = |(joint, weight): (&u16, f32)| {
                                f64::from(weight) * joints[usize::from(*joint)].transform_point3(p)
                            };
                            let total: f64 = weights.iter().map(|weight| f64::from(*weight)).sum();
                            parts.map(part).sum::<DVec3>() / total
                        })
                        .collect()
                }
            };
            let indices: Vec<usize> = match reader.read_indices() {
                Some(indices) => indices.into_u32().map(|i| i as usize).collect(),
                None => (0..positions.len()).collect(),
            };
            for &[a, b, c] in indices.as_chunks::<3>().0 {
                let (b, c) = if matrix.determinant() < 0.0 { (c, b) } else { (b, c) };
                triangles.push([a, b, c].map(|i| positions[i]));
            }
        }
    }
    triangles
}

#[test]
fn models_agree_with_another_reader() {
    let Some(files) = shared_files("models", &["gltf", "glb"]) else { return };
    for file in files {
        let scene = Scene::load(&file, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let radius = 1.0 / scene.normalisation.scale();
        // The other reader's matrices and our positions are f32, with a relative error of 6e-8 each.
        let tolerance = 1e-6 * (radius + scene.normalisation.centre.length());
        let mut ours = (0..scene.triangles.len())
            .map(|i| scene.triangle_positions(i).map(|p| scene.normalisation.undo(p)))
            .peekable();
        for [a, b, c] in triangles_by_another_reader(&file) {
            let is_same = |ours: &[DVec3; 3]| ours.iter().zip([a, b, c]).all(|(p, q)| p.distance(q) <= tolerance);
            if ours.next_if(is_same).is_none() {
                // A triangle that we dropped must have no area.
                let height = (b - a).cross(c - a).length() / (b - a).length().max((c - a).length()).max(tolerance);
                assert!(height <= tolerance, "{}: lacks {a} {b} {c}", file.display());
            }
        }
        assert!(ours.next().is_none(), "{}: has triangles that are not in the file", file.display());
        // All indices are in range.
        for triangle in &scene.triangles {
            assert!(triangle.vertices.iter().all(|v| (*v as usize) < scene.vertices.len()));
            assert!((triangle.material as usize) < scene.materials.len());
        }
        let farthest = scene.vertices.iter().map(|v| v.position.length()).fold(0.0, f32::max);
        assert!(farthest > 0.5 && farthest <= 1.0 + f32::EPSILON, "{}: {farthest}", file.display());
        assert!(scene.vertices.iter().all(|v| v.normal == Vec3::ZERO || v.normal.is_normalized()));
    }
}

#[test]
fn the_reference_box_matches_its_description() {
    let Some(files) = shared_files("reference", &["glb"]) else { return };
    let list: Value = serde_json::from_slice(&std::fs::read(files[0].with_extension("json")).unwrap()).unwrap();
    let scene = Scene::load(&files[0], &ImportOptions::default()).unwrap();
    let numbers = |value: &Value| DVec3::from_array([0, 1, 2].map(|i| value[i].as_f64().unwrap()));
    // Rounding of f32 positions of a few metres.
    const TOLERANCE: f64 = 1e-6;
    let parts = list["parts"].as_array().unwrap();
    let listed = parts.iter().flat_map(|part| part["indices"].as_array().unwrap().iter().map(move |t| (part, t)));
    assert_eq!(listed.clone().count(), scene.triangles.len());
    for (i, (part, triangle)) in listed.enumerate() {
        for (corner, position) in scene.triangle_positions(i).into_iter().enumerate() {
            let expected = numbers(&part["positions"][triangle[corner].as_u64().unwrap() as usize]);
            assert!(scene.normalisation.undo(position).distance(expected) < TOLERANCE, "{} {triangle}", part["name"]);
        }
        assert_eq!(scene.triangles[i].light != NO_LIGHT, !part["emit"].is_null());
    }
    let [camera] = &scene.cameras[..] else { panic!("{:?}", scene.cameras) };
    let eye = scene.normalisation.undo(camera.position);
    assert!(eye.distance(numbers(&list["camera"]["eye"])) < TOLERANCE, "{eye}");
    let Projection::Perspective { yfov, .. } = camera.projection else { panic!("{camera:?}") };
    // An angle in f32, rounded in radians and in degrees by a relative 6e-8 each.
    assert!((f64::from(yfov.to_degrees()) - list["camera"]["yfov_deg"].as_f64().unwrap()).abs() < 1e-5);
    let [light] = &scene.lights[..] else { panic!("{:?}", scene.lights) };
    let LightKind::Mesh { emitters, .. } = &light.kind else { panic!("{light:?}") };
    let emitted = parts.iter().find(|part| !part["emit"].is_null()).map(|part| numbers(&part["emit"]).as_vec3());
    assert_eq!(emitters.len(), 2);
    // A factor up to 1 times a strength, both rounded to f32.
    assert!(emitters.iter().all(|e| e.radiance.distance(emitted.unwrap()) < 1e-5), "{emitters:?}");
}
