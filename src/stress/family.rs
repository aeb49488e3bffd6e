//! Stress families: a parameter pushed to its extremes, and the deviation of the image at each value.

use kernel_kit::Gpu;

use super::stage::Stage;
use crate::{Error, Image, Renderer, Result, Settings, Statistics, Technique};

/// A parameter that is varied to its extremes.
pub struct Family {
    /// Name on the command line.
    pub name: &'static str,
    /// The scene, and the expected image.
    pub title: &'static str,
    /// The parameter, with its unit.
    pub parameter: &'static str,
    /// The definition of the deviation.
    pub deviation: &'static str,
    /// Techniques or variants of the scene that are rendered.
    pub series: &'static [Series],
}

/// A technique or a variant of the scene in a family.
pub struct Series {
    /// The technique, the variant, or both.
    pub name: &'static str,
    /// Values of the parameter, from easy to extreme.
    pub values: &'static [f64],
    /// The maximum deviation of a correct image, as a function of the parameter.
    pub bound: fn(f64) -> f64,
    /// Renders the image to compare with, if there is one, and returns the function that measures a value.
    pub prepare: for<'g> fn(&'g Gpu) -> Result<Measure<'g>>,
}

/// Renders the scene at a value of the parameter and returns the deviation.
pub type Measure<'g> = Box<dyn FnMut(f64) -> Result<f64> + 'g>;

/// The result at one value of the parameter.
#[derive(Debug)]
pub struct Reading {
    /// The value of the parameter.
    pub value: f64,
    /// The maximum deviation of a correct image.
    pub bound: f64,
    /// The deviation, or the error of the render.
    pub outcome: Result<f64>,
}

impl Reading {
    /// Whether the deviation is within its bound.
    pub fn holds(&self) -> bool {
        self.outcome.as_ref().is_ok_and(|deviation| *deviation <= self.bound)
    }
}

impl Family {
    /// The minimum and maximum value of the parameter over all series.
    pub fn range(&self) -> [f64; 2] {
        let values = || self.series.iter().flat_map(|series| series.values).copied();
        [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)]
    }

    /// Finds a series by name.
    pub fn series(&self, name: &str) -> Option<&Series> {
        self.series.iter().find(|series| series.name == name)
    }
}

impl Series {
    /// Measures the given values and calls `after` with each reading.
    ///
    /// # Errors
    /// Those of the image to compare with, and a lost device. Other errors of a render are in its reading.
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

/// The first value whose deviation exceeds its bound or whose render failed.
pub fn breakdown(readings: &[Reading]) -> Option<f64> {
    readings.iter().find(|reading| !reading.holds()).map(|reading| reading.value)
}

/// Settings for a small square image, with few photons because the scenes are small.
pub fn settings(technique: Technique, side: u32, spp: u32, max_bounces: u32) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = side;
        s.image.height = side;
        s.image.spp = spp;
        s.indirect.max_bounces = max_bounces;
        s.visibility_map.photons_per_light = Some(1 << 14);
        s.indirect.photons = Some(1 << 14);
        s.indirect.irradiance_cache.gather_rays = Some(64);
    })
}

/// Renders a stage, imported through its glTF file.
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

/// As [`render`], but returns the image only.
pub(super) fn image(gpu: &Gpu, stage: &Stage, settings: &Settings) -> Result<Image> {
    Ok(render(gpu, stage, settings)?.0)
}
