//! The source visibility preprocess (Zimmerman and Shirley 1995), which shadow photons are compared with: up to 100
//! rays from each cell of a grid to points of each light. Where all of them are blocked, nothing in the cell is thought
//! to see the light, and no shadow ray is traced. That is wrong where a small part of a cell is lit, and shows as
//! jagged edges.
//!
//! In the original the share of rays that were seen weighs the lights' chances to be sampled. Here each light is
//! sampled, and the share is the control variate of pass `shade`.

use super::passes::{Implementation, indirect_light};
use super::two_pass;
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// The two-pass method without shadow rays from cells of space from which no ray reached the light (Zimmerman and
    /// Shirley 1995).
    pub const VISIBILITY_CELLS: Technique = Technique::new(&Description {
        name: "visibility-cells",
        help: "no shadow rays where no ray from the cell saw the light (Zimmerman and Shirley 1995)",
        source: "Zimmerman and Shirley 1995, A Two-Pass Solution to the Rendering Equation with a Source Visibility \
                 Preprocess",
        requirements: Requirements {
            transport: Transport::TwoPass,
            visibility: Visibility::Cells,
            lights: ConsideredLights::All,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::VISIBILITY_CELLS, is_unbiased: |_| false, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    setup.make_direct_light()?;
    setup.trace_cell_rays()?;
    // The global map and the irradiance cache.
    setup.make_indirect_light()
}

fn second_pass(frame: &mut SecondPass<'_, '_>) {
    // Nothing is lit.
    if !frame.has_cells() {
        return two_pass::second_pass(frame);
    }
    frame.trace_camera_rays();
    for lights in frame.light_chunks() {
        frame.look_up_cells(&lights);
        frame.queue_shadow_rays(&lights);
        frame.trace_shadow_rays(&lights);
        frame.shade(&lights);
        frame.add_classes_to_film(&lights);
    }
    indirect_light(frame);
    frame.add_to_film();
}
