//! The passes of a frame: one host file each, one kernel of the same stem in `shaders/`.

pub mod cache;
pub mod cells;
pub mod classify;
pub mod denoise;
pub mod film;
pub mod fine_cells;
pub mod flux;
pub mod gather;
pub mod grid;
pub mod irradiance;
pub mod light_buffer;
pub mod path;
pub mod photons;
pub mod primary;
pub mod sample_lights;
pub mod shade;
pub mod shadow;
pub mod ward;
pub mod zones;

use kernel_kit::{
    Binding, Bindings, Buffer, Composed, Declared, Gpu, Host, Kernel, KernelTable, PART_ALIGNMENT, SharedStruct, Table,
    TableFormat, bindings, shared_struct,
};

use crate::Result;
use crate::gpu_scene::light_buffer::BufferedLight;
use crate::gpu_scene::lights::LightBindings;
use crate::gpu_scene::{CameraUniform, SceneBindings};
use crate::kernels::{GridShape, NOT_SAMPLED, compose_for, features_of};
use crate::specialisation::features::{Feature, Features};
use crate::specialisation::surface_vectors;

shared_struct! {
    /// Whole rows of the image or of its crop, or some pixels of these rows, with several samples per pixel; see
    /// `shaders/lib/tile.wgsl`.
    pub struct Tile {
        /// Width of the whole image in pixels.
        pub width: u32,
        /// Height of the whole image in pixels.
        pub height: u32,
        /// First column of the tile.
        pub first_column: u32,
        /// First row of the tile.
        pub first_row: u32,
        /// Pixels in a row of the tile.
        pub columns: u32,
        /// Rows of the tile.
        pub rows: u32,
        /// Pixels that get samples.
        pub pixel_count: u32,
        /// Points of the tile: pixels times samples.
        pub point_count: u32,
        /// Index of the first sample.
        pub first_sample: u32,
        /// Seed of the render.
        pub seed: u32,
        /// 1 where rays go through the centres of the pixels, 0 where anywhere in them. In general they go through a
        /// square around the centre, with a side of 1 - `centred` pixels.
        pub centred: f32,
        /// Samples of each pixel, whose points are neighbours.
        pub samples_per_pixel: u32,
    }
}

shared_struct! {
    /// A shading point; see `shaders/lib/point.wgsl`.
    pub struct Point {
        /// Origin of the rays that leave the surface, in normalised space: on the triangle, or on the smooth surface
        /// that it approximates.
        pub position: [f32; 3],
        /// Octahedral geometric normal on the viewer's side, or [`crate::kernels::INVALID_POINT`].
        pub normal: u32,
    }
}

/// The structs that host and kernels share. Compiling a kernel compares its structs with these, member by member.
pub const SHARED: &[&SharedStruct] = &[
    &Point::SHARED,
    &Tile::SHARED,
    &cache::CacheParameters::SHARED,
    &cells::CellParameters::SHARED,
    &cells::CellPoint::SHARED,
    &classify::ClassifyParameters::SHARED,
    &denoise::DenoiseParameters::SHARED,
    &film::FilmParameters::SHARED,
    &fine_cells::FineCell::SHARED,
    &fine_cells::FineCellView::SHARED,
    &flux::FluxParameters::SHARED,
    &gather::GatherParameters::SHARED,
    &gather::RecordOrigin::SHARED,
    &grid::RequestedCell::SHARED,
    &grid::GridParameters::SHARED,
    &GridShape::SHARED,
    &grid::Photon::SHARED,
    &irradiance::IrradianceParameters::SHARED,
    &BufferedLight::SHARED,
    &light_buffer::LightBufferParameters::SHARED,
    &photons::PhotonParameters::SHARED,
    &path::GatherHit::SHARED,
    &path::PathParameters::SHARED,
    &sample_lights::SampleLightsParameters::SHARED,
    &shade::ShadeParameters::SHARED,
    &shadow::ShadowParameters::SHARED,
    &ward::WardParameters::SHARED,
    &zones::ZoneParameters::SHARED,
    &ward::WardState::SHARED,
    &CameraUniform::SHARED,
];

/// The sets of bindings that several kernels use. Each kernel takes the bindings that it needs. Compiling fails for a
/// variable that is neither here nor in the pass's own bindings.
const COMMON: &[Declared] = &[
    SceneBindings::DECLARED,
    LightBindings::DECLARED,
    VisiblePointBindings::DECLARED,
    SampledPixelBindings::DECLARED,
    grid::SortedPhotonBindings::DECLARED,
    grid::PhotonGridBindings::DECLARED,
    irradiance::IrradianceMapBindings::DECLARED,
    cache::RecordBindings::DECLARED,
    path::PathQueueBindings::DECLARED,
    zones::ZoneListBindings::DECLARED,
    fine_cells::FineCellBindings::DECLARED,
    sample_lights::SampledLightBindings::DECLARED,
];

