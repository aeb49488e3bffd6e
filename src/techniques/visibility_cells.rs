//! The source visibility preprocess (Zimmerman and Shirley 1995), for comparison with shadow photons: many rays from
//! each cell of a grid to points of each light. If all of them are blocked, points in the cell trace no shadow rays to
//! the light. This is wrong if a small part of the cell is lit, and shows as jagged edges.
//!
//! In the original, the share of rays that reach a light weights the probability of sampling it. Here each light is
//! used, and the share is the control variate of pass `shade`.

use super::passes::{Implementation, second_pass_by_classes};
use super::two_pass;
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// The two-pass method without shadow rays in grid cells from which no ray reached the light (Zimmerman and Shirley
    /// 1995).
    pub const VISIBILITY_CELLS: Technique = Technique::new(&Description {
        name: "visibility-cells",
        help: "no shadow rays in grid cells from which no ray reached the light (Zimmerman and Shirley 1995)",
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
    Implementation { technique: Technique::VISIBILITY_CELLS, first_pass, second_pass };

pub(super) fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    setup.make_direct_light()?;
    setup.trace_cell_rays()?;
    // The global map and the irradiance cache.
    setup.make_indirect_light()
}

pub(super) fn second_pass(frame: &mut SecondPass<'_, '_>) {
    // The scene has no surface or no light.
    if !frame.has_cells() {
        return two_pass::second_pass(frame);
    }
    second_pass_by_classes(frame, SecondPass::look_up_cells);
}
