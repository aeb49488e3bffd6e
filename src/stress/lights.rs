//! Lights: how large, how near, how bright, how many.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DVec3};

use crate::gpu::Gpu;
use crate::{Result, Settings, Technique};

use super::oracle::{difference, green, mean, polygon_irradiance, reflected, relative};
use super::placement::{CLOSED, room};
use super::stage::{Corners, Eye, Paint, Part, Stage, View, cube, inside_out, outline, polygon, square};
use super::{Family, Measure, Series, image, settings};

/// What all floors here reflect.
const ALBEDO: f64 = 0.5;

/// Means of images that sample their light: some thousand light points leave a few tenths of a percent.
const NOISE: f64 = 2e-2;

/// Means of images whose light points bring about the same light each: some ten thousand of them leave less than a thousandth
/// of it; twice that with the rays of paths among them.
const EVEN: f64 = 2e-3;

/// The largest relative error of a pixel, of a view straight at a plane through the origin of that normal that a polygon of unit
/// radiance lights.
fn worst_pixel(image: &crate::Image, eye: &Eye, lamp: &[DVec3], normal: DVec3) -> f64 {
    let side = image.width;
    let expected = |pixel: u32| {
        let (origin, direction) = eye.ray([pixel % side, pixel / side], side);
        let position = origin - direction * (origin.dot(normal) / direction.dot(normal));
        reflected(ALBEDO, polygon_irradiance(lamp, position, normal))
    };
    (0..).zip(green(image)).map(|(pixel, radiance)| relative(radiance, expected(pixel))).fold(0.0, f64::max)
}

/// The relative error of the mean, of the same view.
pub(super) fn worst_mean(image: &crate::Image, eye: &Eye, lamp: &[DVec3], normal: DVec3) -> f64 {
    // The samples fall anywhere in their pixels: the mean over many points is the integral that they estimate.
    const POINTS: u32 = 64;
    let radiance = |at: u32| {
        let (origin, direction) = eye.ray([at % POINTS, at / POINTS], POINTS);
        let position = origin - direction * (origin.dot(normal) / direction.dot(normal));
        reflected(ALBEDO, polygon_irradiance(lamp, position, normal))
    };
    let expected = (0..POINTS * POINTS).map(radiance).sum::<f64>() / f64::from(POINTS * POINTS);
    relative(mean(image), expected)
}

/// A lamp from a point to a sky.
pub static RADIUS: Family = Family {
    name: "light-radius",
    title: "a square lamp of the same power over a floor, from a point to a sky: Lambert's formula",
    parameter: "half the lamp's side over that of the floor",
    deviation: "largest relative error of a pixel; of techniques that sample the lamp, error of the mean",
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
            // There a coordinate of the scene's size is rounded, by 2^-25 at most on either side.
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
        // In units of the lamp's radiance.
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
    title: "a lamp of size 1 nearly touches a floor twice as wide: Lambert's formula",
    parameter: "distance over the lamp's size",
    deviation: "largest relative error of a pixel; of techniques that sample the lamp, error of the mean",
    series: &[
        Series {
            name: "under a square",
            values: &GAPS,
            bound: |_| NEAR,
            prepare: |gpu| distance(gpu, Technique::SHADOW_PHOTONS, Place::Under),
        },
        Series {
            name: "under a disc",
            values: &GAPS,
            bound: |_| NEAR,
            prepare: |gpu| distance(gpu, Technique::SHADOW_PHOTONS, Place::UnderDisc),
        },
        Series {
            name: "on a wall beside it",
            values: &GAPS,
            bound: |_| NEAR,
            prepare: |gpu| distance(gpu, Technique::SHADOW_PHOTONS, Place::Wall),
        },
        Series {
            name: "path, under a square",
            values: &GAPS,
            bound: |_| EVEN,
            prepare: |gpu| distance(gpu, Technique::PATH, Place::Under),
        },
        Series {
            name: "two-pass, under a square",
            values: &GAPS,
            bound: |_| EVEN,
            prepare: |gpu| distance(gpu, Technique::TWO_PASS, Place::Under),
        },
        Series {
            name: "two-pass, under a square of 512 triangles",
            values: &GAPS,
            // Its triangles are chosen by their power, and a point gets half its light from the part of the lamp that is as
            // wide as it is away, one of that many equal ones: three standard errors of their number.
            bound: |gap| 3.0 * ((1.0 / (PI * gap * gap)).min(512.0) / (16 * 16 * MANY_SAMPLES) as f64).sqrt(),
            prepare: |gpu| distance(gpu, Technique::TWO_PASS, Place::UnderMany),
        },
    ],
};

const GAPS: [f64; 15] = [1.0, 0.3, 1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7];

/// What is asked of closed forms near a light.
const NEAR: f64 = 1e-4;

/// Where the surface is that a near lamp lights.
#[derive(Clone, Copy, PartialEq)]
enum Place {
    Under,
    UnderDisc,
    UnderMany,
    Wall,
}

