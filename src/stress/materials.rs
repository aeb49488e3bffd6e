//! Stress families: albedo, roughness and layers of translucent panes.

use std::f64::consts::FRAC_PI_4;

use glam::DVec3;
use kernel_kit::Gpu;

use super::family::{Family, Measure, Series, image, settings};
use super::oracle::{ggx_albedo, green, mean, polygon_irradiance, reflected, relative};
use super::stage::{Eye, Paint, Stage, View, cube, inside_out, outline, square};
use crate::{Result, Technique};

/// A white furnace of increasing albedo.
pub static ALBEDO: Family = Family {
    name: "albedo",
    title: "all surfaces emit the share that they do not reflect; expected: radiance 1 everywhere",
    parameter: "1 - albedo",
    deviation: "relative error of the mean",
    series: &[
        Series {
            name: "path, objects under a bright sky",
            values: &ABSORBED,
            bound: |_| FURNACE,
            prepare: |gpu| open(gpu, Technique::PATH),
        },
        Series {
            name: "shadow-photons, objects under a bright sky",
            values: &ABSORBED,
            bound: |_| SHARED_FURNACE,
            prepare: |gpu| open(gpu, Technique::SHADOW_PHOTONS),
        },
        Series {
            name: "path, closed room",
            values: &ABSORBED,
            bound: |_| CLOSED_FURNACE,
            prepare: |gpu| closed(gpu, Technique::PATH),
        },
        Series {
            name: "shadow-photons, closed room",
            values: &ABSORBED,
            bound: |_| CLOSED_FURNACE,
            prepare: |gpu| closed(gpu, Technique::SHADOW_PHOTONS),
        },
    ],
};

const ABSORBED: [f64; 8] = [0.5, 0.2, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6];

/// Bound of the open furnace by `path`, whose error is smaller at any albedo (docs/stability.md).
const FURNACE: f64 = 1e-3;

/// Twice the noise of the indirect light, which all points share and which comes from some ten thousand photons in
/// view.
const SHARED_FURNACE: f64 = 2e-2;

/// In a closed room, light and noise accumulate over 1 / (1 - albedo) bounces.
const CLOSED_FURNACE: f64 = 5e-2;

fn open(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    // Enough samples for noise below the bound: a path samples one light of two, while all points share the photons.
    let spp = if technique == Technique::PATH { 1024 } else { 256 };
    let settings = settings(technique, 24, spp, 1000);
    Ok(Box::new(move |absorbed| {
        let eye = Eye {
            position: DVec3::new(0.7, 0.9, 1.5),
            towards: DVec3::new(-0.7, -1.0, -1.5),
            view: View::Perspective(0.3),
        };
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| axis * 0.3);
        // A cube in a corner of three walls.
        let corner = [square(x + z, z, x), square(x + y, x, y), square(y + z, y, z)].concat();
        let objects = [corner, cube(DVec3::splat(0.15), 0.1)].concat();
        let paint = Paint { radiance: absorbed, double_sided: true, ..Paint::matte(1.0 - absorbed) };
        let stage = Stage::new(eye).with(objects, paint).with(inside_out(cube(DVec3::ZERO, 2.0)), Paint::lamp(1.0));
        Ok(relative(mean(&image(gpu, &stage, &settings)?), 1.0))
    }))
}

fn closed(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    Ok(Box::new(move |absorbed| {
        let eye = Eye {
            position: DVec3::new(0.1, -0.2, 0.3),
            towards: DVec3::new(0.3, 0.5, -1.0),
            view: View::Perspective(1.5),
        };
        // After this many bounces a thousandth of the light remains.
        let bounces = (7.0 / absorbed).ceil() as u32;
        let paint = Paint { radiance: absorbed, ..Paint::matte(1.0 - absorbed) };
        let stage = Stage::new(eye).with(inside_out(cube(DVec3::ZERO, 0.5)), paint);
        // Each photon is stored 1 / (1 - albedo) times, which limits their number by the device's memory.
        let settings = settings(technique, 16, 32, bounces).with(|s| s.indirect.photons = Some(1 << 12));
        Ok(relative(mean(&image(gpu, &stage, &settings)?), 1.0))
    }))
}

