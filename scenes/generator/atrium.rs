//! A courtyard with two storeys, vaulted arcades, cloths and plants: a scene of the size that users have. Lengths are
//! in metres. The court is 6 x 4 bays, with a ring of 24 vaulted bays round it.

use std::f64::consts::FRAC_PI_2;

use glam::{DAffine3, DQuat, DVec2, DVec3, DVec4};
use image::DynamicImage;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::glb::{Glb, Wrap, encode};
use super::mesh::{Mesh, tidy};

mod architecture;
mod plants;
mod textures;

use architecture::{ARCH, BAY, GALLERY, SPRING, STOREY, WALL};

/// Bays of the court along x and z.
const BAYS: [i32; 2] = [6, 4];
/// Direction to the sun, which is higher than that of the panorama: it reaches the middle of the court.
pub const SUN: DVec3 = DVec3::new(-0.5, 1.0, -0.48);
/// Floor of the court, a step below the arcades.
const COURT: f64 = -0.16;

/// A scene under construction, with the materials by use.
struct Atrium {
    glb: Glb,
    stone: usize,
    plaster: usize,
    tiles: usize,
    terracotta: usize,
    soil: usize,
    leaves: usize,
    bark: usize,
    iron: usize,
    cloths: Vec<usize>,
}

/// The scene with textures of `side` x `side` texels.
pub fn glb(side: u32) -> Vec<u8> {
    let mut atrium = Atrium::new(side);
    atrium.ground();
    atrium.storeys();
    atrium.arcades();
    atrium.court();
    atrium.cloths();
    atrium.greenery();
    atrium.lamps();
    let sun = json!({ "type": "directional", "name": "sun", "color": [1, 0.9, 0.74], "intensity": 7 });
    atrium.glb.punctual_light("sun", sun, 20.0 * SUN, -SUN);

    // From under an arch over the court, and along an arcade.
    for (eye, target) in [([-9.1, 1.75, -1.6], [5.0, 2.9, 2.2]), ([-11.3, 1.65, -8.0], [4.0, 2.3, -4.7])] {
        let [eye, target] = [eye, target].map(DVec3::from_array);
        atrium.glb.camera(eye, target - eye, 60.0, 1.5);
    }
    atrium.glb.finish("Atrium")
}

/// A dielectric with a colour texture.
fn textured(name: &str, colour: usize, normal: Option<usize>, roughness: f64) -> Value {
    let mut material = json!({
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": colour }, "metallicFactor": 0, "roughnessFactor": roughness,
        },
    });
    if let Some(normal) = normal {
        material["normalTexture"] = json!({ "index": normal });
    }
    material
}

fn plain(name: &str, colour: [f64; 3], metallic: f64, roughness: f64) -> Value {
    let [r, g, b] = colour;
    json!({
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [r, g, b, 1], "metallicFactor": metallic, "roughnessFactor": roughness,
        },
    })
}

/// A side of the court: its middle's rotation about +y from +z, its bays, and its distance from the centre.
fn sides() -> [(f64, i32, f64); 4] {
    let [x, z] = BAYS.map(|bays| 0.5 * BAY * f64::from(bays));
    [(0.0, BAYS[0], z), (1.0, BAYS[1], x), (2.0, BAYS[0], z), (3.0, BAYS[1], x)]
        .map(|(quarters, bays, distance)| (quarters * FRAC_PI_2, bays, distance))
}

/// Positions of the `count` bays of a side along it.
fn along(count: i32) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| BAY * (f64::from(i) + 0.5 - 0.5 * f64::from(count)))
}

