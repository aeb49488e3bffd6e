//! Plants of alpha-masked leaves, and cloths.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DQuat, DVec2, DVec3, IVec3};

use super::super::mesh::Mesh;
use super::super::noise::hash;

/// A random number in 0 to 1 of an item of a plant.
fn number(plant: i32, item: u32, what: i32) -> f64 {
    f64::from(hash(IVec3::new(item as i32, what, plant)) >> 12) / f64::from(1 << 20)
}

/// A leaf that rises from the origin and bends towards +z by `bend` radians.
fn leaf(length: f64, width: f64, bend: f64, rows: u32) -> Mesh {
    Mesh::relief(2, rows, false, |u, v| {
        let (side, turn) = (u - 0.5, bend * (1.0 - v));
        let radius = length / bend;
        // The two halves fold forwards.
        let fold = 0.3 * width * side.abs();
        let (sine, cosine) = turn.sin_cos();
        DVec3::new(side * width, radius * sine - fold * sine, radius * (1.0 - cosine) + fold * cosine)
    })
}

/// Long leaves from one foot, 0.9 high.
pub fn fern() -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..56 {
        let number = |what| number(0, i, what);
        let bend = 0.7 + 1.3 * number(0);
        let blade = leaf(0.7 + 0.4 * number(1), 0.13 + 0.05 * number(2), bend, 12);
        let angle = TAU * (f64::from(i) * 0.382 + 0.05 * number(3));
        let lean = DQuat::from_rotation_y(angle) * DQuat::from_rotation_x(0.1 + 0.5 * number(4));
        mesh.append(blade.placed(DAffine3::from_quat(lean)));
    }
    mesh
}

/// `count` leaves in an ellipsoid about `centre`, most of them near its surface, each `size` long.
fn foliage(plant: i32, count: u32, centre: DVec3, radii: DVec3, size: f64) -> Mesh {
    let mut mesh = Mesh::default();
    let blade = leaf(size, 0.55 * size, 0.6, 3);
    for i in 0..count {
        let number = |what| number(plant, i, what);
        let (height, angle) = (2.0 * number(0) - 1.0, TAU * number(1));
        let ring = (1.0 - height * height).sqrt();
        let out = DVec3::new(ring * angle.sin(), height, ring * angle.cos());
        // Twigs end where this product is large, which makes the surface uneven.
        let lobes = 0.85 + 0.15 * (5.0 * angle).sin() * (4.0 * height + f64::from(plant)).sin();
        let at = centre + radii * out * lobes * number(2).powf(0.25);
        let pose = DQuat::from_rotation_y(angle + 1.4 * (number(3) - 0.5))
            * DQuat::from_rotation_x(0.4 + 1.6 * number(4) - 0.5 * height)
            * DQuat::from_rotation_y(TAU * number(5));
        mesh.append(blade.placed(DAffine3::from_scale_rotation_translation(
            DVec3::splat(0.7 + 0.6 * number(6)),
            pose,
            at,
        )));
    }
    mesh
}

/// A round bush on the ground, 0.9 wide.
pub fn bush() -> Mesh {
    foliage(1, 600, DVec3::new(0.0, 0.35, 0.0), DVec3::new(0.45, 0.4, 0.45), 0.13)
}

/// The crown of a tree 4 high.
pub fn crown() -> Mesh {
    let mut mesh = foliage(2, 2600, DVec3::new(0.0, 2.9, 0.0), DVec3::new(1.05, 0.85, 1.05), 0.2);
    mesh.append(foliage(3, 900, DVec3::new(0.35, 3.6, -0.2), DVec3::new(0.6, 0.5, 0.6), 0.18));
    mesh
}

