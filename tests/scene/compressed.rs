//! Compressed files and their uncompressed twins.

use std::path::Path;

use penumbra::internal::scene::{ImportOptions, Scene};
use serde_json::{Value, json};

use crate::builder::{File, U16, png};

const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// A wavy sheet of 400 vertices with normals and two triangles in each cell.
fn sheet() -> File {
    let side = 20;
    let mut file = File::new();
    let at = |i: usize| [(i % side) as f32, ((i / side) as f32 * 0.7).sin(), (i / side) as f32];
    let positions: Vec<[f32; 3]> = (0..side * side).map(at).collect();
    let normals = file.floats(&positions.iter().map(|p| [0.0, p[1].cos(), p[1].sin()]).collect::<Vec<_>>());
    let corner = |x: usize, y: usize| (y * side + x) as u32;
    let cells = (0..(side - 1) * (side - 1)).map(|i| (i % (side - 1), i / (side - 1)));
    let corners: Vec<u32> = cells
        .flat_map(|(x, y)| {
            let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x, y + 1), corner(x + 1, y + 1)];
            [a, b, c, b, d, c]
        })
        .collect();
    // The order in which the official encoder gives back the triangles, so that both files have the same.
    let coded = meshopt::encode_index_buffer(&corners, side * side).unwrap();
    let corners = meshopt::decode_index_buffer::<u16>(&coded, corners.len()).unwrap();
    let indices: Vec<u8> = corners.iter().flat_map(|index| index.to_le_bytes()).collect();
    let indices = file.accessor(&indices, U16, "SCALAR", corners.len());
    file.mesh(&positions, json!({ "indices": indices, "attributes": { "NORMAL": normals } }));
    file
}

