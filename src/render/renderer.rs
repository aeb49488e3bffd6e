//! [`Renderer`]: a render in progress, and its preparation.

use std::collections::BTreeMap;
use std::time::Instant;

use kernel_kit::Gpu;

use super::backup::Backup;
use super::blocks::{Blocks, PixelErrors};
use super::growth::Growth;
use super::notes::notes;
use super::photon_benefit::of_first_sample;
use super::pieces::PieceSums;
use super::stages::{grows, settings_of_stage, stage};
use super::tiles::{TileFilm, TileSize};
use crate::Result;
use crate::bvh::Bvh;
use crate::gpu_scene::lights::LightInfo;
use crate::gpu_scene::{CameraUniform, GpuScene};
use crate::light_transport::first_pass::{FirstPass, MadeMaps};
use crate::light_transport::global_map::GlobalMap;
use crate::light_transport::irradiance_cache::Records;
use crate::light_transport::kernels::{DirectKernels, IndirectKernels};
use crate::light_transport::lighting::Lighting;
use crate::light_transport::shared::Shared;
use crate::passes::TileBuffers;
use crate::passes::film::{Film, Plane};
use crate::passes::primary::{BoundPrimary, Primary};
use crate::scene::{Camera, Scene};
use crate::settings::Settings;
use crate::specialisation::Specialisation;
use crate::specialisation::features::{Feature, Features};
use crate::statistics::totals::Totals;
use crate::techniques::implementation;

/// A render in progress.
pub struct Renderer<'g> {
    pub(super) gpu: &'g Gpu,
    pub(super) scene: Scene,
    pub(super) camera: Camera,
    /// The settings of this view: as [`Renderer::settings`], except for the image's size and, in a preview, the number
    /// of photons.
    pub(super) settings: Settings,
    /// Visibility photons per light that the user requested; `None`: the number follows from the size of the image.
    pub(super) requested_photons: Option<u32>,
    pub(super) specialisation: Specialisation,
    pub(super) notes: Vec<String>,
    pub(super) gpu_scene: GpuScene,
    pub(super) primary: BoundPrimary,
    /// Kept to correct samples that are already summed.
    pub(super) film: Film,
    /// The parts that the technique's first pass made.
    pub(super) lighting: Lighting,
    /// Kept to make new photons and records.
    pub(super) indirect_kernels: IndirectKernels,
    /// How many photons and gather rays there are so far; see `stages.rs`.
    pub(super) stage: i32,
    /// The estimates that decide when records get more gather rays; `None` before the first sample.
    pub(super) growth: Option<Growth>,
    /// The global map of the first stage, for the next view. `None` while that map is in use, and before
    /// [`Renderer::set_view`] was called.
    pub(super) first_map: Option<GlobalMap>,
    /// The irradiance records of earlier previews, unless they are in use.
    pub(super) kept_records: Option<Records>,
    /// Whether the view is a preview ([`Renderer::preview`]), which also uses the records of earlier previews.
    pub(super) is_preview: bool,
    /// Whether other views preceded this one.
    pub(super) has_other_views: bool,
    pub(super) buffers: TileBuffers,
    pub(super) tiles: Vec<TileFilm>,
    pub(super) tile_size: TileSize,
    /// Samples per pixel: the maximum over the pixels with `ImageSettings::noise`, the mean with `Sampling::Adaptive`.
    pub(super) samples: u32,
    /// Which pixels get samples, if some get more than others.
    pub(super) blocks: Option<Blocks>,
    /// Estimated errors of pixels that decided on gather rays, kept for the decision on samples that follows.
    pub(super) errors: Option<PixelErrors>,
    /// See [`crate::passes::shade::ShadeParameters::at_once`].
    pub(super) shade_at_once: bool,
    /// The specialisation with visibility photons, until the first sample has shown whether they pay off; see
    /// [`Renderer::begin_trial`].
    pub(super) with_photons: Option<Specialisation>,
    /// Calls of [`Renderer::render_batch`] so far.
    pub(super) batches: u32,
    pub(super) totals: Totals,
    /// Seconds of one sample of every pixel, by the last batch; `None` before the first batch.
    pub(super) seconds_per_sample: Option<f64>,
    /// Seconds of the last decision on which pixels get more samples, in adaptive sampling with a fixed budget.
    pub(super) seconds_to_allocate: Option<f64>,
    /// [`Gpu::pass_times`] before the render: those of earlier renders on this device.
    pub(super) earlier_pass_times: BTreeMap<String, f64>,
    /// The sums of a piece; `None` for other renders, whose sums are in the film.
    pub(super) piece_sums: Option<PieceSums>,
    /// A copy of the state in case the device is lost; `None` if the caller does not request this.
    pub(super) backup: Option<Backup>,
}

