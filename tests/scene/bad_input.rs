//! Bad input causes an error with the file and the location of the problem, never a panic.

use std::path::Path;

use penumbra::internal::scene::{ImportOptions, Scene};
use penumbra::{Error, Result};
use serde_json::json;

use crate::builder::{F32, File, U8, U16, U32, bytes_of, png, temporary};

/// The location of the input error `outcome`. The file of the error must be `path`.
fn location(outcome: Result<Scene>, path: Option<&Path>) -> String {
    let error = outcome.expect_err("must be refused");
    assert_eq!(error.exit_code(), 3, "{error}");
    assert!(!error.to_string().contains('\n'), "{error}");
    match error {
        Error::Input { file, location, .. } => {
            assert!(path.is_none_or(|path| path == file));
            location
        }
        other => panic!("{other}"),
    }
}

fn load(path: &Path) -> Result<Scene> {
    Scene::load(path, &ImportOptions::default())
}

/// The location of the error that the file is refused with.
pub fn refused_at(file: &File) -> String {
    location(file.load_with(&ImportOptions::default()), None)
}

fn refused_bytes(bytes: &[u8], extension: &str) -> String {
    let path = temporary(extension);
    std::fs::write(&path, bytes).unwrap();
    location(load(&path), Some(&path))
}

#[test]
fn files_of_other_kinds_are_refused() {
    let path = temporary("glb");
    assert_eq!(location(load(&path), Some(&path)), "file");
    std::fs::create_dir(&path).unwrap();
    assert_eq!(location(load(&path), Some(&path)), "file");
    assert_eq!(refused_bytes(b"", "glb"), "file");
    assert_eq!(refused_bytes(b"", "gltf"), "file");
    assert_eq!(refused_bytes(b"solid teapot", "gltf"), "file");
    assert_eq!(refused_bytes(b"solid teapot", "glb"), "byte 0");
    // Nested deeper than a recursive parser could follow.
    assert_eq!(refused_bytes("[".repeat(1 << 20).as_bytes(), "gltf"), "file");
    #[cfg(unix)]
    assert_eq!(location(load(Path::new("/dev/zero")), None), "file");
}

#[test]
fn a_glb_cut_anywhere_is_refused() {
    let glb = File::triangle().glb();
    for length in 0..glb.len() {
        refused_bytes(&glb[..length], "glb");
        // With a matching length in the header.
        if length >= 12 {
            let mut cut = glb[..length].to_vec();
            cut[8..12].copy_from_slice(&(length as u32).to_le_bytes());
            let path = temporary("glb");
            std::fs::write(&path, cut).unwrap();
            location(load(&path), Some(&path));
        }
    }
}

#[test]
fn no_wrong_byte_causes_a_panic() {
    // The outcome depends on the byte. Only panics and hangs are failures.
    let glb = File::triangle().glb();
    let path = temporary("glb");
    for i in 0..glb.len() {
        for flip in [0x01, 0x80, 0xff] {
            let mut damaged = glb.clone();
            damaged[i] ^= flip;
            std::fs::write(&path, damaged).unwrap();
            let outcome = load(&path);
            assert!(outcome.is_ok() || matches!(outcome, Err(Error::Input { .. })));
        }
    }
}