/// Samples of a pixel under a lamp of many triangles.
const MANY_SAMPLES: u32 = 1024;

/// Corners of the disc: as many as a light of a closed form may have.
const DISC_CORNERS: u32 = 64;

fn distance(gpu: &Gpu, technique: Technique, place: Place) -> Result<Measure<'_>> {
    let exact = technique == Technique::SHADOW_PHOTONS;
    let samples = if place == Place::UnderMany { MANY_SAMPLES } else { 64 };
    let settings = settings(technique, 16, if exact { 1 } else { samples }, 0);
    Ok(Box::new(move |gap| {
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
        let (lamp, normal): (Vec<Corners>, DVec3) = match place {
            Place::Wall => (square(x * (gap + 0.5), x * 0.5, z * 0.5), x),
            _ => (square(y * gap, x * 0.5, z * 0.5), y),
        };
        let mut corners = outline(&lamp).to_vec();
        let mut triangles = lamp;
        if place == Place::UnderDisc {
            let at = |i: u32| TAU * f64::from(i) / f64::from(DISC_CORNERS);
            corners = (0..DISC_CORNERS).map(|i| y * gap + 0.5 * (x * at(i).cos() + z * at(i).sin())).collect();
            triangles = polygon(&corners);
        }
        if place == Place::UnderMany {
            let at = |i: u32| (f64::from(i) + 0.5) / 16.0 - 0.5;
            let squares = (0..256).map(|i| y * gap + x * at(i % 16) + z * at(i / 16));
            triangles = squares.flat_map(|centre| square(centre, x / 32.0, z / 32.0)).collect();
        }
        let (surface, eye) = match place {
            // Below the lamp, from its edge on.
            Place::Wall => (
                square(DVec3::ZERO, y, z),
                Eye { position: x * 0.4 - y * 0.25, towards: -x, view: View::Orthographic(0.25) },
            ),
            // Between the two.
            _ => (
                square(DVec3::ZERO, z, x),
                Eye { position: y * (0.5 * gap), towards: -y, view: View::Orthographic(0.3) },
            ),
        };
        let stage = Stage::new(eye).with(surface, Paint::matte(ALBEDO)).with(triangles, Paint::lamp(1.0));
        let error = if exact { worst_pixel } else { worst_mean };
        Ok(error(&image(gpu, &stage, &settings)?, &eye, &corners, normal))
    }))
}

/// Lights of any strength.
pub static RADIANCE: Family = Family {
    name: "radiance",
    title: "a room with brighter or weaker lights: the image is as many times brighter",
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
            // Where the lights' powers round otherwise one has a ray more and another one less, and both other rays.
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

/// Powers of two change no digit; others round otherwise, and now and then a decision of the noise turns.
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

/// A weak and a strong light in one scene.
pub static RATIO: Family = Family {
    name: "ratio",
    title: "two closed rooms side by side, the lamp of the other one brighter: the image of this one stays",
    parameter: "radiance of the other lamp over this one's",
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
        Ok(mean(&image(gpu, &stage, &settings)?))
    };
    let reference = render(1.0)?;
    Ok(Box::new(move |ratio| Ok(relative(render(ratio)?, reference))))
}

/// One lamp cut into many.
pub static LIGHTS: Family = Family {
    name: "lights",
    title: "a lamp over a floor cut into a number of lights, each a node: Lambert's formula for the whole",
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

/// Squares of whole numbers.
const COUNTS: [f64; 6] = [1.0, 9.0, 100.0, 1024.0, 10_000.0, 99_856.0];

fn lights(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    let spp = if technique == Technique::PATH { 64 } else { 1 };
    let settings = settings(technique, 16, spp, 0);
    Ok(Box::new(move |count| {
        let eye = Eye { position: DVec3::Y * 0.25, towards: -DVec3::Y, view: View::Orthographic(0.4) };
        let side = count.sqrt();
        let half = 0.25 / side;
        let mut places = Vec::new();
        for i in 0..side as u32 {
            for j in 0..side as u32 {
                let at = |k: u32| 0.25 * ((2.0 * f64::from(k) + 1.0) / side - 1.0);
                places.push(DAffine3::from_translation(DVec3::new(at(i), 0.5, at(j))));
            }
        }
        let mut stage = Stage::new(eye).with(square(DVec3::ZERO, DVec3::Z * 0.5, DVec3::X * 0.5), Paint::matte(ALBEDO));
        let triangles = square(DVec3::ZERO, DVec3::X * half, DVec3::Z * half);
        stage.parts.push(Part { triangles, paint: Paint::lamp(1.0), places });
        let whole = square(DVec3::Y * 0.5, DVec3::X * 0.25, DVec3::Z * 0.25);
        Ok(worst_mean(&image(gpu, &stage, &settings)?, &eye, &outline(&whole), DVec3::Y))
    }))
}
