//! The techniques, one file each: name, help, requirements, whether the image is unbiased, and the two passes. A new
//! technique is a new file, with a `mod` line and a line in `TECHNIQUES` here.

pub mod auto;
mod light_buffer;
mod negative_photons;
pub(crate) mod passes;
mod path;
mod photon_map;
mod shadow_photons;
mod two_pass;
mod view_sketch;
mod visibility_cells;
mod visibility_estimate;
mod voxel_tags;
mod ward_adaptive;

use std::str::FromStr;

use passes::Implementation;

use crate::settings::{Settings, Technique};

/// All techniques, in the order of help and reports.
static TECHNIQUES: &[Implementation] = &[
    path::IMPLEMENTATION,
    two_pass::IMPLEMENTATION,
    shadow_photons::IMPLEMENTATION,
    visibility_estimate::IMPLEMENTATION,
    ward_adaptive::IMPLEMENTATION,
    visibility_cells::IMPLEMENTATION,
    voxel_tags::IMPLEMENTATION,
    light_buffer::IMPLEMENTATION,
    photon_map::IMPLEMENTATION,
    negative_photons::IMPLEMENTATION,
];

/// The passes of a technique.
///
/// # Panics
/// If the technique is not in `TECHNIQUES`.
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
    /// photons and irradiance records allow; their number grows with the samples.
    pub fn is_unbiased(&self) -> bool {
        self.indirect.clamp.is_none() && (implementation(self.technique).is_unbiased)(self)
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
            format!("no technique is called '{text}'; available: {}", names.join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each technique is found by its name, and the error for an unknown name lists all names.
    #[test]
    fn techniques_are_found_by_name() {
        for technique in Technique::all() {
            assert_eq!(technique.name().parse(), Ok(technique));
            assert_eq!(implementation(technique).technique, technique);
            assert_eq!(Technique::all().filter(|other| *other == technique).count(), 1, "{technique}");
            assert!(!technique.help().is_empty() && !technique.source().is_empty(), "{technique}");
        }
        let error = "photons".parse::<Technique>().unwrap_err();
        assert!(Technique::all().all(|technique| error.contains(technique.name())), "{error}");
    }
}
