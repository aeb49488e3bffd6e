//! Stress: small scenes whose image is known, pushed along one parameter over decades until it is not what it should be.
//!
//! A [`Family`] is such a parameter. Each of its [`Series`] (a technique, a way to come to the same scene) renders one
//! point after the other through the library and says how far the image is from an invariant or a closed form. Where
//! that leaves the bound that is stated for it, the method breaks. `docs/stability.md` has the charts, and why the bounds
//! are what they are.

pub mod density;
pub mod lights;
pub mod materials;
pub mod oracle;
pub mod placement;
pub mod stage;

use crate::gpu::Gpu;
use crate::{Error, Image, Renderer, Result, Settings, Statistics, Technique};

pub use stage::Stage;

/// A parameter that is pushed to its extremes.
pub struct Family {
    /// Name on the command line.
    pub name: &'static str,
    /// What is rendered, and what should not change.
    pub title: &'static str,
    /// The parameter, with its unit.
    pub parameter: &'static str,
    /// What the deviation is.
    pub deviation: &'static str,
    /// Ways to render it.
    pub series: &'static [Series],
}

/// One way to render a family.
pub struct Series {
    /// A technique, or what is special about it.
    pub name: &'static str,
    /// Values of the parameter, from what is easy to what is extreme.
    pub values: &'static [f64],
    /// The largest deviation that is right, by the parameter.
    pub bound: fn(f64) -> f64,
    /// Renders what the points are compared with, where that is another image.
    pub prepare: for<'g> fn(&'g Gpu) -> Result<Measure<'g>>,
}

/// The deviation at a value of the parameter.
pub type Measure<'g> = Box<dyn FnMut(f64) -> Result<f64> + 'g>;

/// All families.
pub const FAMILIES: [&Family; 13] = [
    &placement::SCALE,
    &placement::OFFSET,
    &placement::ASPECT,
    &lights::RADIUS,
    &lights::DISTANCE,
    &lights::RADIANCE,
    &lights::RATIO,
    &lights::LIGHTS,
    &materials::ALBEDO,
    &materials::ROUGHNESS,
    &materials::LAYERS,
    &density::PHOTONS,
    &density::SAMPLES,
];

/// What came of one value.
#[derive(Debug)]
pub struct Reading {
    /// Of the parameter.
    pub value: f64,
    /// What is right at most.
    pub bound: f64,
    /// The deviation; or the error that the render ended with, which is loud.
    pub outcome: Result<f64>,
}

impl Reading {
    /// The image is what it should be.
    pub fn holds(&self) -> bool {
        self.outcome.as_ref().is_ok_and(|deviation| *deviation <= self.bound)
    }
}

impl Family {
    /// The family of that name.
    ///
    /// # Errors
    /// [`Error::Usage`] with the names that there are.
    pub fn named(name: &str) -> Result<&'static Family> {
        FAMILIES.into_iter().find(|family| family.name == name).ok_or_else(|| {
            let names: Vec<&str> = FAMILIES.iter().map(|family| family.name).collect();
            Error::Usage(format!("no family is called '{name}'; there is: {}", names.join(", ")))
        })
    }

    /// The least and the greatest value of the parameter, over all series.
    pub fn range(&self) -> [f64; 2] {
        let values = || self.series.iter().flat_map(|series| series.values).copied();
        [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)]
    }

    /// The series of that name.
    pub fn series(&self, name: &str) -> Option<&Series> {
        self.series.iter().find(|series| series.name == name)
    }
}

impl Series {
    /// Renders the given values; `after` is told of each.
    ///
    /// # Errors
    /// Those of the image that is compared with, and a lost device. What ends the render of a point is in its reading.
    pub fn run(&self, gpu: &Gpu, values: &[f64], mut after: impl FnMut(&Reading)) -> Result<Vec<Reading>> {
        let mut measure = (self.prepare)(gpu)?;
        let mut readings = Vec::new();
        for &value in values {
            let outcome = match measure(value) {
                Err(lost @ Error::DeviceLost { .. }) => return Err(lost),
                outcome => outcome,
            };
            let reading = Reading { value, bound: (self.bound)(value), outcome };
            after(&reading);
            readings.push(reading);
        }
        Ok(readings)
    }
}

/// The first value whose image is not what it should be.
pub fn breakdown(readings: &[Reading]) -> Option<f64> {
    readings.iter().find(|reading| !reading.holds()).map(|reading| reading.value)
}

/// Settings of a small square image: few photons, as the scenes are small too.
pub fn settings(technique: Technique, side: u32, spp: u32, max_bounces: u32) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = side;
        s.image.height = side;
        s.image.spp = spp;
        s.indirect.max_bounces = max_bounces;
        s.visibility_map.photons_per_light = 1 << 14;
        s.indirect.photons = 1 << 14;
        s.indirect.irradiance_cache.gather_rays = 64;
    })
}

/// Renders a stage by way of its glTF file.
///
/// # Errors
/// As [`Stage::import`] and [`Renderer`].
pub fn render(gpu: &Gpu, stage: &Stage, settings: &Settings) -> Result<(Image, Statistics)> {
    let (scene, camera) = stage.import()?;
    let mut renderer = Renderer::new(gpu, scene, &camera, settings)?;
    while renderer.samples() < settings.image.spp {
        renderer.render_batch()?;
    }
    Ok((renderer.image()?, renderer.statistics()?))
}

/// As [`render`], of the image alone.
fn image(gpu: &Gpu, stage: &Stage, settings: &Settings) -> Result<Image> {
    Ok(render(gpu, stage, settings)?.0)
}
