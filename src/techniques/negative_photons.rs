//! As `photon-map`, but direct light counts as unoccluded, and shadow photons subtract their energy (Jensen and
//! Christensen 1995: "adding the negative energy").

use super::passes::Implementation;
use super::photon_map::second_pass;
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// As [`Technique::PHOTON_MAP`], but direct light counts as unoccluded, and shadow photons subtract their energy.
    pub const NEGATIVE_PHOTONS: Technique = Technique::new(&Description {
        name: "negative-photons",
        help: "direct light without occlusion, from which shadow photons subtract energy",
        source: "Jensen and Christensen 1995, \"adding the negative energy\"",
        requirements: Requirements {
            transport: Transport::ShownMapWithNegativePhotons,
            visibility: Visibility::ShadowRays,
            lights: ConsideredLights::All,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::NEGATIVE_PHOTONS, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    // The global map. Rays continue through the first surface, and store photons of negative flux behind it.
    setup.make_indirect_light()
}
