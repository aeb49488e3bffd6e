//! Scenes whose meshes are stored once and placed by instances, against the same scenes with a copy for each.

use std::f32::consts::{PI, TAU};
use std::path::Path;

use penumbra::internal::scene::ImportOptions;
use penumbra::{Aov, Image, Scene, Settings, Statistics, Technique};
use serde_json::json;

use crate::builder::{File, U32, png};
use crate::random::{Random, RandomInput as _};
use crate::setup::render_scene;

/// `side` x `side` leathery balls with holes on a floor below a lamp: turned, stretched, a third of them mirrored. They
/// have normals, a normal map, a texture with an alpha mask, and vertex colours.
fn balls(side: usize, rings: usize) -> File {
    let mut file = File::new();
    let segments = 2 * rings;
    let (mut positions, mut normals, mut uvs, mut colours) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (i, j) in (0..=rings).flat_map(|i| (0..=segments).map(move |j| (i, j))) {
        let (v, u) = (i as f32 / rings as f32, j as f32 / segments as f32);
        let (theta, phi) = (PI * v, TAU * u);
        let d = [theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()];
        positions.push(d.map(|x| x * (1.0 + 0.15 * (3.0 * theta).sin() * (4.0 * phi).cos())));
        normals.push(d);
        uvs.push([4.0 * u, 2.0 * v]);
        colours.push([0.5 + 0.5 * u.min(1.0 - u), 0.9, 0.5 + 0.5 * v]);
    }
    let mut corners: Vec<u8> = Vec::new();
    let mut triangles = 0;
    for (i, j) in (0..rings).flat_map(|i| (0..segments).map(move |j| (i, j))) {
        let (a, b) = ((i * (segments + 1) + j) as u32, ((i + 1) * (segments + 1) + j) as u32);
        // At the poles one of the two has no area.
        let two = [(i > 0, [a, a + 1, b]), (i + 1 < rings, [a + 1, b + 1, b])];
        for (_, triangle) in two.iter().filter(|(has_area, _)| *has_area) {
            corners.extend(triangle.iter().flat_map(|corner| corner.to_le_bytes()));
            triangles += 1;
        }
    }
    let indices = file.accessor(&corners, U32, "SCALAR", 3 * triangles);
    let (normals, uvs, colours) = (file.floats(&normals), file.floats(&uvs), file.floats(&colours));
    let texture =
        png(4, 4, &std::array::from_fn::<_, 16, _>(|i| [255, 120 + 8 * i as u8, 90, if i == 5 { 0 } else { 255 }]));
    let bumps = png(2, 2, &[[128, 128, 255, 255], [168, 128, 250, 255], [128, 98, 250, 255], [128, 128, 255, 255]]);
    for bytes in [texture, bumps] {
        let view = file.view(&bytes);
        let image = file.add("images", json!({ "bufferView": view, "mimeType": "image/png" }));
        file.add("textures", json!({ "source": image }));
    }
    let plain = |colour: [f32; 4]| json!({ "baseColorFactor": colour, "metallicFactor": 0 });
    let mut leather = plain([0.8, 0.8, 0.8, 1.0]);
    leather["baseColorTexture"] = json!({ "index": 0 });
    leather["roughnessFactor"] = json!(0.5);
    file.add(
        "materials",
        json!({ "pbrMetallicRoughness": leather, "normalTexture": { "index": 1 }, "alphaMode": "MASK" }),
    );
    file.add("materials", json!({ "pbrMetallicRoughness": plain([0.6, 0.6, 0.6, 1.0]) }));
    file.add("materials", json!({ "pbrMetallicRoughness": plain([0.0, 0.0, 0.0, 1.0]), "emissiveFactor": [1, 1, 1] }));
    let attributes = json!({ "NORMAL": normals, "TEXCOORD_0": uvs, "COLOR_0": colours });
    let ball = file.mesh(&positions, json!({ "attributes": attributes, "indices": indices, "material": 0 }));
    let square = |x: f32, y: f32| [[-x, y, -x], [-x, y, x], [x, y, x], [-x, y, -x], [x, y, x], [x, y, -x]];
    let size = side as f32;
    file.mesh(&square(2.0 * size, 0.0), json!({ "material": 1 }));
    let lamp = square(0.4 * size, size).map(|[x, y, z]| [z, y, x]);
    file.mesh(&lamp, json!({ "material": 2 }));

    let mut random = Random(7);
    let (mut translations, mut rotations, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    for (i, j) in (0..side).flat_map(|i| (0..side).map(move |j| (i, j))) {
        let at = |i: usize, random: &mut Random| 2.6 * (i as f32 - 0.5 * size) + 0.6 * random.unit();
        translations.push([at(i, &mut random), 1.0, at(j, &mut random)]);
        let q = [0; 4].map(|_| random.unit() - 0.5);
        let length = q.iter().map(|x| x * x).sum::<f32>().sqrt();
        rotations.push(q.map(|x| x / length));
        let mirrored = if (i + j) % 3 == 0 { -1.0 } else { 1.0 };
        scales.push([mirrored, 1.0, 1.0].map(|s| s * (0.5 + 0.7 * random.unit())));
    }
    let (t, r, s) = (file.floats(&translations), file.floats(&rotations), file.floats(&scales));
    let attributes = json!({ "TRANSLATION": t, "ROTATION": r, "SCALE": s });
    file.json["nodes"][ball]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    let lens = json!({ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.01 } });
    let camera = file.add("cameras", lens);
    let (sine, cosine) = 0.15f32.sin_cos();
    let (translation, rotation) = ([0.0, 0.8 * size, 2.4 * size], [-sine, 0.0, 0.0, cosine]);
    file.add("nodes", json!({ "camera": camera, "translation": translation, "rotation": rotation }));
    file
}

