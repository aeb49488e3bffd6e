//! The parts of a render that depend on its view: the camera, and the size of the image.

use std::time::Instant;

use kernel_kit::Gpu;

use super::host_memory::ImageMemory;
use super::tiles::{TileFilm, TileSize};
use crate::Result;
use crate::gpu_scene::{CameraUniform, GpuScene};
use crate::light_transport::first_pass::{FirstPass, MadeMaps};
use crate::light_transport::kernels::{DirectKernels, IndirectKernels};
use crate::light_transport::lighting::Lighting;
use crate::light_transport::shared::Shared;
use crate::passes::TileBuffers;
use crate::passes::film::{Film, Plane};
use crate::passes::primary::{BoundPrimary, Primary};
use crate::scene::{Camera, Scene};
use crate::settings::Settings;
use crate::settings::stages::{grows, settings_of_stage, stage};
use crate::specialisation::Specialisation;
use crate::specialisation::features::Features;
use crate::statistics::totals::Totals;
use crate::techniques::implementation;

/// The inputs of a view.
pub(super) struct ViewOf<'a> {
    pub gpu: &'a Gpu,
    pub scene: &'a Scene,
    pub gpu_scene: &'a GpuScene,
    pub features: &'a Features,
    pub camera: &'a Camera,
    pub settings: &'a Settings,
}

/// The parts of a render that depend on its camera and on the size of its image.
pub(super) struct PreparedView {
    pub primary: BoundPrimary,
    /// Kept to correct samples that are already summed.
    pub film: Film,
    /// The parts that the technique's first pass made.
    pub lighting: Lighting,
    /// Kept to make new photons and records.
    pub indirect_kernels: IndirectKernels,
    pub buffers: TileBuffers,
    pub tiles: Vec<TileFilm>,
    pub tile_size: TileSize,
    /// How many photons and gather rays there are so far; see `settings/stages.rs`.
    pub stage: i32,
    /// The stages that it had after its first one, in order.
    pub later_stages: Vec<i32>,
}

impl ViewOf<'_> {
    /// Runs the technique's first pass, but for the maps that are already made, and makes empty films.
    pub fn prepare(
        &self,
        kernels: Kernels,
        tile_size: TileSize,
        made: MadeMaps,
        totals: &mut Totals,
    ) -> Result<PreparedView> {
        let start = Instant::now();
        let ViewOf { gpu, scene, gpu_scene, features, camera, settings } = *self;
        let Kernels { primary, film, direct, indirect: indirect_kernels } = kernels;
        let buffers = TileBuffers::new(gpu, features, tile_size.points, indirect_kernels.has_light)?;
        let primary = primary.bind(gpu, &buffers, gpu_scene)?;
        let stage = stage(settings, 0, grows(settings));
        let mut first_pass = FirstPass {
            shared: Shared { gpu, scene, gpu_scene, tile: &buffers },
            direct_kernels: direct,
            indirect_kernels: &indirect_kernels,
            primary: &primary,
            camera,
            camera_uniform: &CameraUniform::new(camera, settings.image.width, settings.image.height),
            settings,
            indirect_settings: &settings_of_stage(settings, stage),
            points: tile_size.points,
            totals,
            made,
            lighting: Lighting::default(),
        };
        (implementation(settings.technique).first_pass)(&mut first_pass)?;
        let lighting = first_pass.lighting;
        let tiles = TileFilm::of_all_tiles(gpu, &film, &buffers, lighting.direct.as_ref(), tile_size, settings)?;
        gpu.wait("preparation")?;
        totals.frame_bytes = buffers.bytes() + tiles.iter().flat_map(TileFilm::planes).map(Plane::bytes).sum::<u64>();
        totals.frame_bytes += lighting.frame_bytes();
        totals.time_render = start.elapsed().as_secs_f64();
        Ok(PreparedView {
            primary,
            film,
            lighting,
            indirect_kernels,
            buffers,
            tiles,
            tile_size,
            stage,
            later_stages: Vec::new(),
        })
    }
}

/// The kernels of a render.
pub(super) struct Kernels {
    primary: Primary,
    film: Film,
    direct: DirectKernels,
    indirect: IndirectKernels,
}

impl Kernels {
    /// Composes the kernels, and has the driver compile them. Returns the seconds that this took, too.
    pub fn compile(
        gpu: &Gpu,
        specialisation: &Specialisation,
        gpu_scene: &GpuScene,
        settings: &Settings,
    ) -> Result<(Kernels, f64)> {
        let start = Instant::now();
        let kernels = Kernels::new(gpu, specialisation, &gpu_scene.constants(), settings)?;
        gpu.compile_ahead(gpu_scene)?;
        Ok((kernels, start.elapsed().as_secs_f64()))
    }

    /// The size of the tiles. Refuses an image that has no room in the machine's memory, once that of `last` is
    /// released.
    pub fn fit(
        &self,
        gpu: &Gpu,
        scene: &Scene,
        features: &Features,
        settings: &Settings,
        last: Option<ImageMemory>,
    ) -> Result<TileSize> {
        let memory = ImageMemory::of(features, self.indirect.has_light, settings);
        memory.check(last, gpu.info.is_software(), settings)?;
        TileSize::new(features, scene.lights.len(), settings)
    }

    fn new(
        gpu: &Gpu,
        specialisation: &Specialisation,
        constants: &[(&str, f64)],
        settings: &Settings,
    ) -> Result<Kernels> {
        let features = &specialisation.features;
        let ((direct, primary), (film, indirect)) = rayon::join(
            || {
                rayon::join(
                    || DirectKernels::new(gpu, features, constants, settings),
                    || Primary::new(gpu, features, constants),
                )
            },
            || rayon::join(|| Film::new(gpu, features), || IndirectKernels::new(gpu, specialisation, constants)),
        );
        Ok(Kernels { primary: primary?, film: film?, direct: direct?, indirect: indirect? })
    }
}
