//! Procedural objects: the marble sphere of the paper as an exact sphere of solid marble, and a fractal.

use glam::DVec3;
use serde_json::{Value, json};

use super::glb::{Glb, rotation_about};
use super::marble_sphere;

pub fn glb() -> Vec<u8> {
    let mut glb = Glb::default();
    let marble = json!({
        "name": "marble",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.85, 0.82, 0.76, 1], "metallicFactor": 0, "roughnessFactor": 0.35,
        },
    });
    let marble = glb.push("materials", marble);
    let sphere = json!({
        "source": "procedural/sphere.wgsl", "function": "sphere", "kind": "intersection", "parameters": [1],
        "min": [-1, -1, -1], "max": [1, 1, 1], "material": marble,
        "colour": { "source": "procedural/marble.wgsl", "function": "marble", "parameters": [1.3] },
    });
    place(&mut glb, "sphere", sphere, DVec3::new(-1.15, 1.0, 0.0), 1.0, 0.0);

    let stone = glb.push("materials", super::lambertian("stone", [0.6, 0.33, 0.2]));
    let sponge = json!({
        "source": "procedural/menger.wgsl", "function": "menger", "kind": "distance", "parameters": [4],
        "min": [-1, -1, -1], "max": [1, 1, 1], "material": stone,
    });
    place(&mut glb, "sponge", sponge, DVec3::new(1.25, 0.8, -0.2), 0.8, 30.0);

    marble_sphere::plane_and_lamp(&mut glb);

    glb.camera(DVec3::new(0.0, 2.6, 7.0), DVec3::new(0.0, -0.26, -0.97), 34.0, 1.5);
    glb.finish("Procedural objects")
}

fn place(glb: &mut Glb, name: &str, object: Value, at: DVec3, scale: f64, degrees: f64) {
    let extensions = json!({ "PENUMBRA_procedural": object });
    let rotation = rotation_about(DVec3::Y, degrees);
    let node = json!({
        "name": name, "extensions": extensions,
        "translation": at.to_array(), "rotation": rotation, "scale": [scale, scale, scale],
    });
    glb.push("nodes", node);
}