fn load(file: &File, max_copied_triangles: usize) -> Scene {
    let options = ImportOptions { max_copied_triangles: Some(max_copied_triangles), ..ImportOptions::default() };
    Scene::from_bytes(&file.glb(), Path::new("balls.glb"), &options).unwrap()
}

fn render(scene: &Scene, technique: Technique, spp: u32, seed: u32) -> (Image, Statistics) {
    let settings = Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = 96;
        s.image.height = 64;
        s.image.spp = spp;
        s.image.seed = seed;
        s.image.aovs = vec![Aov::Position];
        s.indirect.photons = Some(1 << 15);
    });
    render_scene(scene.clone(), &scene.cameras[0], &settings)
}

/// The mean of squared relative differences, as relMSE has them.
fn difference(a: &Image, b: &Image) -> f64 {
    let (a, b) = (a.rgb().unwrap(), b.rgb().unwrap());
    let relative = |x: f32, y: f32| f64::from(x - y).powi(2) / (f64::from(y).powi(2) + 0.01);
    let of_channel = |c: usize| a[c].iter().zip(b[c]).map(|(x, y)| relative(*x, *y)).sum::<f64>() / a[c].len() as f64;
    (0..3).map(of_channel).sum::<f64>() / 3.0
}

/// With instances the camera sees surfaces within 1e-5 of where they are without, and images differ by far less than
/// their noise. `shadow-photons` has the kernels of `two-pass` too.
#[test]
fn instances_give_the_image_of_copies() {
    let file = balls(6, 10);
    let (copied, shared) = (load(&file, usize::MAX), load(&file, 0));
    // Two meshes: one of them mirrored.
    assert_eq!((shared.instances.len(), shared.shared_meshes.len()), (36, 2));
    assert!(copied.instances.is_empty() && copied.triangles.len() > 10 * shared.triangles.len());
    assert_eq!(copied.normalisation, shared.normalisation);

    let [a, b] = [&copied, &shared].map(|scene| render(scene, Technique::PATH, 1, 1).0);
    let mut moved = 0;
    for axis in ["P.X", "P.Y", "P.Z"] {
        let (a, b) = (a.channel(axis).unwrap(), b.channel(axis).unwrap());
        let size = 1.0 / copied.normalisation.scale() as f32;
        moved += a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > 1e-5 * size).count();
    }
    // Silhouettes and edges of holes, which rounding moves.
    assert!(moved <= 12, "{moved} of {} coordinates differ", 3 * 96 * 64);

    for technique in [Technique::SHADOW_PHOTONS, Technique::PHOTON_MAP] {
        let reference = render(&copied, technique, 8, 1).0;
        let (instanced, statistics) = render(&shared, technique, 8, 1);
        let noise = difference(&render(&copied, technique, 8, 2).0, &reference);
        let off = difference(&instanced, &reference);
        println!("{technique}: relMSE of the difference {off:.2e}, of another seed {noise:.2e}");
        assert!(statistics.kept.iter().any(|part| part == "instances"), "{:?}", statistics.kept);
        assert!(off < 0.5 * noise, "{technique}: {off} of {noise}");
    }
}

/// Techniques that list the scene's triangles get copies.
#[test]
fn techniques_with_lists_of_triangles_get_copies() {
    let file = balls(3, 6);
    let (copied, shared) = (load(&file, usize::MAX), load(&file, 0));
    for technique in [Technique::LIGHT_BUFFER, Technique::VOXEL_TAGS] {
        let (reference, _) = render(&copied, technique, 4, 1);
        let (expanded, statistics) = render(&shared, technique, 4, 1);
        assert!(!statistics.kept.iter().any(|part| part == "instances"));
        assert_eq!(statistics.scene.triangles, copied.triangles.len() as u64);
        let noise = difference(&render(&copied, technique, 4, 2).0, &reference);
        assert!(difference(&expanded, &reference) < 0.2 * noise, "{technique}");
    }
}

/// Memory on the device grows by the table and the upper BVH alone, not by triangles.
#[test]
fn a_mesh_is_stored_once() {
    let bytes = |side: usize| {
        let (image, statistics) = render(&load(&balls(side, 24), 0), Technique::PATH, 1, 1);
        assert!(image.rgb().unwrap()[0].iter().all(|x| x.is_finite()));
        (statistics.memory.scene, statistics.scene)
    };
    let ((few, _), (many, scene)) = (bytes(3), bytes(30));
    assert_eq!(scene.instances, 900);
    let table = 900 * 112;
    println!("{few} bytes with 9 instances, {many} with 900");
    assert!(many - few < 2 * table, "{few} and {many}");
    // A ball has 48 x 46 triangles and is there twice, once mirrored: 4416, with the floor and the lamp 4420.
    assert!(scene.triangles < 5000, "{scene:?}");
}
