//! The keywords of `Scene.render` that are settings of the library, and what the library calls them.

use std::fmt::Display;
use std::str::FromStr;

use penumbra::Settings;
use penumbra::settings::{Background, Crop, SampleRange};
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::error;

/// A keyword.
struct Keyword {
    name: &'static str,
    /// The path of the field, as messages of the library have it.
    setting: &'static str,
    set: fn(&mut Settings, &Bound<'_, PyAny>) -> PyResult<()>,
}

macro_rules! keywords {
    ($($name:literal => $($field:ident).+ $(, $read:expr)?;)*) => {
        &[$(Keyword {
            name: $name,
            setting: stringify!($($field).+),
            set: |settings, value| {
                settings.$($field).+ = keywords!(@read value $($read)?)?;
                Ok(())
            },
        }),*]
    };
    (@read $value:ident) => { $value.extract() };
    (@read $value:ident $read:expr) => { $read($value) };
}

const KEYWORDS: &[Keyword] = keywords! {
    "technique" => technique, named;
    "width" => image.width;
    "height" => image.height;
    "crop" => image.crop, crop;
    "spp" => image.spp;
    "sampling" => image.sampling, named;
    "samples" => image.piece, samples;
    "seed" => image.seed;
    "aovs" => image.aovs, aovs;
    "denoise" => image.denoise, named;
    "noise" => image.noise;
    "background" => image.background, background;
    "photons" => visibility_map.photons_per_light;
    "nearest" => visibility_map.nearest;
    "shadow_photons_per_ray" => visibility_map.shadow_photons_per_ray;
    "dilate" => visibility_map.dilate;
    "audit" => visibility_map.audit;
    "paper_counting" => visibility_map.paper_counting;
    "fine_cells" => visibility_map.fine_cells;
    "shadow_samples" => shadow_rays.samples;
    "light_sampling" => light_sampling.strategy, |value| named(value).map(Some);
    "sampled_lights" => light_sampling.sampled_lights;
    "max_bounces" => indirect.max_bounces;
    "flux_photons" => indirect.photons;
    "clamp" => indirect.clamp;
    "cache" => indirect.irradiance_cache.enabled;
    "accuracy" => indirect.irradiance_cache.accuracy;
    "gather_rays" => indirect.irradiance_cache.gather_rays;
    "cells" => cells.resolution;
    "cell_rays" => cells.rays_per_light;
    "light_buffer_cells" => light_buffer.resolution;
    "shadow_tolerance" => ward.tolerance;
    "light_scale" => light_scale;
};

/// Other names in the library's messages, and their keywords.
const OTHERS: &[(&str, &str)] = &[("time", "at")];

/// A text of the library with keywords in place of the names of settings.
pub fn with_keywords(text: &str) -> String {
    let settings = KEYWORDS.iter().map(|keyword| (keyword.setting, keyword.name));
    let replace = |text: String, (setting, name): (&str, &str)| text.replace(&format!("`{setting}`"), name);
    let text = settings.chain(OTHERS.iter().copied()).fold(text.to_owned(), replace);
    // The library's other names are keywords themselves.
    text.replace('`', "")
}

/// Takes the settings out of the keywords of a call.
pub fn take_settings(keywords: &Bound<'_, PyDict>) -> PyResult<Settings> {
    let mut settings = Settings::default();
    for keyword in KEYWORDS {
        if let Some(value) = take(keywords, keyword.name)? {
            (keyword.set)(&mut settings, &value).map_err(|problem| about(&value, keyword.name, problem))?;
        }
    }
    Ok(settings)
}

/// Takes a keyword; `None` if it is missing, or Python's None.
pub fn take<'py>(keywords: &Bound<'py, PyDict>, name: &str) -> PyResult<Option<Bound<'py, PyAny>>> {
    let Some(value) = keywords.get_item(name)? else { return Ok(None) };
    keywords.del_item(name)?;
    Ok(Some(value).filter(|value| !value.is_none()))
}

/// As [`take`], as a value of a type.
pub fn take_as<'py, T: FromPyObjectOwned<'py>>(keywords: &Bound<'py, PyDict>, name: &str) -> PyResult<Option<T>> {
    let Some(value) = take(keywords, name)? else { return Ok(None) };
    value.extract::<T>().map(Some).map_err(|problem| about(&value, name, problem.into()))
}

/// Refuses what nobody has taken.
pub fn check_empty(keywords: &Bound<'_, PyDict>, function: &str) -> PyResult<()> {
    match keywords.keys().iter().next() {
        Some(name) => Err(PyTypeError::new_err(format!("{function}() has no keyword argument '{name}'"))),
        None => Ok(()),
    }
}

/// The error of a value that is not of a keyword's type, or out of the type's range.
fn about(value: &Bound<'_, PyAny>, name: &str, problem: PyErr) -> PyErr {
    let py = value.py();
    if problem.is_instance_of::<PyOverflowError>(py) {
        return error(&format!("{name} is {value}, which is out of range"));
    }
    if problem.is_instance_of::<PyTypeError>(py) {
        return PyTypeError::new_err(format!("{name}: {}", problem.value(py)));
    }
    // Such as a tuple of another length.
    if problem.is_instance_of::<PyValueError>(py) {
        return error(&format!("{name} is {value}: {}", problem.value(py)));
    }
    problem
}

/// A value by its name.
fn named<T: FromStr<Err: Display>>(value: &Bound<'_, PyAny>) -> PyResult<T> {
    let name: String = value.extract()?;
    name.parse().map_err(|problem: T::Err| error(&problem.to_string()))
}

fn crop(value: &Bound<'_, PyAny>) -> PyResult<Option<Crop>> {
    let [x, y, width, height] = value.extract()?;
    Ok(Some(Crop { x, y, width, height }))
}

/// The first sample, and the one after the last.
fn samples(value: &Bound<'_, PyAny>) -> PyResult<Option<SampleRange>> {
    let [first, end] = value.extract()?;
    Ok(Some(SampleRange { first, end }))
}

/// A list of names, or "all".
fn aovs(value: &Bound<'_, PyAny>) -> PyResult<Vec<penumbra::Aov>> {
    if value.extract::<&str>().is_ok_and(|name| name == "all") {
        return Ok(penumbra::Aov::ALL.into());
    }
    // A text is a sequence of letters.
    if value.extract::<&str>().is_ok() {
        return Ok(vec![named(value)?]);
    }
    let mut aovs = value.try_iter()?.map(|name| named(&name?)).collect::<PyResult<Vec<_>>>()?;
    // The program sorts them, too: the order of channels is the same.
    aovs.sort();
    aovs.dedup();
    Ok(aovs)
}

fn background(value: &Bound<'_, PyAny>) -> PyResult<Background> {
    match value.extract::<&str>() {
        Ok("environment") => Ok(Background::Environment),
        Ok("transparent") => Ok(Background::Transparent),
        Ok(name) => {
            Err(error(&format!("background is '{name}'; it must be 'environment', 'transparent' or three numbers")))
        }
        Err(_) => Ok(Background::Colour(value.extract()?)),
    }
}
