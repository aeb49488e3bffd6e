//! EXT_lights_image_based: the panorama that a cube map becomes, and the errors of malformed ones.

use glam::{DQuat, DVec3};
use penumbra::internal::scene::{ImportOptions, Panorama, Scene};
use serde_json::{Value, json};

use crate::bad_input::refused_at;
use crate::builder::{File, png};

const SIDE: u32 = 32;

/// A triangle in a cube map of six colours. Of each face the right half is twice as bright, and the upper half twice as
/// green.
fn file() -> File {
    let mut file = File::triangle();
    for face in 0..6u32 {
        let texel = |i: u32| {
            let (right, upper) = (i % SIDE >= SIDE / 2, i / SIDE < SIDE / 2);
            // The alpha of RGBD divides: 127.5 of 255 doubles.
            [40 * (face as u8 + 1), if upper { 255 } else { 188 }, 0, if right { 128 } else { 255 }]
        };
        let texels: Vec<[u8; 4]> = (0..SIDE * SIDE).map(texel).collect();
        let view = file.view(&png(SIDE, SIDE, &texels));
        file.add("images", json!({ "bufferView": view, "mimeType": "image/png" }));
    }
    let light = json!({
        "intensity": 2, "irradianceCoefficients": vec![[0.0; 3]; 9], "specularImageSize": SIDE,
        "specularImages": [[0, 1, 2, 3, 4, 5]],
    });
    file.json["extensions"] = json!({ "EXT_lights_image_based": { "lights": [light] } });
    file.json["scenes"] = json!([{ "nodes": [0], "extensions": { "EXT_lights_image_based": { "light": 0 } } }]);
    file.json["extensionsUsed"] = json!(["EXT_lights_image_based"]);
    file
}

fn linear(byte: f64) -> f64 {
    ((byte / 255.0 + 0.055) / 1.055).powf(2.4)
}

/// The texel of a panorama in a direction.
fn at(panorama: &Panorama, direction: DVec3) -> [f64; 3] {
    let (width, height) = (f64::from(panorama.width), f64::from(panorama.height));
    let d = direction.normalize();
    let column = (d.z.atan2(d.x) / std::f64::consts::TAU + 0.5) * width;
    let row = d.y.acos() / std::f64::consts::PI * height;
    let index = row.min(height - 1.0) as usize * panorama.width as usize + column.min(width - 1.0) as usize;
    panorama.texels[index].map(f64::from)
}

/// Each face as it is seen from the centre: towards, right and up.
const FACES: [[DVec3; 3]; 6] = [
    [DVec3::X, DVec3::Z, DVec3::Y],
    [DVec3::NEG_X, DVec3::NEG_Z, DVec3::Y],
    [DVec3::Y, DVec3::NEG_X, DVec3::NEG_Z],
    [DVec3::NEG_Y, DVec3::NEG_X, DVec3::Z],
    [DVec3::Z, DVec3::NEG_X, DVec3::Y],
    [DVec3::NEG_Z, DVec3::X, DVec3::Y],
];

fn assert_faces(scene: &Scene, rotation: DQuat) {
    let panorama = scene.environment().expect("no environment");
    for (face, [towards, right, up]) in FACES.into_iter().enumerate() {
        for (side, height) in [(0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)] {
            let found = at(panorama, rotation * (towards + side * right + height * up));
            let divided = 2.0 * if side > 0.0 { 255.0 / 128.0 } else { 1.0 };
            let expected = [linear(40.0 * (face + 1) as f64), if height > 0.0 { 1.0 } else { linear(188.0) }, 0.0];
            for (found, expected) in found.into_iter().zip(expected) {
                let expected = expected * divided;
                // Texels are f32: the sRGB curve, the division by alpha and the factor are each rounded.
                assert!((found - expected).abs() < 1e-5 * expected.max(1.0), "face {face}: {found}, not {expected}");
            }
        }
    }
}

#[test]
fn a_cube_map_becomes_a_panorama() {
    let mut file = file();
    let scene = file.load();
    assert!(!scene.notes.iter().any(|note| note.contains("no light") || note.contains("EXT")), "{:?}", scene.notes);
    assert_faces(&scene, DQuat::IDENTITY);
    // No default light comes to it.
    let options = ImportOptions { default_light: true, ..ImportOptions::default() };
    assert_eq!(file.load_with(&options).unwrap().lights.len(), 1);
    // Unless its own is off.
    let mut dark = file.clone();
    dark.json["extensions"]["EXT_lights_image_based"]["lights"][0]["intensity"] = json!(0);
    assert_eq!(dark.load_with(&options).unwrap().placed_lights().len(), 1);
    // A quarter turn about +Y, counter-clockwise seen from above as of a node, and one about +X.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for rotation in [[0.0, half, 0.0, half], [half, 0.0, 0.0, half]] {
        file.json["extensions"]["EXT_lights_image_based"]["lights"][0]["rotation"] = json!(rotation);
        assert_faces(&file.load(), DQuat::from_array(rotation));
    }
    // Only the rendered scene has it.
    file.json["scenes"][0].as_object_mut().unwrap().remove("extensions");
    assert!(file.load().environment().is_none());
}

#[test]
fn malformed_image_lights_are_refused() {
    const LIGHT: &str = "/extensions/EXT_lights_image_based/lights/0";
    let refused = |key: &str, value: Value| {
        let mut file = file();
        file.json["extensions"]["EXT_lights_image_based"]["lights"][0][key] = value;
        refused_at(&file)
    };
    for (key, value, place) in [
        ("intensity", json!(-1), "/intensity"),
        ("rotation", json!([0, 0, 0, 0]), "/rotation"),
        ("rotation", json!([0, 0, 1]), "/rotation"),
        ("irradianceCoefficients", json!([[0, 0, 0]]), "/irradianceCoefficients"),
        ("specularImageSize", json!(16), "/specularImages/0/0"),
        ("specularImages", json!([]), "/specularImages"),
        ("specularImages", json!([[0, 1, 2, 3, 4]]), "/specularImages/0"),
        ("specularImages", json!([[0, 1, 2, 3, 4, 6]]), "/specularImages/0/5"),
        ("specularImages", json!([[0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5]]), "/specularImages/1/0"),
    ] {
        assert_eq!(refused(key, value), format!("{LIGHT}{place}"));
    }
    let mut other = file();
    other.json["scenes"][0]["extensions"]["EXT_lights_image_based"]["light"] = json!(1);
    assert_eq!(refused_at(&other), "/scenes/0/extensions/EXT_lights_image_based/light");
    // A damaged face is refused, or left out on request.
    let mut damaged = file();
    let view = damaged.view(&png(SIDE, SIDE, &vec![[9; 4]; (SIDE * SIDE) as usize])[..60]);
    damaged.json["images"][3]["bufferView"] = json!(view);
    assert!(refused_at(&damaged).starts_with("/images/3"));
    let options = ImportOptions { lenient: true, ..ImportOptions::default() };
    assert!(damaged.load_with(&options).unwrap().environment().is_none());
}