/// The file with its buffer views compressed, and a buffer without data behind them.
fn compressed(plain: &File, extension: &str, version: i32, triangles: bool) -> File {
    let mut file = File { json: plain.json.clone(), bin: Vec::new() };
    let mut fallback = 0;
    for (i, view) in plain.json["bufferViews"].as_array().unwrap().iter().enumerate() {
        let [offset, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
        let bytes = &plain.bin[offset..offset + length];
        let is_indices = plain.json["accessors"][i]["type"] == "SCALAR";
        let (coded, mode, stride) = if is_indices {
            let list: Vec<u32> = bytes.as_chunks::<2>().0.iter().map(|word| u16::from_le_bytes(*word).into()).collect();
            match triangles {
                true => (meshopt::encode_index_buffer(&list, 400).unwrap(), "TRIANGLES", 2),
                false => (meshopt::encode_index_sequence(&list, 400).unwrap(), "INDICES", 2),
            }
        } else {
            let coded = meshopt::encode_vertex_buffer_level(bytes.as_chunks::<12>().0, 3, Some(version)).unwrap();
            (coded, "ATTRIBUTES", 12)
        };
        let at = file.bin.len();
        file.bin.extend(&coded);
        file.json["bufferViews"][i] = json!({
            "buffer": 1, "byteOffset": fallback, "byteLength": length,
            "extensions": { extension: {
                "buffer": 0, "byteOffset": at, "byteLength": coded.len(), "byteStride": stride,
                "count": length / stride, "mode": mode,
            } },
        });
        fallback += length;
    }
    file.json["extensionsRequired"] = json!([extension]);
    file.json["extensionsUsed"] = json!([extension]);
    file.json["buffers"] = json!([
        { "byteLength": file.bin.len() },
        { "byteLength": fallback, "extensions": { extension: { "fallback": true } } },
    ]);
    file
}

fn assert_same(a: &Scene, b: &Scene) {
    // Without the lists, which have thousands of numbers.
    assert!(a.triangles == b.triangles && a.vertices == b.vertices);
    assert!(!a.triangles.is_empty());
}

#[test]
fn meshopt_has_the_bits_of_its_twin() {
    let plain = sheet();
    let scene = plain.load();
    for extension in MESHOPT {
        for (version, triangles) in [(0, true), (1, false), (1, true)] {
            let file = compressed(&plain, extension, version, triangles);
            assert!(file.bin.len() < plain.bin.len() / 2, "{} of {}", file.bin.len(), plain.bin.len());
            let decoded = file.load();
            assert_same(&scene, &decoded);
            assert!(!decoded.notes.iter().any(|note| note.contains("meshopt")), "{:?}", decoded.notes);
        }
    }
}

/// Each fault is refused at its place.
#[test]
fn bad_meshopt_is_refused() {
    let good = compressed(&sheet(), MESHOPT[0], 0, true);
    let refused = |edit: &dyn Fn(&mut Value), bin: &dyn Fn(&mut Vec<u8>)| {
        let mut file = good.clone();
        edit(&mut file.json["bufferViews"][0]["extensions"][MESHOPT[0]]);
        bin(&mut file.bin);
        match file.load_with(&ImportOptions::default()) {
            Err(penumbra::Error::Input { location, problem, .. }) => (location, problem),
            other => panic!("{other:?}"),
        }
    };
    const PLACE: &str = "/bufferViews/0/extensions/EXT_meshopt_compression";
    let member = |key: &str, value: Value| refused(&|view| view[key] = value.clone(), &|_| {}).0;
    assert_eq!(member("buffer", json!(7)), format!("{PLACE}/buffer"));
    assert_eq!(member("buffer", json!(1)), format!("{PLACE}/buffer"));
    assert_eq!(member("byteOffset", json!(u64::MAX)), PLACE);
    assert_eq!(member("byteLength", json!(1 << 30)), PLACE);
    assert_eq!(member("byteLength", json!(0)), PLACE);
    assert_eq!(member("mode", json!("STRIPS")), format!("{PLACE}/mode"));
    assert_eq!(member("mode", json!("INDICES")), format!("{PLACE}/byteStride"));
    assert_eq!(member("byteStride", json!(6)), format!("{PLACE}/byteStride"));
    assert_eq!(member("byteStride", json!(260)), format!("{PLACE}/byteStride"));
    assert_eq!(member("count", json!(0)), format!("{PLACE}/count"));
    assert_eq!(member("count", json!(u64::MAX)), format!("{PLACE}/count"));
    assert_eq!(member("count", json!(399)), format!("{PLACE}/count"));
    assert_eq!(member("filter", json!("QUATERNION")), format!("{PLACE}/filter"));
    assert_eq!(member("filter", json!("COLOR")), format!("{PLACE}/filter"));
    assert_eq!(member("filter", json!(3)), format!("{PLACE}/filter"));
    let (place, problem) = refused(&|_| {}, &|bin| bin[0] = 0xa2);
    assert!(place == PLACE && problem.contains("version"), "{place} {problem}");
    // All views at the same bytes.
    let mut overlapping = good.clone();
    let many = vec![overlapping.json["bufferViews"][0].clone(); 40];
    overlapping.json["bufferViews"].as_array_mut().unwrap().extend(many);
    let error = overlapping.load_with(&ImportOptions::default()).unwrap_err().to_string();
    assert!(error.contains("overlap"), "{error}");
}

/// A filter is applied: unit vectors come back within its precision, numbers with exponents exactly.
#[test]
fn filters_of_meshopt() {
    let plain = sheet();
    let scene = plain.load();
    let mut file = compressed(&plain, MESHOPT[1], 1, true);
    // In the order of the file.
    let (normals, _) = plain.bin[..12 * 400].as_chunks::<12>();
    let normal = |bytes: &[u8; 12]| {
        let coordinate = |i: usize| f32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]);
        glam::Vec3::new(coordinate(0), coordinate(4), coordinate(8)).normalize().extend(0.0).to_array()
    };
    let normals: Vec<[f32; 4]> = normals.iter().map(normal).collect();
    let octahedral = meshopt::encode_filter_oct::<i16>(&normals, 12);
    let coded = meshopt::encode_vertex_buffer_level(&octahedral, 2, Some(1)).unwrap();
    let at = file.bin.len();
    file.bin.extend(&coded);
    let bytes = 8 * normals.len();
    file.json["bufferViews"][0] = json!({
        "buffer": 1, "byteLength": bytes, "byteStride": 8,
        "extensions": { MESHOPT[1]: {
            "buffer": 0, "byteOffset": at, "byteLength": coded.len(), "byteStride": 8, "count": normals.len(),
            "mode": "ATTRIBUTES", "filter": "OCTAHEDRAL",
        } },
    });
    file.json["buffers"][0]["byteLength"] = json!(file.bin.len());
    file.json["accessors"][0] =
        json!({ "bufferView": 0, "componentType": 5122, "normalized": true, "type": "VEC3", "count": normals.len() });
    let decoded = file.load();
    assert!(scene.triangles == decoded.triangles);
    for (a, b) in scene.vertices.iter().zip(decoded.vertices.iter()) {
        assert_eq!(a.position, b.position);
        // Two coordinates of 12 bits, each off by half a unit of 1/2047, and at most twice that on the sphere.
        assert!(a.normal.distance(b.normal) < 2e-3, "{} {}", a.normal, b.normal);
    }
}

