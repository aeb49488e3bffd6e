//! Techniques: which passes run, in which order. [`Renderer`] sets up what all of them share.

mod checkpoint;
mod conditioning;
pub mod film;
mod output;
pub mod recovery;

use std::time::Instant;

use crate::Result;
use crate::bvh::Bvh;
use crate::gpu::{Bindings, Features, Frame, Gpu, Resources};
use crate::gpu_scene::environment::GpuEnvironment;
use crate::gpu_scene::{CameraUniform, GpuScene};
use crate::passes::film::{Film, Plane};
use crate::passes::path::{BoundPath, Path, PathParameters};
use crate::passes::primary::{BoundPrimary, Primary};
use crate::passes::{Tile, TileBuffers};
use crate::scene::{Camera, Scene};
use crate::settings::{Aov, Settings, Technique};
use crate::specialisation::Specialisation;
use crate::statistics::{self, Counter, Statistics};

use crate::light_transport::TILE_SAMPLES;
use crate::light_transport::caustic_map::{CausticKernels, CausticMap};
use crate::light_transport::direct_light::{self, Direct, Shared};
use crate::light_transport::global_map::{GlobalMap, GlobalMapKernels};
use crate::light_transport::irradiance_cache::{CacheKernels, Filling, IrradianceCache};
use crate::statistics::totals::Totals;
pub use checkpoint::Checkpoint;
pub use film::Image;
use recovery::Keeping;

/// Most points of a tile: enough to keep a device busy, little enough memory and time a dispatch.
const TILE_POINTS: u32 = 1 << 19;

/// The visibility map is left out if more points than this are boundary or unknown after the first sample of each pixel:
/// photons are then too sparse for what the scene hides, and asking them costs more than the rays that they save.
/// Measured on the still life (0.57): 42 s with the map, 17 s without.
const PILOT_SHARE: f64 = 0.5;

/// A render under way.
pub struct Renderer<'g> {
    gpu: &'g Gpu,
    scene: Scene,
    camera: Camera,
    settings: Settings,
    specialisation: Specialisation,
    notes: Vec<String>,
    gpu_scene: GpuScene,
    primary: BoundPrimary,
    /// Direct light by the photons and shadow rays, where the technique has it apart.
    direct: Option<Direct>,
    indirect: Indirect,
    /// The caustic map of the samples under way, where there are focusing surfaces.
    caustics: Option<CausticMap>,
    indirect_kernels: IndirectKernels,
    buffers: TileBuffers,
    tiles: Vec<TileFilm>,
    rows: u32,
    /// Most samples of a pixel in a tile.
    layers: u32,
    samples: u32,
    /// Calls of [`Renderer::render_batch`] so far. The map is mended after the second, the fourth, the eighth, ...: what
    /// audits find is found early, and sorting the map anew then costs little of a long render. After the pilot it would
    /// cost a short one more than the few photons are worth that a sample of each pixel finds.
    batches: u32,
    totals: Totals,
    /// What is kept of the render should the device be lost; none where nobody asks for it.
    keeping: Option<Keeping>,
}

/// All light that is not [`Direct`]'s: that of more bounces and highlights of lights that have a surface, or everything.
struct Indirect {
    /// Where paths and gathers end; or shown directly.
    map: Option<GlobalMap>,
    /// The diffuse part.
    cache: Option<IrradianceCache>,
    /// All, or what map and cache leave.
    path: Option<BoundPath>,
    /// How often the photons and the rays of a gather have been multiplied.
    stage: u32,
}

