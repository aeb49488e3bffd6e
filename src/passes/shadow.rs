//! shadow: shadow rays for the points that the photons do not decide, and audits of those that they do.

use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources};
use crate::{Result, shared_struct};

use super::{Tile, TileBuffers, kernel};

shared_struct! {
    /// Immediates of the pass; see `shaders/shadow.wgsl`.
    pub struct ShadowParameters {
        /// The tile.
        pub tile: Tile,
        /// First light of the chunk.
        pub first_light: u32,
        /// Light points of a slot.
        pub light_samples: u32,
        /// Words of visibilities of a slot: 32 light points each.
        pub visibility_words: u32,
        /// Photons that audits can add to the map.
        pub heal_capacity: u32,
    }
}

/// The pass; see `shaders/shadow.wgsl`.
pub struct Shadow {
    kernel: Kernel,
    audits: bool,
}

/// What the pass reads and writes beside the tile's buffers.
pub struct ShadowBuffers<'a> {
    /// Class words of the slots.
    pub classes: &'a Buffer,
    /// Slots to trace, and how many.
    pub boundary_queue: &'a Buffer,
    /// Slots to audit.
    pub audit_queue: &'a Buffer,
    /// Lengths of the queues.
    pub queue_lengths: &'a Buffer,
    /// Visibility bits of the slots.
    pub visibility: &'a Buffer,
    /// Photons that audits add to the map, and how many; none where nothing is audited.
    pub heal: Option<[&'a Buffer; 2]>,
}

impl Shadow {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Shadow> {
        let kernel = kernel(
            gpu,
            "shadow",
            features,
            constants,
            &["points", "boundary_queue", "visibility", "counters", "radiance_direct"],
        )?;
        Ok(Shadow { kernel, audits: features.has("audit") })
    }

    /// Invocations in a workgroup, for the arguments of the indirect dispatches.
    pub fn workgroup_size(&self) -> u32 {
        self.kernel.workgroup_size("shadow").expect("the kernel has this entry point")
    }

    /// Binds it.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        buffers: &ShadowBuffers<'_>,
        scene: &dyn Bindings,
    ) -> Result<BoundShadow> {
        let mut own = Resources::new()
            .with("points", &tile.points)
            .with("counters", &tile.counters)
            .with("radiance_direct", &tile.radiance_direct)
            .with("classes", buffers.classes)
            .with("boundary_queue", buffers.boundary_queue)
            .with("audit_queue", buffers.audit_queue)
            .with("queue_lengths", buffers.queue_lengths)
            .with("visibility", buffers.visibility);
        if let Some([photons, count]) = buffers.heal {
            own = own.with("heal_photons", photons).with("heal_count", count);
        }
        let bind = |entry| self.kernel.bind(gpu, entry, &[&own, scene]);
        Ok(BoundShadow { shadow: bind("shadow")?, audit: self.audits.then(|| bind("audit")).transpose()? })
    }
}

/// The pass, bound.
pub struct BoundShadow {
    shadow: BoundKernel,
    audit: Option<BoundKernel>,
}

impl BoundShadow {
    /// Traces the queued candidates and audits: as many as `arguments` says, an indirect dispatch's three words for the
    /// boundary queue at byte `boundary`, for the audits at byte `audit`.
    pub fn record(
        &self,
        frame: &mut Frame<'_>,
        arguments: &Buffer,
        boundary: u64,
        audit: u64,
        parameters: &ShadowParameters,
    ) {
        self.trace(frame, arguments, boundary, parameters);
        self.audit(frame, arguments, audit, parameters);
    }

    /// Traces the shadow rays of the boundary queue, whose indirect arguments are at byte `offset`.
    pub fn trace(&self, frame: &mut Frame<'_>, arguments: &Buffer, offset: u64, parameters: &ShadowParameters) {
        frame.run_indirect(&self.shadow, arguments, offset, parameters);
    }

    /// Traces the shadow rays of the audit queue, where there are audits.
    pub fn audit(&self, frame: &mut Frame<'_>, arguments: &Buffer, offset: u64, parameters: &ShadowParameters) {
        if let Some(kernel) = &self.audit {
            frame.run_indirect(kernel, arguments, offset, parameters);
        }
    }
}
