//! The list of all stress families.

use super::family::Family;
use super::{density, lights, materials, placement};
use crate::{Error, Result};

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

impl Family {
    /// Finds a family by name.
    ///
    /// # Errors
    /// [`Error::Usage`], which lists the names, if there is no such family.
    pub fn named(name: &str) -> Result<&'static Family> {
        FAMILIES.into_iter().find(|family| family.name == name).ok_or_else(|| {
            let names: Vec<&str> = FAMILIES.iter().map(|family| family.name).collect();
            Error::Usage(format!("no family is called '{name}'; the families are: {}", names.join(", ")))
        })
    }
}
