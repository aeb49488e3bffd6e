//! Adaptive shadow testing (Ward 1991): the lights of a point are tested in the order of their potential contributions,
//! until the sum of the untested contributions is below a tolerance times the light found. The visibility of an
//! untested light is estimated: its visible share in earlier tiles, times the ratio of the visibility of the tested
//! lights at this point to their visible share.
//!
//! Ward tests the parts of a large source one by one. Here all light points of one light are tested together: each of
//! them could contribute about as much as the others, so even the last of four is never below the tolerance.
//!
//! The visible shares are those of earlier tiles, so that results do not depend on the order of a tile's points.

use kernel_kit::{Frame, Gpu};

use super::direct_light::DirectLight;
use super::shared::Shared;
use crate::Result;
use crate::passes::Tile;
use crate::passes::classify::{Chunk, ClassifyBuffers};
use crate::passes::ward::{BoundWard, Ward, WardBuffers, WardParameters};
use crate::settings::Settings;

pub(crate) struct AdaptiveTesting {
    buffers: WardBuffers,
    bound: BoundWard,
    light_samples: u32,
    tolerance: f32,
}

impl AdaptiveTesting {
    /// Makes room for tiles of `points` points, and binds the pass to the classes of direct light.
    pub fn new(
        shared: &Shared<'_>,
        kernel: &Ward,
        direct: &DirectLight,
        points: u32,
        settings: &Settings,
    ) -> Result<AdaptiveTesting> {
        let Shared { gpu, scene, gpu_scene, tile } = *shared;
        let buffers = WardBuffers::new(gpu, points, scene.lights.len() as u32)?;
        let bound = kernel.bind(gpu, tile, direct.classify_buffers(), direct.visibility(), &buffers, gpu_scene)?;
        let (light_samples, tolerance) = (settings.shadow_rays.samples, settings.ward.tolerance);
        Ok(AdaptiveTesting { buffers, bound, light_samples, tolerance })
    }

    fn parameters(&self, tile: &Tile, chunk: &Chunk) -> WardParameters {
        WardParameters {
            tile: *tile,
            light_count: chunk.lights,
            light_samples: self.light_samples,
            visibility_words: self.light_samples.div_ceil(32),
            tolerance: self.tolerance,
            ..WardParameters::default()
        }
    }

    /// See [`BoundWard::order`].
    pub fn order(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound.order(frame, &self.parameters(tile, chunk));
    }

    /// See [`BoundWard::next`].
    pub fn next(&self, frame: &mut Frame<'_>, classify: &ClassifyBuffers, tile: &Tile, chunk: &Chunk) {
        self.bound.next(frame, classify, &self.parameters(tile, chunk));
    }

    /// See [`BoundWard::estimate`].
    pub fn estimate(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound.estimate(frame, &self.parameters(tile, chunk));
    }

    /// See [`BoundWard::learn`].
    pub fn learn(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound.learn(frame, &self.parameters(tile, chunk));
    }

    /// The state that samples leave for later samples: the visible share of each light.
    pub fn state(&self, gpu: &Gpu) -> Result<Vec<u32>> {
        self.buffers.rates(gpu)
    }

    /// Puts back what [`AdaptiveTesting::state`] gave; false if it belongs to another render.
    pub fn restore(&self, gpu: &Gpu, words: &[u32]) -> bool {
        self.buffers.restore(gpu, words)
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        self.buffers.bytes()
    }
}