impl Atrium {
    fn new(side: u32) -> Self {
        let mut glb = Glb::default();
        let images: Vec<Vec<u8>> = (0..7)
            .into_par_iter()
            .map(|i| {
                let image: DynamicImage = match i {
                    0 => textures::stone(side).into(),
                    1 => textures::stone_normals(side).into(),
                    2 => textures::tiles(side).into(),
                    3 => textures::tile_normals(side).into(),
                    4 => textures::plaster(side).into(),
                    5 => textures::cloth(side).into(),
                    _ => textures::leaf(side).into(),
                };
                encode(&image)
            })
            .collect();
        let names = ["stone", "stone normals", "tiles", "tile normals", "plaster", "cloth", "leaf"];
        let wraps = [Wrap::Repeat, Wrap::Repeat, Wrap::Repeat, Wrap::Repeat, Wrap::Mirror, Wrap::Repeat, Wrap::Clamp];
        let t: Vec<usize> =
            names.iter().zip(&images).zip(wraps).map(|((name, png), wrap)| glb.encoded(name, png, wrap)).collect();
        let mut leaves = textured("leaf", t[6], None, 0.6);
        leaves["alphaMode"] = json!("MASK");
        leaves["doubleSided"] = json!(true);
        let colours = [[0.62, 0.06, 0.05], [0.08, 0.2, 0.5], [0.75, 0.45, 0.08]];
        let cloths = colours.map(|[r, g, b]| {
            let mut cloth = textured("cloth", t[5], None, 0.9);
            cloth["pbrMetallicRoughness"]["baseColorFactor"] = json!([r, g, b, 1]);
            cloth["doubleSided"] = json!(true);
            glb.push("materials", cloth)
        });
        Atrium {
            stone: glb.push("materials", textured("stone", t[0], Some(t[1]), 0.85)),
            plaster: glb.push("materials", textured("plaster", t[4], None, 0.8)),
            tiles: glb.push("materials", textured("tiles", t[2], Some(t[3]), 0.4)),
            terracotta: glb.push("materials", plain("terracotta", [0.5, 0.2, 0.1], 0.0, 0.8)),
            soil: glb.push("materials", plain("soil", [0.07, 0.05, 0.035], 0.0, 1.0)),
            leaves: glb.push("materials", leaves),
            bark: glb.push("materials", plain("bark", [0.16, 0.1, 0.06], 0.0, 0.9)),
            iron: glb.push("materials", plain("iron", [0.05, 0.05, 0.055], 1.0, 0.5)),
            cloths: cloths.into(),
            glb,
        }
    }

    /// Adds a node of a mesh.
    fn place(&mut self, mesh: usize, pose: DAffine3) {
        let (scale, rotation, at) = pose.to_scale_rotation_translation();
        self.glb.push(
            "nodes",
            json!({
                "mesh": mesh, "translation": at.to_array().map(tidy),
                "rotation": rotation.to_array().map(tidy), "scale": scale.to_array().map(tidy),
            }),
        );
    }

    /// Adds a mesh and a node for each pose.
    fn scatter(&mut self, name: &str, mesh: &Mesh, material: usize, poses: impl IntoIterator<Item = DAffine3>) {
        let mesh = self.glb.mesh(name, mesh, material);
        poses.into_iter().for_each(|pose| self.place(mesh, pose));
    }

    /// A cuboid between two corners, textured by position.
    fn block(&mut self, name: &str, material: usize, low: [f64; 3], high: [f64; 3]) {
        let [low, high] = [low, high].map(DVec3::from_array);
        let at = DAffine3::from_translation(0.5 * (low + high));
        let mesh = Mesh::cuboid(0.5 * (high - low)).placed(at).projected(BAY);
        self.scatter(name, &mesh, material, [DAffine3::IDENTITY]);
    }

    /// Four cuboids round the court, from `inner` to `outer` metres outside its edge.
    fn ring(&mut self, name: &str, material: usize, [inner, outer]: [f64; 2], [low, high]: [f64; 2]) {
        let [x, z] = BAYS.map(|bays| 0.5 * BAY * f64::from(bays));
        for side in [-1.0, 1.0] {
            let span =
                |half: f64| if side < 0.0 { [-half - outer, -half - inner] } else { [half + inner, half + outer] };
            let [near, far] = span(z);
            self.block(name, material, [-x - outer, low, near], [x + outer, high, far]);
            let [near, far] = span(x);
            self.block(name, material, [near, low, -z - inner], [far, high, z + inner]);
        }
    }