#[test]
fn structure() {
    let refused = |edit: &dyn Fn(&mut File)| {
        let mut file = File::triangle();
        edit(&mut file);
        refused_at(&file)
    };
    const POSITION: &str = "/meshes/0/primitives/0/attributes/POSITION";
    const MANY: u64 = u64::MAX;
    assert_eq!(refused(&|f| f.json["asset"]["version"] = json!("1.0")), "/asset/version");
    // Ranges, counts and strides, some of which overflow.
    assert_eq!(refused(&|f| f.json["accessors"][0]["count"] = json!(4)), "/accessors/0");
    assert_eq!(refused(&|f| f.json["accessors"][0]["count"] = json!(0)), "/accessors/0/count");
    assert_eq!(refused(&|f| f.json["accessors"][0]["count"] = json!(MANY)), "/accessors/0");
    assert_eq!(refused(&|f| f.json["accessors"][0]["byteOffset"] = json!(MANY - 3)), "/accessors/0");
    assert_eq!(refused(&|f| f.json["accessors"][0]["byteOffset"] = json!(2)), "/accessors/0");
    assert_eq!(refused(&|f| f.json["accessors"][0]["componentType"] = json!(5124)), "/accessors/0/componentType");
    assert_eq!(refused(&|f| f.json["accessors"][0]["type"] = json!("VEC2")), POSITION);
    assert_eq!(refused(&|f| f.json["bufferViews"][0]["byteLength"] = json!(MANY)), "/bufferViews/0");
    assert_eq!(refused(&|f| f.json["bufferViews"][0]["byteOffset"] = json!(MANY)), "/bufferViews/0");
    assert_eq!(refused(&|f| f.json["bufferViews"][0]["byteStride"] = json!(8)), "/accessors/0");
    assert_eq!(refused(&|f| f.json["bufferViews"][0]["byteStride"] = json!(0)), "/bufferViews/0/byteStride");
    let zero_filled = json!({ "componentType": 5126, "type": "VEC3", "count": 50_000_000_000u64 });
    assert_eq!(refused(&|f| f.json["accessors"][0] = zero_filled.clone()), "/accessors/0");
    assert_eq!(refused(&|f| f.json["accessors"][0]["count"] = json!(-1)), "/accessors/0/count");
    // Each primitive is within its limits, but their sum is not.
    let many = |f: &mut File| {
        let indices = f.accessor(&[0; 1 << 22], U8, "SCALAR", 1 << 22);
        f.json["meshes"][0]["primitives"] =
            json!(vec![json!({ "attributes": { "POSITION": 0 }, "indices": indices }); 100]);
    };
    assert_eq!(refused(&many), "/meshes/0/primitives/24");
    // Indices.
    for (component, bytes) in [(U8, &[0u8, 1, 3][..]), (U16, &[0, 0, 1, 0, 255, 255]), (U32, &[255; 12])] {
        let edit = |f: &mut File| {
            let indices = f.accessor(bytes, component, "SCALAR", 3);
            f.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
        };
        assert_eq!(refused(&edit), "/meshes/0/primitives/0/indices");
    }
    assert_eq!(refused(&|f| f.json["meshes"][0]["primitives"][0]["indices"] = json!(0)), "/accessors/0");
    assert_eq!(refused(&|f| f.json["meshes"][0]["primitives"][0]["mode"] = json!(7)), "/meshes/0/primitives/0/mode");
    assert_eq!(refused(&|f| f.json["materials"] = json!([{ "alphaMode": "mask" }])), "/materials/0/alphaMode");
    // An attribute of another length.
    let short = |f: &mut File| {
        let normals = f.floats(&[[0f32, 0., 1.]; 2]);
        f.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(normals);
    };
    assert_eq!(refused(&short), "/meshes/0/primitives/0/attributes/NORMAL");
    // Sparse indices that do not increase, and one beyond the end.
    for indices in [[1u8, 1], [1, 3]] {
        let edit = |f: &mut File| {
            let (at, values) = (f.view(&indices), f.view(&bytes_of(&[[0f32; 3]; 2])));
            f.json["accessors"][0]["sparse"] = json!({
                "count": 2, "values": { "bufferView": values }, "indices": { "bufferView": at, "componentType": U8 }
            });
        };
        assert_eq!(refused(&edit), "/accessors/0/sparse/indices");
    }
    // A texture needs coordinates.
    let no_uv = |f: &mut File| {
        let view = f.view(&png(1, 1, &[[0; 4]]));
        f.add("images", json!({ "bufferView": view }));
        f.add("textures", json!({ "source": 0 }));
        f.add("materials", json!({ "emissiveTexture": { "index": 0, "texCoord": 1 } }));
        f.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    };
    assert_eq!(refused(&no_uv), "/meshes/0/primitives/0");
    // Counts of vertices whose sum would overflow.
    let many = |f: &mut File| {
        let accessor = f.add("accessors", json!({ "type": "X", "componentType": F32, "count": u64::MAX }));
        let primitive = json!({ "attributes": { "POSITION": accessor } });
        f.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(primitive);
    };
    assert_eq!(refused(&many), "/meshes/0/primitives/1");
    // Extensions.
    let required = json!(["KHR_gaussian_splatting"]);
    assert_eq!(refused(&|f| f.json["extensionsRequired"] = required.clone()), "/extensionsRequired/0");
}

