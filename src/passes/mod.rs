//! The passes of a frame: one host file each, one kernel of the same stem in `shaders/`.

pub mod cache;
pub mod cells;
pub mod classify;
pub mod film;
pub mod flux;
pub mod gather;
pub mod grid;
pub mod irradiance;
pub mod path;
pub mod photons;
pub mod primary;
pub mod sample_lights;
pub mod shade;
pub mod shadow;
pub mod ward;
pub mod zones;

use crate::gpu::{Buffer, Features, Gpu, Kernel, compose};
use crate::specialisation::surface_vectors;
use crate::{Result, shared_struct};

shared_struct! {
    /// Some whole rows of the image, several samples of each pixel at once; see `shaders/lib/tile.wgsl`.
    pub struct Tile {
        /// Width of the image in pixels.
        pub width: u32,
        /// Height of the image in pixels.
        pub height: u32,
        /// First row of the tile.
        pub first_row: u32,
        /// Pixels of the tile.
        pub pixel_count: u32,
        /// Points of the tile: pixels times samples.
        pub point_count: u32,
        /// Index of the first sample.
        pub first_sample: u32,
        /// Seed of the render.
        pub seed: u32,
        /// 1 where rays go through the middles of the pixels.
        pub centred: u32,
    }
}

shared_struct! {
    /// A point to be lit; see `shaders/lib/point.wgsl`.
    pub struct Point {
        /// Where rays leave the surface, normalised: on the triangle, or on the smooth surface that it stands for.
        pub position: [f32; 3],
        /// Octahedral geometric normal on the viewer's side, or [`INVALID_POINT`].
        pub normal: u32,
    }
}

/// [`Point::normal`] where nothing is to be lit: the ray left the scene, or met an unlit surface. No normal has this
/// code, as -32768 is no signed 16-bit fraction.
pub const INVALID_POINT: u32 = 0x8000_8000;

/// Composes a kernel and compiles its entry points, with those of `constants` that it has `override`s for.
pub(crate) fn kernel(
    gpu: &Gpu,
    stem: &str,
    features: &Features,
    constants: &[(&str, f64)],
    own: &[&str],
) -> Result<Kernel> {
    let composed = compose::compose(stem, features)?;
    Kernel::new(gpu, &composed, &composed.overrides(constants), own)
}

/// What the passes of a tile hand to each other: buffers for [`Tile::point_count`] points.
pub struct TileBuffers {
    /// [`Point`]s.
    pub points: Buffer,
    /// Packed surfaces; see `shaders/lib/point.wgsl`.
    pub surfaces: Buffer,
    /// Emission and direct light; w is 1 where the ray met something.
    pub radiance_direct: Buffer,
    /// Light after one bounce and more; none where the technique computes none.
    pub radiance_indirect: Option<Buffer>,
    /// Base colour, where asked for.
    pub albedo_samples: Option<Buffer>,
    /// Shading normal, where asked for.
    pub normal_samples: Option<Buffer>,
    /// Position and depth, where asked for.
    pub position_samples: Option<Buffer>,
    /// One zero vector, for the part of a sum that a technique does not have.
    pub zeros: Buffer,
    /// What the kernels count: a word for each [`crate::statistics::Counter`].
    pub counters: Buffer,
}

impl TileBuffers {
    /// Buffers for tiles of `points` points.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, features: &Features, points: u32, indirect: bool) -> Result<TileBuffers> {
        let points = points as usize;
        let vectors = surface_vectors(features) as usize;
        let samples = |on: bool, name: &str| on.then(|| gpu.buffer::<[f32; 4]>(name, points)).transpose();
        Ok(TileBuffers {
            points: gpu.buffer::<Point>("penumbra/primary/points", points)?,
            surfaces: gpu.buffer::<[f32; 4]>("penumbra/primary/surfaces", points * vectors)?,
            radiance_direct: gpu.buffer::<[f32; 4]>("penumbra/shade/radiance_direct", points)?,
            radiance_indirect: samples(indirect, "penumbra/shade/radiance_indirect")?,
            albedo_samples: samples(features.has("aov_albedo"), "penumbra/primary/albedo_samples")?,
            normal_samples: samples(features.has("aov_normal"), "penumbra/primary/normal_samples")?,
            position_samples: samples(features.has("aov_position"), "penumbra/primary/position_samples")?,
            zeros: gpu.buffer::<[f32; 4]>("penumbra/film/zeros", 1)?,
            counters: gpu.buffer::<u32>("penumbra/counters", crate::statistics::Counter::COUNT)?,
        })
    }

    /// Points that they have room for, at least.
    pub fn capacity(&self) -> u32 {
        (self.points.bytes / size_of::<Point>() as u64) as u32
    }

    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        let optional = [&self.radiance_indirect, &self.albedo_samples, &self.normal_samples, &self.position_samples];
        let fixed = [&self.points, &self.surfaces, &self.radiance_direct, &self.counters];
        fixed.into_iter().chain(optional.into_iter().flatten()).map(|b| b.bytes).sum()
    }
}
