//! Pass `shade`: computes direct light by the class of each candidate (a point and a light).

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, bindings, shared_struct};

use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::{Feature, Features};

shared_struct! {
    /// Immediates of the pass; see `shaders/shade.wgsl`.
    pub struct ShadeParameters {
        /// The tile.
        pub tile: Tile,
        /// First light of the chunk, or first sampled light index.
        pub first_light: u32,
        /// Lights of the chunk.
        pub lights_in_chunk: u32,
        /// Light points of a candidate.
        pub light_samples: u32,
        /// Words of visibilities of a candidate: 32 light points each.
        pub visibility_words: u32,
        /// See [`AuditProbabilities::away`](super::classify::AuditProbabilities::away).
        pub audit_away: f32,
        /// See [`AuditProbabilities::near`](super::classify::AuditProbabilities::near).
        pub audit_near: f32,
        /// Whether `shade_sampled` adds all terms to all points, where the kernels have a queue.
        pub at_once: u32,
    }
}

bindings! {
    /// Buffers of the kernels with any features.
    struct ShadeBindings {
        pub classes: &Buffer,
        pub visibility: &Buffer,
        pub radiance_direct: &Buffer,
        pub counters: &Buffer,
    }
}

bindings! {
    /// The queue of the points that need light samples, where few do.
    struct SampledBindings {
        pub sampled_points: &Buffer,
        pub queue_lengths: &Buffer,
    }
}

bindings! {
    /// The output for the AOV.
    struct ShadowSampleBindings {
        pub shadow_samples: &Buffer,
    }
}

/// The pass; see `shaders/shade.wgsl`.
pub struct Shade(Kernel);

/// Inputs of the kernels from earlier passes, and their own queue.
pub struct ShadeBuffers<'a> {
    /// Class words of the candidates.
    pub classes: &'a Buffer,
    /// Words of visibilities of the candidates.
    pub visibility: &'a Buffer,
    /// Class, visibility, n_i and n_s of each candidate, for the AOV.
    pub shadow_samples: Option<&'a Buffer>,
    /// Room for every point of the tile.
    pub sampled_points: &'a Buffer,
    /// Lengths of the tile's queues; the length of [`crate::kernels::Queue::Sampled`] must be 0.
    pub queue_lengths: &'a Buffer,
}

impl Shade {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Shade> {
        let mut own = vec![ShadeBindings::DECLARED];
        own.extend(features.has(Feature::FewSampled).then_some(SampledBindings::DECLARED));
        own.extend(features.has(Feature::AovShadow).then_some(ShadowSampleBindings::DECLARED));
        Ok(Shade(kernel(gpu, "shade", features, constants, &own)?))
    }

    /// Binds the pass.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        buffers: &ShadeBuffers<'_>,
        scene: &dyn Bindings,
    ) -> Result<BoundShade> {
        let own = ShadeBindings {
            classes: buffers.classes,
            visibility: buffers.visibility,
            radiance_direct: &tile.radiance_direct,
            counters: &tile.counters,
        };
        let queue = SampledBindings { sampled_points: buffers.sampled_points, queue_lengths: buffers.queue_lengths };
        let aov = buffers.shadow_samples.map(|shadow_samples| ShadowSampleBindings { shadow_samples });
        let mut sets: Vec<&dyn Bindings> = vec![&own, tile, &queue, scene];
        sets.extend(aov.as_ref().map(|aov| aov as &dyn Bindings));
        let bind = |entry| self.0.bind(gpu, entry, &sets);
        let sampled_group = self.0.workgroup_size("shade_sampled");
        let sampled = sampled_group.map(|group| bind("shade_sampled").map(|bound| (bound, group))).transpose()?;
        Ok(BoundShade { shade: bind("shade")?, sampled })
    }
}

/// The pass, bound.
pub struct BoundShade {
    shade: BoundKernel,
    /// The kernel, and the number of invocations in a workgroup.
    sampled: Option<(BoundKernel, u32)>,
}

impl BoundShade {
    /// Adds the light of the chunk's lights to every point of the tile. Where the kernels have a queue, `arrange`
    /// converts its length to indirect arguments, at byte `offset` of `arguments`, for workgroups of the given number
    /// of invocations.
    pub fn record(
        &self,
        frame: &mut Frame<'_>,
        parameters: &ShadeParameters,
        arrange: impl FnOnce(&mut Frame<'_>, u32),
        (arguments, offset): (&Buffer, u64),
    ) {
        match &self.sampled {
            Some((sampled, _)) if parameters.at_once != 0 => {
                frame.run(sampled, parameters.tile.point_count, parameters)
            }
            Some((sampled, group)) => {
                frame.run(&self.shade, parameters.tile.point_count, parameters);
                arrange(frame, *group);
                frame.run_indirect(sampled, arguments, offset, parameters);
            }
            None => frame.run(&self.shade, parameters.tile.point_count, parameters),
        }
    }
}
