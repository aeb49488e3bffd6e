//! A still life that covers many features of glTF: all kinds of textures, alpha modes, vertex colours, a mirrored node,
//! a hierarchy, and four kinds of lights. Lengths are in metres.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage, Rgba, RgbaImage};
use serde_json::json;

use super::glb::{Glb, Wrap, rotation_about};
use super::mesh::Mesh;
use super::noise;

/// Height of the cloth, on which most objects stand.
const CLOTH: f64 = 0.003;

pub fn glb() -> Vec<u8> {
    let mut glb = Glb::default();
    table(&mut glb);
    wall(&mut glb);
    cloth(&mut glb);
    vase(&mut glb);
    pears(&mut glb);
    metal_sphere(&mut glb);
    pane(&mut glb);
    screen(&mut glb);
    candle(&mut glb);
    window(&mut glb);
    let spot = json!({
        "type": "spot", "name": "spot", "color": [1, 0.84, 0.62], "intensity": 2.2,
        "spot": { "innerConeAngle": 0.2, "outerConeAngle": 0.36 },
    });
    let position = DVec3::new(0.55, 0.95, 0.6);
    glb.punctual_light("spot", spot, position, DVec3::new(0.0, 0.04, 0.0) - position);

    let eye = DVec3::new(0.06, 0.42, 1.2);
    glb.camera(eye, DVec3::new(0.02, 0.1, -0.05) - eye, 28.0, 4.0 / 3.0);
    glb.finish("Still life")
}

/// Wood, whose grain KHR_texture_transform rotates and repeats.
fn table(glb: &mut Glb) {
    let wood = RgbImage::from_fn(256, 256, |x, y| {
        let (u, v) = (f64::from(x) / 256.0, f64::from(y) / 256.0);
        let bend = 0.35 * noise::fractal(DVec3::new(1.3 * u, 2.5 * v, 0.5), 3);
        let ring = (14.0 * (v + 0.25 * bend)).rem_euclid(1.0);
        let fibre = noise::fractal(DVec3::new(6.0 * u, 90.0 * v, 2.5), 3);
        let dark = 0.55 * ring * ring + 0.2 * (0.5 + 0.5 * fibre);
        shade(DVec3::new(196.0, 142.0, 88.0).lerp(DVec3::new(104.0, 62.0, 34.0), dark))
    });
    let wood = glb.texture("wood", wood, Wrap::Mirror);
    let transform = json!({ "scale": [3, 2], "rotation": 0.06, "offset": [0.1, 0.3] });
    let wood = glb.push(
        "materials",
        json!({
            "name": "wood",
            "pbrMetallicRoughness": {
                "baseColorTexture": { "index": wood, "extensions": { "KHR_texture_transform": transform } },
                "metallicFactor": 0,
                "roughnessFactor": 0.45,
            },
        }),
    );
    let half = DVec3::new(0.85, 0.02, 0.45);
    let mesh = glb.mesh("table", &Mesh::cuboid(half), wood);
    glb.push("nodes", json!({ "name": "table", "mesh": mesh, "translation": [0, -half.y, 0] }));
}

