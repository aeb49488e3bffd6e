//! Stress families: scale, offset from the origin, and aspect ratio of triangles.

use glam::{DAffine3, DQuat, DVec3};
use kernel_kit::Gpu;

use super::family::{Family, Measure, Series, image, settings};
use super::oracle::{difference, green, mean, polygon_irradiance, reflected, relative};
use super::stage::{Corners, Eye, Paint, PointLight, Stage, View, cube, inside_out, outline, square};
use crate::{Aov, Result, Technique};

/// The whole scene, scaled in its file.
pub static SCALE: Family = Family {
    name: "scale",
    title: "a room scaled in its file, with its point light; expected: the same image",
    parameter: "scale",
    deviation: "mean |difference| / mean, against scale 1; for powers of ten, difference of the means",
    series: &[
        Series {
            name: "path, powers of two",
            values: &TWOS,
            bound: |_| 0.0,
            prepare: |gpu| scale(gpu, Technique::PATH),
        },
        Series {
            name: "two-pass, powers of two",
            values: &TWOS,
            bound: |_| 0.0,
            prepare: |gpu| scale(gpu, Technique::TWO_PASS),
        },
        Series {
            name: "shadow-photons, powers of two",
            values: &TWOS,
            bound: |_| 0.0,
            prepare: |gpu| scale(gpu, Technique::SHADOW_PHOTONS),
        },
        Series {
            name: "shadow-photons, powers of ten",
            values: &[1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 1e2, 1e4, 1e6, 1e8, 1e10, 1e12],
            bound: |_| OTHER_NOISE,
            prepare: |gpu| scale_by_any(gpu, Technique::SHADOW_PHOTONS),
        },
    ],
};

/// 2^-40 to 2^40: 1e-12 to 1e12.
const TWOS: [f64; 10] = [
    1.0 / (1u64 << 40) as f64,
    1.0 / (1u64 << 30) as f64,
    1.0 / (1u64 << 20) as f64,
    1.0 / 1024.0,
    0.5,
    2.0,
    1024.0,
    (1u64 << 20) as f64,
    (1u64 << 30) as f64,
    (1u64 << 40) as f64,
];

/// The noise of another normalised space: scales other than powers of two round coordinates differently.
const OTHER_NOISE: f64 = 1e-2;

fn scale(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    let settings = settings(technique, 32, 4, 8);
    let reference = image(gpu, &room(), &settings)?;
    Ok(Box::new(move |factor| Ok(difference(&image(gpu, &room().scaled(factor), &settings)?, &reference))))
}

fn scale_by_any(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    let settings = settings(technique, 32, 4, 8);
    let reference = mean(&image(gpu, &room(), &settings)?);
    Ok(Box::new(move |factor| Ok(relative(mean(&image(gpu, &room().scaled(factor), &settings)?), reference))))
}

/// A closed room with a cube, a square lamp and a point light.
pub fn room() -> Stage {
    let eye = Eye {
        position: DVec3::new(0.3, 0.1, 0.45),
        towards: DVec3::new(-0.5, -0.35, -1.0),
        view: View::Perspective(1.1),
    };
    let mut stage = Stage::new(eye)
        .with(inside_out(cube(DVec3::ZERO, 0.5)), Paint::matte(0.6))
        .with(cube(DVec3::new(-0.15, -0.3, -0.1), 0.15), Paint::matte(0.4))
        .with(square(DVec3::new(0.1, 0.45, 0.0), DVec3::X * 0.15, DVec3::Z * 0.15), Paint::lamp(4.0));
    stage.lights.push(PointLight { position: DVec3::new(0.3, 0.2, -0.3), intensity: 0.1 });
    stage
}

/// The whole scene, moved away from the origin.
pub static OFFSET: Family = Family {
    name: "offset",
    title: "a scene of size 1 moved away from the origin; expected: the same image, as far as f32 coordinates allow",
    parameter: "offset in sizes of the scene",
    deviation: "mean |difference| / mean, against no offset; for any coordinates, difference of the means",
    series: &[
        Series {
            name: "in the node, which is f64",
            values: &DISTANCES,
            bound: |_| 0.0,
            prepare: |gpu| offset(gpu, OffsetBy::Node),
        },
        Series {
            name: "coordinates that f32 holds",
            values: &DISTANCES,
            bound: |_| 0.0,
            prepare: |gpu| offset(gpu, OffsetBy::Coordinates),
        },
        Series {
            name: "any coordinates",
            values: &DISTANCES,
            // Rounding by half a unit in the last place of f32 at either end moves an edge by 2^-24 of the offset. A
            // few edges cross a pixel.
            bound: |offset| OTHER_NOISE + 8.0 * offset / (1u64 << 24) as f64,
            prepare: |gpu| offset_any(gpu),
        },
    ],
};

const DISTANCES: [f64; 9] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8];

/// Where the file has the offset.
enum OffsetBy {
    /// In the matrices of the nodes, in f64.
    Node,
    /// In the coordinates of the vertices, in f32.
    Coordinates,
}

fn offset(gpu: &Gpu, by: OffsetBy) -> Result<Measure<'_>> {
    let settings = settings(Technique::SHADOW_PHOTONS, 32, 4, 8);
    let reference = image(gpu, &corner(), &settings)?;
    Ok(Box::new(move |distance| {
        let away = DVec3::new(1.0, -1.0, 1.0) * distance;
        let stage = match by {
            OffsetBy::Node => corner().transformed(DAffine3::from_translation(away)),
            OffsetBy::Coordinates => corner().moved(away),
        };
        Ok(difference(&image(gpu, &stage, &settings)?, &reference))
    }))
}

