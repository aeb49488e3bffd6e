//! The earlier methods that shadow photons are compared with, where they stand in for the visibility map: they write the
//! class words of a tile's points, and all else is as with photons.
//!
//! *ward-adaptive* is Ward's adaptive shadow testing (1991): lights are tested in the order of what they could contribute
//! at a point, until the sum of what is left is below a tolerance times what was found; the rest is guessed by the share
//! of each light that was seen so far, times how much more or less than that was seen of the lights tested here. One light
//! alone is always tested, so in scenes with one light it is `two-pass`, as the paper says of it. Ward tests the parts of a
//! large source one by one; here the light points of one light stay together, since each of them could contribute about
//! as much as the others, and a rest of one in four is never below the tolerance.
//!
//! What was seen so far is that of the tiles before, so that results do not depend on the order of a tile's points.
//!
//! *visibility-cells* and *voxel-tags* are in `cells.rs`.

use crate::Result;
use crate::gpu::{Buffer, Features, Frame, Gpu};
use crate::gpu_scene::GpuScene;
use crate::passes::cells::{BoundCells, CellTable, Cells};
use crate::passes::classify::{Chunk, ClassifyBuffers};
use crate::passes::ward::{BoundWard, Ward, WardBuffers, WardParameters};
use crate::passes::{Tile, TileBuffers};
use crate::scene::Scene;
use crate::settings::Settings;

use super::cell_visibility as cells;
use crate::statistics::totals::Totals;

pub(crate) enum EarlierKernels {
    Cells(Cells),
    Ward(Ward),
}

impl EarlierKernels {
    /// Those that the features ask for.
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Option<EarlierKernels>> {
        if features.has("cells") {
            return Ok(Some(EarlierKernels::Cells(Cells::new(gpu, features, constants)?)));
        }
        let ward = features.has("ward").then(|| Ward::new(gpu, features, constants)).transpose()?;
        Ok(ward.map(EarlierKernels::Ward))
    }
}

pub(crate) enum Earlier {
    Cells(Cells, CellTable),
    Ward(Ward, WardBuffers),
}

pub(crate) enum BoundEarlier {
    Cells(BoundCells),
    Ward(BoundWard),
}

impl Earlier {
    /// Does what comes before the first sample, for tiles of `points` points.
    pub fn new(
        gpu: &Gpu,
        kernels: EarlierKernels,
        scene: &Scene,
        gpu_scene: &GpuScene,
        points: u32,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<Earlier> {
        Ok(match kernels {
            EarlierKernels::Cells(kernel) => {
                let table = cells::table(gpu, &kernel, scene, gpu_scene, settings, totals)?;
                Earlier::Cells(kernel, table)
            }
            EarlierKernels::Ward(kernel) => {
                let buffers = WardBuffers::new(gpu, points, scene.lights.len() as u32)?;
                Earlier::Ward(kernel, buffers)
            }
        })
    }

    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        classify: &ClassifyBuffers,
        visibility: &Buffer,
        gpu_scene: &GpuScene,
    ) -> Result<BoundEarlier> {
        Ok(match self {
            Earlier::Cells(kernel, table) => {
                BoundEarlier::Cells(kernel.bind(gpu, tile, table, &classify.classes, gpu_scene)?)
            }
            Earlier::Ward(kernel, buffers) => {
                BoundEarlier::Ward(kernel.bind(gpu, tile, classify, visibility, buffers, gpu_scene)?)
            }
        })
    }

    /// What samples have left, that others go on from.
    pub fn state(&self, gpu: &Gpu) -> Result<Vec<u32>> {
        match self {
            Earlier::Cells(..) => Ok(Vec::new()),
            Earlier::Ward(_, buffers) => buffers.rates(gpu),
        }
    }

    /// Puts back what [`Earlier::state`] gave; false where it is not of this render.
    pub fn restore(&self, gpu: &Gpu, words: &[u32]) -> bool {
        match self {
            Earlier::Cells(..) => words.is_empty(),
            Earlier::Ward(_, buffers) => buffers.restore(gpu, words),
        }
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        match self {
            Earlier::Cells(..) => 0,
            Earlier::Ward(_, buffers) => buffers.bytes(),
        }
    }
}

impl BoundEarlier {
    /// Writes the class words of a tile's points for a chunk of lights. `test` records the shadow rays of the slots that are
    /// in the boundary queue.
    pub fn record(
        &self,
        frame: &mut Frame<'_>,
        classify: &ClassifyBuffers,
        tile: &Tile,
        chunk: &Chunk,
        settings: &Settings,
        test: impl Fn(&mut Frame<'_>),
    ) {
        match self {
            BoundEarlier::Cells(cells) => cells.record(frame, tile, chunk),
            BoundEarlier::Ward(ward) => {
                let parameters = WardParameters {
                    tile: *tile,
                    light_count: chunk.lights,
                    light_samples: settings.shadow_rays.samples,
                    visibility_words: settings.shadow_rays.samples.div_ceil(32),
                    tolerance: settings.ward.tolerance,
                    ..WardParameters::default()
                };
                ward.record(frame, classify, &parameters, test);
            }
        }
    }

    /// The points that the queue has in the end have had their shadow rays.
    pub fn has_tested(&self) -> bool {
        matches!(self, BoundEarlier::Ward(_))
    }
}
