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
    room(&mut glb);
    glass_ball(&mut glb);
    lacquered_ball(&mut glb);
    brushed_drum(&mut glb);
    gold_ring(&mut glb);
    // A small and bright lamp makes sharp caustics.
    let emitter = glb.push("materials", super::emitter("light", 75.0));
    let lamp = glb.mesh("light", &Mesh::quad(0.99 * DVec3::Y, 0.16 * DVec3::X, 0.16 * DVec3::Z), emitter);
    glb.push("nodes", json!({ "name": "light", "mesh": lamp }));

    glb.camera(DVec3::new(0.0, 0.1, 3.6), DVec3::new(0.0, -0.06, -1.0), 40.0, 1.0);
    glb.finish("Materials")
}

fn room(glb: &mut Glb) {
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
}

fn glass_ball(glb: &mut Glb) {
    let glass = json!({
        "KHR_materials_transmission": { "transmissionFactor": 1 },
        "KHR_materials_ior": { "ior": 1.5 },
        "KHR_materials_volume": {
            "thicknessFactor": 0.7, "attenuationDistance": 1.5, "attenuationColor": [0.7, 0.95, 0.85],
        },
    });
    let ball = Mesh::sphere(0.32, 96, 48);
    let object = Object {
        name: "glass ball",
        colour: [1.0; 3],
        metallic_roughness: [0.0, 0.0],
        extensions: glass,
        position: [0.35, FLOOR + 0.42, 0.3],
    };
    object.add(glb, &ball);
}

fn lacquered_ball(glb: &mut Glb) {
    let lacquer = json!({ "KHR_materials_clearcoat": { "clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.05 } });
    let ball = Mesh::sphere(0.24, 64, 32);
    let object = Object {
        name: "lacquered ball",
        colour: [0.5, 0.02, 0.03],
        metallic_roughness: [0.0, 0.7],
        extensions: lacquer,
        position: [-0.62, FLOOR + 0.24, 0.35],
    };
    object.add(glb, &ball);
}

fn brushed_drum(glb: &mut Glb) {
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
    let object = Object {
        name: "brushed drum",
        colour: [0.8, 0.8, 0.82],
        metallic_roughness: [1.0, 0.35],
        extensions: brushed,
        position: [-0.35, FLOOR, -0.45],
    };
    object.add(glb, &drum);
}

fn gold_ring(glb: &mut Glb) {
    let ring = Mesh::surface(128, 24, true, |u, v| {
        let (sine, cosine) = (TAU * u).sin_cos();
        let radial = DVec3::new(sine, 0.0, cosine);
        let (up, out) = (TAU * (0.5 - v)).sin_cos();
        let normal = out * radial + up * DVec3::Y;
        (0.22 * radial + DVec3::new(0.02, 0.07, 0.02) * normal, (normal / DVec3::new(1.0, 3.5, 1.0)).normalize())
    });
    let object = Object {
        name: "gold ring",
        colour: [1.0, 0.77, 0.34],
        metallic_roughness: [1.0, 0.1],
        extensions: json!({}),
        position: [-0.12, FLOOR + 0.07, 0.6],
    };
    object.add(glb, &ring);
}

/// An object with its own material.
struct Object {
    name: &'static str,
    /// Linear RGB.
    colour: [f64; 3],
    /// Metallic and roughness factor.
    metallic_roughness: [f64; 2],
    /// Extensions of the material.
    extensions: Value,
    position: [f64; 3],
}

impl Object {
    fn add(self, glb: &mut Glb, mesh: &Mesh) {
        let ([r, g, b], [metallic, roughness]) = (self.colour, self.metallic_roughness);
        let material = json!({
            "name": self.name,
            "pbrMetallicRoughness": {
                "baseColorFactor": [r, g, b, 1], "metallicFactor": metallic, "roughnessFactor": roughness,
            },
            "extensions": self.extensions,
        });
        let material = glb.push("materials", material);
        let mesh = glb.mesh(self.name, mesh, material);
        glb.push("nodes", json!({ "name": self.name, "mesh": mesh, "translation": self.position }));
    }
}
