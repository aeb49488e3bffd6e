//! Stress families: size, distance, radiance and number of lights.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DVec3};
use kernel_kit::Gpu;

use super::family::{Family, Measure, Series, image, settings};
use super::oracle::{difference, green, mean, polygon_irradiance, reflected, relative};
use super::placement::{CLOSED, room};
use super::stage::{Corners, Eye, Paint, Part, Stage, View, cube, inside_out, outline, polygon, square};
use crate::{Result, Settings, Technique};

/// Albedo of all floors here.
const ALBEDO: f64 = 0.5;

/// Bound for means of images that sample their light: some thousand light points leave a few tenths of a percent of
/// noise.
const NOISE: f64 = 2e-2;

/// Bound for means of images whose light points contribute nearly equally: some ten thousand of them leave less than
/// 0.1 % of noise, or twice that with the rays of paths.
const EVEN: f64 = 2e-3;

/// The largest relative error of a pixel. The view is straight at a plane through the origin, with the given normal,
/// which a polygon of unit radiance lights.
fn worst_pixel(image: &crate::Image, eye: &Eye, lamp: &[DVec3], normal: DVec3) -> f64 {
    let side = image.width;
    let expected = |pixel: u32| {
        let (origin, direction) = eye.ray([pixel % side, pixel / side], side);
        let position = origin - direction * (origin.dot(normal) / direction.dot(normal));
        reflected(ALBEDO, polygon_irradiance(lamp, position, normal))
    };
    (0..).zip(green(image)).map(|(pixel, radiance)| relative(radiance, expected(pixel))).fold(0.0, f64::max)
}

/// The relative error of the mean, for the view of [`worst_pixel`].
pub(super) fn worst_mean(image: &crate::Image, eye: &Eye, lamp: &[DVec3], normal: DVec3) -> f64 {
    // Samples are distributed over the whole pixel; they estimate the integral, which is the mean over many points.
    const POINTS: u32 = 64;
    let radiance = |at: u32| {
        let (origin, direction) = eye.ray([at % POINTS, at / POINTS], POINTS);
        let position = origin - direction * (origin.dot(normal) / direction.dot(normal));
        reflected(ALBEDO, polygon_irradiance(lamp, position, normal))
    };
    let expected = (0..POINTS * POINTS).map(radiance).sum::<f64>() / f64::from(POINTS * POINTS);
    relative(mean(image), expected)
}

/// A lamp of any size, from nearly a point to nearly a sky.
pub static RADIUS: Family = Family {
    name: "light-radius",
    title: "a square lamp of constant power over a floor, from a point to a sky; expected: Lambert's formula",
    parameter: "half the lamp's side over the floor's side",
    deviation: "largest relative error of a pixel; for techniques that sample the lamp, error of the mean",
    series: &[
        Series {
            name: "shadow-photons",
            values: &RADII,
            bound: |_| CLOSED,
            prepare: |gpu| radius(gpu, Technique::SHADOW_PHOTONS, DVec3::Y),
        },
        Series {
            name: "two-pass",
            values: &RADII,
            bound: |_| EVEN,
            prepare: |gpu| radius(gpu, Technique::TWO_PASS, DVec3::Y),
        },
        Series { name: "path", values: &RADII, bound: |_| EVEN, prepare: |gpu| radius(gpu, Technique::PATH, DVec3::Y) },
        Series {
            name: "shadow-photons, away from the middle",
            values: &RADII,
            // Away from the centre, coordinates of the scene's size are rounded by at most 2^-25 on either side.
            bound: |radius| CLOSED + 2.0 / (radius * (1u64 << 24) as f64),
            prepare: |gpu| radius(gpu, Technique::SHADOW_PHOTONS, DVec3::new(0.3, 1.0, 0.2)),
        },
    ],
};

const RADII: [f64; 13] = [1e3, 1e2, 1e1, 1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9];

