//! Path tracing, the reference: unidirectional, with next-event estimation and multiple importance sampling (Kajiya
//! 1986). It shares only the scene, the BVH and the BSDFs with the photon code.

use super::passes::Implementation;
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// Unidirectional path tracing with next-event estimation and multiple importance sampling: the reference.
    pub const PATH: Technique = Technique::new(&Description {
        name: "path",
        help: "path tracing with next-event estimation: the reference",
        source: "Kajiya 1986; figures 2 and 3 of Jensen and Christensen 1995, upper left",
        requirements: Requirements {
            transport: Transport::Paths,
            visibility: Visibility::ShadowRays,
            lights: ConsideredLights::OneAtVertex,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::PATH, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    // There are no photons and no records; this only binds pass `path`.
    setup.make_indirect_light()
}

fn second_pass(frame: &mut SecondPass<'_, '_>) {
    frame.trace_camera_rays();
    frame.trace_paths();
    frame.add_to_film();
}
