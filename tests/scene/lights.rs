//! Punctual lights, emissive meshes and the default light.

use std::f64::consts::{FRAC_PI_4, PI};

use glam::Vec3;
use penumbra::internal::scene::{EmitterTriangle, ImportOptions, LightKind, NO_LIGHT, Projection, Scene};
use serde_json::{Value, json};

use crate::builder::{File, png};

/// The triangle of [`File::triangle`], whose scale is 1/4 and whose centre is (2, 1, 0), and a node with the light.
fn with_light(light: Value, mut node: Value) -> File {
    let mut file = File::triangle();
    file.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [light] } });
    node["extensions"] = json!({ "KHR_lights_punctual": { "light": 0 } });
    file.add("nodes", node);
    file
}

fn light(light: Value, node: Value) -> LightKind {
    with_light(light, node).load().lights.swap_remove(0).kind
}

#[test]
fn point_light_in_normalised_space() {
    let json = json!({ "type": "point", "color": [1, 0.5, 0.25], "intensity": 32, "range": 8, "name": "bulb" });
    let file = with_light(json, json!({ "translation": [2, 5, 0], "scale": [9, 9, 9] }));
    let scene = file.load();
    assert_eq!(scene.lights[0].name, "bulb");
    // Intensity over distance squared is kept: 32 / 4^2.
    let expected = LightKind::Point { position: Vec3::Y, intensity: Vec3::new(2.0, 1.0, 0.5), range: 2.0 };
    assert_eq!(scene.lights[0].kind, expected);
    let LightKind::Point { intensity, range, .. } = light(json!({ "type": "point" }), json!({})) else { panic!() };
    assert_eq!((intensity, range), (Vec3::splat(1.0 / 16.0), f32::INFINITY));
}

#[test]
fn spot_light_defaults_and_direction() {
    // A rotation by 180 degrees about +x: -z becomes +z.
    let kind = light(json!({ "type": "spot", "spot": {} }), json!({ "rotation": [1, 0, 0, 0] }));
    let LightKind::Spot { direction, cos_inner, cos_outer, .. } = kind else { panic!("{kind:?}") };
    assert_eq!(direction, Vec3::Z);
    assert_eq!((cos_inner, cos_outer), (1.0, FRAC_PI_4.cos() as f32));
    let spot = json!({ "innerConeAngle": 0.3, "outerConeAngle": 0.30000000001 });
    let LightKind::Spot { cos_inner, cos_outer, .. } = light(json!({ "type": "spot", "spot": spot }), json!({})) else {
        panic!()
    };
    assert!(cos_inner > cos_outer, "angles that are equal in f32");
}

#[test]
fn directional_light_keeps_its_lux() {
    let json = json!({ "type": "directional", "intensity": 3, "range": 1 });
    let kind = light(json, json!({ "scale": [5, 5, 5] }));
    assert_eq!(kind, LightKind::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::splat(3.0) });
}

#[test]
fn lights_without_emission_or_direction_are_left_out() {
    for (json, node) in [
        (json!({ "type": "point", "intensity": 0 }), json!({})),
        (json!({ "type": "directional" }), json!({ "scale": [1, 1, 0] })),
        (json!({ "type": "spherical" }), json!({})),
    ] {
        let scene = with_light(json, node).load();
        assert!(scene.lights.is_empty());
        assert!(scene.notes.iter().any(|n| n.contains("left out")), "{:?}", scene.notes);
    }
}