fn radius(gpu: &Gpu, technique: Technique, centre: DVec3) -> Result<Measure<'_>> {
    let exact = technique == Technique::SHADOW_PHOTONS;
    let settings = settings(technique, 16, if exact { 1 } else { 16 }, 0);
    Ok(Box::new(move |radius| {
        let lamp = square(centre, DVec3::X * radius, DVec3::Z * radius);
        let eye = Eye { position: DVec3::Y * 0.5, towards: -DVec3::Y, view: View::Orthographic(0.4) };
        let radiance = 1.0 / (radius * radius);
        let stage = Stage::new(eye)
            .with(square(DVec3::ZERO, DVec3::Z * 0.5, DVec3::X * 0.5), Paint::matte(ALBEDO))
            .with(lamp.clone(), Paint::lamp(radiance));
        // Normalised to a lamp of unit radiance.
        let mut image = image(gpu, &stage, &settings)?;
        image
            .channels
            .iter_mut()
            .flat_map(|channel| &mut channel.samples)
            .for_each(|x| *x = (f64::from(*x) / radiance) as f32);
        let error = if exact { worst_pixel } else { worst_mean };
        Ok(error(&image, &eye, &outline(&lamp), DVec3::Y))
    }))
}

/// A lamp that nearly touches a surface.
pub static DISTANCE: Family = Family {
    name: "distance",
    title: "a lamp of size 1 nearly touches a floor twice as wide; expected: Lambert's formula",
    parameter: "distance over the lamp's size",
    deviation: "largest relative error of a pixel; for techniques that sample the lamp, error of the mean",
    series: &[
        Series {
            name: "under a square",
            values: &GAPS,
            bound: |_| NEAR,
            prepare: |gpu| distance(gpu, Technique::SHADOW_PHOTONS, Layout::Under),
        },
        Series {
            name: "under a disc",
            values: &GAPS,
            bound: |_| NEAR,
            prepare: |gpu| distance(gpu, Technique::SHADOW_PHOTONS, Layout::UnderDisc),
        },
        Series {
            name: "on a wall beside it",
            values: &GAPS,
            bound: |_| NEAR,
            prepare: |gpu| distance(gpu, Technique::SHADOW_PHOTONS, Layout::Wall),
        },
        Series {
            name: "path, under a square",
            values: &GAPS,
            bound: |_| EVEN,
            prepare: |gpu| distance(gpu, Technique::PATH, Layout::Under),
        },
        Series {
            name: "two-pass, under a square",
            values: &GAPS,
            bound: |_| EVEN,
            prepare: |gpu| distance(gpu, Technique::TWO_PASS, Layout::Under),
        },
        Series {
            name: "two-pass, under a square of 512 triangles",
            values: &GAPS,
            // Triangles are sampled by power. A point receives half of its light from the part of the lamp that is as
            // wide as it is distant. The bound is three standard errors of the number of samples on such a part.
            bound: |gap| 3.0 * ((1.0 / (PI * gap * gap)).min(512.0) / (16 * 16 * MANY_SAMPLES) as f64).sqrt(),
            prepare: |gpu| distance(gpu, Technique::TWO_PASS, Layout::UnderMany),
        },
    ],
};

const GAPS: [f64; 15] = [1.0, 0.3, 1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7];

/// Bound of closed forms close to a light.
const NEAR: f64 = 1e-4;

/// The shape of a near lamp, and where the surface is.
#[derive(Clone, Copy, PartialEq)]
enum Layout {
    Under,
    UnderDisc,
    UnderMany,
    Wall,
}

/// Samples per pixel under a lamp of many triangles.
const MANY_SAMPLES: u32 = 1024;

/// Corners of the disc: the maximum for a light with a closed form.
const DISC_CORNERS: u32 = 64;

fn distance(gpu: &Gpu, technique: Technique, layout: Layout) -> Result<Measure<'_>> {
    let exact = technique == Technique::SHADOW_PHOTONS;
    let samples = if layout == Layout::UnderMany { MANY_SAMPLES } else { 64 };
    let settings = settings(technique, 16, if exact { 1 } else { samples }, 0);
    Ok(Box::new(move |gap| {
        let (stage, corners, normal) = near_lamp(layout, gap);
        let error = if exact { worst_pixel } else { worst_mean };
        Ok(error(&image(gpu, &stage, &settings)?, &stage.eye, &corners, normal))
    }))
}

