//! The paper's method: shadow rays only where photons do not decide (Jensen and Christensen 1995, figures 2 and 3,
//! lower left).
//!
//! If the photons near a point are of both kinds, the boundary of a shadow is near. Audits, which are not in the paper,
//! trace shadow rays at some of the other points too. They keep the image unbiased, and repair the map where it is
//! wrong.

use super::passes::{Implementation, indirect_light};
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// The two-pass method with shadow rays only where photons do not decide. The default.
    pub const SHADOW_PHOTONS: Technique = Technique::new(&Description {
        name: "shadow-photons",
        help: "as two-pass, with shadow rays only at shadow boundaries, which photons find",
        source: "Jensen and Christensen 1995, figures 2 and 3, lower left",
        requirements: Requirements {
            transport: Transport::TwoPass,
            visibility: Visibility::Photons,
            lights: ConsideredLights::SampledByZones,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::SHADOW_PHOTONS, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    // Many lights: "divide the scene into zones according to the light sources". There is no visibility map then.
    setup.make_light_sampler()?;
    // Illumination and shadow photons of every light ("Extending the photon map").
    setup.make_visibility_map()?;
    // Not in the paper: where these photons do not decide, the shadow rays of earlier samples are photons that do.
    setup.make_fine_cells()?;
    setup.make_direct_light()?;
    // The global map and the irradiance cache of the two-pass method.
    setup.make_indirect_light()
}

fn second_pass(frame: &mut SecondPass<'_, '_>) {
    frame.trace_camera_rays();
    frame.sample_lights();
    for lights in frame.light_chunks() {
        // Lit, shadowed or boundary, by n_i and n_s of the nearest photons ("Extending the photon map", cases 1 to 3).
        // The class of a cell is computed once; points look it up.
        frame.classify(&lights);
        frame.look_up_map_cells(&lights);
        frame.classify_requested_cells();
        frame.query_photons(&lights);
        // Not in the paper: without dilation, faint penumbrae of wide lights would be missed.
        frame.dilate_boundaries(&lights);
        // "It is only in case 3 that the use of shadow rays is beneficial."
        frame.trace_shadow_rays(&lights);
        frame.audit(&lights);
        frame.shade(&lights);
        frame.add_classes_to_film(&lights);
    }
    indirect_light(frame);
    frame.add_to_film();
}