/// A light that is off gives no light: the default light is added beside it.
#[test]
fn lights_that_are_off_do_not_replace_the_default_light() {
    let lit = ImportOptions { default_light: true, ..Default::default() };
    for (json, node) in [
        (json!({ "type": "point", "intensity": 0 }), json!({})),
        (json!({ "type": "point", "color": [0, 0, 0] }), json!({})),
        (json!({ "type": "directional" }), json!({ "scale": [1, 1, 0] })),
    ] {
        let scene = with_light(json, node).load_with(&lit).unwrap();
        assert_eq!(scene.lights.iter().map(|light| light.name.as_str()).collect::<Vec<_>>(), ["default light"]);
        assert!(scene.notes.iter().any(|note| note.contains("a soft one is added")), "{:?}", scene.notes);
    }
    // A point light needs no direction.
    let scene = with_light(json!({ "type": "point" }), json!({ "scale": [0, 0, 0], "name": "bulb" })).load_with(&lit);
    assert_eq!(scene.unwrap().lights.iter().map(|light| light.name.as_str()).collect::<Vec<_>>(), ["bulb"]);
}

/// The emitters of light `index`.
fn emitters(scene: &Scene, index: usize) -> &[EmitterTriangle] {
    match &scene.lights[index].kind {
        LightKind::Mesh { emitters, .. } => emitters,
        other => panic!("{other:?}"),
    }
}

#[test]
fn lights_come_in_the_order_of_nodes_one_for_each_node_and_material() {
    let mut file = with_light(json!({ "type": "point" }), json!({ "name": "bulb" }));
    for strength in [1, 2] {
        file.add("materials", json!({ "emissiveFactor": [strength, 0, 0] }));
    }
    // Three primitives, two of which share a material.
    let position = file.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].clone();
    let primitive = |material: u32| json!({ "attributes": { "POSITION": position }, "material": material });
    let lamp = file.add("meshes", json!({ "primitives": [primitive(0), primitive(1), primitive(0)] }));
    file.add("nodes", json!({ "mesh": lamp, "name": "lamp" }));
    file.add("nodes", json!({ "mesh": lamp, "translation": [0, 0, 1] }));
    let scene = file.load();
    let names: Vec<&str> = scene.lights.iter().map(|l| l.name.as_str()).collect();
    assert_eq!(names, ["bulb", "lamp", "lamp", "light 3", "light 4"]);
    let of_triangles: Vec<u32> = scene.triangles.iter().map(|t| t.light).collect();
    assert_eq!(of_triangles, [NO_LIGHT, 1, 2, 1, 3, 4, 3]);
    assert_eq!(emitters(&scene, 1), [1, 3].map(|triangle| EmitterTriangle { triangle, radiance: Vec3::X }));
    assert_eq!(emitters(&scene, 4), [EmitterTriangle { triangle: 5, radiance: 2.0 * Vec3::X }]);
}

/// A triangle with the texture coordinates `uvs` that emits an image with radiance 8 at white texels.
fn textured(width: u32, height: u32, texels: &[[u8; 4]], uvs: [[f32; 2]; 3]) -> Scene {
    const NEAREST: u32 = 9728;
    filtered(NEAREST, width, height, texels, uvs)
}

fn filtered(filter: u32, width: u32, height: u32, texels: &[[u8; 4]], uvs: [[f32; 2]; 3]) -> Scene {
    lamp(8.0, filter, [width, height], texels, uvs)
}

/// A triangle that shines with that strength through a texture.
fn lamp(strength: f32, filter: u32, [width, height]: [u32; 2], texels: &[[u8; 4]], uvs: [[f32; 2]; 3]) -> Scene {
    let mut file = File::new();
    let view = file.view(&png(width, height, texels));
    file.add("images", json!({ "bufferView": view, "mimeType": "image/png" }));
    file.add("samplers", json!({ "magFilter": filter }));
    file.add("textures", json!({ "source": 0, "sampler": 0 }));
    let strength = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": strength } });
    file.add(
        "materials",
        json!({ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 }, "extensions": strength }),
    );
    let uv = file.floats(&uvs);
    file.mesh(
        &[[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]],
        json!({ "material": 0, "attributes": { "TEXCOORD_0": uv } }),
    );
    file.load()
}

const BLACK: [u8; 4] = [0, 0, 0, 255];
const WHITE: [u8; 4] = [255; 4];