/// A lamp at a distance of `gap` from a surface. Returns the stage, the corners of the lamp and the normal of the
/// surface.
fn near_lamp(layout: Layout, gap: f64) -> (Stage, Vec<DVec3>, DVec3) {
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
    let (lamp, normal): (Vec<Corners>, DVec3) = match layout {
        Layout::Wall => (square(x * (gap + 0.5), x * 0.5, z * 0.5), x),
        _ => (square(y * gap, x * 0.5, z * 0.5), y),
    };
    let mut corners = outline(&lamp).to_vec();
    let mut triangles = lamp;
    if layout == Layout::UnderDisc {
        let at = |i: u32| TAU * f64::from(i) / f64::from(DISC_CORNERS);
        corners = (0..DISC_CORNERS).map(|i| y * gap + 0.5 * (x * at(i).cos() + z * at(i).sin())).collect();
        triangles = polygon(&corners);
    }
    if layout == Layout::UnderMany {
        let at = |i: u32| (f64::from(i) + 0.5) / 16.0 - 0.5;
        let squares = (0..256).map(|i| y * gap + x * at(i % 16) + z * at(i / 16));
        triangles = squares.flat_map(|centre| square(centre, x / 32.0, z / 32.0)).collect();
    }
    let (surface, position, half) = match layout {
        // Seen below the lamp, from its edge downwards.
        Layout::Wall => (square(DVec3::ZERO, y, z), x * 0.4 - y * 0.25, 0.25),
        // Seen from between the lamp and the floor.
        _ => (square(DVec3::ZERO, z, x), y * (0.5 * gap), 0.3),
    };
    let eye = Eye { position, towards: -normal, view: View::Orthographic(half) };
    let stage = Stage::new(eye).with(surface, Paint::matte(ALBEDO)).with(triangles, Paint::lamp(1.0));
    (stage, corners, normal)
}

/// All lights scaled in radiance.
pub static RADIANCE: Family = Family {
    name: "radiance",
    title: "a room with all lights scaled; expected: the image scaled by the same factor",
    parameter: "factor on all lights",
    deviation: "mean |difference| / mean of the image over the factor, against factor 1",
    series: &[
        Series { name: "path", values: &FACTORS, bound: proportional, prepare: |gpu| radiance(gpu, Technique::PATH) },
        Series {
            name: "two-pass",
            values: &FACTORS,
            bound: proportional,
            prepare: |gpu| radiance(gpu, Technique::TWO_PASS),
        },
        Series {
            name: "shadow-photons",
            values: &FACTORS,
            bound: proportional,
            prepare: |gpu| radiance(gpu, Technique::SHADOW_PHOTONS),
        },
        Series {
            name: "photon-map",
            values: &FACTORS,
            // If the powers of the lights round differently, one light has one ray more and another one less; both then
            // have other rays.
            bound: |factor| 5.0 * proportional(factor),
            prepare: |gpu| radiance(gpu, Technique::PHOTON_MAP),
        },
    ],
};

const FACTORS: [f64; 14] = [
    1.0 / (1u64 << 40) as f64,
    1e-12,
    1e-9,
    1e-6,
    1.0 / 1024.0,
    1e-3,
    1e-1,
    1e1,
    1e3,
    1024.0,
    1e6,
    1e9,
    1e12,
    (1u64 << 40) as f64,
];

/// Scaling by a power of two is exact. Other factors round differently, which now and then changes a random decision.
fn proportional(factor: f64) -> f64 {
    if factor.log2().fract() == 0.0 { 0.0 } else { 2e-3 }
}

fn radiance(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    let settings = settings(technique, 32, 4, 8);
    let reference = image(gpu, &room(), &settings)?;
    Ok(Box::new(move |factor| {
        let mut stage = room();
        stage.parts.iter_mut().for_each(|part| part.paint.radiance *= factor);
        stage.lights.iter_mut().for_each(|light| light.intensity *= factor);
        let mut image = image(gpu, &stage, &settings)?;
        let over = |x: &mut f32| *x = (f64::from(*x) / factor) as f32;
        image.channels.iter_mut().flat_map(|channel| &mut channel.samples).for_each(over);
        Ok(difference(&image, &reference))
    }))
}

