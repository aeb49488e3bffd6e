//! Stress families: number of photons and number of samples.

use glam::DVec3;
use kernel_kit::Gpu;

use super::family::{Family, Measure, Series, image, settings};
use super::lights::worst_mean;
use super::oracle::{green, polygon_irradiance, reflected, relative};
use super::placement::CLOSED;
use super::stage::{Eye, Paint, Stage, View, outline, square};
use crate::{Result, Technique};

/// All photons concentrated on one spot.
pub static PHOTONS: Family = Family {
    name: "photons",
    title: "all photons fall on a spot of a thousandth of the floor, in one or two cells; expected: Lambert's formula",
    parameter: "photons emitted",
    deviation: "relative error of the mean",
    series: &[
        Series {
            name: "shadow-photons",
            values: &EMITTED,
            bound: |_| SPOT,
            prepare: |gpu| photons(gpu, Technique::SHADOW_PHOTONS),
        },
        Series {
            name: "visibility-estimate",
            values: &EMITTED,
            bound: |_| SPOT,
            prepare: |gpu| photons(gpu, Technique::VISIBILITY_ESTIMATE),
        },
    ],
};

/// A map is traced with at most 2^22 rays.
const EMITTED: [f64; 9] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 4e6, 1e7];

/// The noise of four light points per pixel, where there are too few photons to classify points.
const SPOT: f64 = 2e-2;

fn photons(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    Ok(Box::new(move |photons| {
        let lamp = square(DVec3::Y * 1e-3, DVec3::X * 5e-4, DVec3::Z * 5e-4);
        let eye = Eye { position: DVec3::Y * 5e-4, towards: -DVec3::Y, view: View::Orthographic(5e-4) };
        let stage = Stage::new(eye)
            .with(square(DVec3::ZERO, DVec3::Z, DVec3::X), Paint::matte(0.5))
            .with(lamp.clone(), Paint::lamp(1.0));
        let settings =
            settings(technique, 16, 16, 0).with(|s| s.visibility_map.photons_per_light = Some(photons as u32));
        Ok(worst_mean(&image(gpu, &stage, &settings)?, &eye, &outline(&lamp), DVec3::Y))
    }))
}

/// Many samples per pixel.
pub static SAMPLES: Family = Family {
    name: "samples",
    title: "all samples of a pixel are equal; expected: their mean is the same value",
    parameter: "samples per pixel",
    deviation: "largest relative error of a pixel, against Lambert's formula in f64",
    series: &[Series {
        name: "shadow-photons",
        values: &[1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6],
        bound: |_| CLOSED,
        prepare: |gpu| samples(gpu),
    }],
};

fn samples(gpu: &Gpu) -> Result<Measure<'_>> {
    let lamp = square(DVec3::Y * 0.5, DVec3::X * 0.25, DVec3::Z * 0.25);
    let expected = reflected(0.5, polygon_irradiance(&outline(&lamp), DVec3::ZERO, DVec3::Y));
    // The view is so small that the irradiance is that of its centre.
    let eye = Eye { position: DVec3::Y * 0.25, towards: -DVec3::Y, view: View::Orthographic(1e-5) };
    let stage =
        Stage::new(eye).with(square(DVec3::ZERO, DVec3::Z, DVec3::X), Paint::matte(0.5)).with(lamp, Paint::lamp(1.0));
    Ok(Box::new(move |spp| {
        let image = image(gpu, &stage, &settings(Technique::SHADOW_PHOTONS, 4, spp as u32, 0))?;
        Ok(green(&image).map(|radiance| relative(radiance, expected)).fold(0.0, f64::max))
    }))
}
