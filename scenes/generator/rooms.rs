//! Two rooms whose light comes by way of a few bright surfaces, so that most of the image is indirect: in one it falls
//! through a door that is ajar, in the other a floor lamp shines at the ceiling.

use glam::{DVec2, DVec3};
use serde_json::json;

use super::glb::{Glb, rotation_about};
use super::mesh::Mesh;

/// The room, in metres: |x| <= HALF.x, 0 <= y <= 2 HALF.y, |z| <= HALF.z.
const HALF: DVec3 = DVec3::new(2.2, 1.25, 2.4);

/// The doorway in the wall at x = -HALF.x: ends along z, and height.
const DOORWAY: [f64; 2] = [-0.9, 0.0];
const DOOR_HEIGHT: f64 = 2.05;
const WALL: f64 = 0.12;
/// Degrees between the door and its frame.
const AJAR: f64 = 20.0;
/// Width of the corridor behind the door.
const CORRIDOR: f64 = 1.6;

/// The room behind a door that is ajar; its only lamp hangs in the corridor.
pub fn door() -> Vec<u8> {
    let mut room = Room::new();
    room.inner_walls(false);
    // The wall with the doorway: before it, behind it and above it.
    let x = -HALF.x - 0.5 * WALL;
    for (from, to, below, above) in [
        (-HALF.z, DOORWAY[0], 0.0, 2.0 * HALF.y),
        (DOORWAY[1], HALF.z, 0.0, 2.0 * HALF.y),
        (DOORWAY[0], DOORWAY[1], DOOR_HEIGHT, 2.0 * HALF.y),
    ] {
        let centre = DVec3::new(x, 0.5 * (below + above), 0.5 * (from + to));
        let half = DVec3::new(0.5 * WALL, 0.5 * (above - below), 0.5 * (to - from));
        room.cuboid("wall", room.white, centre, half, 0.0);
    }
    // The door turns about its far side into the room.
    let width = DOORWAY[1] - DOORWAY[0];
    let (sine, cosine) = AJAR.to_radians().sin_cos();
    let middle = DVec3::new(-HALF.x + 0.5 * width * sine, 0.5 * DOOR_HEIGHT, DOORWAY[0] + 0.5 * width * cosine);
    let leaf = DVec3::new(0.02, 0.5 * DOOR_HEIGHT - 0.005, 0.5 * width - 0.005);
    room.cuboid("door", room.wood, middle, leaf, AJAR);

    // The corridor, as long as the room.
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
    let half = DVec3::new(0.5 * CORRIDOR, HALF.y, HALF.z);
    let centre = DVec3::new(-HALF.x - WALL - half.x, HALF.y, 0.0);
    for (name, offset, u, v) in [
        ("corridor floor", -half.y * y, half.x * x, -half.z * z),
        ("corridor ceiling", half.y * y, half.x * x, half.z * z),
        ("corridor end", -half.z * z, half.x * x, half.y * y),
        ("corridor front", half.z * z, -half.x * x, half.y * y),
        ("corridor side", -half.x * x, -half.z * z, half.y * y),
    ] {
        room.add(name, &Mesh::quad(centre + offset, u, v), room.white);
    }
    // The threshold closes the gap below the thickness of the wall.
    let sill = DVec3::new(-HALF.x - 0.5 * WALL, 0.0, 0.5 * (DOORWAY[0] + DOORWAY[1]));
    room.add("threshold", &Mesh::quad(sill, 0.5 * WALL * x, -0.5 * width * z), room.wood);
    let lamp = Mesh::quad(centre + DVec3::new(0.1, half.y - 0.06, -0.9), 0.25 * x, 0.25 * z);
    let emitter = room.glb.push("materials", super::emitter("lamp", 600.0));
    room.add("lamp", &lamp, emitter);
    room.finish("Door")
}

