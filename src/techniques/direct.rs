//! Direct light by shadow photons: the techniques `two-pass`, `shadow-photons` and `visibility-estimate`.
//!
//! They differ in what `needs` keeps: without a visibility map every point is unknown and asks all shadow rays; with
//! one only boundary and unknown points do; and the visibility estimate asks none where there are photons at all.

use glam::DVec4;

use crate::Result;
use crate::gpu::{Buffer, Features, Frame, Gpu};
use crate::needs::Needs;
use crate::passes::classify::{BoundClassify, Chunk, Classify, ClassifyBuffers, Queue};
use crate::passes::film::{Film, Plane};
use crate::passes::shade::{BoundShade, Shade, ShadeParameters};
use crate::passes::shadow::{BoundShadow, Shadow, ShadowBuffers, ShadowParameters};
use crate::passes::{Tile, TileBuffers};
use crate::scene::Scene;
use crate::settings::Settings;
use crate::tables::SceneTables;

use super::totals::Totals;
use super::visibility_map::{MapKernels, VisibilityMap};

/// Most slots (points times lights) that are worked on at once, where one light's points are not more.
const CHUNK_SLOTS: u32 = 1 << 21;

/// Most words of visibilities at once: half of the smallest storage binding that devices offer.
const CHUNK_WORDS: u32 = 1 << 24;

/// A light wider than this share of the scene's radius has penumbrae so wide that faint ones would be missed without
/// dilation; the boundaries of a narrower one are too wide already (the two scenes of the paper: 0.33 and 0.02).
const WIDE_LIGHT: f32 = 0.05;

pub(super) struct Kernels {
    classify: Classify,
    shadow: Shadow,
    shade: Shade,
    map: Option<MapKernels>,
}

impl Kernels {
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)], settings: &Settings) -> Result<Kernels> {
        let ((classify, map), (shadow, shade)) = rayon::join(
            || {
                rayon::join(
                    || Classify::new(gpu, features, constants, settings.nearest),
                    || features.has("visibility_map").then(|| MapKernels::new(gpu, features, constants, settings)),
                )
            },
            || {
                rayon::join(|| Shadow::new(gpu, features, constants), || Shade::new(gpu, features, constants))
            },
        );
        Ok(Kernels { classify: classify?, shadow: shadow?, shade: shade?, map: map.transpose()? })
    }
}

pub(super) struct Direct {
    buffers: Buffers,
    map: Option<VisibilityMap>,
    classify: Classify,
    shadow: Shadow,
    shade: Shade,
    bound: Bound,
    lights: u32,
    lights_in_chunk: u32,
    settings: Settings,
    dilate: u32,
    film: bool,
}

/// What the passes hand to each other for a chunk of lights.
struct Buffers {
    classify: ClassifyBuffers,
    visibility: Buffer,
    /// Class, visibility, n_i and n_s of each slot, for the AOV.
    shadow_samples: Option<Buffer>,
}

/// The passes bound to the current map: a new grid binds anew.
struct Bound {
    classify: BoundClassify,
    shadow: BoundShadow,
    shade: BoundShade,
}

/// The film of one light's classes.
pub(super) struct ShadowFilm(Plane);

impl ShadowFilm {
    /// Class of the first sample; means of visibility, n_i and n_s.
    pub fn read(&self, gpu: &Gpu, samples: u32) -> Result<Vec<DVec4>> {
        let mut means = self.0.means(gpu, samples)?;
        // Only the first sample wrote its class into the sum.
        means.iter_mut().for_each(|v| v.x *= f64::from(samples));
        Ok(means)
    }
}
