//! The parts of the building: columns, arches, vaults, walls, mouldings and balustrades.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DAffine3, DVec2, DVec3};

use super::super::mesh::Mesh;

/// Distance between columns.
pub const BAY: f64 = 3.2;
/// Height at which arches and vaults spring from columns.
pub const SPRING: f64 = 3.0;
/// Height of the floor of the gallery, and of the top of its walls above the floor.
pub const GALLERY: f64 = 5.0;
pub const STOREY: f64 = 3.6;
/// Half the thickness of the walls round the court.
pub const WALL: f64 = 0.25;
/// Radius of the openings between columns.
pub const ARCH: f64 = 1.26;
/// Edge length of what one texture covers: a bay, so that walls of bays continue each other.
const TEXTURE: f64 = BAY;

/// A fluted column with a base, two rings of leaves on its capital and an abacus, up to [`SPRING`].
pub fn column() -> Mesh {
    const FLUTES: u32 = 16;
    let slab = |half: DVec3, y: f64| Mesh::cuboid(half).placed(DAffine3::from_translation(y * DVec3::Y));
    let mut mesh = slab(DVec3::new(0.36, 0.08, 0.36), 0.08);
    // Two rings with a hollow between them.
    mesh.append(Mesh::lathe(48, 18, |v| {
        let ring = 0.035 * (3.0 * PI * v).sin() + 0.012 * (9.0 * PI * v).sin();
        DVec2::new(0.27 + 0.055 * v + ring, 0.42 - 0.26 * v)
    }));
    mesh.append(Mesh::relief(6 * FLUTES, 20, true, |u, v| {
        // Flutes fade at both ends. The shaft is wider at its foot.
        let fade = ((v * 14.0).min((1.0 - v) * 14.0)).min(1.0);
        let flute = 0.09 * fade * (PI * f64::from(FLUTES) * u).sin().powi(2);
        let radius = (0.225 + 0.035 * v.powf(1.6)) * (1.0 - flute);
        let (sine, cosine) = (TAU * u).sin_cos();
        DVec3::new(radius * sine, 2.42 - 2.0 * v, radius * cosine)
    }));
    mesh.append(Mesh::lathe(48, 12, |v| {
        let neck = 0.02 * (-((v - 0.93) / 0.05).powi(2)).exp();
        DVec2::new(0.22 + 0.13 * (1.0 - v).powi(3) + neck, 2.87 - 0.45 * v)
    }));
    for (count, foot, length, turn) in [(8, 2.44, 0.24, 0.0), (8, 2.46, 0.38, 0.5)] {
        let leaf = leaf_of_stone(length);
        for i in 0..count {
            let angle = TAU * (f64::from(i) + turn) / f64::from(count);
            let at = DAffine3::from_rotation_y(angle) * DAffine3::from_translation(DVec3::new(0.0, foot, 0.215));
            mesh.append(leaf.placed(at));
        }
    }
    mesh.append(slab(DVec3::new(0.4, 0.065, 0.4), SPRING - 0.065));
    mesh.repeated(DVec2::new(1.0, 1.5))
}

/// A leaf of a capital, which rises from the origin and curls outwards, towards +z.
fn leaf_of_stone(length: f64) -> Mesh {
    let at = |u: f64, v: f64| {
        let (side, up) = (2.0 * u - 1.0, 1.0 - v);
        let (curl, width) = (0.5 * length * up.powi(4), 0.085 * (1.0 - 0.75 * up.powi(3)));
        let lobes = 1.0 + 0.12 * (7.0 * PI * up).sin();
        DVec3::new(
            side * width * lobes,
            length * (up - 0.35 * up.powi(5)),
            curl + 0.02 - 0.03 * side * side + 0.06 * up,
        )
    };
    Mesh::relief(4, 10, false, at)
}