/// Glazed tiles in rough grout: base colour, metallic-roughness and normal textures.
fn wall(glb: &mut Glb) {
    // Width of the texture in texels and in tiles.
    const SIZE: u32 = 256;
    const TILES: u32 = 4;
    // Height of the glaze above the grout in texels: 0 in the joint, 1.5 on the tile, with a rounded edge.
    let height = |x: u32, y: u32| {
        let across = SIZE / TILES;
        let edge = |t: u32| (t % across).min(across - 1 - t % across);
        let rise = (f64::from(edge(x).min(edge(y))) - 2.0).clamp(0.0, 3.0) / 3.0;
        1.5 * rise * (2.0 - rise)
    };
    let colour = RgbImage::from_fn(SIZE, SIZE, |x, y| {
        let tile = DVec3::new(f64::from(x * TILES / SIZE), f64::from(y * TILES / SIZE), 0.0);
        let tint = noise::fractal(7.0 * tile, 1);
        let glaze = DVec3::new(86.0, 142.0, 140.0) + tint * DVec3::new(22.0, 20.0, 14.0);
        shade(if height(x, y) > 0.0 { glaze } else { DVec3::new(176.0, 168.0, 154.0) })
    });
    let roughness = RgbImage::from_fn(SIZE, SIZE, |x, y| {
        let smear = 0.5 + 0.5 * noise::fractal(DVec3::new(f64::from(x), f64::from(y), 64.0) / 24.0, 3);
        let roughness = if height(x, y) > 0.0 { 0.22 + 0.18 * smear } else { 0.95 };
        Rgb([0, (255.0 * roughness).round() as u8, 0])
    });
    let normal = RgbImage::from_fn(SIZE, SIZE, |x, y| {
        let beside = |dx: u32, dy: u32| height((x + dx) % SIZE, (y + dy) % SIZE);
        let slope_u = 0.5 * (beside(1, 0) - beside(SIZE - 1, 0));
        // Green points to the top of the image, opposite to v.
        let slope_up = 0.5 * (beside(0, SIZE - 1) - beside(0, 1));
        let normal = DVec3::new(-slope_u, -slope_up, 1.0).normalize();
        shade(127.5 + 127.5 * normal)
    });
    let colour = glb.texture("tiles", colour, Wrap::Repeat);
    let roughness = glb.texture("tile roughness", roughness, Wrap::Repeat);
    let normal = glb.texture("tile normals", normal, Wrap::Repeat);
    let tiles = glb.push(
        "materials",
        json!({
            "name": "tiles",
            "pbrMetallicRoughness": {
                "baseColorTexture": { "index": colour },
                "metallicRoughnessTexture": { "index": roughness },
            },
            "normalTexture": { "index": normal },
        }),
    );
    let half = DVec2::new(1.2, 0.8);
    let mut mesh = Mesh::quad(DVec3::ZERO, half.x * DVec3::X, half.y * DVec3::Y);
    // The texture, which has four tiles, repeats every 0.4 m.
    mesh.uvs.iter_mut().for_each(|uv| *uv *= 2.0 * half / 0.4);
    mesh.tangents = [DVec3::X.extend(1.0); 4].into();
    let mesh = glb.mesh("wall", &mesh, tiles);
    glb.push("nodes", json!({ "name": "wall", "mesh": mesh, "translation": [0, 0.5, -0.5] }));
}

/// A checked cloth with a border of holes (alpha mask).
fn cloth(glb: &mut Glb) {
    let checks = RgbaImage::from_fn(320, 240, |x, y| {
        let woven = if (x + y) % 2 == 0 { 0.0 } else { -8.0 };
        let red = DVec3::new(168.0, 40.0, 44.0);
        let colour = match (x / 20 % 2, y / 20 % 2) {
            (0, 0) => DVec3::new(232.0, 226.0, 214.0),
            (1, 1) => red,
            _ => red.lerp(DVec3::new(232.0, 226.0, 214.0), 0.5),
        } + woven;
        let border = x.min(319 - x).min(y).min(239 - y);
        let hole = DVec2::new(f64::from(x % 10) - 4.5, f64::from(y % 10) - 4.5).length() < 3.2;
        let Rgb([r, g, b]) = shade(colour);
        Rgba([r, g, b, if (2..18).contains(&border) && hole { 0 } else { 255 }])
    });
    let checks = glb.texture("checks", checks, Wrap::Clamp);
    let cloth = glb.push(
        "materials",
        json!({
            "name": "cloth",
            "pbrMetallicRoughness": {
                "baseColorTexture": { "index": checks }, "metallicFactor": 0, "roughnessFactor": 0.9,
            },
            "alphaMode": "MASK",
            "doubleSided": true,
        }),
    );
    let mesh = Mesh::surface(32, 24, false, |u, v| {
        let p = DVec2::new(u - 0.5, v - 0.5) * DVec2::new(0.64, 0.48);
        // Flat in the middle, where objects stand, with ripples of this slope at the border.
        let ripple = |p: DVec2| {
            let border = ((p.x.abs() / 0.32).max(p.y.abs() / 0.24) - 0.7).max(0.0) / 0.3;
            0.006 * border * border * (0.5 + 0.5 * (40.0 * p.x).sin() * (35.0 * p.y + 1.0).cos())
        };
        let step = 1e-4;
        let slope = |d: DVec2| (ripple(p + step * d) - ripple(p - step * d)) / (2.0 * step);
        (DVec3::new(p.x, ripple(p), p.y), DVec3::new(-slope(DVec2::X), 1.0, -slope(DVec2::Y)).normalize())
    });
    let mesh = glb.mesh("cloth", &mesh, cloth);
    let rotation = rotation_about(DVec3::Y, 12.0);
    glb.push(
        "nodes",
        json!({ "name": "cloth", "mesh": mesh, "translation": [-0.04, CLOTH, 0.07], "rotation": rotation }),
    );
}

