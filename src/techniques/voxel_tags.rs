//! Voxel occlusion testing (Woo and Amanatides 1990), for comparison with shadow photons: for each light, each voxel is
//! tagged lit, shadowed or neither, and only points in voxels of the last kind trace shadow rays.
//!
//! The original rasterises the shadow volumes of single polygons into the grid, which misses shadows that several
//! polygons cast together. Here rays set the tags. Occluders may lie between the rays, so a tag counts only if the 26
//! neighbouring voxels have the same tag.

use super::passes::{Implementation, indirect_light};
use super::two_pass;
use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::Technique;
use crate::settings::technique::{ConsideredLights, Description, Requirements, Transport, Visibility};

impl Technique {
    /// The two-pass method with shadow rays only in voxels that are neither lit nor shadowed as a whole (Woo and
    /// Amanatides 1990).
    pub const VOXEL_TAGS: Technique = Technique::new(&Description {
        name: "voxel-tags",
        help: "shadow rays only in voxels neither completely lit nor completely in shadow (Woo and Amanatides 1990)",
        source: "Woo and Amanatides 1990, Voxel Occlusion Testing",
        requirements: Requirements {
            transport: Transport::TwoPass,
            visibility: Visibility::Voxels,
            lights: ConsideredLights::All,
        },
    });
}

pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::VOXEL_TAGS, is_unbiased: |_| false, first_pass, second_pass };

fn first_pass(setup: &mut FirstPass<'_>) -> Result<()> {
    setup.make_direct_light()?;
    // The tags: pass `cells` with the feature `voxel_tags`.
    setup.trace_cell_rays()?;
    // The global map and the irradiance cache.
    setup.make_indirect_light()
}

fn second_pass(frame: &mut SecondPass<'_, '_>) {
    // The scene has no surface or no light.
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
