//! [`Renderer`]: a render in progress, and its preparation.

use std::collections::BTreeMap;
use std::time::Instant;

use kernel_kit::Gpu;

use super::backup::Backup;
use super::notes::notes;
use super::photon_benefit::postpone_photons;
use super::pieces::PieceSums;
use super::prepared_view::{Kernels, PreparedView, ViewOf};
use super::sampling_state::SamplingState;
use crate::Result;
use crate::bvh::Bvh;
use crate::gpu_scene::GpuScene;
use crate::gpu_scene::lights::LightInfo;
use crate::light_transport::first_pass::MadeMaps;
use crate::light_transport::global_map::GlobalMap;
use crate::light_transport::irradiance_cache::Records;
use crate::passes::film::Plane;
use crate::scene::{Camera, Scene};
use crate::settings::Settings;
use crate::specialisation::Specialisation;
use crate::specialisation::features::Feature;
use crate::statistics::totals::Totals;

/// A render in progress.
pub struct Renderer<'g> {
    pub(super) gpu: &'g Gpu,
    pub(super) scene: Scene,
    pub(super) camera: Camera,
    /// See [`Renderer::settings`].
    pub(super) settings: Settings,
    /// Visibility photons per light that the user requested; `None`: the number follows from the size of the image.
    pub(super) requested_photons: Option<u32>,
    pub(super) specialisation: Specialisation,
    pub(super) notes: Vec<String>,
    pub(super) gpu_scene: GpuScene,
    pub(super) view: PreparedView,
    pub(super) sampling: SamplingState,
    /// The global map of the first stage, for the next view. `None` while that map is in use, and before
    /// [`Renderer::set_view`] was called.
    pub(super) first_map: Option<GlobalMap>,
    /// The irradiance records of earlier previews, unless they are in use.
    pub(super) kept_records: Option<Records>,
    /// Whether the view is a preview ([`Renderer::preview`]), which also uses the records of earlier previews.
    pub(super) is_preview: bool,
    /// Whether other views preceded this one.
    pub(super) has_other_views: bool,
    /// The specialisation with visibility photons, until the first sample has shown whether they pay off; see
    /// [`Renderer::begin_trial`].
    pub(super) with_photons: Option<Specialisation>,
    pub(super) totals: Totals,
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
    /// [`crate::Error::Setting`] for settings out of range, [`crate::Error::Memory`] for an image that has no room in
    /// the machine's memory, [`crate::Error::Usage`] for a row of pixels with too many points and lights,
    /// [`crate::Error::Buffer`] for what the device cannot hold, and those of [`Gpu::check`].
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
        Renderer::prepare(gpu, scene, camera, settings, settings.image.spp, forced)
    }

    /// Like [`Renderer::new`], but begins with a preview of `size`: see [`Renderer::preview`]. It has visibility
    /// photons only if they are requested or shown, because a single sample traces few shadow rays.
    /// [`Renderer::set_view`] begins the image.
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
        let mut renderer = Renderer::prepare(gpu, scene, camera, &settings, 1, &[])?;
        (renderer.is_preview, renderer.has_other_views) = (true, true);
        Ok(renderer)
    }

    /// What the constructors have in common. Kernels are those for a render of `spp` samples per pixel.
    fn prepare(
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
        let settings_of_kernels = settings.clone().with(|s| s.image.spp = spp);
        let (specialisation, gpu_scene) = upload(gpu, &scene, bvh, camera, &settings_of_kernels, forced)?;
        totals.scene_bytes = gpu_scene.bytes;
        let (specialisation, with_photons) = match forced {
            [] => postpone_photons(specialisation, &scene, camera, &settings_of_kernels),
            _ => (specialisation, None),
        };
        let (kernels, time_compile) = Kernels::compile(gpu, &specialisation, &gpu_scene, settings)?;
        totals.time_compile = time_compile;
        let features = &specialisation.features;
        let inputs = ViewOf { gpu, scene: &scene, gpu_scene: &gpu_scene, features, camera, settings };
        let tile_size = kernels.fit(gpu, &scene, features, settings, None)?;
        let view = inputs.prepare(kernels, tile_size, MadeMaps::default(), &mut totals)?;

        // A piece cannot count the points with highlights first. With glossy surfaces, nearly all points have one.
        let shade_at_once = settings.image.piece.is_some() && features.has(Feature::Glossy);
        let piece_sums = settings.image.piece.map(|piece| PieceSums::new(&view.buffers, &settings.image, piece));
        Ok(Renderer {
            notes: notes(&scene, settings, view.stage, features, &totals.indirect, &gpu_scene),
            gpu,
            scene,
            camera: camera.clone(),
            settings: settings.clone(),
            requested_photons: settings.visibility_map.photons_per_light,
            specialisation,
            gpu_scene,
            view,
            sampling: SamplingState::new(&settings.image, shade_at_once),
            first_map: None,
            kept_records: None,
            is_preview: false,
            has_other_views: false,
            with_photons,
            piece_sums,
            totals,
            earlier_pass_times,
            backup: None,
        })
    }

    /// All planes of the film, in an order that depends only on scene and settings.
    pub(super) fn planes(&self) -> impl Iterator<Item = &Plane> {
        self.view.tiles.iter().flat_map(|tile| tile.planes().chain(&tile.classes))
    }

    /// Mean number of samples per pixel so far; for a piece, the number of its own samples. With
    /// [`ImageSettings::noise`](crate::settings::ImageSettings::noise) it is the number of the pixels that have the
    /// most.
    pub fn samples(&self) -> u32 {
        self.sampling.samples
    }

    /// The settings of this view: those that were given, with the view's image size and, in a preview, the number of
    /// visibility photons that the previous view had.
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

/// Decides what the kernels contain, and uploads the scene for them. The decision comes in two parts: which tables the
/// scene has follows from the first, and the tables of lights decide on further features.
fn upload(
    gpu: &Gpu,
    scene: &Scene,
    bvh: Bvh,
    camera: &Camera,
    settings: &Settings,
    forced: &[(Feature, bool)],
) -> Result<(Specialisation, GpuScene)> {
    let mut specialisation = Specialisation::new(scene, Some(camera), settings);
    specialisation.decide_by_device(gpu, scene, &bvh);
    specialisation.decide_on_layers(gpu, GpuScene::largest_table(scene, &bvh, &specialisation.features));
    specialisation.force(forced);
    let size = [settings.image.width, settings.image.height];
    let gpu_scene = GpuScene::new(gpu, scene, bvh, camera, size, &specialisation.features)?;
    let facts: Vec<_> = gpu_scene.lights.lights.iter().map(LightInfo::facts).collect();
    specialisation.decide_on_packed_lights(scene, &facts);
    specialisation.force(forced);
    Ok((specialisation, gpu_scene))
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
