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
            "pbrMetallicRoughness": { "baseColorTexture": { "index": marble }, "metallicFactor": 0, "roughnessFactor": 0.35 },
        }),
    );
    let ball = glb.mesh("sphere", &Mesh::sphere(1.0, 144, 72), marble);
    glb.push("nodes", json!({ "name": "sphere", "mesh": ball, "translation": [0, 1, 0] }));

    let grey = glb.push("materials", super::lambertian("plane", [0.7, 0.7, 0.7]));
    let plane = glb.mesh("plane", &Mesh::quad(DVec3::ZERO, 6.0 * DVec3::X, -6.0 * DVec3::Z), grey);
    glb.push("nodes", json!({ "name": "plane", "mesh": plane }));

    // Radiance L gives the plane beside the sphere an irradiance of L pi 0.15^2 cos / d^2 = 0.0010 L: a reflected 0.5.
    let emitter = glb.push("materials", super::emitter("light", 2000.0));
    let lamp = glb.mesh("light", &Mesh::icosphere(0.15, 2), emitter);
    glb.push("nodes", json!({ "name": "light", "mesh": lamp, "translation": [-3, 5, 2] }));

    glb.camera(DVec3::new(0.0, 3.0, 8.0), DVec3::new(0.0, -0.25, -0.97), 40.0, 1.0);
    glb.finish("Marble sphere")
}

/// White marble with grey veins, cut from a solid so that it has neither seam nor poles.
fn marble() -> RgbImage {
    let (width, height) = (512, 256);
    RgbImage::from_fn(width, height, |x, y| {
        let p = on_sphere((f64::from(x) + 0.5) / f64::from(width), (f64::from(y) + 0.5) / f64::from(height));
        let warp = 0.6 * noise::fractal(2.0 * p + 17.0, 5);
        // Veins where bent planes cross zero: thin, some broad and faint, some fine and dark.
        let broad = vein((2.1 * p.dot(DVec3::new(0.6, 0.7, 0.4)) + warp) * 1.9, 0.30);
        let fine = vein((2.7 * p.dot(DVec3::new(-0.7, 0.5, 0.5)) + 1.3 * warp) * 2.3, 0.10);
        let cloud = 0.5 + 0.5 * noise::fractal(3.0 * p, 4);
        let white = DVec3::new(236.0, 232.0, 224.0) - 22.0 * cloud;
        let stone =
            white.lerp(DVec3::new(150.0, 150.0, 154.0), 0.6 * broad).lerp(DVec3::new(78.0, 80.0, 88.0), 0.8 * fine);
        Rgb(stone.to_array().map(|c| c.round() as u8))
    })
}

/// 1 where `x` is whole, falling to 0 over `width`.
fn vein(x: f64, width: f64) -> f64 {
    let distance = (x - x.round()).abs();
    (1.0 - distance / width).max(0.0).powi(2)
}
