//! Pass `shadow`: traces shadow rays for boundary and unknown candidates, and audits lit and shadowed ones.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, PART_ALIGNMENT, bindings, shared_struct};

use super::grid::Photon;
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::{Feature, Features};

shared_struct! {
    /// Immediates of the pass; see `shaders/shadow.wgsl`.
    pub struct ShadowParameters {
        /// The tile.
        pub tile: Tile,
        /// First light of the chunk, or first sampled light index.
        pub first_light: u32,
        /// Light points of a candidate.
        pub light_samples: u32,
        /// Words of visibilities of a candidate: 32 light points each.
        pub visibility_words: u32,
        /// Number of photons for which [`Repairs`] has room.
        pub repair_capacity: u32,
    }
}

bindings! {
    /// Buffers of shadow rays.
    struct ShadowBindings {
        pub boundary_queue: &Buffer,
        pub queue_lengths: &Buffer,
        pub visibility: &Buffer,
        pub counters: &Buffer,
        pub radiance_direct: &Buffer,
    }
}

bindings! {
    /// Further buffers of audits.
    struct AuditBindings {
        pub classes: &Buffer,
        pub audit_queue: &Buffer,
        pub repairs: Option<&Buffer>,
    }
}

/// The pass; see `shaders/shadow.wgsl`.
pub struct Shadow {
    kernel: Kernel,
    audits: bool,
}

/// Buffers of the pass, apart from the tile's.
pub struct ShadowBuffers<'a> {
    /// Class words of the candidates.
    pub classes: &'a Buffer,
    /// Candidates to trace.
    pub boundary_queue: &'a Buffer,
    /// Candidates to audit.
    pub audit_queue: &'a Buffer,
    /// Lengths of the queues, by [`crate::kernels::Queue`].
    pub queue_lengths: &'a Buffer,
    /// Visibility bits of the candidates.
    pub visibility: &'a Buffer,
    /// Photons that audits add to the map; `None` without a map.
    pub repairs: Option<&'a Repairs>,
}

/// Photons of audits for the visibility map.
pub struct Repairs {
    all: Buffer,
    /// Their number, also of those that there was no room for.
    pub count: Buffer,
    /// [`Photon`]s.
    pub photons: Buffer,
}

impl Repairs {
    /// Room for `photons` photons.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, photons: u32) -> Result<Repairs> {
        let bytes = u64::from(photons) * size_of::<Photon>() as u64;
        let all = gpu.buffer::<u8>("penumbra/shadow/repairs", (PART_ALIGNMENT + bytes) as usize)?;
        Ok(Repairs::of(all))
    }

    /// In a buffer of that size.
    pub fn of(all: Buffer) -> Repairs {
        let photons = all.part("penumbra/shadow/repair_photons", PART_ALIGNMENT, all.bytes - PART_ALIGNMENT);
        Repairs { count: all.part("penumbra/shadow/repair_count", 0, 4), photons, all }
    }
}

impl Shadow {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Shadow> {
        let audits = features.has(Feature::Audit);
        let mut own = vec![ShadowBindings::DECLARED];
        own.extend(audits.then_some(AuditBindings::DECLARED));
        Ok(Shadow { kernel: kernel(gpu, "shadow", features, constants, &own)?, audits })
    }

    /// Invocations in a workgroup, for the arguments of the indirect dispatches.
    pub fn workgroup_size(&self) -> u32 {
        self.kernel.workgroup_size("shadow").expect("the kernel has this entry point")
    }

    /// Binds the pass.
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
        let own = ShadowBindings {
            boundary_queue: buffers.boundary_queue,
            queue_lengths: buffers.queue_lengths,
            visibility: buffers.visibility,
            counters: &tile.counters,
            radiance_direct: &tile.radiance_direct,
        };
        let audit = self.audits.then_some(AuditBindings {
            classes: buffers.classes,
            audit_queue: buffers.audit_queue,
            repairs: buffers.repairs.map(|repairs| &repairs.all),
        });
        let mut sets: Vec<&dyn Bindings> = vec![&own, tile, scene];
        sets.extend(audit.as_ref().map(|audit| audit as &dyn Bindings));
        let bind = |entry| self.kernel.bind(gpu, entry, &sets);
        Ok(BoundShadow { shadow: bind("shadow")?, audit: self.audits.then(|| bind("audit")).transpose()? })
    }
}

/// The pass, bound.
pub struct BoundShadow {
    shadow: BoundKernel,
    audit: Option<BoundKernel>,
}

impl BoundShadow {
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