impl Indirect {
    /// Traces the photons and fills the cache, of the kernels that there are.
    fn new(
        shared: &Shared<'_>,
        primary: &BoundPrimary,
        kernels: &IndirectKernels,
        camera: &CameraUniform,
        settings: &Settings,
        samples: u32,
        totals: &mut Totals,
    ) -> Result<Indirect> {
        let stage = stage(samples);
        let settings = &refined(settings, stage);
        let IndirectKernels { map, cache, path, features, .. } = kernels;
        let Shared { gpu, gpu_scene, tile, .. } = *shared;
        totals.indirect_bytes = 0;
        let paths = path.is_some();
        let map = map.as_ref().map(|map| GlobalMap::new(shared, map, settings, paths, totals)).transpose()?;
        let nothing = Resources::new();
        let scene: [&dyn Bindings; 2] = [gpu_scene, map.as_ref().map_or(&nothing, |map| map as &dyn Bindings)];
        let filling = |kernels| Filling { gpu, kernels, features, tile, primary, scene: &scene, camera, settings };
        let cache = cache.as_ref().map(|kernels| IrradianceCache::new(&filling(kernels), totals)).transpose()?;
        let mut sets = scene.to_vec();
        sets.extend(cache.as_ref().map(|cache| cache.buffers() as &dyn Bindings));
        let path = path.as_ref().map(|path| path.bind(gpu, tile, &sets)).transpose()?;
        Ok(Indirect { map, cache, path, stage })
    }

    fn record(&self, frame: &mut Frame<'_>, parameters: &PathParameters) {
        if let Some(map) = &self.map {
            map.record(frame, &parameters.tile);
        }
        if let Some(cache) = &self.cache {
            cache.record(frame, &parameters.tile);
        }
        match (&self.path, &self.cache) {
            (Some(path), Some(cache)) => path.record_queued(frame, &cache.buffers().path_arguments, parameters),
            (Some(path), None) => path.record(frame, parameters),
            (None, _) => {}
        }
    }
}

/// Samples a pixel from which on photons and gather rays are more than at first: four times, and four times again for each
/// four times the samples. Points share what these tell, so no number of samples would take their error away.
const REFINED: u32 = 32;

/// Most such steps: a million photon rays by default, and some thousand rays a record.
const MOST_STAGES: u32 = 2;

/// How often photons and gather rays have been multiplied once there are so many samples.
fn stage(samples: u32) -> u32 {
    ((samples / REFINED).checked_ilog2().map_or(0, |log| log / 2 + 1)).min(MOST_STAGES)
}

fn refined(settings: &Settings, stage: u32) -> Settings {
    let more = |number: u32, most: u32| number.saturating_mul(1 << (2 * stage)).min(number.max(most));
    settings.clone().with(|s| {
        s.indirect.photons = more(settings.indirect.photons, Settings::MAX_PHOTONS);
        s.indirect.irradiance_cache.gather_rays =
            more(settings.indirect.irradiance_cache.gather_rays, Settings::MAX_GATHER_RAYS);
        // Other photons and other directions, far from the seeds that users count up.
        s.image.seed = settings.image.seed.wrapping_add(stage.wrapping_mul(0x9e37_79b9));
    })
}

/// How far a render is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Samples a pixel so far.
    pub samples: u32,
    /// Rays of all types so far.
    pub rays: u64,
    /// Boundary and unknown points over all points so far.
    pub boundary_share: f64,
}

/// The film of some rows.
struct TileFilm {
    first_row: u32,
    rows: u32,
    direct: Plane,
    indirect: Option<Plane>,
    squares: Option<Plane>,
    albedo: Option<Plane>,
    normal: Option<Plane>,
    position: Option<Plane>,
    shadow: Vec<direct_light::ShadowFilm>,
}

impl TileFilm {
    fn planes(&self) -> impl Iterator<Item = &Plane> {
        let optional = [&self.indirect, &self.squares, &self.albedo, &self.normal, &self.position];
        std::iter::once(&self.direct).chain(optional.into_iter().flatten())
    }
}

