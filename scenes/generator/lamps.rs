//! A thousand lamps of very different power in a hundred rooms without ceilings, seen from above. Most lamps are hidden
//! from most points.

use glam::{DVec3, IVec3};
use serde_json::json;

use super::glb::Glb;
use super::mesh::Mesh;
use super::noise::hash;

/// Number of rooms per side, and edge length of a room.
const ROOMS: i32 = 10;
const ROOM: f64 = 2.0;
const LAMPS_PER_ROOM: i32 = 10;
/// Half the width of the doors in the middle of the walls, and the height of the walls.
const DOOR: f64 = 0.3;
const WALL: f64 = 1.3;

pub fn glb() -> Vec<u8> {
    let mut glb = Glb::default();
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
    let half = 0.5 * ROOM * f64::from(ROOMS);
    let grey = glb.push("materials", super::lambertian("grey", [0.7, 0.7, 0.7]));
    let brown = glb.push("materials", super::lambertian("brown", [0.5, 0.35, 0.22]));
    let floor = glb.mesh("floor", &Mesh::quad(DVec3::ZERO, half * x, -half * z), grey);
    glb.push("nodes", json!({ "name": "floor", "mesh": floor }));

    // Each wall has two parts with a door between them.
    let length = 0.25 * ROOM - 0.5 * DOOR;
    let across = DVec3::new(length, 0.5 * WALL, 0.03);
    let walls =
        [across, DVec3::new(across.z, across.y, across.x)].map(|half| glb.mesh("wall", &Mesh::cuboid(half), grey));
    for line in 0..=ROOMS {
        for room in 0..ROOMS {
            for side in [-1.0, 1.0] {
                let along = ROOM * (f64::from(room) + 0.5) - half + side * (DOOR + length);
                let at = ROOM * f64::from(line) - half;
                glb.push("nodes", json!({ "mesh": walls[0], "translation": [along, 0.5 * WALL, at] }));
                glb.push("nodes", json!({ "mesh": walls[1], "translation": [at, 0.5 * WALL, along] }));
            }
        }
    }

    let pillar = glb.mesh("pillar", &Mesh::cuboid(DVec3::new(0.12, 0.4, 0.12)), brown);
    // Square lamps that emit downwards in warm and cold colours. Their radiance varies by a factor of more than a
    // hundred.
    let lamps: Vec<usize> = (0..6)
        .map(|i| {
            let mut emitter = super::emitter("lamp", 2.0 * 3f64.powi(i));
            emitter["emissiveFactor"] = if i % 2 == 0 { json!([1, 0.8, 0.5]) } else { json!([0.6, 0.8, 1]) };
            let emitter = glb.push("materials", emitter);
            glb.mesh("lamp", &Mesh::quad(DVec3::ZERO, 0.03 * x, 0.03 * z), emitter)
        })
        .collect();
    for room in 0..ROOMS * ROOMS {
        let corner = DVec3::new(ROOM * f64::from(room % ROOMS) - half, 0.0, ROOM * f64::from(room / ROOMS) - half);
        let number = |item: i32, what: i32| f64::from(hash(IVec3::new(room, item, what)) >> 12) / f64::from(1 << 20);
        let position = |item: i32, from_wall: f64| {
            let inside = |what| from_wall + (ROOM - 2.0 * from_wall) * number(item, what);
            corner + DVec3::new(inside(0), 0.0, inside(1))
        };
        for item in 0..3 {
            let at = position(item, 0.3) + 0.4 * y;
            glb.push("nodes", json!({ "mesh": pillar, "translation": at.to_array() }));
        }
        for item in 3..3 + LAMPS_PER_ROOM {
            let at = position(item, 0.1) + (0.85 + 0.4 * number(item, 2)) * y;
            // Strong lamps are rare.
            let strength = (6.0 * number(item, 3).powi(2)) as usize;
            glb.push("nodes", json!({ "mesh": lamps[strength], "translation": at.to_array() }));
        }
    }

    glb.camera(DVec3::new(-4.0, 7.0, 12.0), DVec3::new(0.3, -0.9, -1.0), 48.0, 1.0);
    glb.finish("Lamps")
}
