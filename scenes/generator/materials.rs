//! Glass, metal and lacquer in the room of the paper's second scene.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, DVec4};
use serde_json::{Value, json};

use super::glb::Glb;
use super::mesh::Mesh;

/// Height of the floor.
const FLOOR: f64 = -1.0;

pub fn glb() -> Vec<u8> {
    let mut glb = Glb::default();
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
    let white = glb.push("materials", super::lambertian("white", [0.75, 0.75, 0.75]));
    let blue = glb.push("materials", super::lambertian("blue", [0.1, 0.2, 0.5]));
    let ochre = glb.push("materials", super::lambertian("ochre", [0.65, 0.4, 0.1]));
    for (name, material, centre, u, v) in [
        ("floor", white, FLOOR * y, x, -z),
        ("ceiling", white, y, x, z),
        ("back wall", white, -z, x, y),
        ("left wall", blue, -x, -z, y),
        ("right wall", ochre, x, z, y),
    ] {
        let mesh = glb.mesh(name, &Mesh::quad(centre, u, v), material);
        glb.push("nodes", json!({ "name": name, "mesh": mesh }));
    }

    let glass = json!({
        "KHR_materials_transmission": { "transmissionFactor": 1 },
        "KHR_materials_ior": { "ior": 1.5 },
        "KHR_materials_volume": {
            "thicknessFactor": 0.7, "attenuationDistance": 1.5, "attenuationColor": [0.7, 0.95, 0.85],
        },
    });
    let ball = Mesh::sphere(0.32, 96, 48);
    place(&mut glb, "glass ball", &ball, [1.0; 3], [0.0, 0.0], glass, [0.35, FLOOR + 0.42, 0.3]);

    let lacquer = json!({ "KHR_materials_clearcoat": { "clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.05 } });
    let ball = Mesh::sphere(0.24, 64, 32);
    place(&mut glb, "lacquered ball", &ball, [0.5, 0.02, 0.03], [0.0, 0.7], lacquer, [-0.62, FLOOR + 0.24, 0.35]);

    let brushed = json!({ "KHR_materials_anisotropy": { "anisotropyStrength": 0.8 } });
    let mut drum = Mesh::lathe(96, 24, |v| {
        // The top, a rounded edge, and the side down to the floor.
        let (radius, height, edge) = (0.3, 0.7, 0.03);
        match v * 3.0 {
            v if v < 1.0 => DVec2::new(v * (radius - edge), height),
            v if v < 2.0 => {
                let (sine, cosine) = ((v - 1.0) * TAU / 4.0).sin_cos();
                DVec2::new(radius - edge + edge * sine, height - edge + edge * cosine)
            }
            v => DVec2::new(radius, (height - edge) * (3.0 - v)),
        }
    });
    // Brushed around the axis.
    let around = |n: &DVec3| n.cross(DVec3::Y).try_normalize().unwrap_or(DVec3::X);
    drum.tangents = drum.normals.iter().map(|n| DVec4::from((around(n), 1.0))).collect();
    place(&mut glb, "brushed drum", &drum, [0.8, 0.8, 0.82], [1.0, 0.35], brushed, [-0.35, FLOOR, -0.45]);

    let ring = Mesh::surface(128, 24, true, |u, v| {
        let (sine, cosine) = (TAU * u).sin_cos();
        let radial = DVec3::new(sine, 0.0, cosine);
        let (up, out) = (TAU * (0.5 - v)).sin_cos();
        let normal = out * radial + up * DVec3::Y;
        (0.22 * radial + DVec3::new(0.02, 0.07, 0.02) * normal, (normal / DVec3::new(1.0, 3.5, 1.0)).normalize())
    });
    place(&mut glb, "gold ring", &ring, [1.0, 0.77, 0.34], [1.0, 0.1], json!({}), [-0.12, FLOOR + 0.07, 0.6]);

    // A small and bright lamp makes sharp caustics.
    let emitter = glb.push("materials", super::emitter("light", 75.0));
    let lamp = glb.mesh("light", &Mesh::quad(0.99 * y, 0.16 * x, 0.16 * z), emitter);
    glb.push("nodes", json!({ "name": "light", "mesh": lamp }));

    glb.camera(DVec3::new(0.0, 0.1, 3.6), DVec3::new(0.0, -0.06, -1.0), 40.0, 1.0);
    glb.finish("Materials")
}

/// Adds an object with its own material: colour, metallic and roughness factor, extensions.
fn place(
    glb: &mut Glb,
    name: &str,
    mesh: &Mesh,
    [r, g, b]: [f64; 3],
    [metallic, roughness]: [f64; 2],
    extensions: Value,
    at: [f64; 3],
) {
    let material = json!({
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [r, g, b, 1], "metallicFactor": metallic, "roughnessFactor": roughness,
        },
        "extensions": extensions,
    });
    let material = glb.push("materials", material);
    let mesh = glb.mesh(name, mesh, material);
    glb.push("nodes", json!({ "name": name, "mesh": mesh, "translation": at }));
}