impl<'g> Renderer<'g> {
    /// Prepares the first sample: builds the BVH, compiles kernels, uploads the scene, and runs the technique's first
    /// pass.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for settings out of range, [`crate::Error::Buffer`] for what the device cannot hold, and
    /// those of [`Gpu::check`].
    pub fn new(gpu: &'g Gpu, scene: Scene, camera: &Camera, settings: &Settings) -> Result<Renderer<'g>> {
        Renderer::with_features(gpu, scene, camera, settings, &[])
    }

    /// Like [`Renderer::new`], with features switched on or off whatever the scene needs, to measure the cost of each.
    /// Kernels, buffers and tables follow the switches until the trial of photons ends without them (to avoid this,
    /// request photons), or until [`Renderer::set_view`] is called. Visibility photons are emitted before the first
    /// sample.
    ///
    /// # Errors
    /// Those of [`Renderer::new`], and [`crate::Error::Kernel`] for a feature that lacks what only a scene that needs
    /// it has.
    #[doc(hidden)]
    pub fn with_features(
        gpu: &'g Gpu,
        scene: Scene,
        camera: &Camera,
        settings: &Settings,
        forced: &[(Feature, bool)],
    ) -> Result<Renderer<'g>> {
        Renderer::specialised(gpu, scene, camera, settings, settings.image.spp, forced)
    }

    /// Like [`Renderer::new`], but begins with a preview of `size`: see [`Renderer::preview`]. It has visibility photons
    /// only if they are requested or shown, because a single sample traces few shadow rays. [`Renderer::set_view`]
    /// begins the image.
    ///
    /// # Errors
    /// Those of [`Renderer::new`].
    pub fn with_preview(
        gpu: &'g Gpu,
        scene: Scene,
        camera: &Camera,
        settings: &Settings,
        [width, height]: [u32; 2],
    ) -> Result<Renderer<'g>> {
        let settings = settings.clone().with(|s| (s.image.width, s.image.height) = (width, height));
        let mut renderer = Renderer::specialised(gpu, scene, camera, &settings, 1, &[])?;
        (renderer.is_preview, renderer.has_other_views) = (true, true);
        Ok(renderer)
    }

    /// The common part of the constructors, with the kernels of a render of `spp` samples per pixel.
    fn specialised(
        gpu: &'g Gpu,
        mut scene: Scene,
        camera: &Camera,
        settings: &Settings,
        spp: u32,
        forced: &[(Feature, bool)],
    ) -> Result<Renderer<'g>> {
        settings.check()?;
        let earlier_pass_times = gpu.pass_times()?;
        let mut totals = Totals::default();
        scene.scale_lights(settings.light_scale);
        if !Specialisation::traces_instances(settings) {
            scene.expand_instances(settings.technique.name())?;
        }
        let bvh = build_hierarchy(&mut scene, &mut totals)?;
        let of_spp = settings.clone().with(|s| s.image.spp = spp);
        let mut specialisation = Specialisation::new(&scene, Some(camera), &of_spp);
        specialisation.of_device(gpu, &scene, &bvh);
        specialisation.of_largest_table(gpu, GpuScene::largest_table(&scene, &bvh, &specialisation.features));
        // Before tables are made, and again after the lights have decided on features of their own.
        specialisation.force(forced);
        let size = [settings.image.width, settings.image.height];
        let gpu_scene = GpuScene::new(gpu, &scene, bvh, camera, size, &specialisation.features)?;
        totals.scene_bytes = gpu_scene.bytes;
        let facts: Vec<_> = gpu_scene.lights.lights.iter().map(LightInfo::facts).collect();
        specialisation.of_packed_lights(&scene, &facts);
        specialisation.force(forced);
        let (specialisation, with_photons) = match forced {
            [] => of_first_sample(specialisation, &scene, camera, &of_spp),
            _ => (specialisation, None),
        };

        let start = Instant::now();
        let kernels = Kernels::new(gpu, &specialisation, &gpu_scene.constants(), settings)?;
        gpu.compile_ahead(&gpu_scene)?;
        totals.time_compile = start.elapsed().as_secs_f64();
        let features = &specialisation.features;
        let view = ViewOf { gpu, scene: &scene, gpu_scene: &gpu_scene, features, camera, settings };
        let PreparedView { primary, film, lighting, indirect_kernels, buffers, tiles, tile_size, stage } =
            view.prepare(kernels, MadeMaps::default(), &mut totals)?;

        // A piece does not count first: highlights are at nearly all points where there are glossy surfaces.
        let shade_at_once = settings.image.piece.is_some() && features.has(Feature::Glossy);
        let piece_sums = settings.image.piece.map(|piece| PieceSums::new(&buffers, &settings.image, piece));
        Ok(Renderer {
            notes: notes(&scene, settings, stage, features, &totals.indirect, &gpu_scene),
            gpu,
            scene,
            camera: camera.clone(),
            settings: settings.clone(),
            requested_photons: settings.visibility_map.photons_per_light,
            specialisation,
            gpu_scene,
            primary,
            film,
            lighting,
            indirect_kernels,
            stage,
            growth: None,
            first_map: None,
            kept_records: None,
            is_preview: false,
            has_other_views: false,
            buffers,
            tiles,
            tile_size,
            samples: 0,
            blocks: Blocks::of(&settings.image),
            errors: None,
            shade_at_once,
            with_photons,
            piece_sums,
            batches: 0,
            totals,
            seconds_per_sample: None,
            seconds_to_allocate: None,
            earlier_pass_times,
            backup: None,
        })
    }

    /// All planes of the film, in an order that depends only on scene and settings.
    pub(super) fn planes(&self) -> impl Iterator<Item = &Plane> {
        self.tiles.iter().flat_map(|tile| tile.planes().chain(&tile.classes))
    }

    /// Mean number of samples per pixel so far; for a piece, the number of its own samples. With
    /// [`ImageSettings::noise`](crate::settings::ImageSettings::noise) it is the number of the pixels that have the
    /// most.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// The settings, as they were given.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The device that it runs on.
    pub fn gpu(&self) -> &'g Gpu {
        self.gpu
    }

    /// The features of the kernels, and what was left out.
    pub fn specialisation(&self) -> &Specialisation {
        &self.specialisation
    }

    /// Notes on the render, one line each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

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
    pub film: Film,
    pub lighting: Lighting,
    pub indirect_kernels: IndirectKernels,
    pub buffers: TileBuffers,
    pub tiles: Vec<TileFilm>,
    pub tile_size: TileSize,
    /// The stage of photons and gather rays.
    pub stage: i32,
}

