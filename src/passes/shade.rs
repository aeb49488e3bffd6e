//! shade: direct light by the class of each point and light.

use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources};
use crate::{Result, shared_struct};

use super::{Tile, TileBuffers, kernel};

shared_struct! {
    /// Immediates of the pass; see `shaders/shade.wgsl`.
    pub struct ShadeParameters {
        /// The tile.
        pub tile: Tile,
        /// First light of the chunk.
        pub first_light: u32,
        /// Lights of the chunk.
        pub lights_in_chunk: u32,
        /// Light points of a slot.
        pub light_samples: u32,
        /// Words of visibilities of a slot.
        pub visibility_words: u32,
        /// Probability that a decided point is audited.
        pub audit_probability: f32,
        /// To a multiple of eight bytes.
        pub padding: u32,
    }
}

/// The pass; see `shaders/shade.wgsl`.
pub struct Shade(Kernel);

/// What the kernel reads of the passes before it, and its own queue.
pub struct ShadeBuffers<'a> {
    /// Class words of the slots.
    pub classes: &'a Buffer,
    /// Words of visibilities of the slots.
    pub visibility: &'a Buffer,
    /// Written where the AOV is asked for: class, visibility, n_i and n_s of each slot.
    pub shadow_samples: Option<&'a Buffer>,
    /// Room for every point of the tile.
    pub sampled_points: &'a Buffer,
    /// Lengths of the tile's queues, that of [`super::classify::Queue::Sampled`] 0.
    pub queue_lengths: &'a Buffer,
}

impl Shade {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Shade> {
        let mut own = vec!["points", "surfaces", "classes", "visibility", "radiance_direct", "counters"];
        if features.has("few_sampled") {
            own.extend(["sampled_points", "queue_lengths"]);
        }
        Ok(Shade(kernel(gpu, "shade", features, constants, &own)?))
    }

    /// Binds it.
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
        let mut own = Resources::new()
            .with("points", &tile.points)
            .with("surfaces", &tile.surfaces)
            .with("radiance_direct", &tile.radiance_direct)
            .with("counters", &tile.counters)
            .with("classes", buffers.classes)
            .with("visibility", buffers.visibility);
        if let Some(samples) = buffers.shadow_samples {
            own = own.with("shadow_samples", samples);
        }
        let sampled_group = self.0.workgroup_size("shade_sampled");
        if sampled_group.is_some() {
            own = own.with("sampled_points", buffers.sampled_points).with("queue_lengths", buffers.queue_lengths);
        }
        let bind = |entry| self.0.bind(gpu, entry, &[&own, scene]);
        let sampled = sampled_group.map(|group| Ok((bind("shade_sampled")?, group))).transpose()?;
        Ok(BoundShade { shade: bind("shade")?, sampled })
    }
}

/// The pass, bound.
pub struct BoundShade {
    shade: BoundKernel,
    /// With the invocations of a workgroup.
    sampled: Option<(BoundKernel, u32)>,
}

impl BoundShade {
    /// Adds the light of the chunk's lights to every point of the tile. Where the kernel has a queue, `arrange` is asked to make
    /// its length into an indirect dispatch's arguments for workgroups of so many invocations: those are at byte `offset` of `arguments`.
    pub fn record(
        &self,
        frame: &mut Frame<'_>,
        parameters: &ShadeParameters,
        arrange: impl FnOnce(&mut Frame<'_>, u32),
        (arguments, offset): (&Buffer, u64),
    ) {
        frame.run(&self.shade, parameters.tile.point_count, parameters);
        if let Some((sampled, group)) = &self.sampled {
            arrange(frame, *group);
            frame.run_indirect(sampled, arguments, offset, parameters);
        }
    }
}
