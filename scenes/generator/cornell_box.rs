//! The paper's second scene (fig. 3): a cube in a room under a large square light. All surfaces face the room.

use glam::DVec3;
use serde_json::json;

use super::glb::{Glb, rotation_about};
use super::mesh::Mesh;

pub fn glb() -> Vec<u8> {
    let mut glb = Glb::default();
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
    let white = glb.push("materials", super::lambertian("white", [0.75, 0.75, 0.75]));
    let red = glb.push("materials", super::lambertian("red", [0.6, 0.06, 0.05]));
    let green = glb.push("materials", super::lambertian("green", [0.12, 0.45, 0.09]));

    for (name, material, centre, u, v) in [
        ("floor", white, -y, x, -z),
        ("ceiling", white, y, x, z),
        ("back wall", white, -z, x, y),
        ("left wall", red, -x, -z, y),
        ("right wall", green, x, z, y),
    ] {
        let mesh = glb.mesh(name, &Mesh::quad(centre, u, v), material);
        glb.push("nodes", json!({ "name": name, "mesh": mesh }));
    }

    let cube = glb.mesh("cube", &Mesh::cuboid(DVec3::splat(0.35)), white);
    let position = [0.3, -0.65, 0.1];
    glb.push(
        "nodes",
        json!({ "name": "cube", "mesh": cube, "translation": position, "rotation": rotation_about(y, 20.0) }),
    );

    // Radiance L causes an irradiance of about 0.64 L / 2^2 = 0.16 L at the centre of the floor: a reflected radiance
    // of 0.46 without indirect light.
    let emitter = glb.push("materials", super::emitter("light", 12.0));
    let lamp = glb.mesh("light", &Mesh::quad(0.99 * y, 0.4 * x, 0.4 * z), emitter);
    glb.push("nodes", json!({ "name": "light", "mesh": lamp }));

    glb.camera(3.6 * z, -z, 40.0, 1.0);
    glb.finish("Box")
}