/// Composes a kernel and compiles its entry points. It takes the `constants` for which it declares an `override`. `own`
/// are the pass's own bindings.
pub(crate) fn kernel(
    gpu: &Gpu,
    stem: &str,
    features: &Features,
    constants: &[(&str, f64)],
    own: &[Declared],
) -> Result<Kernel> {
    let vectors = surface_vectors(features);
    // Renders that differ in other features share the kernel.
    let features = &features_of(stem, features);
    let named: Vec<Feature> = features.iter().collect();
    Kernel::kept(gpu, &format!("{stem} {named:?} {:?} {vectors} {constants:?}", features.functions()), || {
        let composed = compose_for(gpu, stem, features)?;
        let constants = &composed.overrides(&[constants, &[("surface_vectors", f64::from(vectors))]].concat());
        let opaque = &[("VisibleSurface", size_of::<[f32; 4]>() * vectors as usize)];
        Ok(Kernel::new(
            gpu,
            &composed,
            &Host { constants, shared: SHARED, opaque, own, common: Some(COMMON), late: late_entries(stem) },
        )?)
    })
}

/// The entry points of a kernel that change earlier samples: no first sample needs them.
fn late_entries(stem: &str) -> &'static [&'static str] {
    match stem {
        "cache" => &["change"],
        "film" => &["take_snapshot", "correct", "correct_squares"],
        _ => &[],
    }
}

/// Compiles the entry points of a kernel that belongs to no pass, but uses the passes' structs. `own` are its own
/// bindings; all others are checked when the kernel is bound.
///
/// # Errors
/// As [`Kernel::new`].
pub fn new_kernel(gpu: &Gpu, composed: &Composed, constants: &[(&str, f64)], own: &[Declared]) -> Result<Kernel> {
    Ok(Kernel::new(gpu, composed, &Host { constants, shared: SHARED, opaque: &[], own, common: None, late: &[] })?)
}

bindings! {
    /// The visible points and their surfaces; see `shaders/lib/visible_point.wgsl`.
    struct VisiblePointBindings {
        pub point_table: &Table,
        pub surface_table: &Table,
    }
}

bindings! {
    /// The pixels of a tile that get samples; see `shaders/lib/tile.wgsl`.
    struct SampledPixelBindings {
        pub sampled_pixels: &Buffer,
        pub list_indices: &Buffer,
    }
}

/// The pixels of a tile that get samples, where some get more than others.
pub struct SampledPixels {
    /// Their indices among the pixels of the tile's rows.
    pub list: Buffer,
    /// For each pixel of the rows its index in the list, or [`NOT_SAMPLED`].
    list_indices: Buffer,
}

impl SampledPixels {
    /// Room for tiles of up to `pixels` pixels, all of which are listed.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    fn new(gpu: &Gpu, pixels: u32) -> Result<SampledPixels> {
        let sampled = SampledPixels {
            list: gpu.buffer::<u32>("penumbra/sampled_pixels", pixels as usize)?,
            list_indices: gpu.buffer::<u32>("penumbra/list_indices", pixels as usize)?,
        };
        sampled.set_all(gpu);
        Ok(sampled)
    }

    /// Lists these pixels of a tile of `pixels` pixels.
    pub fn set(&self, gpu: &Gpu, list: &[u32], pixels: usize) {
        let mut indices = vec![NOT_SAMPLED; pixels];
        list.iter().zip(0..).for_each(|(pixel, index)| indices[*pixel as usize] = index);
        gpu.write(&self.list, list);
        gpu.write(&self.list_indices, &indices);
    }

    /// Lists all pixels.
    pub fn set_all(&self, gpu: &Gpu) {
        let pixels = (self.list.bytes / 4) as usize;
        self.set(gpu, &(0..pixels as u32).collect::<Vec<_>>(), pixels);
    }
}

/// The guides of denoisers: of the first surface that is neither a mirror nor clear glass.
pub struct GuideSamples {
    all: Buffer,
    /// Base colour, times the throughput of the way to the surface; w is 1 where chance chose what the ray shows.
    pub albedo: Buffer,
    /// Shading normal; w is 1 where chance chose the reflection in glass, or the blended surface.
    pub normal: Buffer,
    /// Position on the triangle; w is 1 where there is a surface.
    pub position: Buffer,
}

impl GuideSamples {
    /// Guides of `points` points.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, points: usize) -> Result<GuideSamples> {
        let room = (points.max(1) * size_of::<[f32; 4]>()).next_multiple_of(PART_ALIGNMENT as usize);
        Ok(GuideSamples::of(gpu.buffer::<u8>("penumbra/primary/guides", 3 * room)?))
    }

    /// In the three parts of a buffer.
    pub fn of(all: Buffer) -> GuideSamples {
        let room = all.bytes / 3;
        let part = |index: u64, label: &str| all.part(label, index * room, room);
        GuideSamples {
            albedo: part(0, "penumbra/primary/guide_albedos"),
            normal: part(1, "penumbra/primary/guide_normals"),
            position: part(2, "penumbra/primary/guide_positions"),
            all,
        }
    }
}