/// A vase with vertex colours. Its child nodes are leaves with an alpha mask.
fn vase(glb: &mut Glb) {
    let glaze = glb.push(
        "materials",
        json!({ "name": "glaze", "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0.15 } }),
    );
    let (height, wall) = (0.24, 0.006);
    let outside = |y: f64| 0.034 + 0.036 * (PI * (y / height).powf(0.8)).sin().max(0.0) + 0.006 * (y / height).powi(6);
    // The profile goes up the inside, over the rim and down the outside. `t` is the share of the way.
    let mesh = Mesh::lathe(64, 72, |t| match t {
        ..0.05 => DVec2::new((outside(wall) - wall) * t / 0.05, wall),
        ..0.45 => {
            let y = wall + (height - wall) * (t - 0.05) / 0.4;
            DVec2::new(outside(y) - wall, y)
        }
        ..0.55 => {
            let (sin, cos) = (PI * (t - 0.45) / 0.1).sin_cos();
            DVec2::new(outside(height) - 0.5 * wall * (1.0 + cos), height + 0.5 * wall * sin)
        }
        ..0.95 => {
            let y = height * (0.95 - t) / 0.4;
            DVec2::new(outside(y), y)
        }
        _ => DVec2::new(outside(0.0) * (1.0 - t) / 0.05, 0.0),
    })
    .coloured(|p| {
        let y = (p.y / height).clamp(0.0, 1.0);
        let run = 0.12 * noise::fractal(DVec3::new(40.0 * p.x, 6.0 * p.y, 40.0 * p.z), 3);
        let t = ((y - 0.45 + run) / 0.3).clamp(0.0, 1.0);
        DVec3::new(0.72, 0.68, 0.58).lerp(DVec3::new(0.03, 0.09, 0.26), t * t * (3.0 - 2.0 * t))
    });
    let mesh = glb.mesh("vase", &mesh, glaze);

    let leaf_mesh = leaf(glb);
    let leaves: Vec<usize> = [(20.0, 1.0), (100.0, 0.85), (165.0, 0.95), (235.0, 0.8), (305.0, 1.05)]
        .into_iter()
        .map(|(degrees, scale)| {
            glb.push(
                "nodes",
                json!({
                    "name": "leaf", "mesh": leaf_mesh, "scale": [scale, scale, scale],
                    "translation": [0, 0.17, 0], "rotation": rotation_about(DVec3::Y, degrees),
                }),
            )
        })
        .collect();
    glb.push(
        "nodes",
        json!({ "name": "vase", "mesh": mesh, "translation": [-0.22, CLOTH, -0.06], "children": leaves }),
    );
}

/// A leaf: a bent strip with an alpha mask. Returns the mesh.
fn leaf(glb: &mut Glb) -> usize {
    let blade = RgbaImage::from_fn(96, 192, |x, y| {
        let (across, up) = ((f64::from(x) + 0.5) / 48.0 - 1.0, 1.0 - (f64::from(y) + 0.5) / 192.0);
        let outline = 0.9 * (PI * up.powf(0.8)).sin().max(0.0).powf(0.8);
        let midrib = (across.abs() / 0.05).min(1.0);
        let veins = (24.0 * (up - 0.35 * across.abs())).rem_euclid(1.0);
        let green = DVec3::new(62.0, 112.0, 48.0) + 24.0 * up - 14.0 * if veins < 0.2 { 1.0 } else { 0.0 };
        let Rgb([r, g, b]) = shade(DVec3::new(150.0, 172.0, 96.0).lerp(green, midrib));
        let stalk = across.abs() < 0.06 && up < 0.2;
        Rgba([r, g, b, if across.abs() < outline || stalk { 255 } else { 0 }])
    });
    let blade = glb.texture("leaf", blade, Wrap::Clamp);
    let material = glb.push(
        "materials",
        json!({
            "name": "leaf",
            "pbrMetallicRoughness": {
                "baseColorTexture": { "index": blade }, "metallicFactor": 0, "roughnessFactor": 0.5,
            },
            "alphaMode": "MASK",
            "alphaCutoff": 0.5,
            "doubleSided": true,
        }),
    );
    // A strip that rises from the origin and bends towards +z along an arc of this radius.
    let (radius, width) = (0.2, 0.045);
    let strip = Mesh::surface(6, 16, false, |u, v| {
        let (sin, cos) = (1.1 * (1.0 - v)).sin_cos();
        let fold = (u - 0.5).abs();
        let normal = DVec3::new(0.0, -sin, cos);
        let position = DVec3::new((u - 0.5) * 2.0 * width, radius * sin, radius * (1.0 - cos));
        // The two halves fold forward along the midrib.
        let facing = DVec3::new(-0.35 * (u - 0.5).signum() * if fold > 0.0 { 1.0 } else { 0.0 }, 0.0, 0.0) + normal;
        (position + 0.7 * width * fold * normal, facing.normalize())
    });
    glb.mesh("leaf", &strip, material)
}

/// Two pears of one mesh with vertex colours. The second pear is mirrored.
fn pears(glb: &mut Glb) {
    let skin = glb.push(
        "materials",
        json!({ "name": "pear", "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0.4 } }),
    );
    let mesh = Mesh::lathe(48, 40, |t| {
        let (sin, cos) = (PI * t).sin_cos();
        // Narrower above the middle, with a rounded top and a flattened base.
        let neck = ((cos + 0.5) / 1.2).clamp(0.0, 1.0);
        let girth = 1.0 - 0.42 * neck * neck * (3.0 - 2.0 * neck) + 0.22 * cos.powi(8);
        DVec2::new(0.037 * girth * sin, 0.05 * (1.0 + cos))
    })
    .coloured(|p| {
        let blush = (0.5 + 14.0 * p.x + 0.5 * noise::fractal(30.0 * p, 4)).clamp(0.0, 1.0);
        let speckle = if noise::fractal(400.0 * p, 1) > 0.55 { 0.75 } else { 1.0 };
        speckle * DVec3::new(0.5, 0.47, 0.07).lerp(DVec3::new(0.55, 0.17, 0.05), 0.7 * blush)
    });
    let mesh = glb.mesh("pear", &mesh, skin);
    let bark = glb.push("materials", super::lambertian("bark", [0.07, 0.045, 0.025]));
    let stalk = glb.mesh("stalk", &Mesh::cuboid(DVec3::new(0.0015, 0.012, 0.0015)), bark);
    let mut stalk = |lean| {
        let rotation = rotation_about(DVec3::Z, lean);
        glb.push("nodes", json!({ "name": "stalk", "mesh": stalk, "translation": [0, 0.108, 0], "rotation": rotation }))
    };
    let stalks = [stalk(14.0), stalk(-8.0)];
    glb.push(
        "nodes",
        json!({
            "name": "pear", "mesh": mesh, "children": [stalks[0]],
            "translation": [-0.075, CLOTH, 0.1], "rotation": rotation_about(DVec3::Y, 30.0),
        }),
    );
    glb.push(
        "nodes",
        json!({
            "name": "mirrored pear", "mesh": mesh, "children": [stalks[1]], "scale": [-0.92, 0.92, 0.92],
            "translation": [-0.155, CLOTH, 0.14], "rotation": rotation_about(DVec3::Y, 200.0),
        }),
    );
}

fn metal_sphere(glb: &mut Glb) {
    let copper = glb.push(
        "materials",
        json!({
            "name": "rough copper",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.93, 0.62, 0.52, 1], "metallicFactor": 1, "roughnessFactor": 0.3,
            },
        }),
    );
    let radius = 0.062;
    let mesh = glb.mesh("metal sphere", &Mesh::sphere(radius, 64, 32), copper);
    glb.push("nodes", json!({ "name": "metal sphere", "mesh": mesh, "translation": [0.04, CLOTH + radius, 0.02] }));
}

/// A tinted pane that transmits 65 % of the rays (alpha blend).
fn pane(glb: &mut Glb) {
    let tint = glb.push(
        "materials",
        json!({
            "name": "pane",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.15, 0.35, 0.8, 0.35], "metallicFactor": 0, "roughnessFactor": 0.1,
            },
            "alphaMode": "BLEND",
            "doubleSided": true,
        }),
    );
    let mesh = glb.mesh("pane", &Mesh::quad(DVec3::ZERO, 0.06 * DVec3::X, 0.08 * DVec3::Y), tint);
    glb.push(
        "nodes",
        json!({
            "name": "pane", "mesh": mesh,
            "translation": [0.17, 0.085, 0.1], "rotation": rotation_about(DVec3::Y, -35.0),
        }),
    );
}

