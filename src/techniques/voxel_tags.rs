//! Voxel occlusion testing (Woo and Amanatides 1990), for comparison with shadow photons: for each light, each voxel is
//! tagged lit, shadowed or neither, and only points in voxels of the last kind trace shadow rays.
//!
//! The original rasterises the shadow volumes of single polygons into the grid, which misses shadows that several
//! polygons cast together. Here rays set the tags. Occluders may lie between the rays, so a tag counts only if the 26
//! neighbouring voxels have the same tag.

use super::passes::Implementation;
use super::visibility_cells::{first_pass, second_pass};
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

/// The passes of `visibility-cells`. With the feature `voxel_tags`, the classes that pass `cells` gives to cells are
/// tags.
pub(super) const IMPLEMENTATION: Implementation =
    Implementation { technique: Technique::VOXEL_TAGS, first_pass, second_pass };