/// The buffers that the passes of a tile share, for [`Tile::point_count`] points.
pub struct TileBuffers {
    /// [`Point`]s.
    pub points: KernelTable,
    /// Packed surfaces; see `shaders/lib/point.wgsl`.
    pub surfaces: KernelTable,
    /// Emission and direct light; w is 1 where the camera ray hit a surface or the environment.
    pub radiance_direct: Buffer,
    /// Indirect light, of one bounce and more; `None` if the technique computes none.
    pub radiance_indirect: Option<Buffer>,
    /// Base colour; `None` without this AOV.
    pub albedo_samples: Option<Buffer>,
    /// Shading normal; `None` without this AOV.
    pub normal_samples: Option<Buffer>,
    /// Position and depth; `None` without this AOV.
    pub position_samples: Option<Buffer>,
    /// The guides of denoisers; `None` without denoising.
    pub guides: Option<GuideSamples>,
    /// The pixels that get samples; `None` if all do.
    pub sampled_pixels: Option<SampledPixels>,
    /// One zero vector, bound in place of a component of the radiance that the technique does not compute.
    pub zeros: Buffer,
    /// One word for each [`crate::statistics::Counter`].
    pub counters: Buffer,
    /// Vectors of a point's surface.
    surface_vectors: u32,
}

impl Bindings for TileBuffers {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        let points = VisiblePointBindings { point_table: &self.points.table, surface_table: &self.surfaces.table };
        points.find(name).or_else(|| {
            let SampledPixels { list, list_indices } = self.sampled_pixels.as_ref()?;
            SampledPixelBindings { sampled_pixels: list, list_indices }.find(name)
        })
    }
}

impl TileBuffers {
    /// Buffers for tiles of `points` points.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, features: &Features, points: u32, indirect: bool) -> Result<TileBuffers> {
        let adaptive = features.has(Feature::AdaptiveSampling);
        let sampled_pixels = adaptive.then(|| SampledPixels::new(gpu, points)).transpose()?;
        let points = points as usize;
        let vectors = surface_vectors(features) as usize;
        let point_buffer = gpu.buffer::<Point>("penumbra/primary/points", points)?;
        let surface_buffer = gpu.buffer::<[f32; 4]>("penumbra/primary/surfaces", points * vectors)?;
        let samples = |on: bool, name: &str| on.then(|| gpu.buffer::<[f32; 4]>(name, points)).transpose();
        Ok(TileBuffers {
            points: gpu.table_of(point_buffer, TableFormat::Uint)?,
            surfaces: gpu.table_of(surface_buffer, TableFormat::Uint)?,
            radiance_direct: gpu.buffer::<[f32; 4]>("penumbra/shade/radiance_direct", points)?,
            radiance_indirect: samples(indirect, "penumbra/shade/radiance_indirect")?,
            albedo_samples: samples(features.has(Feature::AovAlbedo), "penumbra/primary/albedo_samples")?,
            normal_samples: samples(features.has(Feature::AovNormal), "penumbra/primary/normal_samples")?,
            position_samples: samples(features.has(Feature::AovPosition), "penumbra/primary/position_samples")?,
            guides: features.has(Feature::Guides).then(|| GuideSamples::new(gpu, points)).transpose()?,
            sampled_pixels,
            zeros: gpu.buffer::<[f32; 4]>("penumbra/film/zeros", 1)?,
            counters: gpu.buffer::<u32>("penumbra/counters", crate::statistics::Counter::COUNT)?,
            surface_vectors: vectors as u32,
        })
    }

    /// Inputs of the film's planes besides the samples.
    pub fn film_inputs(&self) -> film::Inputs<'_> {
        film::Inputs {
            counters: &self.counters,
            sampled_pixels: self.sampled_pixels.as_ref().map(|pixels| &pixels.list),
        }
    }

    /// The buffer for indirect light, or an error that names the `kernel` that requires it.
    ///
    /// # Errors
    /// [`Error::Kernel`](crate::Error::Kernel) where the technique computes no indirect light.
    pub(crate) fn required_indirect(&self, kernel: &str) -> Result<&Buffer> {
        let missing = || crate::Error::kernel(kernel, "nothing is bound to the variable 'radiance_indirect'");
        self.radiance_indirect.as_ref().ok_or_else(missing)
    }

    /// Number of points that the buffers have room for.
    pub fn capacity(&self) -> u32 {
        (self.points.buffer.bytes / size_of::<Point>() as u64) as u32
    }

    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        let optional = [&self.radiance_indirect, &self.albedo_samples, &self.normal_samples, &self.position_samples];
        let fixed = [&self.points.buffer, &self.surfaces.buffer, &self.radiance_direct, &self.counters];
        let guides = self.guides.iter().map(|guides| &guides.all);
        let lists = self.sampled_pixels.iter().flat_map(|sampled| [&sampled.list, &sampled.list_indices]);
        fixed.into_iter().chain(optional.into_iter().flatten()).chain(guides).chain(lists).map(|b| b.bytes).sum()
    }
}
