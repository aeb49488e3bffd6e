//! The light buffer (Haines and Greenberg 1986), for comparison with shadow photons: the directions around each light
//! are divided into cells, and each cell lists the surfaces that may hide the light from what lies in it. A point
//! traces shadow rays unless its list shows that the light is visible, or is hidden by a single triangle.
//!
//! The original has only point lights, whose visibility the list decides completely. Here lights may have a surface,
//! and a list has every surface that may hide some part of the light. Shadow rays are traced through the BVH, not
//! through the lists.

use super::passes::{Implementation, second_pass_by_classes};
use super::two_pass;
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// The two-pass method with shadow rays only where a list of the surfaces before the light does not decide (Haines
    /// and Greenberg 1986).
    pub const LIGHT_BUFFER: Technique = Technique::new(&Description {
        name: "light-buffer",
        help: "shadow rays only where lists of the occluders around a light do not decide (Haines and Greenberg 1986)",
        source: "Haines and Greenberg 1986, The Light Buffer: A Shadow-Testing Accelerator",
        requirements: Requirements {
            transport: Transport::TwoPass,
            visibility: Visibility::LightBuffer,
            lights: ConsideredLights::All,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::LIGHT_BUFFER, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    setup.make_direct_light()?;
    setup.make_light_buffers()?;
    // The global map and the irradiance cache.
    setup.make_indirect_light()
}

fn second_pass(frame: &mut SecondPass<'_, '_>) {
    // Nothing is to be lit, or there are too many lights.
    if !frame.has_light_buffers() {
        return two_pass::second_pass(frame);
    }
    second_pass_by_classes(frame, SecondPass::look_up_light_buffers);
}
