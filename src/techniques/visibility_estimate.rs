//! No shadow rays: the visibility of a light is n_i / (n_s + n_i) of the nearest photons (Jensen and Christensen 1995,
//! equation 1, and figures 2 and 3, lower right). Shadow rays are traced only to lights without photons, such as an
//! environment.

use super::passes::{Implementation, indirect_light};
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// No shadow rays: visibility n_i / (n_s + n_i), equation 1 of the paper.
    pub const VISIBILITY_ESTIMATE: Technique = Technique::new(&Description {
        name: "visibility-estimate",
        help: "as two-pass, without shadow rays: visibility is estimated from photons (equation 1 of the paper)",
        source: "Jensen and Christensen 1995, equation 1, and figures 2 and 3, lower right",
        requirements: Requirements {
            transport: Transport::TwoPass,
            visibility: Visibility::PhotonsAlone,
            lights: ConsideredLights::All,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::VISIBILITY_ESTIMATE, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    // Illumination and shadow photons of every light ("Extending the photon map").
    setup.make_visibility_map()?;
    setup.make_direct_light()?;
    // The global map and the irradiance cache of the two-pass method.
    setup.make_indirect_light()
}

fn second_pass(frame: &mut SecondPass<'_, '_>) {
    frame.trace_camera_rays();
    for lights in frame.light_chunks() {
        // n_i and n_s of the nearest photons, exactly.
        frame.classify(&lights);
        frame.look_up_map_cells(&lights);
        frame.classify_requested_cells();
        frame.query_photons(&lights);
        // For lights without photons.
        frame.trace_shadow_rays(&lights);
        // The light times n_i / (n_s + n_i): equation 1.
        frame.shade(&lights);
        frame.add_classes_to_film(&lights);
    }
    indirect_light(frame);
    frame.add_to_film();
}