/// A wall about x = 0, z = 0 with an opening: an arch of radius `arch` on jambs of height `jamb`. `top` is the wall's
/// height above its foot. Its ends and its top are open.
pub fn arched_wall(arch: f64, jamb: f64, top: f64) -> Mesh {
    let half = 0.5 * BAY;
    let corner = (top - jamb).atan2(half);
    let round = |angle: f64| DVec2::new(arch * angle.cos(), jamb + arch * angle.sin());
    // Each piece is a strip between the opening and the edge of the wall, from left to right over the arch.
    type Line = [DVec2; 2];
    let [left, right] = [-1.0, 1.0].map(|side| side * half);
    let arcs: [(f64, f64, Line); 3] = [
        (PI, PI - corner, [DVec2::new(left, jamb), DVec2::new(left, top)]),
        (PI - corner, corner, [DVec2::new(left, top), DVec2::new(right, top)]),
        (corner, 0.0, [DVec2::new(right, top), DVec2::new(right, jamb)]),
    ];
    let mut face = Mesh::default();
    let mut strip = |columns: u32, inner: &dyn Fn(f64) -> DVec2, outer: Line| {
        face.append(Mesh::surface(columns, 2, false, |u, v| {
            (outer[0].lerp(outer[1], u).lerp(inner(u), v).extend(WALL), DVec3::Z)
        }));
    };
    for (from, to, outer) in arcs {
        strip(16, &|u| round(from + (to - from) * u), outer);
    }
    if jamb > 0.0 {
        let [foot, spring] = [DVec2::ZERO, DVec2::new(0.0, jamb)];
        strip(1, &|u| DVec2::new(-arch, jamb * u), [foot, spring].map(|p| p + DVec2::new(left, 0.0)));
        strip(1, &|u| DVec2::new(arch, jamb * (1.0 - u)), [spring, foot].map(|p| p + DVec2::new(right, 0.0)));
    }
    let mut mesh = face.placed(DAffine3::from_rotation_y(PI));
    mesh.append(face);
    if jamb > 0.0 {
        for side in [-1.0, 1.0] {
            let centre = DVec3::new(side * arch, 0.5 * jamb, 0.0);
            mesh.append(Mesh::quad(centre, side * WALL * DVec3::Z, 0.5 * jamb * DVec3::Y));
        }
    }
    let mut mesh = mesh.projected(TEXTURE);
    mesh.append(soffit(arch, WALL).placed(DAffine3::from_translation(jamb * DVec3::Y)));
    // A round moulding along the arch on both faces.
    let moulding = Mesh::surface(48, 8, false, |u, v| {
        let (up, right) = (PI * (1.0 - u)).sin_cos();
        let (out, front) = (PI * (0.5 - v)).sin_cos();
        let radial = DVec3::new(right, up, 0.0);
        let normal = out * radial + front * DVec3::Z;
        ((arch + 0.09) * radial + DVec3::new(0.0, jamb, WALL) + 0.06 * normal, normal)
    });
    mesh.append(moulding.placed(DAffine3::from_rotation_y(PI)));
    mesh.append(moulding);
    mesh
}

/// The underside of an arch that springs at y = 0.
fn soffit(arch: f64, half_depth: f64) -> Mesh {
    let mesh = Mesh::surface(48, 2, false, |u, v| {
        let (up, right) = (PI * (1.0 - u)).sin_cos();
        let radial = DVec3::new(right, up, 0.0);
        (arch * radial + half_depth * (1.0 - 2.0 * v) * DVec3::Z, -radial)
    });
    mesh.repeated(DVec2::new(PI * arch, 2.0 * half_depth) / TEXTURE)
}

/// An arch between two bays of the vault. It springs at y = 0.
pub fn band() -> Mesh {
    let (half_depth, outer) = (0.2, 0.5 * BAY + 0.06);
    let face = Mesh::surface(48, 1, false, |u, v| {
        let (up, right) = (PI * (1.0 - u)).sin_cos();
        ((outer + (ARCH - outer) * v) * DVec3::new(right, up, 0.0) + half_depth * DVec3::Z, DVec3::Z)
    });
    let mut mesh = face.placed(DAffine3::from_rotation_y(PI));
    mesh.append(face);
    let mut mesh = mesh.projected(TEXTURE);
    mesh.append(soffit(ARCH, half_depth));
    mesh
}

/// A groin vault over a bay about the origin, seen from below, with ribs and a boss. It springs at y = 0.
pub fn vault() -> Mesh {
    let radius = 0.5 * BAY;
    // A quarter: a barrel along z, from the edge at +z to the diagonals.
    let quarter = Mesh::surface(32, 10, false, |u, v| {
        let (sine, cosine) = (FRAC_PI_2 * (2.0 * u - 1.0)).sin_cos();
        let (x, y) = (radius * sine, radius * cosine);
        (DVec3::new(x, y, radius + (x.abs() - radius) * v), DVec3::new(-sine, -cosine, 0.0))
    });
    let quarter = quarter.repeated(DVec2::new(PI * radius, radius) / TEXTURE);
    let rib = Mesh::relief(48, 10, false, |u, v| {
        let (sine, cosine) = (FRAC_PI_2 * (2.0 * u - 1.0)).sin_cos();
        let across = DVec3::new(1.0, 0.0, -1.0).normalize();
        let along = DVec3::new(cosine, -sine, cosine).normalize();
        let (out, down) = (PI * (v - 0.5)).sin_cos();
        radius * DVec3::new(sine, cosine, sine) + 0.07 * (out * across - down * along.cross(across).normalize())
    });
    let boss = Mesh::lathe(32, 12, |v| {
        let (sine, cosine) = (FRAC_PI_2 * v).sin_cos();
        DVec2::new(0.16 * cosine, radius - 0.12 * sine)
    });
    let mut mesh = Mesh::default();
    for turn in 0..4 {
        let turn = DAffine3::from_rotation_y(FRAC_PI_2 * f64::from(turn));
        mesh.append(quarter.placed(turn));
    }
    mesh.append(rib.placed(DAffine3::from_rotation_y(FRAC_PI_2)));
    mesh.append(rib);
    mesh.append(boss);
    mesh
}

