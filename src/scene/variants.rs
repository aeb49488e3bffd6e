//! The extension KHR_materials_variants: materials by name, such as the colours of a shoe.

use super::json::Json;
use super::notes::Notes;
use crate::input::printable;
use crate::{Error, Result};

const EXTENSION: &str = "KHR_materials_variants";

/// The variants of a file.
pub(super) struct Variants {
    names: Vec<String>,
    /// The variant to render. `None`: each primitive has its own material.
    chosen: Option<usize>,
}

impl Variants {
    /// Reads their names and finds the one that is `wanted`. Adds a note if there are variants, but none is wanted.
    ///
    /// # Errors
    /// [`Error::Input`] where the extension is malformed, [`Error::Usage`] if no variant has that name.
    pub fn read(root: &Json, wanted: Option<&str>, notes: &mut Notes) -> Result<Self> {
        let mut names = Vec::new();
        if let Some(extension) = root.extension(EXTENSION)? {
            for variant in extension.require("variants")?.items()? {
                names.push(printable(variant.require("name")?.string()?));
            }
        }
        let listed = if names.is_empty() { "none".into() } else { names.join(", ") };
        let chosen = match wanted {
            Some(wanted) => {
                let index = names.iter().position(|name| *name == wanted);
                let problem = || Error::Usage(format!("no variant is called '{wanted}'; available: {listed}"));
                Some(index.ok_or_else(problem)?)
            }
            None => {
                if !names.is_empty() {
                    notes.push(format!("no variant of the materials is selected; available: {listed}"));
                }
                None
            }
        };
        Ok(Variants { names, chosen })
    }

    /// Their names.
    pub fn into_names(self) -> Vec<String> {
        self.names
    }

    /// The material that the chosen variant gives to a primitive, if it gives one. `materials` is their number.
    pub fn material(&self, primitive: &Json, materials: usize) -> Result<Option<usize>> {
        let Some(extension) = primitive.extension(EXTENSION)? else { return Ok(None) };
        let mut found = None;
        for mapping in filled_list(&extension, "mappings")? {
            let material = mapping.require("material")?.index(materials, "material")?;
            for variant in filled_list(&mapping, "variants")? {
                if Some(variant.index(self.names.len(), "variant")?) == self.chosen {
                    found = found.or(Some(material));
                }
            }
        }
        Ok(found)
    }
}

/// The elements of the list `key`, of which there must be one.
fn filled_list<'a>(owner: &Json<'a>, key: &str) -> Result<Vec<Json<'a>>> {
    let list = owner.require(key)?;
    if list.len() == 0 { Err(list.error("must not be empty")) } else { list.items() }
}
