//! Pass `ward`: sorts the lights of each point by their potential contribution, queues them one by one for pass
//! `shadow`, and estimates the visibility of the lights that remain.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, bindings, shared_struct};

use super::classify::ClassifyBuffers;
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/ward.wgsl`.
    pub struct WardParameters {
        /// The tile.
        pub tile: Tile,
        /// Lights, all of them in one chunk.
        pub light_count: u32,
        /// First light that `order` adds; set by [`BoundWard::order`].
        pub first_light: u32,
        /// End of the lights that `order` adds; set by [`BoundWard::order`].
        pub end_light: u32,
        /// Light points of a candidate.
        pub light_samples: u32,
        /// Words of visibilities of a candidate: 32 light points each.
        pub visibility_words: u32,
        /// Share of the light found so far, 0 to 1. Testing stops when the remaining lights could contribute less than
        /// this.
        pub tolerance: f32,
    }
}

shared_struct! {
    /// Progress of a point through its lights; see `shaders/ward.wgsl`.
    pub struct WardState {
        rest: f32,
        found: f32,
        visible: f32,
        expected: f32,
        waiting: u32,
        current: u32,
    }
}

bindings! {
    /// Buffers of the kernels.
    struct WardBindings {
        pub classes: &Buffer,
        pub visibility: &Buffer,
        pub queue_lengths: &Buffer,
        pub boundary_queue: &Buffer,
        pub light_keys: &Buffer,
        pub ward_states: &Buffer,
        pub light_rates: &Buffer,
        pub light_tests: &Buffer,
    }
}

/// Number of lights whose potentials one invocation computes. Their light points, and for each the search for an
/// emitter triangle, stay well below the 65,535 iterations that lavapipe allows an invocation.
const LIGHTS_AT_ONCE: u32 = 64;

/// The pass; see `shaders/ward.wgsl`.
pub struct Ward(Kernel);

/// State that one round or tile passes to the next: the state of each point, and the visible share of each light so
/// far.
pub struct WardBuffers {
    keys: Buffer,
    states: Buffer,
    rates: Buffer,
    tests: Buffer,
}

impl WardBuffers {
    /// Buffers for `points` points and `lights` lights.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, points: u32, lights: u32) -> Result<WardBuffers> {
        Ok(WardBuffers {
            keys: gpu.buffer::<u32>("penumbra/ward/keys", points as usize * lights as usize)?,
            states: gpu.buffer::<WardState>("penumbra/ward/states", points as usize)?,
            // A prior of one visible test per light: before the first test, a light counts as unoccluded.
            rates: gpu.upload("penumbra/ward/rates", &vec![[1u32; 2]; lights as usize])?,
            tests: gpu.buffer::<[u32; 2]>("penumbra/ward/tests", lights as usize)?,
        })
    }

    /// For each light, the number of light points that were visible so far, and the number tested.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn rates(&self, gpu: &Gpu) -> Result<Vec<u32>> {
        Ok(gpu.read(&self.rates, (self.rates.bytes / 4) as usize)?)
    }

    /// Restores what [`WardBuffers::rates`] returned. Does nothing and returns false if `rates` is for another number
    /// of lights.
    pub fn restore(&self, gpu: &Gpu, rates: &[u32]) -> bool {
        let fits = rates.len() as u64 * 4 == self.rates.bytes;
        if fits {
            gpu.write(&self.rates, rates);
        }
        fits
    }

    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        [&self.keys, &self.states, &self.rates, &self.tests].into_iter().map(|buffer| buffer.bytes).sum()
    }
}

impl Ward {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Ward> {
        Ok(Ward(kernel(gpu, "ward", features, constants, &[WardBindings::DECLARED])?))
    }

    /// Binds the pass.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        classify: &ClassifyBuffers,
        visibility: &Buffer,
        buffers: &WardBuffers,
        scene: &dyn Bindings,
    ) -> Result<BoundWard> {
        let own = WardBindings {
            classes: &classify.classes,
            visibility,
            queue_lengths: &classify.queue_lengths,
            boundary_queue: &classify.boundary_queue,
            light_keys: &buffers.keys,
            ward_states: &buffers.states,
            light_rates: &buffers.rates,
            light_tests: &buffers.tests,
        };
        let bind = |entry| self.0.bind(gpu, entry, &[&own, tile, scene]);
        Ok(BoundWard { order: bind("order")?, next: bind("next")?, estimate: bind("estimate")?, learn: bind("learn")? })
    }
}

/// The pass, bound.
pub struct BoundWard {
    order: BoundKernel,
    next: BoundKernel,
    estimate: BoundKernel,
    learn: BoundKernel,
}

impl BoundWard {
    /// Sorts the lights of each point by potential contribution.
    pub fn order(&self, frame: &mut Frame<'_>, parameters: &WardParameters) {
        let points = parameters.tile.point_count;
        for first_light in (0..parameters.light_count).step_by(LIGHTS_AT_ONCE as usize) {
            let end_light = (first_light + LIGHTS_AT_ONCE).min(parameters.light_count);
            frame.run(&self.order, points, &WardParameters { first_light, end_light, ..*parameters });
        }
    }

    /// Queues the next light of each point that still has lights to test.
    pub fn next(&self, frame: &mut Frame<'_>, classify: &ClassifyBuffers, parameters: &WardParameters) {
        frame.clear(&classify.queue_lengths);
        frame.run(&self.next, parameters.tile.point_count, parameters);
    }

    /// Estimates the visibility of the lights that were not tested.
    pub fn estimate(&self, frame: &mut Frame<'_>, parameters: &WardParameters) {
        frame.run(&self.estimate, parameters.tile.point_count, parameters);
    }

    /// Adds this tile's tests to the statistics of each light, from which visibility is estimated.
    pub fn learn(&self, frame: &mut Frame<'_>, parameters: &WardParameters) {
        frame.run(&self.learn, parameters.light_count, parameters);
    }
}