/// A screen that shows a sunset: a light with an emissive texture in a tilted frame.
fn screen(glb: &mut Glb) {
    let sunset = RgbImage::from_fn(160, 120, |x, y| {
        let p = DVec2::new(f64::from(x) / 160.0, f64::from(y) / 120.0);
        let sky = DVec3::new(30.0, 44.0, 110.0).lerp(DVec3::new(250.0, 140.0, 60.0), (p.y / 0.62).min(1.0).powi(2));
        let sun = (p - DVec2::new(0.62, 0.52)) * DVec2::new(4.0 / 3.0, 1.0);
        let hill = 0.62 + 0.12 * noise::fractal(DVec3::new(4.0 * p.x, 0.5, 0.5), 4);
        shade(if p.y > hill {
            DVec3::new(24.0, 20.0, 34.0)
        } else if sun.length() < 0.11 {
            DVec3::new(255.0, 232.0, 170.0)
        } else {
            sky
        })
    });
    let sunset = glb.texture("sunset", sunset, Wrap::Clamp);
    let mut picture = super::emitter("screen", 2.0);
    picture["emissiveTexture"] = json!({ "index": sunset });
    let picture = glb.push("materials", picture);
    let plastic = glb.push(
        "materials",
        json!({
            "name": "plastic",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.03, 0.03, 0.035, 1], "metallicFactor": 0, "roughnessFactor": 0.5,
            },
        }),
    );
    let half = DVec3::new(0.14, 0.105, 0.006);
    let frame = glb.mesh("frame", &Mesh::cuboid(half), plastic);
    // A millimetre in front of the frame.
    let image = Mesh::quad((half.z + 0.001) * DVec3::Z, 0.92 * half.x * DVec3::X, 0.92 * half.y * DVec3::Y);
    let image = glb.mesh("screen", &image, picture);
    let image = glb.push("nodes", json!({ "name": "screen", "mesh": image }));
    let frame = glb.push(
        "nodes",
        json!({ "name": "frame", "mesh": frame, "rotation": rotation_about(DVec3::X, -10.0), "children": [image] }),
    );
    glb.push(
        "nodes",
        json!({
            "name": "tablet", "children": [frame],
            "translation": [0.2, 0.107, -0.26], "rotation": rotation_about(DVec3::Y, -18.0),
        }),
    );
}

