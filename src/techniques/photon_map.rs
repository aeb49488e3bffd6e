//! The global map shown directly, by density estimation (Jensen and Christensen 1995: "visualizing the results from the
//! photon map directly"). Photons carry all light that Lambertian surfaces reflect; paths carry the light that glossy
//! surfaces reflect.

use super::passes::Implementation;
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// The global map shown directly, by density estimation.
    pub const PHOTON_MAP: Technique = Technique::new(&Description {
        name: "photon-map",
        help: "the photon map shown directly, by density estimation",
        source: "Jensen and Christensen 1995, \"visualizing the results from the photon map directly\"",
        requirements: Requirements {
            transport: Transport::ShownMap,
            visibility: Visibility::ShadowRays,
            lights: ConsideredLights::All,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::PHOTON_MAP, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    // The global map alone.
    setup.make_indirect_light()
}

pub(super) fn second_pass(frame: &mut SecondPass<'_, '_>) {
    frame.trace_camera_rays();
    frame.show_global_map();
    // The light that glossy surfaces reflect.
    frame.trace_paths();
    frame.add_to_film();
}