    fn ground(&mut self) {
        let [x, z] = BAYS.map(|bays| 0.5 * BAY * f64::from(bays));
        let floor = |half: DVec2, repeat: f64| {
            let mut mesh = Mesh::quad(DVec3::ZERO, half.x * DVec3::X, -half.y * DVec3::Z);
            mesh.tangents = [DVec4::new(1.0, 0.0, 0.0, 1.0); 4].into();
            mesh.repeated(2.0 * half / repeat)
        };
        let court = floor(DVec2::new(x, z), 2.4);
        self.scatter("court", &court, self.stone, [DAffine3::from_translation(COURT * DVec3::Y)]);
        // The arcades' floor, a strip on each side, above a kerb.
        for (quarters, bays, distance) in sides() {
            let long = 0.5 * BAY * f64::from(bays) + if bays == BAYS[0] { BAY } else { -0.45 };
            let half = DVec2::new(long, 0.5 * (BAY + 0.45));
            let at = DVec3::new(0.0, 0.0, distance + 0.5 * (BAY - 0.45));
            let pose = DAffine3::from_rotation_y(quarters) * DAffine3::from_translation(at);
            self.scatter("arcade floor", &floor(half, 1.6), self.tiles, [pose]);
        }
        self.ring("kerb", self.stone, [-0.5, -0.45], [COURT - 0.1, 0.001]);
    }

    /// The walls, the gallery and the roof.
    fn storeys(&mut self) {
        let lower = architecture::arched_wall(ARCH, 0.0, GALLERY - SPRING);
        let upper = architecture::arched_wall(1.1, 1.8, STOREY);
        let string = architecture::moulding(&[
            [0.0, 0.1],
            [0.16, 0.06],
            [0.16, 0.0],
            [0.1, -0.04],
            [0.1, -0.09],
            [0.05, -0.16],
            [0.0, -0.17],
        ]);
        let eaves = architecture::eaves();
        let walls: Vec<DAffine3> = sides()
            .into_iter()
            .flat_map(|(angle, bays, distance)| {
                along(bays).map(move |x| {
                    // The front, +z, looks into the court.
                    DAffine3::from_rotation_y(angle)
                        * DAffine3::from_translation(DVec3::new(x, 0.0, distance))
                        * DAffine3::from_rotation_y(std::f64::consts::PI)
                })
            })
            .collect();
        let at = |x: f64, y: f64, z: f64| {
            walls.iter().map(move |&wall| wall * DAffine3::from_translation(DVec3::new(x, y, z)))
        };
        self.scatter("wall", &lower, self.stone, at(0.0, SPRING, 0.0));
        self.scatter("gallery wall", &upper, self.stone, at(0.0, GALLERY, 0.0));
        self.scatter("string course", &string, self.plaster, at(0.0, GALLERY, WALL));
        self.scatter("cornice", &string, self.plaster, at(0.0, GALLERY + STOREY, WALL));
        self.scatter("balustrade", &architecture::balustrade(2.2), self.plaster, at(0.0, GALLERY, 0.05));
        self.scatter("eaves", &eaves, self.terracotta, at(0.0, GALLERY + STOREY + 0.2, WALL + 0.45));

        let top = GALLERY + STOREY;
        self.ring("gallery floor", self.stone, [-WALL + 0.01, BAY], [GALLERY - 0.3, GALLERY + 0.02]);
        self.ring("roof", self.terracotta, [-WALL - 0.3, BAY + 0.4], [top, top + 0.18]);
        self.ring("outer wall", self.stone, [BAY, BAY + 0.4], [COURT, top]);
    }

    /// Columns, vaults, and the arches between them.
    fn arcades(&mut self) {
        let [x, z] = BAYS.map(|bays| 0.5 * BAY * f64::from(bays));
        let corner = |i: i32, k: i32| DVec3::new(BAY * f64::from(i) - x, 0.0, BAY * f64::from(k) - z);
        // Grid points of the court's edge and, with half a column each, of the outer walls.
        let edge = |i: i32, k: i32, out: i32| i == -out || i == BAYS[0] + out || k == -out || k == BAYS[1] + out;
        let grid: Vec<(i32, i32)> = (-1..=BAYS[0] + 1).flat_map(|i| (-1..=BAYS[1] + 1).map(move |k| (i, k))).collect();
        let court = |i: i32, k: i32| (0..=BAYS[0]).contains(&i) && (0..=BAYS[1]).contains(&k);
        let columns = grid.iter().filter(|&&(i, k)| edge(i, k, 1) || court(i, k) && edge(i, k, 0));
        let columns: Vec<DAffine3> = columns.map(|&(i, k)| DAffine3::from_translation(corner(i, k))).collect();
        self.scatter("column", &architecture::column(), self.plaster, columns);

        let bays: Vec<(i32, i32)> = (-1..=BAYS[0])
            .flat_map(|i| (-1..=BAYS[1]).map(move |k| (i, k)))
            .filter(|&(i, k)| i == -1 || i == BAYS[0] || k == -1 || k == BAYS[1])
            .collect();
        let middle = |i: i32, k: i32| corner(i, k) + DVec3::new(0.5 * BAY, SPRING, 0.5 * BAY);
        let poses = bays.iter().map(|&(i, k)| DAffine3::from_translation(middle(i, k)));
        self.scatter("vault", &architecture::vault(), self.plaster, poses);

        // Arches across the arcade, at every column of the court's edge and of the corners.
        let mut arches = Vec::new();
        for (angle, bays, distance) in sides() {
            for i in 0..=bays {
                let x = BAY * (f64::from(i) - 0.5 * f64::from(bays));
                let at = DVec3::new(x, SPRING, distance + 0.5 * BAY);
                arches.push(
                    DAffine3::from_rotation_y(angle)
                        * DAffine3::from_translation(at)
                        * DAffine3::from_rotation_y(FRAC_PI_2),
                );
            }
        }
        self.scatter("arch", &architecture::band(), self.stone, arches);
    }

