//! The paper's first scene (fig. 2): a marble sphere on a plane under a small spherical light.

use glam::DVec3;
use image::{Rgb, RgbImage};
use serde_json::json;

use super::glb::{Glb, Wrap};
use super::mesh::{Mesh, on_sphere};
use super::noise;

pub fn glb() -> Vec<u8> {
    let mut glb = Glb::default();

    let marble = glb.texture("marble", marble(), Wrap::Repeat);
    let marble = glb.push(
        "materials",
        json!({
            "name": "marble",
            "pbrMetallicRoughness": {
                "baseColorTexture": { "index": marble }, "metallicFactor": 0, "roughnessFactor": 0.35,
            },
        }),
    );
    let ball = glb.mesh("sphere", &Mesh::sphere(1.0, 144, 72), marble);
    glb.push("nodes", json!({ "name": "sphere", "mesh": ball, "translation": [0, 1, 0] }));

    plane_and_lamp(&mut glb);
    glb.camera(DVec3::new(0.0, 3.0, 8.0), DVec3::new(0.0, -0.25, -0.97), 40.0, 1.0);
    glb.finish("Marble sphere")
}

/// The plane and the light.
pub(super) fn plane_and_lamp(glb: &mut Glb) {
    let grey = glb.push("materials", super::lambertian("plane", [0.7, 0.7, 0.7]));
    let plane = glb.mesh("plane", &Mesh::quad(DVec3::ZERO, 6.0 * DVec3::X, -6.0 * DVec3::Z), grey);
    glb.push("nodes", json!({ "name": "plane", "mesh": plane }));

    // Without the sphere, radiance L causes an irradiance of L pi 0.15^2 (5 / d) / d^2 = 0.0015 L below its centre,
    // with d^2 = 38: a reflected radiance of 0.5.
    let emitter = glb.push("materials", super::emitter("light", 1500.0));
    let lamp = glb.mesh("light", &Mesh::icosphere(0.15, 2), emitter);
    glb.push("nodes", json!({ "name": "light", "mesh": lamp, "translation": [-3, 5, 2] }));
}

/// White marble with grey veins, evaluated in space so that there are no seams or poles.
fn marble() -> RgbImage {
    let (width, height) = (512, 256);
    RgbImage::from_fn(width, height, |x, y| {
        let p = on_sphere((f64::from(x) + 0.5) / f64::from(width), (f64::from(y) + 0.5) / f64::from(height));
        let warp = DVec3::new(3.0, 17.0, 29.0).map(|offset| noise::fractal(1.4 * p + offset, 5));
        let p = p + 0.45 * warp;
        // Veins are zeros of distorted planes that fade in and out. Some are broad and faint, others fine and dark.
        let fade = |offset: f64| (0.45 + noise::fractal(1.7 * p + offset, 3)).clamp(0.0, 1.0);
        let broad = fade(41.0) * vein(1.3 * p.dot(DVec3::new(0.6, 0.7, 0.4)), 0.35);
        let fine = fade(53.0) * vein(1.9 * p.dot(DVec3::new(-0.7, 0.5, 0.5)), 0.10);
        let cross = fade(67.0) * vein(1.1 * p.dot(DVec3::new(0.2, -0.4, 0.9)) + 0.3, 0.06);
        let cloud = 0.5 + 0.5 * noise::fractal(2.5 * p, 4);
        let white = DVec3::new(236.0, 232.0, 224.0) - 26.0 * cloud;
        let grey = DVec3::new(128.0, 128.0, 134.0);
        let dark = DVec3::new(62.0, 64.0, 74.0);
        let stone = white.lerp(grey, 0.7 * broad).lerp(dark, 0.9 * fine).lerp(dark, 0.8 * cross);
        Rgb(stone.to_array().map(|c| c.round() as u8))
    })
}

/// 1 at integers `x`, falling to 0 over `width`.
fn vein(x: f64, width: f64) -> f64 {
    let distance = (x - x.round()).abs();
    (1.0 - distance / width).max(0.0).powi(2)
}