/// A metal of decreasing roughness, up to a mirror.
pub static ROUGHNESS: Family = Family {
    name: "roughness",
    title: "a metal under uniform light of radiance 1; expected: the albedo of its microfacets",
    parameter: "roughness",
    deviation: "relative error of the mean, against the integral in f64",
    series: &[
        Series {
            name: "path",
            values: &ROUGHNESSES,
            bound: |_| MIRROR,
            prepare: |gpu| roughness(gpu, Technique::PATH),
        },
        Series {
            name: "shadow-photons",
            values: &ROUGHNESSES,
            bound: |_| MIRROR,
            prepare: |gpu| roughness(gpu, Technique::SHADOW_PHOTONS),
        },
    ],
};

const ROUGHNESSES: [f64; 9] = [1.0, 0.5, 0.2, 0.1, 3e-2, 1e-2, 1e-3, 1e-4, 1e-5];

/// The noise of some thousand samples with weights between 0 and 1.
const MIRROR: f64 = 5e-3;

fn roughness(gpu: &Gpu, technique: Technique) -> Result<Measure<'_>> {
    let settings = settings(technique, 16, 64, 4);
    Ok(Box::new(move |roughness| {
        let eye = Eye {
            position: DVec3::new(0.0, 0.5, 0.5),
            towards: DVec3::new(0.0, -1.0, -1.0),
            view: View::Orthographic(0.2),
        };
        let metal = Paint { metallic: 1.0, roughness, ..Paint::matte(1.0) };
        let stage = Stage::new(eye)
            .with(square(DVec3::ZERO, DVec3::Z * 0.5, DVec3::X * 0.5), metal)
            .with(inside_out(cube(DVec3::ZERO, 2.0)), Paint::lamp(1.0));
        let expected = ggx_albedo(roughness * roughness, FRAC_PI_4.cos());
        Ok(relative(mean(&image(gpu, &stage, &settings)?), expected))
    }))
}

/// A stack of translucent panes.
pub static LAYERS: Family = Family {
    name: "layers",
    title: "black panes that together transmit half of the light; expected: half of the light",
    parameter: "panes",
    deviation: "relative error of the mean",
    series: &[
        Series { name: "seen through", values: &PANES, bound: |_| HALF, prepare: |gpu| layers(gpu, None) },
        Series {
            name: "lit through, two-pass",
            values: &PANES,
            bound: |_| HALF,
            prepare: |gpu| layers(gpu, Some(Technique::TWO_PASS)),
        },
        Series {
            name: "lit through, shadow-photons",
            values: &PANES,
            bound: |_| HALF,
            prepare: |gpu| layers(gpu, Some(Technique::SHADOW_PHOTONS)),
        },
        Series {
            name: "lit through, path",
            values: &PANES,
            bound: |_| HALF,
            prepare: |gpu| layers(gpu, Some(Technique::PATH)),
        },
    ],
};

const PANES: [f64; 9] = [1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4];

/// Three standard errors of some ten thousand rays, each of which is stopped or not: 1 % each.
const HALF: f64 = 3e-2;

fn layers(gpu: &Gpu, lit_by: Option<Technique>) -> Result<Measure<'_>> {
    let settings = settings(lit_by.unwrap_or(Technique::PATH), 16, 64, 0);
    Ok(Box::new(move |panes| {
        let alpha = 1.0 - 0.5f64.powf(1.0 / panes);
        let pane = |i: u32| {
            let height = 0.2 + 0.2 * (f64::from(i) + 0.5) / panes;
            square(DVec3::Y * height, DVec3::Z * 0.5, DVec3::X * 0.5)
        };
        let glass = Paint { alpha, double_sided: true, ..Paint::matte(0.0) };
        let lamp = square(DVec3::Y * 0.6, DVec3::X * 0.1, DVec3::Z * 0.1);
        let (position, towards, half) = match lit_by {
            // Upwards at the lamp through the panes, or downwards at the floor below them.
            None => (DVec3::ZERO, DVec3::Y, 0.05),
            Some(_) => (DVec3::Y * 0.1, -DVec3::Y, 1e-3),
        };
        let eye = Eye { position, towards, view: View::Orthographic(half) };
        let stage = Stage::new(eye)
            .with((0..panes as u32).flat_map(pane).collect(), glass)
            .with(square(DVec3::ZERO, DVec3::Z * 0.3, DVec3::X * 0.3), Paint::matte(0.5))
            .with(lamp.clone(), Paint::lamp(1.0));
        let whole = match lit_by {
            None => 1.0,
            Some(_) => reflected(0.5, polygon_irradiance(&outline(&lamp), DVec3::ZERO, DVec3::Y)),
        };
        let image = image(gpu, &stage, &settings)?;
        let finite = green(&image).all(f64::is_finite);
        Ok(if finite { relative(mean(&image), 0.5 * whole) } else { f64::INFINITY })
    }))
}