/// A small file may refer to the same data many times. The cost must not be the product.
#[test]
fn shared_data_is_counted_or_kept_once() {
    // Elements without data, more than any other attribute has.
    let mut file = File::triangle();
    file.json["accessors"][0] = json!({ "componentType": 5126, "type": "VEC3", "count": 1 << 20 });
    assert_eq!(refused_at(&file), "/accessors/0");
    file.view(&[0; 1 << 20]);
    assert_eq!(file.load().triangles.len(), 0, "a file of that size may have as many");

    // A lamp of 10,000 triangles in 10,000 nodes, refused before any of them is transformed: each is another light.
    let mut file = File::triangle();
    let indices = file.accessor(&[0u8, 1, 2].repeat(10_000), U8, "SCALAR", 30_000);
    file.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let lamp = file.add("materials", json!({ "emissiveFactor": [1, 1, 1] }));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(lamp);
    file.json["nodes"] = json!(vec![json!({ "mesh": 0 }); 10_000]);
    assert_eq!(refused_at(&file), "/nodes/3355");

    // 1,000 sparse accessors with the same indices. 100 of them replace more elements than a scene may have corners.
    let mut file = File::triangle();
    let count = 1 << 20;
    let indices = file.view(&(0..count).flat_map(u32::to_le_bytes).collect::<Vec<_>>());
    let values = file.view(&vec![0; 4 * count as usize]);
    let sparse = json!({
        "count": count, "indices": { "bufferView": indices, "componentType": U32 }, "values": { "bufferView": values }
    });
    let accessor = json!({ "componentType": U32, "type": "SCALAR", "count": count, "sparse": sparse });
    file.json["accessors"].as_array_mut().unwrap().extend(vec![accessor; 1000]);
    assert_eq!(refused_at(&file), "/accessors/97/sparse");

    // A hundred images with the same bytes are decoded once.
    let mut file = File::triangle();
    let view = file.view(&png(2, 2, &[[1, 2, 3, 255]; 4]));
    let coordinates = file.floats(&[[0f32, 0.]; 3]);
    file.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(coordinates);
    for i in 0..100 {
        file.add("images", json!({ "bufferView": view }));
        file.add("textures", json!({ "source": i }));
        file.add("materials", json!({ "emissiveTexture": { "index": i } }));
    }
    let scene = file.load();
    assert_eq!((scene.images.len(), scene.textures.len(), scene.materials.len()), (1, 1, 101), "with the default one");
}

/// Import time must not grow with the square of the number of objects in a file.
#[test]
fn many_of_a_kind_are_read_in_time() {
    // As many different names of extensions as fit in 2 MB. Each used to be compared with all before it.
    let mut file = File::triangle();
    file.json["extensionsUsed"] = (0..200_000).map(|i| json!(format!("A{i}"))).collect();
    let notes = file.load().notes;
    assert_eq!(notes.len(), 101, "a hundred, and the number of the others");
    assert!(notes.last().unwrap().starts_with("1999"), "{notes:?}");
    // Primitives of 1,000 emissive materials in 40 nodes, each a light of its own. They used to be moved and searched
    // one by one.
    let mut file = File::triangle();
    file.json["materials"] = json!(vec![json!({ "emissiveFactor": [1, 1, 1] }); 1000]);
    file.json["meshes"][0]["primitives"] =
        (0..1000).map(|m| json!({ "attributes": { "POSITION": 0 }, "material": m })).collect();
    file.json["nodes"] = json!(vec![json!({ "mesh": 0 }); 40]);
    assert_eq!(file.load().lights.len(), 40_000);
}

/// Text from a file is shown on one line, without control characters and with a limited length. Names are shortened,
/// because many objects may copy them.
#[test]
fn text_from_files_is_printable() {
    let long = format!("evil\u{1b}[2J\n{}", "x".repeat(1 << 20));
    let mut file = File::triangle();
    file.json["nodes"][0]["name"] = json!(long);
    file.json["extensionsUsed"] = json!([long]);
    file.json["materials"] = json!([{ "emissiveFactor": [1, 1, 1] }]);
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let scene = file.load();
    for words in [&scene.lights[0].name, &scene.notes[0]] {
        assert!(words.contains("evil") && !words.contains(char::is_control) && words.len() < 1000, "{words}");
    }
    file.json["extensionsRequired"] = json!([long]);
    let error = file.load_with(&ImportOptions::default()).unwrap_err().to_string();
    assert!(!error.contains(char::is_control) && error.len() < 2000, "{error}");
}