/// A candle whose flame is a point light.
fn candle(glb: &mut Glb) {
    let wax = glb.push(
        "materials",
        json!({
            "name": "wax",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.82, 0.74, 0.6, 1], "metallicFactor": 0, "roughnessFactor": 0.6,
            },
        }),
    );
    let (radius, height, rim) = (0.021, 0.09, 0.004);
    let mesh = Mesh::lathe(40, 40, |t| match t {
        ..0.2 => DVec2::new((radius - rim) * t / 0.2, height),
        ..0.4 => {
            let (sin, cos) = (0.5 * PI * (t - 0.2) / 0.2).sin_cos();
            DVec2::new(radius - rim + rim * sin, height - rim + rim * cos)
        }
        ..0.8 => DVec2::new(radius, (height - rim) * (0.8 - t) / 0.4),
        _ => DVec2::new(radius * (1.0 - t) / 0.2, 0.0),
    });
    let mesh = glb.mesh("candle", &mesh, wax);
    let position = DVec3::new(0.33, 0.0, -0.02);
    glb.push("nodes", json!({ "name": "candle", "mesh": mesh, "translation": position.to_array() }));
    let flame = json!({ "type": "point", "name": "flame", "color": [1, 0.55, 0.2], "intensity": 0.06 });
    glb.punctual_light("flame", flame, position + (height + 0.03) * DVec3::Y, -DVec3::Y);
}

/// A window-sized light of a cool colour, out of view on the left.
fn window(glb: &mut Glb) {
    let mut light = super::emitter("window", 9.0);
    light["emissiveFactor"] = json!([0.8, 0.92, 1]);
    let light = glb.push("materials", light);
    let centre = DVec3::new(-0.9, 0.9, 0.5);
    let facing = -centre.normalize();
    let right = DVec3::Y.cross(facing).normalize();
    let mesh = glb.mesh("window", &Mesh::quad(centre, 0.3 * right, 0.4 * facing.cross(right)), light);
    glb.push("nodes", json!({ "name": "window", "mesh": mesh }));
}

/// An 8-bit colour from components in 0 to 255.
fn shade(colour: DVec3) -> Rgb<u8> {
    Rgb(colour.to_array().map(|c| c.round().clamp(0.0, 255.0) as u8))
}