fn offset_any(gpu: &Gpu) -> Result<Measure<'_>> {
    let settings = settings(Technique::SHADOW_PHOTONS, 32, 4, 8);
    let reference = mean(&image(gpu, &room(), &settings)?);
    Ok(Box::new(move |distance| {
        let stage = room().moved(DVec3::new(0.7, -0.9, 0.8) * distance);
        Ok(relative(mean(&image(gpu, &stage, &settings)?), reference))
    }))
}

/// A corner of two walls under a lamp, with a triangle across it. All coordinates are 0 or 1, so f32 represents them
/// exactly with integer offsets up to 2^24.
pub fn corner() -> Stage {
    let [o, x, y, z] = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    let quad = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| vec![[a, b, c], [a, c, d]];
    let eye = Eye {
        position: DVec3::new(1.625, 0.375, 1.25),
        towards: DVec3::new(-1.0, -0.125, -0.75),
        view: View::Perspective(0.9),
    };
    Stage::new(eye)
        .with(quad(o, z, z + x, x), Paint::matte(0.6))
        .with(quad(o, x, x + y, y), Paint::matte(0.5))
        .with(vec![[x, y, z]], Paint { double_sided: true, ..Paint::matte(0.7) })
        .with(vec![[y, y + x, y + z]], Paint::lamp(3.0))
}

/// A floor cut into needle-shaped triangles.
pub static ASPECT: Family = Family {
    name: "aspect",
    title: "a floor cut into needles; expected: the irradiance of a floor",
    parameter: "length over width of the needles",
    deviation: "largest relative error of a pixel against Lambert's formula; for shadow rays, the occluded share",
    series: &[
        Series {
            name: "along the axes",
            values: &ASPECTS,
            bound: |_| CLOSED,
            prepare: |gpu| needles(gpu, DQuat::IDENTITY),
        },
        Series {
            name: "tilted",
            values: &ASPECTS,
            // Corners are rounded by up to 2^-25 of the scene's radius either way, which rotates a needle by that over
            // its width.
            bound: |aspect| CLOSED + 4.0 * aspect / (1u64 << 24) as f64,
            prepare: |gpu| needles(gpu, tilt()),
        },
        Series { name: "shadow rays, tilted", values: &ASPECTS, bound: |_| 0.0, prepare: |gpu| shadows(gpu, tilt()) },
    ],
};

const ASPECTS: [f64; 10] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9];

/// Error of the closed form in f32: in absolute terms about 1e-6 of the angle that the light subtends.
pub(super) const CLOSED: f64 = 1e-5;

/// Number of needles in the middle of the floor.
const NEEDLES: u32 = 16;

fn tilt() -> DQuat {
    DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 0.5, 0.7)
}

fn needles(gpu: &Gpu, rotation: DQuat) -> Result<Measure<'_>> {
    let expected = reflected(0.5, polygon_irradiance(&outline(&lamp()), DVec3::ZERO, DVec3::Y));
    // Nothing is random: one sample at the centre of each pixel, no audits, and no boundary nearby.
    let settings = settings(Technique::SHADOW_PHOTONS, 16, 1, 0).with(|s| s.visibility_map.audit = 0.0);
    Ok(Box::new(move |aspect| {
        let image = image(gpu, &floor_of_needles(aspect, rotation), &settings)?;
        Ok(green(&image).map(|radiance| relative(radiance, expected)).fold(0.0, f64::max))
    }))
}

/// The share of shadow rays that are occluded, although there is nothing between the floor and its lamp.
fn shadows(gpu: &Gpu, rotation: DQuat) -> Result<Measure<'_>> {
    let settings = settings(Technique::TWO_PASS, 16, 16, 0).with(|s| s.image.aovs = vec![Aov::Shadow]);
    Ok(Box::new(move |aspect| {
        let image = image(gpu, &floor_of_needles(aspect, rotation), &settings)?;
        let visibility = image.channel("shadow.light 0.visibility").into_iter().flatten().map(|v| f64::from(*v));
        Ok(1.0 - visibility.sum::<f64>() / image.pixels() as f64)
    }))
}

fn lamp() -> Vec<Corners> {
    square(DVec3::Y * 0.5, DVec3::X * 0.25, DVec3::Z * 0.25)
}

fn floor_of_needles(aspect: f64, rotation: DQuat) -> Stage {
    let width = 1.0 / aspect;
    // The view covers the needles only, and is so small that the irradiance is that of its centre.
    let half = 0.5 * width * f64::from(NEEDLES);
    let eye = Eye { position: DVec3::Y * 0.25, towards: -DVec3::Y, view: View::Orthographic(half.min(1e-4)) };
    let strip =
        |from: f64, to: f64| square(DVec3::X * (0.5 * (from + to)), DVec3::Z * 0.5, DVec3::X * (0.5 * (to - from)));
    let needle = |i: u32| strip(width * f64::from(i) - half, width * f64::from(i + 1) - half);
    let mut floor: Vec<_> = (0..NEEDLES).flat_map(needle).collect();
    floor.extend(strip(-half - 0.5, -half));
    floor.extend(strip(half, half + 0.5));
    let stage = Stage::new(eye).with(floor, Paint::matte(0.5)).with(lamp(), Paint::lamp(1.0));
    stage.transformed(DAffine3::from_quat(rotation))
}
