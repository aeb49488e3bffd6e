//! The techniques, one file each: its name, its help, what it needs, whether it is unbiased, and the passes that it
//! runs. A new technique is a new file and a line in the list.

mod negative_photons;
pub(crate) mod passes;
mod path;
mod photon_map;
mod shadow_photons;
mod two_pass;
mod visibility_cells;
mod visibility_estimate;
mod voxel_tags;
mod ward_adaptive;

use std::str::FromStr;

use crate::settings::{Settings, Technique};

use passes::Implementation;

/// All techniques, in the order of help and reports.
static TECHNIQUES: [Implementation; 9] = [
    path::IMPLEMENTATION,
    two_pass::IMPLEMENTATION,
    shadow_photons::IMPLEMENTATION,
    visibility_estimate::IMPLEMENTATION,
    ward_adaptive::IMPLEMENTATION,
    visibility_cells::IMPLEMENTATION,
    voxel_tags::IMPLEMENTATION,
    photon_map::IMPLEMENTATION,
    negative_photons::IMPLEMENTATION,
];

/// The passes of a technique.
///
/// # Panics
/// If the technique is not in the list: a defect of its file.
pub(crate) fn implementation(technique: Technique) -> &'static Implementation {
    let listed = TECHNIQUES.iter().find(|implementation| implementation.technique == technique);
    listed.unwrap_or_else(|| panic!("the technique {technique} is not listed"))
}

impl Technique {
    /// All techniques, in the order of help and reports.
    pub fn all() -> impl ExactSizeIterator<Item = Technique> + Clone {
        TECHNIQUES.iter().map(|implementation| implementation.technique)
    }
}

impl Settings {
    /// Whether the image converges to the true one as samples are added. Indirect light converges only as far as
    /// photons and irradiance records allow; there are more of them the more samples there are.
    pub fn is_unbiased(&self) -> bool {
        (implementation(self.technique).is_unbiased)(self)
    }
}

impl Default for Technique {
    /// [`Technique::SHADOW_PHOTONS`].
    fn default() -> Technique {
        Technique::SHADOW_PHOTONS
    }
}

impl FromStr for Technique {
    type Err = String;

    /// The technique of a name.
    fn from_str(text: &str) -> Result<Technique, String> {
        Technique::all().find(|technique| technique.name() == text).ok_or_else(|| {
            let names: Vec<_> = Technique::all().map(Technique::name).collect();
            format!("no technique is called '{text}'; there is: {}", names.join(", "))
        })
    }
}