fn fixture(name: &str) -> Vec<u8> {
    std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scene/files/").to_owned() + name).unwrap()
}

fn load_fixture(name: &str) -> Scene {
    Scene::from_bytes(&fixture(name), Path::new(name), &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

/// Checks that the file `name` has the vertices and triangles of `sheet.glb`, in any order. Positions deviate by at
/// most half of `step` on each axis.
fn assert_near_sheet(name: &str, step: f64, normal_tolerance: f32, uv_tolerance: Option<f32>) {
    let (plain, scene) = (load_fixture("sheet.glb"), load_fixture(name));
    assert_eq!(scene.vertices.len(), plain.vertices.len(), "{name}");
    let positions = |scene: &Scene| -> Vec<glam::DVec3> {
        scene.vertices.iter().map(|v| scene.normalisation.undo(v.position)).collect()
    };
    let of_plain = positions(&plain);
    // Vertices lie one unit apart, so the nearest one is the same one.
    let twin: Vec<usize> = positions(&scene)
        .iter()
        .map(|p| {
            let distance = |i: &usize| of_plain[*i].distance(*p);
            let nearest = (0..of_plain.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
            // 1e-6 is for the rounding of normalised positions.
            let tolerance = 0.5 * step * 3f64.sqrt() + 1e-6;
            assert!(distance(&nearest) < tolerance, "{name}: {p} is {} away", distance(&nearest));
            nearest
        })
        .collect();
    for (vertex, twin) in scene.vertices.iter().zip(&twin) {
        let twin = &plain.vertices[*twin];
        assert!(vertex.normal.distance(twin.normal) < normal_tolerance, "{name}: {} {}", vertex.normal, twin.normal);
        let uv_tolerance = uv_tolerance.unwrap_or(f32::INFINITY);
        assert!(vertex.uv[0].distance(twin.uv[0]) < uv_tolerance, "{name}: {} {}", vertex.uv[0], twin.uv[0]);
    }
    let corners = |scene: &Scene, twin: &dyn Fn(usize) -> usize| {
        let rotated = |t: [usize; 3]| (0..3).map(|i| [t[i], t[(i + 1) % 3], t[(i + 2) % 3]]).min().unwrap();
        let twins = scene.triangles.iter().map(|t| rotated(t.vertices.map(|v| twin(v as usize))));
        let mut all: Vec<_> = twins.collect();
        all.sort_unstable();
        all
    };
    assert!(corners(&scene, &|v| twin[v]) == corners(&plain, &|v| v), "{name}");
}

/// Files by gltfpack: quantised positions of 14 bits and normals of 8, and positions of 15 bits with exponents.
#[test]
fn gltfpack_is_near_its_twin() {
    // A byte of a normal is off by half a unit on each axis, or by one in the octahedron of 8 bits, and gltfpack left
    // out the texture coordinates, which no material uses.
    assert_near_sheet("sheet-meshopt-ext.glb", 11.0 / 16383.0, 0.01, None);
    // 15 bits of mantissa, whose sign is one, for numbers up to 11.
    assert_near_sheet("sheet-meshopt-khr.glb", 16.0 / 16384.0, 0.02, None);
}

/// Root of the mean square of the differences between the texels and those that `tests/scene/files/make.mjs` writes.
fn deviation(scene: &Scene) -> f64 {
    assert_eq!((scene.images[0].width, scene.images[0].height), (22, 18));
    let expected = |i: usize| {
        let (x, y) = (i % 22, i / 22);
        [11 * x, 13 * y, 6 * (x + y), 255 - 5 * x].map(|value| value as f64)
    };
    let texels = scene.images[0].texels.iter().enumerate();
    let square =
        |(i, texel): (usize, &[u8; 4])| (0..4).map(|c| (f64::from(texel[c]) - expected(i)[c]).powi(2)).sum::<f64>();
    (texels.map(square).sum::<f64>() / (4.0 * 22.0 * 18.0)).sqrt()
}

/// Lossy texels, lossless alpha.
#[test]
fn lossy_webp_is_near_its_source() {
    let scene = textured(&fixture("lossy.webp"), Some("EXT_texture_webp")).load();
    // Quality 90 of libwebp, with chroma at half of the resolution.
    let deviation = deviation(&scene);
    assert!(deviation < 4.0, "{deviation}");
    assert!(scene.images[0].texels.iter().enumerate().all(|(i, texel)| usize::from(texel[3]) == 255 - 5 * (i % 22)));
}

fn webp(width: u32, height: u32, texels: &[[u8; 4]]) -> Vec<u8> {
    let image = image::RgbaImage::from_raw(width, height, texels.concat()).unwrap();
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::WebP).unwrap();
    bytes.into_inner()
}

/// A triangle whose base colour is the image `bytes`, named by the extension if there is one, with a PNG beside it.
fn textured(bytes: &[u8], extension: Option<&str>) -> File {
    let mut file = File::new();
    let view = file.view(&png(1, 1, &[[9, 9, 9, 255]]));
    file.add("images", json!({ "bufferView": view }));
    let view = file.view(bytes);
    file.add("images", json!({ "bufferView": view }));
    file.add(
        "textures",
        match extension {
            Some(name) => json!({ "source": 0, "extensions": { name: { "source": 1 } } }),
            None => json!({ "source": 1 }),
        },
    );
    file.add("materials", json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
    let uvs = file.floats(&[[0f32, 0.], [1., 0.], [0., 1.]]);
    let members = json!({ "material": 0, "attributes": { "TEXCOORD_0": uvs } });
    file.mesh(&[[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]], members);
    file
}

#[test]
fn webp_has_the_texels_of_its_twin() {
    let texels: Vec<[u8; 4]> = (0..35u8).map(|i| [i * 7, 255 - i, i.wrapping_mul(i), 128 + i]).collect();
    let coded = webp(7, 5, &texels);
    let mut file = textured(&coded, Some("EXT_texture_webp"));
    file.json["extensionsRequired"] = json!(["EXT_texture_webp"]);
    let scene = file.load();
    assert_eq!(scene.images.len(), 1);
    assert_eq!((scene.images[0].width, scene.images[0].height), (7, 5));
    assert_eq!(scene.images[0].texels, texels);
    assert!(!scene.notes.iter().any(|note| note.contains("webp")), "{:?}", scene.notes);

    let refused = |file: File| file.load_with(&ImportOptions::default()).unwrap_err().to_string();
    // WebP without the extension, and another format with it.
    assert!(refused(textured(&coded, None)).contains("/textures/0/source"));
    let error = refused(textured(&png(1, 1, &[[0; 4]]), Some("EXT_texture_webp")));
    assert!(error.contains("/textures/0/extensions/EXT_texture_webp/source"), "{error}");
    // Cut, and with another size in the frame than in the header.
    for length in [20, 30, coded.len() - 8] {
        assert!(refused(textured(&coded[..length], Some("EXT_texture_webp"))).contains("/images/1"));
    }
    let mut huge = coded.clone();
    // The size follows two headers and a signature: 16383 x 16383 texels.
    huge[21..25].copy_from_slice(&((16382u32 | 16382 << 14).to_le_bytes()));
    let error = refused(textured(&huge, Some("EXT_texture_webp")));
    assert!(error.contains("/images/1") && error.contains("16383 x 16383"), "{error}");
}

/// A lenient import does without an image that is missing, of unknown format, damaged in its header or in its texels.
#[test]
fn lenient_imports_leave_out_images() {
    let good = png(2, 2, &[[1, 2, 3, 4]; 4]);
    let mut damaged = good.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x55;
    let lenient = ImportOptions { lenient: true, ..Default::default() };
    let mut missing = textured(&good, None);
    missing.json["images"][1] = json!({ "uri": "not there.png" });
    let files = [missing, textured(b"GIF89a unknown", None), textured(&good[..20], None), textured(&damaged, None)];
    for mut file in files {
        let error = file.load_with(&ImportOptions::default()).unwrap_err().to_string();
        assert!(error.contains("/images/1") || error.contains("/textures/0"), "{error}");
        file.json["materials"][0]["normalTexture"] = json!({ "index": 0 });
        file.json["materials"][0]["emissiveTexture"] = json!({ "index": 0 });
        file.json["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
        let scene = file.load_with(&lenient).unwrap();
        assert_eq!(scene.triangles.len(), 1);
        assert!(scene.images.is_empty() && scene.textures.is_empty());
        let material = &scene.materials[0];
        assert!(material.texture_infos().next().is_none());
        assert_eq!(material.base_colour, glam::Vec4::ONE);
        // The factor alone would make the surface a lamp.
        assert_eq!(material.emissive, glam::Vec3::ZERO);
        assert!(scene.notes.iter().any(|note| note.contains("is left out")), "{:?}", scene.notes);
        // A missing file is one that the scene refers to.
        let is_missing = file.json["images"][1]["uri"].is_string();
        assert_eq!(scene.files.iter().any(|file| file.ends_with("not there.png")), is_missing, "{:?}", scene.files);
    }
    // Without a fault, the same file as without the option.
    let (a, b) = (textured(&good, None).load(), textured(&good, None).load_with(&lenient).unwrap());
    assert_eq!((a.images, a.materials, a.notes), (b.images, b.materials, b.notes));
}

/// The codings lose some precision: UASTC less than ETC1S, whose blocks have four colours of one hue.
#[test]
fn ktx2_is_near_its_source() {
    let files = [("etc1s.ktx2", 20.0), ("uastc.ktx2", 5.0), ("uastc-zstd.ktx2", 5.0)];
    let decoded: Vec<Vec<[u8; 4]>> = files
        .iter()
        .map(|(name, tolerance)| {
            let mut file = textured(&fixture(name), Some("KHR_texture_basisu"));
            file.json["extensionsRequired"] = json!(["KHR_texture_basisu"]);
            let scene = file.load();
            assert!(!scene.notes.iter().any(|note| note.contains("basisu")), "{:?}", scene.notes);
            let deviation = deviation(&scene);
            assert!(deviation < *tolerance, "{name}: {deviation}");
            scene.images[0].texels.clone()
        })
        .collect();
    // The same texels as by the official transcoder; Zstandard loses nothing.
    for (texels, file) in decoded.iter().zip(["etc1s.rgba", "uastc.rgba", "uastc.rgba"]) {
        assert!(texels.as_flattened() == fixture(file), "{file}");
    }
}

/// Files of two channels have green where others have alpha. By the Khronos Data Format, a sample's channel is in the
/// lower half of its byte 3: of ETC1S 3 for RRR, 4 for GGG; of UASTC 5 for RRRG.
#[test]
fn ktx2_of_two_channels_has_red_and_green() {
    let codings = [("etc1s", &[3, 4][..]), ("uastc", &[5]), ("uastc-zstd", &[5])];
    for (name, channels) in codings {
        let mut coded = fixture(&format!("{name}.ktx2"));
        let descriptor = u32::from_le_bytes(coded[48..52].try_into().unwrap()) as usize;
        for (sample, channel) in channels.iter().enumerate() {
            let byte = &mut coded[descriptor + 28 + 16 * sample + 3];
            *byte = *byte & 0xf0 | channel;
        }
        let scene = textured(&coded, Some("KHR_texture_basisu")).load();
        let whole = fixture(&format!("{}.rgba", name.trim_end_matches("-zstd")));
        let expected: Vec<[u8; 4]> = whole.as_chunks().0.iter().map(|[r, _, _, a]| [*r, *a, 0, 255]).collect();
        assert!(scene.images[0].texels == expected, "{name}");
    }
}

/// A compressed image that is damaged, in its header or in its texels, leaves the PNG beside it to a lenient import.
#[test]
fn a_damaged_form_leaves_the_other_one() {
    let lenient = ImportOptions { lenient: true, ..Default::default() };
    let coded = webp(7, 5, &[[1, 2, 3, 255]; 35]);
    let mut damaged = fixture("uastc-zstd.ktx2");
    let last = damaged.len() - 8;
    damaged[last..].fill(0x55);
    let files = [(&coded[..20], "EXT_texture_webp"), (&damaged[..], "KHR_texture_basisu")];
    for (bytes, extension) in files {
        let file = textured(bytes, Some(extension));
        assert!(file.load_with(&ImportOptions::default()).unwrap_err().to_string().contains("/images/1"));
        let scene = file.load_with(&lenient).unwrap();
        assert_eq!(scene.images[0].texels, [[9, 9, 9, 255]], "{extension}");
        assert!(scene.materials[0].texture_infos().next().is_some());
        assert!(scene.notes.iter().any(|note| note.contains("is left out")), "{:?}", scene.notes);
        // So does one that is equal to another image, which is the one that is decoded.
        let mut twice = file.clone();
        let image = twice.json["images"][1].clone();
        twice.json["images"].as_array_mut().unwrap().push(image);
        twice.json["textures"][0]["extensions"][extension]["source"] = json!(2);
        assert_eq!(twice.load_with(&lenient).unwrap().images[0].texels, [[9, 9, 9, 255]], "{extension}");
    }
}

/// Every byte of the headers, and any cut, gives an image or an error at the image.
#[test]
fn damaged_ktx2_is_refused() {
    let load = |bytes: &[u8]| match textured(bytes, Some("KHR_texture_basisu")).load_with(&ImportOptions::default()) {
        Ok(_) => true,
        Err(error) => {
            let text = error.to_string();
            assert!(text.contains("/images/1") || text.contains("/textures/0"), "{text}");
            false
        }
    };
    for name in ["etc1s.ktx2", "uastc.ktx2", "uastc-zstd.ktx2"] {
        let good = fixture(name);
        assert!(load(&good));
        for length in (1..good.len()).step_by(7) {
            load(&good[..length]);
        }
        for at in 0..400.min(good.len()) {
            for byte in [0, 0x7f, 0xff] {
                let mut damaged = good.clone();
                damaged[at] = byte;
                load(&damaged);
            }
        }
        let with = |at: usize, word: u32| {
            let mut damaged = good.clone();
            damaged[at..at + 4].copy_from_slice(&word.to_le_bytes());
            load(&damaged)
        };
        // Width, height, depth, layers, faces, levels, supercompression.
        for (at, word) in [(20, 1 << 20), (24, 0), (28, 1), (32, 2), (36, 6), (40, 0), (40, 99), (44, 3)] {
            assert!(!with(at, word), "{name} {at} {word}");
        }
    }
}

/// Draco without quantisation loses nothing and keeps the order of vertices and triangles.
#[test]
fn exact_draco_has_the_bits_of_its_twin() {
    let (plain, exact) = (load_fixture("sheet.glb"), load_fixture("sheet-exact.glb"));
    assert_same(&plain, &exact);
    assert!(!exact.notes.iter().any(|note| note.contains("draco")), "{:?}", exact.notes);
}

/// Draco with 14 bits of position, 10 of normals in the octahedron and 12 of texture coordinates, in its own order.
#[test]
fn quantised_draco_is_near_its_twin() {
    for name in ["sheet-sequential.glb", "sheet-edgebreaker.glb"] {
        // Two coordinates of a normal, each off by half of 2/1023, and at most twice that on the sphere: 2.8e-3.
        // Two texture coordinates from 0 to 1, each off by half of 1/4095: 1.7e-4.
        assert_near_sheet(name, 11.0 / 16383.0, 4e-3, Some(2e-4));
    }
}

/// Faults of a compressed primitive are refused at their place; the others at the extension.
#[test]
fn bad_draco_is_refused() {
    let glb = fixture("sheet-edgebreaker.glb");
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let good = File { json: serde_json::from_slice(&glb[20..20 + length]).unwrap(), bin: glb[28 + length..].to_vec() };
    assert_eq!(good.load().triangles.len(), 242);
    let refused = |edit: &dyn Fn(&mut File)| {
        let mut file = good.clone();
        edit(&mut file);
        match file.load_with(&ImportOptions::default()) {
            Err(penumbra::Error::Input { location, .. }) => location,
            other => panic!("{other:?}"),
        }
    };
    fn extension(file: &mut File) -> &mut Value {
        &mut file.json["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]
    }
    const PLACE: &str = "/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression";
    assert_eq!(refused(&|f| f.json["meshes"][0]["primitives"][0]["mode"] = json!(5)), PLACE);
    assert_eq!(refused(&|f| extension(f)["bufferView"] = json!(9)), format!("{PLACE}/bufferView"));
    assert_eq!(refused(&|f| extension(f)["attributes"]["NORMAL"] = json!(77)), PLACE);
    let joint = |f: &mut File| extension(f)["attributes"]["JOINTS_0"] = json!(0);
    assert_eq!(refused(&joint), "/meshes/0/primitives/0/attributes");
    let number = |f: &File, name: &str| f.json["meshes"][0]["primitives"][0]["attributes"][name].as_u64().unwrap();
    let normals = number(&good, "NORMAL") as usize;
    let place = format!("/accessors/{normals}");
    assert_eq!(refused(&|f| f.json["accessors"][normals]["count"] = json!(7)), place);
    assert_eq!(refused(&|f| f.json["accessors"][normals]["type"] = json!("VEC2")), place);
    assert_eq!(refused(&|f| f.json["accessors"][normals]["componentType"] = json!(5121)), place);
    assert_eq!(refused(&|f| f.json["accessors"][normals]["count"] = json!(1u64 << 40)), PLACE);
    let indices = good.json["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize;
    assert_eq!(refused(&|f| f.json["accessors"][indices]["count"] = json!(723)), PLACE);
    assert_eq!(
        refused(&|f| f.json["accessors"][indices]["componentType"] = json!(5120)),
        format!("/accessors/{indices}")
    );
    for (key, value) in [("type", json!("VEC3")), ("componentType", json!(5126))] {
        assert_eq!(refused(&|f| f.json["accessors"][indices][key] = value.clone()), format!("/accessors/{indices}"));
    }
    // Where all accessors have data of their own, nothing is decoded, not even a strip.
    let mut plain = File::triangle();
    let stream = json!({ "bufferView": 0, "attributes": { "POSITION": 0 } });
    plain.json["meshes"][0]["primitives"][0]["mode"] = json!(5);
    plain.json["meshes"][0]["primitives"][0]["extensions"] = json!({ "KHR_draco_mesh_compression": stream });
    plain.json["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    assert_eq!(plain.load().triangles.len(), 1);
    // Damage anywhere gives a mesh or an error, never a panic.
    for at in 0..good.bin.len() {
        for flip in [1, 0x80, 0xff] {
            let mut damaged = good.clone();
            damaged.bin[at] ^= flip;
            let outcome = damaged.load_with(&ImportOptions::default());
            assert!(matches!(outcome, Ok(_) | Err(penumbra::Error::Input { .. })), "{at} {flip}");
        }
    }
}
