//! The textures of the atrium. Each is square and has its features at fixed shares of its side, so that it looks the
//! same at any size.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3, IVec3};
use image::{Rgb, RgbImage, Rgba, RgbaImage};

use super::super::noise::{fractal, hash};

/// Blocks of a wall per texture: rows, and blocks in a row.
const ROWS: f64 = 8.0;
const BLOCKS: f64 = 4.0;
/// Floor tiles along the side of a texture.
const TILES: f64 = 4.0;

/// A random number in 0 to 1.
fn number(x: f64, y: f64, what: i32) -> f64 {
    f64::from(hash(IVec3::new(x as i32, y as i32, what))) / f64::from(u32::MAX)
}

fn shade(colour: DVec3) -> Rgb<u8> {
    Rgb(colour.to_array().map(|c| c.round().clamp(0.0, 255.0) as u8))
}

fn image(side: u32, colour: impl Fn(DVec2) -> DVec3) -> RgbImage {
    RgbImage::from_fn(side, side, |x, y| shade(colour(centre(side, x, y))))
}

fn centre(side: u32, x: u32, y: u32) -> DVec2 {
    (DVec2::new(f64::from(x), f64::from(y)) + 0.5) / f64::from(side)
}

/// A normal map of a height in units of the texture's side, which must repeat.
fn normals(side: u32, height: impl Fn(DVec2) -> f64) -> RgbImage {
    let step = 1.0 / f64::from(side);
    RgbImage::from_fn(side, side, |x, y| {
        let at = |dx: i64, dy: i64| {
            let wrapped = |a: u32, d: i64| (i64::from(a) + d).rem_euclid(i64::from(side)) as u32;
            height(centre(side, wrapped(x, dx), wrapped(y, dy)))
        };
        // Green points to the top of the image, opposite to v.
        let slope = DVec2::new(at(1, 0) - at(-1, 0), at(0, -1) - at(0, 1)) / (2.0 * step);
        shade(127.5 + 127.5 * DVec3::new(-slope.x, -slope.y, 1.0).normalize())
    })
}

/// The block at `p`, as (column, row), and the distance from its edge over the height of a row.
fn block(p: DVec2) -> (DVec2, f64) {
    let row = (p.y * ROWS).floor();
    // Every other row is shifted by half a block.
    let x = (p.x + 0.5 / BLOCKS * row.rem_euclid(2.0)) * BLOCKS;
    let inside = DVec2::new(x.fract(), (p.y * ROWS).fract());
    let edge = inside.min(1.0 - inside) * DVec2::new(ROWS / BLOCKS, 1.0);
    (DVec2::new(x.floor().rem_euclid(BLOCKS), row), edge.min_element())
}

/// Each block has a grain of its own, so that the texture repeats.
fn grain(p: DVec2, block: DVec2, what: f64, octaves: u32) -> f64 {
    fractal(DVec3::new(ROWS * p.x, ROWS * p.y, 3.1 * block.x + 17.3 * block.y + what), octaves)
}

/// Blocks of sandstone.
pub fn stone(side: u32) -> RgbImage {
    image(side, |p| {
        let (id, edge) = block(p);
        let tint = number(id.x, id.y, 0);
        let light = DVec3::new(214.0, 194.0, 160.0).lerp(DVec3::new(196.0, 166.0, 124.0), tint);
        let layers = grain(DVec2::new(0.4 * p.x, 2.5 * p.y), id, 0.5, 4);
        let colour = light + 13.0 * layers + 10.0 * grain(6.0 * p, id, 40.5, 3);
        colour.lerp(DVec3::new(146.0, 130.0, 106.0), 1.0 - ((edge - 0.012) / 0.014).clamp(0.0, 1.0))
    })
}

pub fn stone_normals(side: u32) -> RgbImage {
    normals(side, |p| {
        let (id, edge) = block(p);
        let rise = ((edge - 0.008) / 0.03).clamp(0.0, 1.0);
        0.0022 * rise * (2.0 - rise) + 0.0007 * rise * grain(5.0 * p, id, 20.5, 4)
    })
}

/// The tile at `p`, and the distance from its edge over its side.
fn tile(p: DVec2) -> (DVec2, DVec2, f64) {
    let cell = (p * TILES).floor();
    let inside = (p * TILES).fract();
    (cell, inside, inside.min(1.0 - inside).min_element())
}