/// A moulding that is as long as a bay, along x in front of z = 0: points of its profile as (depth, height), downwards.
pub fn moulding(profile: &[[f64; 2]]) -> Mesh {
    let mut mesh = Mesh::default();
    for line in profile.windows(2) {
        let [[z0, y0], [z1, y1]] = [line[0], line[1]];
        let [top, bottom] = [DVec3::new(0.0, y0, z0), DVec3::new(0.0, y1, z1)];
        mesh.append(Mesh::quad(0.5 * (top + bottom), 0.5 * BAY * DVec3::X, 0.5 * (top - bottom)));
    }
    mesh.projected(TEXTURE)
}

/// A balustrade of `width` along x.
pub fn balustrade(width: f64) -> Mesh {
    let rail = |half: DVec3, y: f64| Mesh::cuboid(half).placed(DAffine3::from_translation(y * DVec3::Y));
    let mut mesh = rail(DVec3::new(0.5 * width, 0.06, 0.13), 0.06);
    mesh.append(rail(DVec3::new(0.5 * width, 0.05, 0.14), 0.9));
    let baluster = Mesh::lathe(24, 28, |v| {
        let belly = 0.055 * (-((v - 0.68) / 0.16).powi(2)).exp();
        let rings = 0.02 * ((-((v - 0.08) / 0.04).powi(2)).exp() + (-((v - 0.94) / 0.05).powi(2)).exp());
        DVec2::new(0.03 + belly + rings, 0.85 - 0.73 * v)
    });
    let count = (width / 0.24) as u32;
    for i in 0..count {
        let x = width * ((f64::from(i) + 0.5) / f64::from(count) - 0.5);
        mesh.append(baluster.placed(DAffine3::from_translation(x * DVec3::X)));
    }
    mesh
}

/// Two courses of roof tiles, as long as a bay, along x. They end at z = 0 and rise towards -z.
pub fn eaves() -> Mesh {
    let tile = Mesh::relief(10, 3, false, |u, v| {
        let (up, right) = (PI * (1.0 - u)).sin_cos();
        let radius = 0.085 + 0.015 * v;
        DVec3::new(radius * right, radius * up + 0.18 * (1.0 - v), -0.5 * (1.0 - v))
    });
    let mut mesh = Mesh::default();
    for course in 0..2 {
        for i in 0..16 {
            let back = f64::from(course);
            let at = DVec3::new(BAY * ((f64::from(i) + 0.5) / 16.0 - 0.5), 0.17 * back, -0.42 * back);
            mesh.append(tile.placed(DAffine3::from_translation(at)));
        }
    }
    mesh
}

/// The fountain: a basin and a bowl on a foot.
pub fn fountain() -> Mesh {
    // From the middle of the basin's floor over its rim to the ground.
    let basin = [
        [0.3, 0.12],
        [1.3, 0.12],
        [1.36, 0.5],
        [1.42, 0.58],
        [1.6, 0.58],
        [1.64, 0.5],
        [1.5, 0.4],
        [1.5, 0.14],
        [1.7, 0.1],
        [1.7, 0.0],
    ];
    let bowl = [
        [0.0, 1.3],
        [0.1, 1.3],
        [0.4, 1.36],
        [0.66, 1.5],
        [0.72, 1.5],
        [0.62, 1.36],
        [0.3, 1.16],
        [0.12, 1.08],
        [0.1, 0.9],
        [0.17, 0.7],
        [0.12, 0.5],
        [0.2, 0.3],
        [0.32, 0.12],
    ];
    let mut mesh = Mesh::default();
    for profile in [basin.as_slice(), &bowl] {
        for line in profile.windows(2) {
            let [from, to] = [line[0], line[1]].map(DVec2::from_array);
            mesh.append(Mesh::lathe(96, 2, |v| from.lerp(to, v)));
        }
    }
    mesh.repeated(DVec2::new(3.0, 0.5))
}

/// A pot of height 0.55, filled to 8 cm below its rim.
pub fn pot() -> Mesh {
    let profile = [
        [0.0, 0.47],
        [0.26, 0.47],
        [0.27, 0.55],
        [0.33, 0.55],
        [0.33, 0.46],
        [0.3, 0.44],
        [0.31, 0.3],
        [0.26, 0.12],
        [0.2, 0.0],
    ];
    let mut mesh = Mesh::default();
    for line in profile.windows(2) {
        let [from, to] = [line[0], line[1]].map(DVec2::from_array);
        mesh.append(Mesh::lathe(48, 3, |v| from.lerp(to, v)));
    }
    mesh
}