/// The brightest lamps of f32 are as bright through a texture.
#[test]
fn bright_textured_emitters_do_not_overflow() {
    let scene = lamp(1e38, 9729, [1, 1], &[WHITE], [[0., 0.], [1., 0.], [0., 1.]]);
    assert_eq!(emitters(&scene, 0)[0].radiance, Vec3::splat(1e38));
}

#[test]
fn textured_emitters_emit_their_mean() {
    let half = [BLACK, WHITE];
    // A quarter of the triangle has u > 1/2. The edge cuts about 8 of the 64 strata, each with an error of at most a
    // half.
    let scene = textured(2, 1, &half, [[0., 0.], [1., 0.], [0., 1.]]);
    let mean = emitters(&scene, 0)[0].radiance;
    assert!((mean / 8.0 - Vec3::splat(0.25)).abs().max_element() < 1.0 / 16.0, "{mean}");
    // sRGB 188 is 0.5029 linear, by the standard's formula ((188/255 + 0.055) / 1.055)^2.4.
    let scene = textured(1, 1, &[[188, 0, 0, 255]], [[0., 0.], [1., 0.], [0., 1.]]);
    let mean = emitters(&scene, 0)[0].radiance;
    // 0.5029 has four decimals: half of the last one is 5e-5.
    assert!((mean - Vec3::new(8.0 * 0.5029, 0.0, 0.0)).length() < 8.0 * 1e-4, "{mean}");
    // Tiled into the white half, with v beyond the image.
    let scene = textured(2, 1, &half, [[1.6, -3.], [1.9, 2.], [1.6, 7.]]);
    // A mean of 64 equal points in f32: at most 64 roundings of 6e-8 of it.
    assert!((emitters(&scene, 0)[0].radiance - Vec3::splat(8.0)).length() < 1e-4);
    // Bilinear with texel centres at u = 1/4 and 3/4: a third of the way gives a third of the light.
    const LINEAR: u32 = 9729;
    let uv = [0.25 + 0.5 / 3.0, 0.5];
    let scene = filtered(LINEAR, 2, 1, &half, [uv; 3]);
    assert!((emitters(&scene, 0)[0].radiance - Vec3::splat(8.0 / 3.0)).length() < 1e-5);
    // Coordinates that overflow have no filter weights.
    assert!(filtered(LINEAR, 2, 1, &half, [[3e38, 0.], [-3e38, 3e38], [0., 3e38]]).lights.is_empty());
    // In the black half and away from its edges there is no emitter, and thus no light.
    let mut black_left = vec![BLACK; 16];
    black_left[12..].fill(WHITE);
    let scene = textured(16, 1, &black_left, [[0.2, 0.5], [0.5, 0.5], [0.4, 0.5]]);
    assert!(scene.lights.is_empty());
    assert_eq!(scene.triangles[0].light, NO_LIGHT);
}

/// The mean of small bright spots is that of all texels: one texel in eight by eight is bright. There are about as many
/// points as texels, so a spot has one on average, up to two where the points are dense, and the mean is within half of
/// 1/64. Of 64 points, between none and four met a spot.
#[test]
fn small_bright_spots_are_counted() {
    for place in 0..8 {
        let mut texels = vec![BLACK; 64 * 64];
        for spot in 0..64 {
            texels[(spot / 8 * 8 + place) * 64 + spot % 8 * 8 + (5 * place + 3) % 8] = WHITE;
        }
        for corners in [[[0., 0.], [1., 0.], [0., 1.]], [[1., 1.], [0., 1.], [1., 0.]]] {
            let scene = textured(64, 64, &texels, corners);
            let share = emitters(&scene, 0)[0].radiance.x / 8.0 * 64.0;
            assert!((share - 1.0).abs() < 0.5, "spots at {place}: {share} of the mean");
        }
    }
}