impl ViewOf<'_> {
    /// Runs the technique's first pass, but for the maps that are already made, and makes empty films.
    pub fn prepare(&self, kernels: Kernels, made: MadeMaps, totals: &mut Totals) -> Result<PreparedView> {
        let start = Instant::now();
        let ViewOf { gpu, scene, gpu_scene, features, camera, settings } = *self;
        let tile_size = TileSize::new(features, scene.lights.len(), settings)?;
        let Kernels { primary, film, direct, indirect: indirect_kernels } = kernels;
        let buffers = TileBuffers::new(gpu, features, tile_size.points, indirect_kernels.bring_light())?;
        let primary = primary.bind(gpu, &buffers, gpu_scene)?;
        let stage = stage(settings, 0, grows(settings));
        let mut first_pass = FirstPass {
            shared: Shared { gpu, scene, gpu_scene, tile: &buffers },
            direct_kernels: direct,
            indirect_kernels: &indirect_kernels,
            primary: &primary,
            view: camera,
            camera: &CameraUniform::new(camera, settings.image.width, settings.image.height),
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
        Ok(PreparedView { primary, film, lighting, indirect_kernels, buffers, tiles, tile_size, stage })
    }
}

/// Builds the BVH and puts the scene's triangles in its order.
fn build_hierarchy(scene: &mut Scene, totals: &mut Totals) -> Result<Bvh> {
    let start = Instant::now();
    let bvh = Bvh::of(scene)?;
    scene.reorder_triangles(&bvh.order);
    totals.bvh_depth = bvh.depth;
    totals.time_bvh = start.elapsed().as_secs_f64();
    Ok(bvh)
}

/// The kernels of a render.
pub(super) struct Kernels {
    primary: Primary,
    film: Film,
    direct: DirectKernels,
    indirect: IndirectKernels,
}

impl Kernels {
    pub fn new(
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
