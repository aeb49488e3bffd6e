//! Numbers of photons and of samples.

use glam::DVec3;

use crate::gpu::Gpu;
use crate::{Result, Technique};

use super::lights::worst_mean;
use super::oracle::{green, polygon_irradiance, reflected, relative};
use super::placement::CLOSED;
use super::stage::{Eye, Paint, Stage, View, outline, square};
use super::{Family, Measure, Series, image, settings};

/// Photons that all fall on one spot.
pub static PHOTONS: Family = Family {
    name: "photons",
    title: "all photons fall on a spot of a thousandth of the floor, in one cell or two: Lambert's formula",
    parameter: "photons emitted",
    deviation: "relative error of the mean",
    series: &[
        Series {
            name: "shadow-photons",
            values: &EMITTED,
            bound: |_| SPOT,
            prepare: |gpu| photons(gpu, Technique::ShadowPhotons),
        },
        Series {
            name: "visibility-estimate",
            values: &EMITTED,
            bound: |_| SPOT,
            prepare: |gpu| photons(gpu, Technique::VisibilityEstimate),
        },
    ],
};

/// A map is traced with 2^22 rays at most.
const EMITTED: [f64; 9] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 4e6, 1e7];

/// Noise of four light points a pixel, where photons are too few to tell.
const SPOT: f64 = 2e-2;

fn photons(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    Ok(Box::new(move |photons| {
        let lamp = square(DVec3::Y * 1e-3, DVec3::X * 5e-4, DVec3::Z * 5e-4);
        let eye = Eye { position: DVec3::Y * 5e-4, towards: -DVec3::Y, view: View::Orthographic(5e-4) };
        let stage = Stage::new(eye)
            .with(square(DVec3::ZERO, DVec3::Z, DVec3::X), Paint::matte(0.5))
            .with(lamp.clone(), Paint::lamp(1.0));
        let settings = settings(technique, 16, 16, 0).with(|s| s.visibility_map.photons_per_light = photons as u32);
        Ok(worst_mean(&image(gpu, &stage, &settings)?, &eye, &outline(&lamp), DVec3::Y))
    }))
}

/// Samples of a pixel.
pub static SAMPLES: Family = Family {
    name: "samples",
    title: "samples that are all alike: their mean is one of them",
    parameter: "samples a pixel",
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
    // So small a view has the irradiance of its middle.
    let eye = Eye { position: DVec3::Y * 0.25, towards: -DVec3::Y, view: View::Orthographic(1e-5) };
    let stage =
        Stage::new(eye).with(square(DVec3::ZERO, DVec3::Z, DVec3::X), Paint::matte(0.5)).with(lamp, Paint::lamp(1.0));
    Ok(Box::new(move |spp| {
        let image = image(gpu, &stage, &settings(Technique::ShadowPhotons, 4, spp as u32, 0))?;
        Ok(green(&image).map(|radiance| relative(radiance, expected)).fold(0.0, f64::max))
    }))
}