/// JSON takes more memory than its text. The number of values is checked before parsing.
#[test]
fn json_of_too_many_values_is_refused() {
    let mut text = b"{\"asset\":{\"version\":\"2.0\"},\"extras\":[\"".to_vec();
    // Characters in a string are not values, escaped or not.
    text.extend(b",[{:\\\",".repeat(1 << 21));
    text.extend(b"\"");
    let loaded = [text.as_slice(), b"]}"].concat();
    let path = temporary("gltf");
    std::fs::write(&path, loaded).unwrap();
    load(&path).unwrap();
    text.extend(b",0".repeat(1 << 23));
    text.extend(b"]}");
    assert_eq!(refused_bytes(&text, "gltf"), "file");
}

#[test]
fn an_unknown_extension_that_is_only_used_is_noted_once() {
    let mut file = File::triangle();
    file.json["extensionsUsed"] = json!(["ACME_bubbles", "KHR_texture_transform", "ACME_bubbles"]);
    let notes = file.load().notes;
    assert_eq!(notes.iter().filter(|n| n.contains("ACME_bubbles")).count(), 1, "{notes:?}");
    assert!(!notes.iter().any(|n| n.contains("KHR_texture_transform")));
}

#[test]
fn nodes() {
    let refused = |nodes: serde_json::Value| {
        let mut file = File::triangle();
        file.json["nodes"] = nodes;
        refused_at(&file)
    };
    assert_eq!(refused(json!([{ "children": [0] }])), "/nodes/0");
    // The error is at a node of the loop, not at a descendant of it.
    assert_eq!(refused(json!([{}, { "children": [2, 3] }, { "children": [1] }, {}])), "/nodes/1");
    assert_eq!(refused(json!([{ "children": [2] }, { "children": [2] }, {}])), "/nodes/1/children/0");
    assert_eq!(refused(json!([{ "children": [1, 1] }, {}])), "/nodes/0/children/1");
    assert_eq!(refused(json!([{ "mesh": 1 }])), "/nodes/0/mesh");
    assert_eq!(refused(json!([{ "rotation": [0, 0, 0, 0] }])), "/nodes/0/rotation");
    assert_eq!(refused(json!([{ "scale": [1, 1] }])), "/nodes/0/scale");
    // Products that overflow f64.
    let big = json!([1e200, 1e200, 1e200]);
    assert_eq!(refused(json!([{ "scale": big, "children": [1] }, { "scale": big, "mesh": 0 }])), "/nodes/1");
    // A chain deep enough to overflow the stack of a recursive traversal.
    let mut file = File::triangle();
    let depth = 100_000;
    file.json["nodes"] =
        (0..depth).map(|i| if i + 1 < depth { json!({ "children": [i + 1] }) } else { json!({ "mesh": 0 }) }).collect();
    assert_eq!(file.load().triangles.len(), 1);
    file.json["scenes"] = json!([{ "nodes": (0..depth).collect::<Vec<_>>() }]);
    assert_eq!(file.load().triangles.len(), 1, "a node below another listed node is rendered once");
}

#[test]
fn numbers_that_are_not_finite() {
    for (attribute, bad) in [("POSITION", f32::NAN), ("POSITION", f32::INFINITY), ("NORMAL", f32::NEG_INFINITY)] {
        let mut file = File::triangle();
        let accessor = file.floats(&[[0f32, 0., 0.], [1., 0., 0.], [0., bad, 0.]]);
        let mesh = json!({ "primitives": [
            { "attributes": { "POSITION": 0 } },
            { "attributes": { "POSITION": 0, attribute: accessor } },
        ] });
        file.json["meshes"][0] = mesh;
        assert_eq!(refused_at(&file), format!("/meshes/0/primitives/1/attributes/{attribute}"));
        // A lenient import keeps the other primitive.
        let scene = file.load_with(&ImportOptions { lenient: true, ..Default::default() }).unwrap();
        assert_eq!(scene.triangles.len(), 1);
        assert!(scene.notes.iter().any(|n| n.contains("not finite")), "{:?}", scene.notes);
    }
}

