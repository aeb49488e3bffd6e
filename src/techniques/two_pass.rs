//! The two-pass method with all shadow rays (Jensen and Christensen 1995, figures 2 and 3, upper right): the renderer
//! with which shadow photons are compared.

use super::passes::{Implementation, indirect_light};
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// The two-pass method with all shadow rays.
    pub const TWO_PASS: Technique = Technique::new(&Description {
        name: "two-pass",
        help: "photon map, final gather and irradiance cache, with shadow rays from all points",
        source: "Jensen and Christensen 1995, figures 2 and 3, upper right",
        requirements: Requirements {
            transport: Transport::TwoPass,
            visibility: Visibility::ShadowRays,
            lights: ConsideredLights::AllOrSampled,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::TWO_PASS, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    // Only if the settings request a few of many lights.
    setup.make_light_sampler()?;
    setup.make_direct_light()?;
    // The global map and the irradiance cache.
    setup.make_indirect_light()
}

pub(super) fn second_pass(frame: &mut SecondPass<'_, '_>) {
    frame.trace_camera_rays();
    frame.sample_lights();
    for lights in frame.light_chunks() {
        // Every point is dark or unknown.
        frame.classify(&lights);
        frame.trace_shadow_rays(&lights);
        frame.shade(&lights);
        frame.add_classes_to_film(&lights);
    }
    indirect_light(frame);
    frame.add_to_film();
}