/// A weak and a strong light in the same scene.
pub static RATIO: Family = Family {
    name: "ratio",
    title: "two closed rooms side by side, with a brighter lamp in the other one; expected: the same image of this one",
    parameter: "radiance of the other lamp over that of this one",
    deviation: "relative difference of the means, against ratio 1",
    series: &[
        Series { name: "path", values: &RATIOS, bound: |_| NOISE, prepare: |gpu| ratio(gpu, Technique::PATH) },
        Series { name: "two-pass", values: &RATIOS, bound: |_| NOISE, prepare: |gpu| ratio(gpu, Technique::TWO_PASS) },
        Series {
            name: "shadow-photons",
            values: &RATIOS,
            bound: |_| NOISE,
            prepare: |gpu| ratio(gpu, Technique::SHADOW_PHOTONS),
        },
    ],
};

const RATIOS: [f64; 8] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e6, 1e9, 1e12];

fn ratio(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    let settings = settings(technique, 32, 16, 8);
    let render = move |ratio: f64| {
        let (left, right) = (DVec3::X * -0.6, DVec3::X * 0.6);
        let lamp = |centre: DVec3| square(centre + DVec3::Y * 0.45, DVec3::X * 0.15, DVec3::Z * 0.15);
        let eye = Eye {
            position: left + DVec3::new(0.3, 0.1, 0.45),
            towards: DVec3::new(-0.5, -0.35, -1.0),
            view: View::Perspective(1.1),
        };
        let stage = Stage::new(eye)
            .with([left, right].map(|centre| inside_out(cube(centre, 0.5))).concat(), Paint::matte(0.6))
            .with(cube(left + DVec3::new(-0.15, -0.3, -0.1), 0.15), Paint::matte(0.4))
            .with(lamp(left), Paint::lamp(1.0))
            .with(lamp(right), Paint::lamp(ratio));
        image(gpu, &stage, &settings).map(|image| mean(&image))
    };
    let reference = render(1.0)?;
    Ok(Box::new(move |ratio| Ok(relative(render(ratio)?, reference))))
}

/// One lamp split into many lights.
pub static LIGHTS: Family = Family {
    name: "lights",
    title: "a lamp over a floor, split into many lights of one node each; expected: Lambert's formula for the lamp",
    parameter: "lights",
    deviation: "relative error of the mean",
    series: &[
        Series {
            name: "shadow-photons",
            values: &COUNTS,
            bound: |lights| if lights <= f64::from(Settings::MANY_LIGHTS) { EVEN } else { NOISE },
            prepare: |gpu| lights(gpu, Technique::SHADOW_PHOTONS),
        },
        Series { name: "path", values: &COUNTS, bound: |_| NOISE, prepare: |gpu| lights(gpu, Technique::PATH) },
    ],
};

/// Square numbers.
const COUNTS: [f64; 6] = [1.0, 9.0, 100.0, 1024.0, 10_000.0, 99_856.0];

fn lights(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    let spp = if technique == Technique::PATH { 64 } else { 1 };
    let settings = settings(technique, 16, spp, 0);
    Ok(Box::new(move |count| {
        let eye = Eye { position: DVec3::Y * 0.25, towards: -DVec3::Y, view: View::Orthographic(0.4) };
        let side = count.sqrt();
        let half = 0.25 / side;
        let mut instances = Vec::new();
        for i in 0..side as u32 {
            for j in 0..side as u32 {
                let at = |k: u32| 0.25 * ((2.0 * f64::from(k) + 1.0) / side - 1.0);
                instances.push(DAffine3::from_translation(DVec3::new(at(i), 0.5, at(j))));
            }
        }
        let mut stage = Stage::new(eye).with(square(DVec3::ZERO, DVec3::Z * 0.5, DVec3::X * 0.5), Paint::matte(ALBEDO));
        let triangles = square(DVec3::ZERO, DVec3::X * half, DVec3::Z * half);
        stage.parts.push(Part { triangles, paint: Paint::lamp(1.0), instances });
        let whole = square(DVec3::Y * 0.5, DVec3::X * 0.25, DVec3::Z * 0.25);
        Ok(worst_mean(&image(gpu, &stage, &settings)?, &eye, &outline(&whole), DVec3::Y))
    }))
}