/// A texture without coordinates refuses a file, unless the import is lenient: then its first texel is everywhere.
#[test]
fn textures_without_coordinates() {
    let mut file = File::triangle();
    let view = file.view(&png(1, 1, &[[255, 0, 0, 255]]));
    file.add("images", json!({ "bufferView": view, "mimeType": "image/png" }));
    file.add("textures", json!({ "source": 0 }));
    file.add("materials", json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    assert_eq!(refused_at(&file), "/meshes/0/primitives/0");
    let scene = file.load_with(&ImportOptions { lenient: true, ..Default::default() }).unwrap();
    assert!(scene.vertices.iter().all(|vertex| vertex.uv[0].length() == 0.0) && scene.triangles.len() == 1);
    assert!(scene.notes.iter().any(|note| note.contains("1 primitive lacks coordinates")), "{:?}", scene.notes);
    // An occlusion texture is not read.
    file.json["materials"][0] = json!({ "occlusionTexture": { "index": 0 } });
    assert_eq!(file.load().triangles.len(), 1);
}

/// A hundred notes are shown, and the others are counted: each once, however often it is repeated.
#[test]
fn more_than_a_hundred_notes_are_counted() {
    let mut file = File::triangle();
    let names: Vec<String> = (0..110).map(|i| format!("ACME_{i}")).collect();
    file.json["extensionsUsed"] = json!([names.clone(), names.clone(), names].concat());
    let notes = file.load().notes;
    assert_eq!(notes.len(), 101);
    // Those on ten extensions, on the camera and on the light.
    assert_eq!(notes[100], "12 more notes on the file are not shown");
}

#[test]
fn later_versions_are_noted() {
    let mut file = File::triangle();
    file.json["asset"] = json!({ "version": "2.1", "minVersion": "2.1" });
    assert!(file.load().notes.iter().any(|note| note.contains("needs glTF version 2.1")));
}

#[test]
fn images() {
    let refused = |bytes: &[u8]| {
        let mut file = File::triangle();
        let view = file.view(bytes);
        file.add("images", json!({ "bufferView": view }));
        file.add("textures", json!({ "source": 0 }));
        file.add("materials", json!({ "normalTexture": { "index": 0 } }));
        refused_at(&file)
    };
    let good = png(2, 2, &[[1, 2, 3, 4]; 4]);
    assert_eq!(refused(&good[..good.len() - 20]), "/images/0");
    assert_eq!(refused(b"GIF89a not decoded here"), "/textures/0/source");
    // A header with a valid checksum that claims 384,000 x 384,000 texels: 590 GB.
    let mut huge = good.clone();
    huge[16..20].copy_from_slice(&384_000u32.to_be_bytes());
    huge[20..24].copy_from_slice(&384_000u32.to_be_bytes());
    let crc = huge[12..29].iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
    });
    huge[29..33].copy_from_slice(&(!crc).to_be_bytes());
    assert_eq!(refused(&huge), "/images/0");
    // A JPEG whose header claims 4096 x 4096 texels. The decoder would fill in the missing ones.
    let grey = image::GrayImage::from_pixel(16, 16, image::Luma([128]));
    let mut jpeg = std::io::Cursor::new(Vec::new());
    grey.write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    let mut jpeg = jpeg.into_inner();
    let frame = jpeg.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
    for side in [5, 7] {
        jpeg[frame + side..frame + side + 2].copy_from_slice(&4096u16.to_be_bytes());
    }
    assert_eq!(refused(&jpeg), "/images/0");
}