impl<'g> Renderer<'g> {
    /// Makes everything ready for the first sample: hierarchy, kernels, tables, photons and their grid.
    ///
    /// # Errors
    /// [`crate::Error::Setting`] for settings out of range, [`crate::Error::Buffer`] for what the device cannot hold, and those of
    /// [`Gpu::check`].
    pub fn new(gpu: &'g Gpu, mut scene: Scene, camera: &Camera, settings: &Settings) -> Result<Renderer<'g>> {
        settings.check()?;
        let mut totals = Totals::default();

        scene.scale_lights(settings.light_scale);
        let start = Instant::now();
        let positions: Vec<_> = (0..scene.triangles.len()).map(|i| scene.triangle_positions(i)).collect();
        let bvh = Bvh::build(&positions)?;
        drop(positions);
        scene.reorder_triangles(&bvh.order);
        totals.bvh_depth = bvh.depth;
        totals.time_bvh = start.elapsed().as_secs_f64();

        let mut specialisation = Specialisation::new(&scene, settings);
        specialisation.of_hierarchy(&bvh);
        let features = device_features(gpu, specialisation.features.clone());
        let size = [settings.image.width, settings.image.height];
        let gpu_scene = GpuScene::new(gpu, &scene, bvh, camera, size, &features)?;
        totals.scene_bytes = gpu_scene.bytes;
        let decided = features.has("visibility_map") && !features.has("light_sampling");
        // Light points tell all that glossy surfaces reflect.
        let closed = !features.has("glossy") && gpu_scene.lights.lights.iter().all(|light| light.closed_form);
        let features = features.with("few_sampled", decided && closed);

        let start = Instant::now();
        let constants = gpu_scene.constants();
        let kernels = Kernels::new(gpu, &features, &constants, settings)?;
        gpu.compile_ahead(&gpu_scene)?;
        totals.time_compile = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let most = TILE_POINTS.min(direct_light::most_points(&features, scene.lights.len(), settings));
        let rows = (most / settings.image.width).clamp(1, settings.image.height);
        let layers = most_layers(most, rows, settings);
        let points = rows * settings.image.width * layers;
        let Kernels { primary, film, direct, indirect: indirect_kernels } = kernels;
        let has_indirect = indirect_kernels.path.is_some() || indirect_kernels.map.is_some();
        let buffers = TileBuffers::new(gpu, &features, points, has_indirect)?;
        let primary = primary.bind(gpu, &buffers, &gpu_scene)?;
        let shared = Shared { gpu, scene: &scene, gpu_scene: &gpu_scene, tile: &buffers };
        let direct = direct.map(|direct| Direct::new(&shared, direct, points, settings, &mut totals)).transpose()?;
        let view = CameraUniform::new(camera, settings.image.width, settings.image.height);
        let indirect = Indirect::new(&shared, &primary, &indirect_kernels, &view, settings, 0, &mut totals)?;
        let first_rows = (0..settings.image.height).step_by(rows as usize);
        let tiles = first_rows
            .map(|first_row| {
                let rows = rows.min(settings.image.height - first_row);
                new_film(gpu, &film, &buffers, direct.as_ref(), [first_row, rows], settings)
            })
            .collect::<Result<Vec<_>>>()?;
        gpu.wait("preparation")?;
        totals.frame_bytes = buffers.bytes() + tiles.iter().flat_map(TileFilm::planes).map(Plane::bytes).sum::<u64>();
        totals.frame_bytes += direct.as_ref().map_or(0, Direct::frame_bytes);
        totals.frame_bytes += indirect.cache.as_ref().map_or(0, IrradianceCache::frame_bytes);
        totals.time_render = start.elapsed().as_secs_f64();

        let notes = notes(&scene, settings, &totals.indirect, gpu_scene.lights.environment.as_ref());
        let (camera, settings) = (camera.clone(), settings.clone());
        Ok(Renderer {
            gpu,
            scene,
            camera,
            settings,
            specialisation,
            notes,
            gpu_scene,
            primary,
            direct,
            indirect,
            caustics: None,
            indirect_kernels,
            buffers,
            tiles,
            rows,
            layers,
            samples: 0,
            batches: 0,
            totals,
            keeping: None,
        })
    }

    /// Renders some more samples of every pixel, at least one, and no more than are missing to the settings' number
    /// where some are.
    ///
    /// # Errors
    /// [`crate::Error::Computation`] where more than a thousandth of the rays met the loop budget, and those of [`Gpu::check`].
    pub fn render_batch(&mut self) -> Result<Progress> {
        self.render_at_most(u32::MAX)
    }

    /// As [`Renderer::render_batch`], of no more than `limit` samples a pixel, at least one: for those short of time.
    ///
    /// # Errors
    /// As [`Renderer::render_batch`].
    pub fn render_at_most(&mut self, limit: u32) -> Result<Progress> {
        self.refine()?;
        let start = Instant::now();
        let width = self.settings.image.width;
        let most = self.layers.min(limit.max(1));
        let missing = self.settings.image.spp.saturating_sub(self.samples);
        let layers = if missing > 0 { most.min(missing) } else { most };
        // The first sample of each pixel is the pilot.
        let layers = if self.batches == 0 && self.specialisation.features.has("visibility_map") { 1 } else { layers };
        if self.batches == 1 {
            self.end_pilot()?;
        }
        if self.batches > 0
            && let Some(direct) = &mut self.direct
        {
            let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
            let shared = Shared { gpu, scene, gpu_scene, tile };
            direct.heal(&shared, self.batches > 1 && self.batches.is_power_of_two(), &mut self.totals)?;
        }
        self.trace_caustics()?;
        self.batches += 1;
        for index in 0..self.tiles.len() {
            let film = &self.tiles[index];
            let pixel_count = film.rows * width;
            let tile = Tile {
                width,
                height: self.settings.image.height,
                first_row: film.first_row,
                pixel_count,
                point_count: pixel_count * layers,
                first_sample: self.samples,
                seed: self.settings.image.seed,
                centred: u32::from(self.settings.image.spp == 1),
            };
            let mut frame = self.gpu.frame("sample");
            frame.clear(&self.buffers.counters);
            self.primary.record(&mut frame, &tile);
            let (max_bounces, shadow_samples) = (self.settings.indirect.max_bounces, self.settings.shadow_rays.samples);
            let path_parameters = PathParameters { tile, max_bounces, light_samples: shadow_samples };
            if let Some(direct) = &self.direct {
                direct.record(&mut frame, &tile, &film.shadow);
            }
            self.indirect.record(&mut frame, &path_parameters);
            if let Some(caustics) = &self.caustics {
                caustics.record(&mut frame, &tile);
            }
            for plane in film.planes() {
                plane.record(&mut frame, &tile);
            }
            frame.submit()?;
            let counters: Vec<u32> = self.gpu.read(&self.buffers.counters, Counter::COUNT)?;
            self.totals.add(&counters, u64::from(tile.point_count));
            if self.specialisation.features.has("visibility_map") {
                self.totals.add_mapped(&counters);
            }
        }
        self.samples += layers;
        self.count_procedural_misses()?;
        self.totals.check()?;
        self.keep()?;
        self.totals.time_render += start.elapsed().as_secs_f64();
        let points = self.totals.points();
        Ok(Progress { samples: self.samples, rays: self.totals.rays().total, boundary_share: points.boundary_share })
    }

    /// Adds what the kernels have counted of procedural objects since the last batch.
    fn count_procedural_misses(&mut self) -> Result<()> {
        if !self.specialisation.features.has("procedurals") {
            return Ok(());
        }
        let misses = &self.gpu_scene.procedural_misses;
        let counters = [Counter::ProceduralOverruns, Counter::ProceduralNonsense];
        for (counter, more) in counters.into_iter().zip(self.gpu.read::<u32>(misses, 2)?) {
            self.totals.count(counter, more.into());
        }
        self.gpu.write(misses, &[0u32; 2]);
        Ok(())
    }

    /// Makes photons and records anew, and more of them, once there are so many samples that they ask for it. The next
    /// samples do it too; on its own it is for those who want to know the time that either takes.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn refine(&mut self) -> Result<()> {
        let start = Instant::now();
        self.refine_for(self.samples)?;
        self.totals.time_render += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// As [`Renderer::refine`], as if there were that many samples.
    fn refine_for(&mut self, samples: u32) -> Result<()> {
        if self.indirect.map.is_none() || stage(samples) == self.indirect.stage {
            return Ok(());
        }
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
        let shared = Shared { gpu, scene, gpu_scene, tile };
        let view = CameraUniform::new(&self.camera, self.settings.image.width, self.settings.image.height);
        let (kernels, totals) = (&self.indirect_kernels, &mut self.totals);
        self.indirect = Indirect::new(&shared, &self.primary, kernels, &view, &self.settings, samples, totals)?;
        Ok(())
    }

    /// Makes the caustic map of the next samples, unless they share that of the last.
    fn trace_caustics(&mut self) -> Result<()> {
        let number = CausticMap::number_at(self.samples);
        let IndirectKernels { map: Some(map), caustics: Some(kernels), .. } = &self.indirect_kernels else {
            return Ok(());
        };
        if self.caustics.as_ref().is_none_or(|caustics| caustics.number() != number) {
            let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
            let shared = Shared { gpu, scene, gpu_scene, tile };
            let traced = CausticMap::new(&shared, kernels, map, &self.settings, number, &mut self.totals)?;
            self.caustics = Some(traced);
        }
        Ok(())
    }

    /// Leaves the visibility map out if the first samples say that it does not pay.
    fn end_pilot(&mut self) -> Result<()> {
        let share = self.asked_boundary_share();
        // Without a map every point is unknown; and whoever asks for the classes, or for what the map alone says, gets it.
        let asked =
            self.settings.technique == Technique::VisibilityEstimate || self.specialisation.features.has("aov_shadow");
        if !self.specialisation.features.has("visibility_map") || asked || share <= PILOT_SHARE {
            return Ok(());
        }
        self.leave_map_out(&format!(
            "it does not pay: {:.0} % of the first points were boundary or unknown",
            100.0 * share
        ))
    }

    /// Boundary and unknown points over all, of the lights that photons are asked about: every point is unknown to the
    /// environment.
    fn asked_boundary_share(&self) -> f64 {
        let points = self.totals.points();
        let lights = self.scene.lights.len() as u64;
        let others = lights - self.scene.placed_lights().len() as u64;
        // Every light has the same points, dark ones included.
        let unasked = others * (points.total + points.dark) / lights.max(1);
        let asking = points.boundary + points.unknown - unasked;
        asking as f64 / (points.total - unasked).max(1) as f64
    }

    /// Goes on without the visibility map.
    fn leave_map_out(&mut self, reason: &str) -> Result<()> {
        self.specialisation.leave_map_out(reason);
        self.notes.push(format!(
            "the visibility map is left out: {reason}; more `visibility_map.photons_per_light` may help"
        ));
        let start = Instant::now();
        let features = device_features(self.gpu, self.specialisation.features.clone());
        let kernels = direct_light::Kernels::new(self.gpu, &features, &self.gpu_scene.constants(), &self.settings)?;
        self.gpu.compile_ahead(&self.gpu_scene)?;
        self.totals.time_compile += start.elapsed().as_secs_f64();
        let points = self.rows * self.settings.image.width * self.layers;
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
        let shared = Shared { gpu, scene, gpu_scene, tile };
        let direct = Direct::new(&shared, kernels, points, &self.settings, &mut self.totals)?;
        self.direct = Some(direct);
        Ok(())
    }

    /// All that is summed, in an order that the scene and the settings decide.
    fn planes(&self) -> impl Iterator<Item = &Plane> {
        self.tiles.iter().flat_map(|tile| tile.planes().chain(tile.shadow.iter().map(direct_light::ShadowFilm::plane)))
    }

    /// Samples a pixel so far.
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

    /// The image so far, with the channels that the settings ask for.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn image(&self) -> Result<Image> {
        output::image(self, None)
    }

