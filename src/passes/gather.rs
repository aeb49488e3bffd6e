//! Pass `gather`: the final gather of irradiance records, with their gradients (Ward and Heckbert 1992).

use kernel_kit::{Bindings, BoundKernel, Buffer, Gpu, Kernel, bindings, shared_struct};

use super::{TileBuffers, kernel};
use crate::Result;
use crate::kernels::RECORD_HEAD_TEXELS;
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/gather.wgsl`.
    pub struct GatherParameters {
        first: u32,
        count: u32,
        rings: u32,
        sectors: u32,
        max_bounces: u32,
        seed: u32,
        first_record: u32,
        height: u32,
    }
}

bindings! {
    /// Everything that the kernel reads and writes except the scene and the global map.
    struct GatherBindings {
        pub counters: &Buffer,
        pub wanted: &Buffer,
        pub gathered: &Buffer,
        pub follow_count: &Buffer,
        pub follow_arguments: &Buffer,
        pub follow_rays: &Buffer,
        pub follow_hits: &Buffer,
        pub record_heads: &Buffer,
        pub record_values: &Buffer,
    }
}

shared_struct! {
    /// Head of an irradiance record; see `shaders/lib/record.wgsl`. Lengths are normalised.
    pub struct RecordHead {
        /// Position.
        pub position: [f32; 3],
        /// As `gather` writes it, the size of a pixel at the position; in the table that points are interpolated from,
        /// the record's radius. 0 marks a record that is not finite, which is not used.
        pub size: f32,
        /// Unit normal.
        pub normal: [f32; 3],
        /// Harmonic mean of the distances of its rays' hits, or less where the gradient brings the irradiance to 0
        /// sooner.
        pub distance: f32,
    }
}

const _: () = assert!(RECORD_HEAD_TEXELS as usize * size_of::<[f32; 4]>() == size_of::<RecordHead>());

/// Rays in a dispatch: 4 MiB of results, and too short for a desktop's watchdog to stop it.
const BATCH_RAYS: u32 = 1 << 18;

/// The pass; see `shaders/gather.wgsl`.
pub struct Gather(Kernel);

/// The pass, bound, with its buffers.
pub struct BoundGather {
    gather: BoundKernel,
    arrange_follow: BoundKernel,
    follow: BoundKernel,
    record: BoundKernel,
    wanted: Buffer,
    heads: Buffer,
    follow_count: Buffer,
    follow_arguments: Buffer,
    strata: [u32; 2],
}

impl Gather {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Gather> {
        Ok(Gather(kernel(gpu, "gather", features, constants, &[GatherBindings::DECLARED])?))
    }

    /// Binds it to a tile's buffers, for records of about `rays` rays whose values go to `values`.
    ///
    /// # Errors
    /// As [`Kernel::bind`] and [`Gpu::buffer`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        rays: u32,
        values: &Buffer,
        scene: &[&dyn Bindings],
    ) -> Result<BoundGather> {
        let strata = strata(rays);
        let rays = BATCH_RAYS.max(strata[0] * strata[1]) as usize;
        let points = tile.capacity() as usize;
        let wanted = gpu.buffer::<u32>("penumbra/gather/wanted", points)?;
        let heads = gpu.buffer::<RecordHead>("penumbra/gather/record_heads", points)?;
        let follow_count = gpu.buffer::<u32>("penumbra/gather/follow_count", 1)?;
        let follow_arguments = gpu.buffer::<u32>("penumbra/gather/follow_arguments", 3)?;
        let own = GatherBindings {
            counters: &tile.counters,
            wanted: &wanted,
            gathered: &gpu.buffer::<[f32; 4]>("penumbra/gather/gathered", rays)?,
            follow_count: &follow_count,
            follow_arguments: &follow_arguments,
            follow_rays: &gpu.buffer::<u32>("penumbra/gather/follow_rays", rays)?,
            follow_hits: &gpu.buffer::<[f32; 4]>("penumbra/gather/follow_hits", rays)?,
            record_heads: &heads,
            record_values: values,
        };
        let mut sets: Vec<&dyn Bindings> = vec![&own, tile];
        sets.extend(scene);
        let entry = |name: &str| self.0.bind(gpu, name, &sets);
        Ok(BoundGather {
            gather: entry("gather")?,
            arrange_follow: entry("arrange_follow")?,
            follow: entry("follow")?,
            record: entry("record")?,
            wanted,
            heads,
            follow_count,
            follow_arguments,
            strata,
        })
    }
}

/// Parameters of all gathers of a render.
#[derive(Clone, Copy, Debug)]
pub struct GatherSettings {
    /// Maximum number of bounces of indirect light.
    pub max_bounces: u32,
    /// Seed of the render.
    pub seed: u32,
    /// Height of the image in pixels.
    pub height: u32,
}

impl BoundGather {
    /// Rays of a record: one for each stratum.
    pub fn rays(&self) -> u32 {
        self.strata[0] * self.strata[1]
    }

    /// Gathers records at the tile's points `wanted` and returns their heads. Their values follow those of the `before`
    /// earlier records.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn gather(&self, gpu: &Gpu, wanted: &[u32], before: u32, settings: GatherSettings) -> Result<Vec<RecordHead>> {
        gpu.write(&self.wanted, wanted);
        let [rings, sectors] = self.strata;
        let rays = rings * sectors;
        let batch = (BATCH_RAYS / rays).max(1);
        let wanted = wanted.len() as u32;
        for first in (0..wanted).step_by(batch as usize) {
            let count = batch.min(wanted - first);
            let GatherSettings { max_bounces, seed, height } = settings;
            let first_record = before + first;
            let parameters = GatherParameters { first, count, rings, sectors, max_bounces, seed, first_record, height };
            let mut frame = gpu.frame("gather");
            frame.clear(&self.follow_count);
            frame.run(&self.gather, count * rays, &parameters);
            frame.run(&self.arrange_follow, 1, &parameters);
            frame.run_indirect(&self.follow, &self.follow_arguments, 0, &parameters);
            frame.run(&self.record, count, &parameters);
            frame.submit()?;
        }
        Ok(gpu.read(&self.heads, wanted as usize)?)
    }
}

/// Numbers of rings and sectors that divide the hemisphere into about `rays` strata, each as wide as it is high (Ward
/// and Heckbert 1992: pi times as many sectors as rings).
fn strata(rays: u32) -> [u32; 2] {
    let rings = (f64::from(rays) / std::f64::consts::PI).sqrt().round().max(1.0);
    let sectors = (f64::from(rays) / rings).round().max(1.0);
    [rings as u32, sectors as u32]
}
