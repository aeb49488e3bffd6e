//! Small objects of many shapes, scattered over a plane under a small square light: most shadows are narrow, and few
//! photons meet each object.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec2, DVec3, IVec3};
use serde_json::json;

use super::glb::{Glb, rotation_about};
use super::mesh::{Mesh, tidy};
use super::noise::hash;

const OBJECTS: usize = 340;
/// Half the edge of the plane, and of the square in which objects stand.
const PLANE: f64 = 6.0;
const SQUARE: f64 = 5.0;

pub fn glb() -> Vec<u8> {
    let mut glb = Glb::default();
    let grey = glb.push("materials", super::lambertian("plane", [0.7, 0.7, 0.7]));
    let plane = glb.mesh("plane", &Mesh::quad(DVec3::ZERO, PLANE * DVec3::X, -PLANE * DVec3::Z), grey);
    glb.push("nodes", json!({ "name": "plane", "mesh": plane }));

    let shapes = shapes();
    // Every shape in every colour.
    let colours = [[0.65, 0.12, 0.1], [0.7, 0.45, 0.1], [0.2, 0.45, 0.15], [0.12, 0.25, 0.55], [0.75, 0.72, 0.65]];
    let colours = colours.map(|colour| glb.push("materials", super::lambertian("object", colour)));
    let meshes: Vec<Vec<usize>> = shapes
        .iter()
        .map(|(name, shape)| colours.iter().map(|&colour| glb.mesh(name, shape, colour)).collect())
        .collect();

    for (i, (at, size)) in places().into_iter().enumerate() {
        let (shape, colour) = (pick(i, 4, shapes.len()), pick(i, 5, colours.len()));
        // Half of the objects stand upright, the others lie as they fell.
        let turn = rotation_about(DVec3::Y, 360.0 * number(i, 6));
        let tilt = if pick(i, 7, 2) == 0 { 0.0 } else { 180.0 * number(i, 8) };
        let lean = rotation_about(DVec3::X, tilt);
        let rotation = (DQuat::from_array(turn) * DQuat::from_array(lean)).normalize().to_array().map(tidy);
        let scale = DVec3::from_array([9, 10, 11].map(|what| tidy(size * (0.6 + 0.4 * number(i, what)))));
        // The lowest corner rests on the plane.
        let matrix = DMat3::from_quat(DQuat::from_array(rotation)) * DMat3::from_diagonal(scale);
        let lowest = shapes[shape].1.positions.iter().map(|&p| (matrix * p).y).fold(f64::INFINITY, f64::min);
        let position = [tidy(at.x), tidy(-lowest), tidy(at.y)];
        glb.push(
            "nodes",
            json!({
                "mesh": meshes[shape][colour], "translation": position, "rotation": rotation,
                "scale": scale.to_array(),
            }),
        );
    }

    // Radiance L causes an irradiance of L 0.64^2 (4.5 / d)^2 / d^2 = 0.0064 L at the centre of the plane, with d^2 =
    // 36: a reflected radiance of 0.5.
    let emitter = glb.push("materials", super::emitter("light", 350.0));
    let light = Mesh::quad(DVec3::new(-4.0, 4.5, 0.0), 0.32 * DVec3::X, 0.32 * DVec3::Z);
    let light = glb.mesh("light", &light, emitter);
    glb.push("nodes", json!({ "name": "light", "mesh": light }));

    glb.camera(DVec3::new(0.0, 5.2, 6.2), DVec3::new(0.0, -0.85, -0.9), 38.0, 1.0);
    glb.finish("Crowd")
}

/// Solids that fit into the unit sphere.
fn shapes() -> [(&'static str, Mesh); 5] {
    let half = 0.57;
    // From the middle of the top to the middle of the bottom. Edges are sharp: their corners belong to both faces.
    let turned = |profile: &[[f64; 2]]| {
        let mut mesh = Mesh::default();
        for line in profile.windows(2) {
            let [from, to] = [line[0], line[1]].map(DVec2::from_array);
            mesh.append(Mesh::lathe(32, 1, |v| from.lerp(to, v)));
        }
        mesh
    };
    let torus = Mesh::surface(32, 12, true, |u, v| {
        let ((sine, cosine), (up, out)) = ((TAU * u).sin_cos(), (TAU * (0.5 - v)).sin_cos());
        let radial = DVec3::new(sine, 0.0, cosine);
        // The last row equals the first bit for bit.
        let normal = if v == 1.0 { -radial } else { out * radial + up * DVec3::Y };
        (0.7 * radial + 0.3 * normal, normal)
    });
    [
        ("box", Mesh::cuboid(DVec3::splat(half))),
        ("sphere", Mesh::sphere(1.0, 32, 16)),
        ("cone", turned(&[[0.0, 1.0], [0.8, -0.6], [0.0, -0.6]])),
        ("cylinder", turned(&[[0.0, 0.8], [0.6, 0.8], [0.6, -0.8], [0.0, -0.8]])),
        ("torus", torus),
    ]
}

/// Centre and radius of each object's circle on the plane. The circles do not overlap: a candidate that does is
/// dropped.
fn places() -> Vec<(DVec2, f64)> {
    let mut places: Vec<(DVec2, f64)> = Vec::new();
    let mut candidate = 0;
    while places.len() < OBJECTS {
        let at = DVec2::new(number(candidate, 0), number(candidate, 1)) * 2.0 * SQUARE - SQUARE;
        // Small objects are common.
        let size = 0.1 + 0.2 * number(candidate, 2).powi(2);
        // The gap spreads the objects evenly, as blue noise.
        let free = |&(other, radius): &(DVec2, f64)| at.distance(other) > size + radius + 0.08;
        if places.iter().all(free) {
            places.push((at, size));
        }
        candidate += 1;
    }
    places
}

/// A random number in 0 to 1.
fn number(item: usize, what: i32) -> f64 {
    f64::from(hash(IVec3::new(item as i32, what, 340)) >> 12) / f64::from(1 << 20)
}

/// A random index below `count`.
fn pick(item: usize, what: i32, count: usize) -> usize {
    (number(item, what) * count as f64) as usize
}