    /// What was done so far. The times that the library does not see (start, import, total) are 0.
    ///
    /// # Errors
    /// As [`Gpu::pass_times`].
    pub fn statistics(&self) -> Result<Statistics> {
        Ok(output::statistics(self, self.gpu.pass_times()?))
    }

    /// What was kept and left out.
    pub fn specialisation(&self) -> &Specialisation {
        &self.specialisation
    }

    /// Remarks on the render, a line each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// The kernels of a render; those that it does not need are none.
struct Kernels {
    primary: Primary,
    film: Film,
    direct: Option<direct_light::Kernels>,
    indirect: IndirectKernels,
}

/// Those of [`Indirect`].
struct IndirectKernels {
    map: Option<GlobalMapKernels>,
    caustics: Option<CausticKernels>,
    cache: Option<CacheKernels>,
    path: Option<Path>,
    features: Features,
}

impl Kernels {
    fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)], settings: &Settings) -> Result<Kernels> {
        let two_pass = settings.technique.is_two_pass();
        let ((direct, primary), (film, indirect)) = rayon::join(
            || {
                rayon::join(
                    || two_pass.then(|| direct_light::Kernels::new(gpu, features, constants, settings)).transpose(),
                    || Primary::new(gpu, features, constants),
                )
            },
            || {
                rayon::join(
                    || Film::new(gpu, features),
                    || IndirectKernels::new(gpu, features, constants, settings.technique),
                )
            },
        );
        Ok(Kernels { primary: primary?, film: film?, direct: direct?, indirect: indirect? })
    }
}

