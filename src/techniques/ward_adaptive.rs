//! Adaptive shadow testing (Ward 1991), for comparison with shadow photons: the lights of a point are tested in the
//! order of their potential contributions, until the rest is below a tolerance. The rest is estimated. A single light
//! is always tested, so in scenes with one light this equals `two-pass`, as the paper says.

use super::passes::{Implementation, indirect_light};
use super::two_pass;
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// The two-pass method with shadow rays to the lights that may contribute most; the visibility of the others is
    /// estimated (Ward 1991).
    pub const WARD_ADAPTIVE: Technique = Technique::new(&Description {
        name: "ward-adaptive",
        help: "shadow rays to the lights that contribute most, estimates for the rest (Ward 1991)",
        source: "Ward 1991, Adaptive Shadow Testing for Ray Tracing",
        requirements: Requirements {
            transport: Transport::TwoPass,
            visibility: Visibility::Adaptive,
            lights: ConsideredLights::All,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::WARD_ADAPTIVE, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    setup.make_direct_light()?;
    setup.make_adaptive_testing()?;
    // The global map and the irradiance cache.
    setup.make_indirect_light()
}

fn second_pass(frame: &mut SecondPass<'_, '_>) {
    if !frame.has_adaptive_testing() {
        return two_pass::second_pass(frame);
    }
    frame.trace_camera_rays();
    // One chunk has all lights.
    for lights in frame.light_chunks() {
        frame.order_lights(&lights);
        for _ in 0..lights.lights {
            frame.queue_next_light(&lights);
            frame.trace_shadow_rays(&lights);
        }
        frame.estimate_untested_lights(&lights);
        frame.learn_visibility(&lights);
        // Counts the classes; the shadow rays are already traced.
        frame.queue_shadow_rays(&lights);
        frame.shade(&lights);
        frame.add_classes_to_film(&lights);
    }
    indirect_light(frame);
    frame.add_to_film();
}