/// The room with a floor lamp whose shade is open at the top only.
pub fn uplight() -> Vec<u8> {
    let mut room = Room::new();
    room.inner_walls(true);
    let foot = DVec3::new(-1.3, 0.0, -1.5);
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
    room.cuboid("pole", room.wood, foot + 0.85 * y, DVec3::new(0.015, 0.85, 0.015), 0.0);
    // The outside of the shade, then its inside, from the bottom to the rim and back.
    let shade = [[0.0, 1.7], [0.09, 1.7], [0.17, 1.86], [0.16, 1.86], [0.08, 1.71], [0.0, 1.71]];
    let mut mesh = Mesh::default();
    // From left to right of the profile's direction is from inside to outside: the profile runs backwards.
    for line in shade.windows(2) {
        let [to, from] = [line[0], line[1]].map(DVec2::from_array);
        mesh.append(Mesh::lathe(24, 1, |v| from.lerp(to, v)));
    }
    let metal = room.glb.push("materials", super::lambertian("shade", [0.5, 0.5, 0.52]));
    let mesh = room.glb.mesh("shade", &mesh, metal);
    room.glb.push("nodes", json!({ "name": "shade", "mesh": mesh, "translation": foot.to_array() }));
    let emitter = room.glb.push("materials", super::emitter("lamp", 900.0));
    let lamp = Mesh::quad(foot + 1.74 * y, 0.06 * x, -0.06 * z);
    room.add("lamp", &lamp, emitter);
    room.finish("Uplight")
}

/// A room with furniture, under construction.
struct Room {
    glb: Glb,
    white: usize,
    wood: usize,
}

impl Room {
    fn new() -> Room {
        let mut glb = Glb::default();
        let white = glb.push("materials", super::lambertian("white", [0.75, 0.73, 0.7]));
        let wood = glb.push("materials", super::lambertian("wood", [0.5, 0.33, 0.18]));
        let red = glb.push("materials", super::lambertian("red", [0.6, 0.1, 0.08]));
        let blue = glb.push("materials", super::lambertian("blue", [0.15, 0.25, 0.5]));
        let mut room = Room { glb, white, wood };

        // A table with a ball and a box on it, and a crate beside it.
        let table = DVec3::new(0.55, 0.0, -0.9);
        room.cuboid("table", wood, table + DVec3::new(0.0, 0.72, 0.0), DVec3::new(0.65, 0.025, 0.4), 0.0);
        for (x, z) in [(-0.58, -0.33), (0.58, -0.33), (-0.58, 0.33), (0.58, 0.33)] {
            room.cuboid("leg", wood, table + DVec3::new(x, 0.3475, z), DVec3::new(0.03, 0.3475, 0.03), 0.0);
        }
        let ball = room.glb.mesh("ball", &Mesh::sphere(0.16, 48, 24), red);
        let position = table + DVec3::new(-0.25, 0.905, 0.1);
        room.glb.push("nodes", json!({ "name": "ball", "mesh": ball, "translation": position.to_array() }));
        room.cuboid("box", blue, table + DVec3::new(0.25, 0.845, -0.05), DVec3::new(0.14, 0.1, 0.1), 30.0);
        room.cuboid("crate", white, DVec3::new(-0.75, 0.25, 0.1), DVec3::new(0.25, 0.25, 0.25), 35.0);
        room
    }

    /// Floor, ceiling and walls, which face the room; the wall at -x only if it is `closed`.
    fn inner_walls(&mut self, closed: bool) {
        let [x, y, z] = [HALF.x * DVec3::X, HALF.y * DVec3::Y, HALF.z * DVec3::Z];
        let (white, wood) = (self.white, self.wood);
        for (name, material, centre, u, v) in [
            ("floor", wood, DVec3::ZERO, x, -z),
            ("ceiling", white, 2.0 * y, x, z),
            ("back wall", white, y - z, x, y),
            ("front wall", white, y + z, -x, y),
            ("right wall", white, y + x, z, y),
        ] {
            self.add(name, &Mesh::quad(centre, u, v), material);
        }
        if closed {
            self.add("left wall", &Mesh::quad(y - x, -z, y), white);
        }
    }

    /// A cuboid about `centre`, turned by `degrees` about +y.
    fn cuboid(&mut self, name: &str, material: usize, centre: DVec3, half: DVec3, degrees: f64) {
        let mesh = self.glb.mesh(name, &Mesh::cuboid(half), material);
        self.glb.push(
            "nodes",
            json!({
                "name": name, "mesh": mesh, "translation": centre.map(super::mesh::tidy).to_array(),
                "rotation": rotation_about(DVec3::Y, degrees),
            }),
        );
    }

    fn add(&mut self, name: &str, mesh: &Mesh, material: usize) {
        let mesh = self.glb.mesh(name, mesh, material);
        self.glb.push("nodes", json!({ "name": name, "mesh": mesh }));
    }

    fn finish(mut self, name: &str) -> Vec<u8> {
        self.glb.camera(DVec3::new(1.7, 1.5, 2.3), DVec3::new(-0.62, -0.14, -1.0), 58.0, 1.0);
        self.glb.finish(name)
    }
}