impl IndirectKernels {
    fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)], technique: Technique) -> Result<IndirectKernels> {
        let has = |name| features.has(name);
        // The map shows all that Lambertian surfaces reflect.
        let rest = has("photon_map") && has("glossy");
        let paths = technique == Technique::Path || has("indirect") || rest;
        let ((map, caustics), (cache, path)) = rayon::join(
            || {
                rayon::join(
                    || has("global_map").then(|| GlobalMapKernels::new(gpu, features, constants)).transpose(),
                    || has("caustics").then(|| CausticKernels::new(gpu, features, constants)).transpose(),
                )
            },
            || {
                rayon::join(
                    || has("irradiance_cache").then(|| CacheKernels::new(gpu, features, constants)).transpose(),
                    || paths.then(|| Path::new(gpu, features, constants)).transpose(),
                )
            },
        );
        Ok(IndirectKernels { map: map?, caustics: caustics?, cache: cache?, path: path?, features: features.clone() })
    }
}

/// Most samples of a pixel in a tile of `rows` rows and at most `points` points.
fn most_layers(points: u32, rows: u32, settings: &Settings) -> u32 {
    (points / (rows * settings.image.width)).clamp(1, TILE_SAMPLES.min(settings.image.spp))
}

/// `features` with those of the device.
pub fn device_features(gpu: &Gpu, features: Features) -> Features {
    features.with("texture_loads", gpu.texture_loads).with("interleave", gpu.info.is_software())
}

