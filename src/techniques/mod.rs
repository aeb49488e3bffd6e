//! The techniques, one file each: name, help, requirements, and the two passes. A new technique is a new
//! file, with a `mod` line and a line in `TECHNIQUES` here.

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

use crate::settings::Technique;

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
    use crate::settings::Settings;

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

    /// Techniques that trace a shadow ray wherever they do not know are unbiased: a noise is requested of these alone.
    #[test]
    fn a_noise_requires_an_unbiased_image() {
        let unbiased = ["path", "two-pass", "shadow-photons", "light-buffer"];
        let noisy = Settings::default().with(|s| s.image.noise = Some(0.01));
        for technique in Technique::all() {
            let settings = noisy.clone().with(|s| s.technique = technique);
            assert_eq!(settings.check().is_ok(), unbiased.contains(&technique.name()), "{technique}");
            let clamped = settings.with(|s| s.indirect.clamp = Some(1.0));
            assert!(!clamped.is_unbiased() && clamped.check().is_err(), "{technique}");
            assert!(clamped.with(|s| s.image.noise = None).check().is_ok(), "{technique}");
        }
        assert!(!noisy.clone().with(|s| s.visibility_map.audit = 0.0).is_unbiased());
        let exact = noisy.with(|s| (s.technique, s.ward.tolerance) = (Technique::WARD_ADAPTIVE, 0.0));
        assert!(exact.is_unbiased() && exact.check().is_ok());
    }
}