    fn court(&mut self) {
        let ground = DAffine3::from_translation(COURT * DVec3::Y);
        self.scatter("fountain", &architecture::fountain(), self.plaster, [ground]);
        let water = self.glb.push("materials", plain("water", [0.02, 0.06, 0.07], 0.0, 0.08));
        let disc = Mesh::lathe(64, 1, |v| DVec2::new(1.4 * v, 0.5));
        self.scatter("water", &disc, water, [ground]);
    }

    fn cloths(&mut self) {
        let curtain = plants::curtain();
        let banner = plants::banner();
        let rod = Mesh::lathe(12, 1, |v| DVec2::new(0.018, 1.3 - 2.6 * v));
        let rod = self.glb.mesh("rod", &rod, self.iron);
        let cloths = self.cloths.clone();
        let meshes: Vec<[usize; 2]> = cloths
            .iter()
            .map(|&cloth| [self.glb.mesh("curtain", &curtain, cloth), self.glb.mesh("banner", &banner, cloth)])
            .collect();
        for (side, (angle, bays, distance)) in sides().into_iter().enumerate() {
            let front = DAffine3::from_rotation_y(angle)
                * DAffine3::from_translation(distance * DVec3::Z)
                * DAffine3::from_rotation_y(std::f64::consts::PI);
            for (i, x) in along(bays).enumerate() {
                // Curtains in every other opening, and banners over the columns between the bays.
                let [curtain, banner] = meshes[(i + side) % 3];
                if (i + side) % 2 == 0 {
                    let at = |x: f64| front * DAffine3::from_translation(DVec3::new(x, SPRING - 0.12, 0.0));
                    let bar = at(x) * DAffine3::from_rotation_z(FRAC_PI_2);
                    self.place(rod, bar);
                    self.place(curtain, at(x - ARCH + 0.1));
                    self.place(curtain, at(x + ARCH - 0.1) * DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)));
                }
                if i > 0 && (i + side) % 2 == 1 {
                    let at = DVec3::new(x - 0.5 * BAY, GALLERY + 0.95, WALL + 0.17);
                    self.place(banner, front * DAffine3::from_translation(at));
                }
            }
        }
    }

    fn greenery(&mut self) {
        let [x, z] = BAYS.map(|bays| 0.5 * BAY * f64::from(bays));
        // A bed in each quarter of the court, with a tree and bushes.
        let (mut trees, mut bushes) = (Vec::new(), Vec::new());
        for (quarter, [sx, sz]) in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].into_iter().enumerate() {
            let centre = DVec3::new(sx * 5.2, COURT, sz * 3.6);
            let [half_x, half_z, high] = [1.9, 1.2, 0.4];
            let [low, far] = [centre - DVec3::new(half_x, 0.0, half_z), centre + DVec3::new(half_x, high, half_z)];
            for (from, to) in [
                ([low.x, low.y, low.z], [far.x, far.y, low.z + 0.2]),
                ([low.x, low.y, far.z - 0.2], [far.x, far.y, far.z]),
                ([low.x, low.y, low.z + 0.2], [low.x + 0.2, far.y, far.z - 0.2]),
                ([far.x - 0.2, low.y, low.z + 0.2], [far.x, far.y, far.z - 0.2]),
            ] {
                self.block("bed", self.stone, from, to);
            }
            let [inner_low, inner_high] = [[low.x + 0.2, low.y, low.z + 0.2], [far.x - 0.2, far.y - 0.1, far.z - 0.2]];
            self.block("soil", self.soil, inner_low, inner_high);
            let ground = centre + (high - 0.1) * DVec3::Y;
            let turned = |turn: f64, scale: f64, at: DVec3| {
                DAffine3::from_scale_rotation_translation(DVec3::splat(scale), DQuat::from_rotation_y(turn), at)
            };
            trees.push(turned(1.3 * quarter as f64, 1.0 + 0.08 * quarter as f64, ground));
            for i in 0..4 {
                let side = DVec3::new([-1.2, -0.6, 0.65, 1.2][i], 0.0, [0.4, -0.5, 0.5, -0.3][i]);
                bushes.push(turned(1.7 * (i + quarter) as f64, 0.75 + 0.12 * (i % 3) as f64, ground + side));
            }
        }
        self.scatter("trunk", &plants::trunk(), self.bark, trees.iter().copied());
        self.scatter("crown", &plants::crown(), self.leaves, trees);
        self.scatter("bush", &plants::bush(), self.leaves, bushes);

        // Pots before every other column of the court, and ivy on the balustrades.
        let (mut pots, mut ivy) = (Vec::new(), Vec::new());
        for (side, (angle, bays, distance)) in sides().into_iter().enumerate() {
            let front = DAffine3::from_rotation_y(angle) * DAffine3::from_translation(distance * DVec3::Z);
            for (i, x) in along(bays).enumerate() {
                if i > 0 {
                    let at = DVec3::new(x - 0.5 * BAY, COURT, -0.95);
                    pots.push(
                        front * DAffine3::from_translation(at) * DAffine3::from_rotation_y((i + 3 * side) as f64),
                    );
                }
                if (i + side) % 2 == 0 {
                    let at = DVec3::new(x, GALLERY + 0.95, -WALL - 0.02);
                    ivy.push(front * DAffine3::from_translation(at) * DAffine3::from_rotation_y(std::f64::consts::PI));
                }
            }
        }
        // And one in each corner of the arcades.
        for [sx, sz] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
            pots.push(DAffine3::from_translation(DVec3::new(sx * (x + BAY - 0.9), 0.0, sz * (z + BAY - 0.9))));
        }
        self.scatter("pot", &architecture::pot(), self.terracotta, pots.iter().copied());
        let fern = pots.into_iter().map(|pot| pot * DAffine3::from_translation(0.45 * DVec3::Y));
        self.scatter("fern", &plants::fern(), self.leaves, fern);
        self.scatter("ivy", &plants::ivy(), self.leaves, ivy);
    }

    /// A lamp under each vault but those of the corners: a globe on a rod, under a shade.
    fn lamps(&mut self) {
        // Radiance L causes an irradiance of L pi 0.09^2 / 2.5^2 = 0.004 L on the floor below.
        let mut emitter = super::emitter("lamp", 90.0);
        emitter["emissiveFactor"] = json!([1, 0.72, 0.42]);
        let emitter = self.glb.push("materials", emitter);
        let poses: Vec<DAffine3> = sides()
            .into_iter()
            .flat_map(|(angle, bays, distance)| {
                along(bays).map(move |x| {
                    let at = DVec3::new(x, 2.6, distance + 0.5 * BAY);
                    DAffine3::from_rotation_y(angle) * DAffine3::from_translation(at)
                })
            })
            .collect();
        self.scatter("lamp", &Mesh::icosphere(0.09, 1), emitter, poses.iter().copied());
        // From the rod at the vault to the shade's rim, and back inside.
        let length = SPRING + 0.5 * BAY - 2.6;
        let profile = [[0.008, length], [0.008, 0.16], [0.05, 0.15], [0.2, 0.04], [0.05, 0.135], [0.0, 0.14]];
        let mut shade = Mesh::default();
        for line in profile.windows(2) {
            let [from, to] = [line[0], line[1]].map(DVec2::from_array);
            shade.append(Mesh::lathe(32, 1, |v| from.lerp(to, v)));
        }
        self.scatter("shade", &shade, self.iron, poses);
    }
}