fn notes(
    scene: &Scene,
    settings: &Settings,
    indirect: &statistics::Indirect,
    environment: Option<&GpuEnvironment>,
) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some([width, height]) = environment.and_then(|environment| environment.reduced) {
        notes.push(format!("the panorama is reduced to {width} x {height} texels: the device has no room for more"));
    }
    if scene.is_empty() {
        let shown = if environment.is_some() { "is the environment alone" } else { "is empty" };
        notes.push(format!("the scene has no triangles: the image {shown}"));
    }
    let wanted = u64::from(settings.indirect.photons);
    // Rounding by light takes a few rays; less than half are left only where the device has no room.
    if indirect.emitted > 0 && indirect.emitted <= wanted / 2 {
        let emitted = indirect.emitted;
        notes.push(format!("the photons of {emitted} rays fill the device's largest buffer: not {wanted} carry flux"));
    }
    if indirect.cut > 0 {
        notes.push(format!("{} photons carry more flux than they can hold: indirect light is too dark", indirect.cut));
    }
    notes
}

fn new_film(
    gpu: &Gpu,
    film: &Film,
    buffers: &TileBuffers,
    direct: Option<&Direct>,
    [first_row, rows]: [u32; 2],
    settings: &Settings,
) -> Result<TileFilm> {
    let pixels = rows * settings.image.width;
    let plane = |samples: &crate::gpu::Buffer| film.plane(gpu, pixels, samples, &buffers.counters);
    let optional = |samples: &Option<crate::gpu::Buffer>| samples.as_ref().map(plane).transpose();
    let other = buffers.radiance_indirect.as_ref();
    let squares = settings.image.aovs.contains(&Aov::Variance).then(|| {
        let parts = [&buffers.radiance_direct, other.unwrap_or(&buffers.zeros)];
        film.plane_of_squares(gpu, pixels, parts, &buffers.counters)
    });
    Ok(TileFilm {
        first_row,
        rows,
        direct: plane(&buffers.radiance_direct)?,
        indirect: optional(&buffers.radiance_indirect)?,
        squares: squares.transpose()?,
        albedo: optional(&buffers.albedo_samples)?,
        normal: optional(&buffers.normal_samples)?,
        position: optional(&buffers.position_samples)?,
        shadow: match direct {
            Some(direct) => direct.films(gpu, film, pixels, &buffers.counters)?,
            None => Vec::new(),
        },
    })
}