#[test]
fn uris_stay_within_the_folder_of_the_scene() {
    let root = temporary("folder");
    let folder = root.join("scene");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(root.join("secret.bin"), [0; 36]).unwrap();
    std::fs::write(folder.join("inside.bin"), [0; 36]).unwrap();
    let path = folder.join("scene.gltf");
    let outcome = |uri: &str| {
        let json = json!({ "asset": { "version": "2.0" }, "buffers": [{ "byteLength": 36, "uri": uri }] });
        std::fs::write(&path, json.to_string()).unwrap();
        load(&path)
    };
    assert!(outcome("inside.bin").is_ok());
    assert!(outcome("x/../inside.bin").is_ok());
    let absolute = root.join("secret.bin");
    for uri in [
        "../secret.bin",
        "x/../../secret.bin",
        "%2e%2e/secret.bin",
        "..%2fsecret.bin",
        absolute.to_str().unwrap(),
        "file:///etc/passwd",
        "http://example.org/a.bin",
        "inside.bin%00",
        "inside%2",
        "%ff",
        "",
        ".",
        "absent.bin",
        "data:;base64,AAA?",
        "data:;base64,A",
        "data:AAAA",
    ] {
        assert_eq!(location(outcome(uri), Some(&path)), "/buffers/0/uri", "{uri}");
    }
    // A legal URI whose data is too short.
    assert_eq!(location(outcome("data:;base64,AAAA"), Some(&path)), "/buffers/0");
}

#[test]
fn values_out_of_range() {
    let refused = |list: &str, value: serde_json::Value| {
        let mut file = File::triangle();
        file.add(list, value);
        refused_at(&file)
    };
    let material = |value| refused("materials", value);
    assert_eq!(
        material(json!({ "pbrMetallicRoughness": { "metallicFactor": 1.5 } })),
        "/materials/0/pbrMetallicRoughness/metallicFactor"
    );
    assert_eq!(material(json!({ "emissiveFactor": [0, -1, 0] })), "/materials/0/emissiveFactor");
    let sheen = |value| material(json!({ "extensions": { "KHR_materials_sheen": value } }));
    let pointer = "/materials/0/extensions/KHR_materials_sheen";
    assert_eq!(sheen(json!({ "sheenColorFactor": [0, 2, 0] })), format!("{pointer}/sheenColorFactor"));
    assert_eq!(sheen(json!({ "sheenRoughnessFactor": -1 })), format!("{pointer}/sheenRoughnessFactor"));
    assert_eq!(material(json!({ "emissiveFactor": [1e39, 0, 0] })), "/materials/0/emissiveFactor");
    assert_eq!(material(json!({ "emissiveTexture": { "index": 0 } })), "/materials/0/emissiveTexture/index");
    assert_eq!(material(json!({ "emissiveTexture": {} })), "/materials/0/emissiveTexture");
    let strength = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 1e30 } });
    assert_eq!(
        material(json!({ "emissiveFactor": [1e30, 0, 0], "extensions": strength })),
        "/materials/0/extensions/KHR_materials_emissive_strength"
    );
    let camera = |value| refused("cameras", value);
    assert_eq!(camera(json!({ "type": "fisheye" })), "/cameras/0");
    assert_eq!(camera(json!({ "type": "perspective" })), "/cameras/0");
    let lens =
        |yfov: f64, znear: f64| json!({ "type": "perspective", "perspective": { "yfov": yfov, "znear": znear } });
    assert_eq!(camera(lens(0.0, 1.0)), "/cameras/0/perspective/yfov");
    assert_eq!(camera(lens(3.2, 1.0)), "/cameras/0/perspective");
    assert_eq!(camera(lens(1.0, 0.0)), "/cameras/0/perspective/znear");
    let light = |value: serde_json::Value| {
        let mut file = File::triangle();
        file.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [value] } });
        refused_at(&file)
    };
    const LIGHT: &str = "/extensions/KHR_lights_punctual/lights/0";
    assert_eq!(light(json!({ "type": "point", "intensity": -1 })), format!("{LIGHT}/intensity"));
    assert_eq!(light(json!({ "type": "point", "range": 0 })), format!("{LIGHT}/range"));
    assert_eq!(light(json!({ "type": "spot" })), LIGHT);
    assert_eq!(light(json!({ "type": "spot", "spot": { "innerConeAngle": 0.8 } })), format!("{LIGHT}/spot"));
    let wide = json!({ "outerConeAngle": 1.6 });
    assert_eq!(light(json!({ "type": "spot", "spot": wide })), format!("{LIGHT}/spot/outerConeAngle"));
}