/// Square floor tiles in two colours, each with a star.
pub fn tiles(side: u32) -> RgbImage {
    image(side, |p| {
        let (id, inside, edge) = tile(p);
        let from_centre = inside - 0.5;
        let angle = from_centre.y.atan2(from_centre.x);
        let star = from_centre.length() < 0.26 + 0.1 * (8.0 * angle).cos();
        let ring = (from_centre.length() - 0.42).abs() < 0.018;
        let dark = (id.x + id.y).rem_euclid(2.0) == 0.0;
        let [ground, figure] = match dark {
            true => [DVec3::new(156.0, 84.0, 60.0), DVec3::new(214.0, 190.0, 150.0)],
            false => [DVec3::new(206.0, 186.0, 150.0), DVec3::new(66.0, 92.0, 104.0)],
        };
        let wear = fractal(DVec3::new(14.0 * p.x, 14.0 * p.y, 9.0 * id.x + 5.0 * id.y + 0.5), 4);
        let colour = if star || ring { figure } else { ground } + 14.0 * wear + 18.0 * (number(id.x, id.y, 1) - 0.5);
        if edge < 0.012 { DVec3::new(122.0, 114.0, 102.0) } else { colour }
    })
}

pub fn tile_normals(side: u32) -> RgbImage {
    normals(side, |p| {
        let (id, _, edge) = tile(p);
        let rise = ((edge - 0.008) / 0.02).clamp(0.0, 1.0);
        let dents = fractal(DVec3::new(24.0 * p.x, 24.0 * p.y, 7.0 * id.x + 3.0 * id.y + 0.5), 3);
        0.0016 * rise * (2.0 - rise) + 0.00025 * rise * dents
    })
}

/// Plaster and smooth stone, for mirrored repeat.
pub fn plaster(side: u32) -> RgbImage {
    image(side, |p| {
        let at = DVec3::new(p.x, p.y, 0.5);
        let cloud = fractal(3.0 * at, 6);
        let stain = (fractal(1.3 * at + 7.5, 4) - 0.1).max(0.0);
        DVec3::new(220.0, 208.0, 184.0) + 16.0 * cloud - stain * DVec3::new(40.0, 46.0, 54.0)
    })
}

/// A damask: figures in the shade of the ground. Materials colour it.
pub fn cloth(side: u32) -> RgbImage {
    image(side, |p| {
        // Rows of figures are shifted by half a figure.
        let row = (6.0 * p.y).floor();
        let cell = DVec2::new((6.0 * p.x + 0.5 * row.rem_euclid(2.0)).fract(), (6.0 * p.y).fract()) - 0.5;
        let angle = cell.x.atan2(cell.y);
        let petal = 0.3 + 0.13 * (6.0 * angle).cos();
        let figure = cell.length() < petal && (cell.length() - 0.6 * petal).abs() > 0.03;
        let stripe = (p.x - 0.5).abs() > 0.44 && (p.x - 0.5).abs() < 0.47;
        let weave = 0.5 + 0.5 * (TAU * 256.0 * p.x).sin() * (TAU * 256.0 * p.y).sin();
        let base = if stripe {
            255.0
        } else if figure {
            208.0
        } else {
            150.0
        };
        DVec3::splat(base - 26.0 * weave)
    })
}

/// One leaf with a serrated edge, upright.
pub fn leaf(side: u32) -> RgbaImage {
    RgbaImage::from_fn(side, side, |x, y| {
        let p = centre(side, x, y);
        let (across, up) = (2.0 * p.x - 1.0, 1.0 - p.y);
        let teeth = 0.035 * (26.0 * up).fract();
        let outline = 0.92 * (PI * up.powf(0.75)).sin().max(0.0).powf(0.8) - teeth;
        let midrib = (across.abs() / 0.035).min(1.0);
        let vein = (11.0 * (up - 0.45 * across.abs())).rem_euclid(1.0);
        let cells = fractal(DVec3::new(40.0 * p.x, 40.0 * p.y, 0.5), 4);
        let green = DVec3::new(86.0, 136.0, 56.0) + DVec3::new(26.0, 26.0, 10.0) * (up + 0.5 * cells);
        let green = if vein < 0.1 { green + 16.0 } else { green };
        let Rgb([r, g, b]) = shade(DVec3::new(142.0, 164.0, 88.0).lerp(green, midrib));
        let stalk = across.abs() < 0.04 && up < 0.15;
        Rgba([r, g, b, if across.abs() < outline || stalk { 255 } else { 0 }])
    })
}