#[test]
fn a_single_bright_texel_is_not_lost() {
    for bright in 0..64 {
        let mut texels = vec![BLACK; 64 * 64];
        texels[bright * 64 + 20] = WHITE;
        // This triangle covers the texels with u + v <= 1: those of the rows above 43.
        let scene = textured(64, 64, &texels, [[0., 0.], [1., 0.], [0., 1.]]);
        if bright < 43 {
            let radiance = emitters(&scene, 0)[0].radiance.x;
            // At most two of the 64 points can hit the texel: strata near a corner are as small as a texel.
            assert!(radiance > 0.0 && radiance <= 2.0 * 8.0 / 64.0, "row {bright}: {radiance}");
        }
    }
}

#[test]
fn the_default_light_lights_a_white_surface_that_faces_it_to_one() {
    let mut file = File::new();
    file.mesh(&[[-1., 0., -1.], [-1., 0., 1.], [1., 0., -1.], [1., 0., 1.]], json!({ "mode": 5 }));
    let lit = ImportOptions { default_light: true, ..Default::default() };
    let scene = file.load_with(&lit).unwrap();
    assert!(scene.notes.iter().any(|n| n.contains("a soft one is added")));
    assert!(!scene.notes.iter().any(|n| n == "no light in the file: `default_light` adds one"));
    assert_eq!(scene.lights.len(), 1);

    let emitting = emitters(&scene, 0);
    let corners = emitting.iter().flat_map(|emitter| scene.triangle_positions(emitter.triangle as usize));
    let corners: Vec<_> = corners.map(|p| scene.normalisation.undo(p)).collect();
    let bounds = corners.iter().fold((corners[0], corners[0]), |(low, high), p| (low.min(*p), high.max(*p)));
    let towards = (bounds.0 + bounds.1).normalize();
    // Above, before and to the left of the front, +Z.
    assert!(towards.y > 0.7 && towards.z > 0.3 && towards.x < -0.2, "{towards}");

    // Irradiance at the world's origin by the midpoint rule with 128 x 128 parts, whose error is about 1e-5.
    const N: u32 = 128;
    let mut irradiance = 0.0;
    for emitter in emitters(&scene, 0) {
        let [a, b, c] = scene.triangle_positions(emitter.triangle as usize).map(|p| scene.normalisation.undo(p));
        let cross = (b - a).cross(c - a);
        let normal = cross.normalize();
        // Roundings of corners to f32.
        assert!((normal + towards).length() < 1e-6, "faces the middle of the scene");
        let area = 0.5 * cross.length() / f64::from(N * N);
        for i in 0..N {
            for j in 0..2 * (N - i) - 1 {
                // The small triangles of strip i, upright and inverted: their centroids.
                let (u, inverted) = (j / 2, j % 2);
                let third = if inverted == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 };
                let at = |k: u32| (f64::from(k) + third) / f64::from(N);
                let p = a + at(u) * (b - a) + at(i) * (c - a);
                let d = p.normalize();
                irradiance +=
                    f64::from(emitter.radiance.x) * d.dot(towards) * -d.dot(normal) * area / p.length_squared();
            }
        }
    }
    assert!((irradiance / PI - 1.0).abs() < 1e-3, "{}", irradiance / PI);
    // The light is neither in the view of the framing camera nor between the camera and the scene.
    let camera = scene.frame_camera();
    let Projection::Perspective { yfov, .. } = camera.projection else { panic!() };
    for emitter in emitters(&scene, 0) {
        for corner in scene.triangle_positions(emitter.triangle as usize) {
            let v = corner - camera.position;
            let depth = -v.dot(camera.axes[2]);
            assert!(v.dot(camera.axes[1]) > depth * (yfov / 2.0).tan());
        }
    }
}

#[test]
fn the_default_light_is_for_scenes_without_lights() {
    let lit = ImportOptions { default_light: true, ..Default::default() };
    assert!(File::triangle().load().lights.is_empty());
    let file = with_light(json!({ "type": "point" }), json!({}));
    let (with, without) = (file.load_with(&lit).unwrap(), file.load());
    assert_eq!((with.lights, with.triangles, with.notes), (without.lights, without.triangles, without.notes));
    // Nothing to light: nothing is added.
    assert!(File::new().load_with(&lit).unwrap().triangles.is_empty());
}