/// The trunk and the branches of that tree.
pub fn trunk() -> Mesh {
    let mut mesh = limb(DVec3::ZERO, DVec3::new(0.05, 2.3, 0.0), 0.09, 0.06);
    for i in 0..9 {
        let angle = TAU * 0.382 * f64::from(i);
        let from = DVec3::new(0.05, 1.7 + 0.07 * f64::from(i), 0.0);
        let reach = DVec3::new(angle.sin(), 0.9 + 0.3 * number(4, i, 0), angle.cos()) * 0.8;
        mesh.append(limb(from, from + reach, 0.04, 0.012));
    }
    mesh
}

fn limb(from: DVec3, to: DVec3, foot: f64, tip: f64) -> Mesh {
    let turn = DQuat::from_rotation_arc(DVec3::Y, (to - from).normalize());
    let length = from.distance(to);
    Mesh::relief(12, 10, true, |u, v| {
        let (sine, cosine) = (TAU * u).sin_cos();
        let radius = tip + (foot - tip) * v;
        let bark = 1.0 + 0.08 * (3.0 * TAU * u + 9.0 * v).sin();
        let bend = 0.04 * length * (PI * v).sin();
        from + turn * DVec3::new(radius * bark * sine + bend, length * (1.0 - v), radius * bark * cosine)
    })
}

/// Strands of ivy that hang from y = 0 in front of z = 0, 1.6 wide.
pub fn ivy() -> Mesh {
    let mut mesh = Mesh::default();
    for strand in 0..12 {
        let number = |item: u32, what| number(5, 100 * strand + item, what);
        let x = 1.5 * (f64::from(strand) / 11.0 - 0.5) + 0.08 * number(0, 0);
        let length = 0.4 + 1.4 * number(0, 1).powi(2);
        for i in 0..(length / 0.05) as u32 {
            let down = 0.05 * f64::from(i);
            let at = DVec3::new(x + 0.06 * (9.0 * down + x).sin(), 0.1 - down, 0.05 + 0.06 * number(i, 2));
            let pose = DQuat::from_rotation_z(PI + 2.4 * (number(i, 3) - 0.5))
                * DQuat::from_rotation_x(-0.3 - 0.5 * number(i, 4));
            let blade = leaf(0.1 + 0.05 * number(i, 5), 0.09, 0.6, 3);
            mesh.append(blade.placed(DAffine3::from_rotation_translation(pose, at)));
        }
    }
    mesh
}

/// A curtain 2.7 long that hangs from y = 0 between x = 0 and x = 1.15, and is tied towards x = 0.
pub fn curtain() -> Mesh {
    let mesh = Mesh::relief(72, 40, false, |u, v| {
        // Wide at the top, narrow at the tie, and a little wider at the hem.
        let tie = (-((v - 0.62) / 0.2).powi(2)).exp();
        let width = 1.15 - 0.35 * v - 0.62 * tie;
        let fold = (TAU * (6.5 * u + 0.25 * (3.0 * v).sin())).sin() + 0.35 * (TAU * 15.0 * u + 2.0 * v).sin();
        let depth = (0.03 + 0.05 * v) * (1.0 + 0.3 * tie);
        let sag = 0.05 * (PI * u).sin() * (1.0 - v).powi(6);
        DVec3::new(width * u, -2.7 * v - sag - 0.12 * u * tie, depth * fold + 0.04 * (2.0 * v + u).sin())
    });
    mesh.repeated(DVec2::new(1.0, 2.0))
}

/// A banner 0.9 wide and 2.4 long that hangs from y = 0 about x = 0, with a swallow tail.
pub fn banner() -> Mesh {
    let mesh = Mesh::relief(32, 64, false, |u, v| {
        let side = u - 0.5;
        let wave = 0.05 * v * (TAU * (1.3 * u - 0.4 * v)).sin() + 0.03 * (4.0 * v).sin();
        let tail = 0.5 * (0.5 - side.abs());
        DVec3::new(0.9 * side * (1.0 - 0.05 * (PI * v).sin()), -(2.4 - tail) * v, 0.05 + wave.abs())
    });
    mesh.repeated(DVec2::new(1.0, 2.5))
}
