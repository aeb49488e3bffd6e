//! Direct light (paper, "Extending the photon map": cases 1 to 3). For a chunk of lights, its passes classify the
//! points of a tile, queue those that need shadow rays, trace the rays and add the light: `classify`, `shadow`,
//! `shade`. Techniques differ in the steps that they take and in how points are classified: without a visibility map
//! every point is unknown, and all shadow rays are traced.

use kernel_kit::{Bindings, Buffer, Frame, Gpu};

use super::audits::Precautions;
use super::fine_cells::FineCellMap;
use super::light_sampler::LightSampler;
use super::shared::{Shared, TILE_POINTS};
use super::visibility_map::VisibilityMap;
use crate::kernels::Queue;
use crate::passes::Tile;
use crate::passes::classify::{BoundClassify, BoundShowCells, Chunk, Classify, ClassifyBuffers, ShowCells};
use crate::passes::film::{Film, Inputs, Plane};
use crate::passes::fine_cells::FineCellBindings;
use crate::passes::sample_lights::SampledLightBindings;
use crate::passes::shade::{BoundShade, Shade, ShadeBuffers, ShadeParameters};
use crate::passes::shadow::{BoundShadow, Shadow, ShadowBuffers, ShadowParameters};
use crate::settings::{Aov, Settings};
use crate::specialisation::features::{Feature, Features};
use crate::{Error, Result};

/// Maximum number of shadow-ray candidates (point and light) in a chunk of several lights: four lights of a full tile.
/// Classes and queues then take 32 MiB.
const CHUNK_CANDIDATES: u32 = 1 << 21;

/// Maximum number of words of visibilities in a chunk: half of the smallest storage binding that devices offer.
const CHUNK_WORDS: u32 = 1 << 24;

/// Maximum number of loop iterations of `shade` for the lights of a chunk: lavapipe ends all loops of an invocation,
/// without an error, after 65,535 of them. Ten thousand lights in one chunk lost half of their light.
const SHADE_ITERATIONS: u32 = 32_768;

/// Lights wider than this share of the scene's radius get dilation from the start: faint parts of their wide penumbrae
/// would be missed without it. (The lights of the paper's two scenes: 0.33 and 0.02.)
const WIDE_LIGHT: f32 = 0.05;

/// Maximum number of sampled lights of a tile: with 8 bytes each they fit into a binding of 128 MiB, which all devices
/// have.
const MAX_SAMPLED_LIGHTS: u32 = 1 << 24;

/// Maximum number of points of a tile. Adaptive shadow testing holds all lights of a point at once. Counts of a tile,
/// which may reach the number of light points of all its candidates, must fit in a word. Path tracing has neither
/// limit.
pub(crate) fn max_points(features: &Features, lights: usize, settings: &Settings) -> u32 {
    if settings.technique.is_path_tracing() {
        return u32::MAX;
    }
    let lights = lights.max(1) as u32;
    if features.has(Feature::Ward) {
        let words = lights.saturating_mul(settings.shadow_rays.samples.div_ceil(32));
        return (CHUNK_CANDIDATES / lights).min(CHUNK_WORDS / words).max(1);
    }
    let samples = settings.shadow_rays.samples;
    if features.has(Feature::LightSampling) {
        let considered = settings.light_sampling.sampled_lights;
        return (u32::MAX / considered.saturating_mul(samples)).min(MAX_SAMPLED_LIGHTS / considered).max(1);
    }
    (u32::MAX / lights.saturating_mul(samples)).max(1)
}

pub(crate) struct DirectLightKernels {
    classify: Classify,
    shadow: Shadow,
    shade: Shade,
    audits: bool,
    /// All lights are in one chunk.
    all_lights_at_once: bool,
}

impl DirectLightKernels {
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        settings: &Settings,
    ) -> Result<DirectLightKernels> {
        let (classify, (shadow, shade)) = rayon::join(
            || Classify::new(gpu, features, settings.visibility_map.nearest),
            || rayon::join(|| Shadow::new(gpu, features, constants), || Shade::new(gpu, features, constants)),
        );
        Ok(DirectLightKernels {
            classify: classify?,
            shadow: shadow?,
            shade: shade?,
            audits: features.has(Feature::Audit),
            all_lights_at_once: features.has(Feature::Ward),
        })
    }
}

/// The parts of the first pass that direct light reads, if the technique has them.
#[derive(Clone, Copy, Default)]
pub(crate) struct DirectInputs<'a> {
    pub visibility_map: Option<&'a VisibilityMap>,
    pub light_sampler: Option<&'a LightSampler>,
    pub fine_cells: Option<&'a FineCellMap>,
}

impl<'a> DirectInputs<'a> {
    /// The sampled lights and the fine cells, as kernels read them.
    fn bindings(self) -> (SampledLightBindings<'a>, FineCellBindings<'a>) {
        let sampled_lights = self.light_sampler.map(LightSampler::sampled_lights);
        let fine_cells = self.fine_cells.map(FineCellMap::bindings).unwrap_or_default();
        (SampledLightBindings { sampled_lights }, fine_cells)
    }
}

pub(crate) struct DirectLight {
    kernels: DirectLightKernels,
    buffers: Buffers,
    /// `None` while the map is being sorted again.
    bound: Option<Bound>,
    sizes: Sizes,
    /// Pixels by which boundaries are widened; `None`: [`Precautions::dilate`] decides.
    fixed_dilation: Option<u32>,
    /// The precautions of the current batch; the default, without audits, if no kernel audits.
    precautions: Precautions,
    /// Photons that audits can add to the map.
    repair_capacity: u32,
}

/// The size of a chunk of lights.
#[derive(Clone, Copy)]
struct Sizes {
    /// Lights that each point considers.
    lights: u32,
    lights_in_chunk: u32,
    /// Light points of a candidate.
    light_samples: u32,
    /// Words of visibilities of a candidate.
    visibility_words: u32,
}

impl Sizes {
    /// # Errors
    /// [`Error::Usage`] if all lights must be in one chunk and are too many for the device.
    fn new(shared: &Shared<'_>, points: u32, lights: u32, all_at_once: bool, settings: &Settings) -> Result<Sizes> {
        let light_samples = settings.shadow_rays.samples;
        let visibility_words = light_samples.div_ceil(32);
        // A sum of light is rounded after each chunk, so all pieces must have the same chunks, whatever the size of
        // their tiles.
        let points = settings.image.piece.map_or(points, |_| TILE_POINTS.max(points));
        let fitting = (CHUNK_CANDIDATES / points).min(CHUNK_WORDS / (points * visibility_words));
        // For each light, `shade` iterates over the light points and over the edges of the closed form.
        let edges = shared.gpu_scene.lights.lights.iter().map(|light| light.contour_edges as u32).max().unwrap_or(0);
        let shaded = SHADE_ITERATIONS / (2 + light_samples + 2 * edges);
        if all_at_once && lights > shaded && shared.gpu.is_software() {
            return Err(Error::Usage(format!(
                "adaptive shadow testing adds the light of all {lights} lights at once, and this device only that of \
                 {shaded} with {light_samples} light points each; choose fewer `shadow_rays.samples`, or another \
                 `technique`"
            )));
        }
        let fitting = fitting.min(shaded).clamp(1, lights.max(1));
        let lights_in_chunk = if all_at_once { lights } else { fitting };
        Ok(Sizes { lights, lights_in_chunk, light_samples, visibility_words })
    }
}

/// The buffers by which the passes of a chunk of lights exchange data.
struct Buffers {
    classify: ClassifyBuffers,
    visibility: Buffer,
    /// Class, visibility, n_i and n_s of each candidate, for the AOV.
    shadow_samples: Option<Buffer>,
}

/// The passes, bound to the current map; they must be bound again after the map was sorted again.
struct Bound {
    classify: BoundClassify,
    shadow: BoundShadow,
    shade: BoundShade,
}

impl DirectLight {
    /// Makes the buffers for tiles of `points` points, and binds the passes.
    pub fn new(
        shared: &Shared<'_>,
        kernels: DirectLightKernels,
        points: u32,
        settings: &Settings,
        inputs: DirectInputs<'_>,
    ) -> Result<DirectLight> {
        let Shared { gpu, scene, gpu_scene, .. } = *shared;
        let lights = inputs.light_sampler.map_or(scene.lights.len() as u32, LightSampler::lights);
        let sizes = Sizes::new(shared, points, lights, kernels.all_lights_at_once, settings)?;
        let candidates = points * sizes.lights_in_chunk;
        let classes_shown = settings.image.aovs.contains(&Aov::Shadow);
        let shadow_samples = || gpu.buffer::<[f32; 4]>("penumbra/shade/shadow_samples", candidates as usize);
        let buffers = Buffers {
            classify: ClassifyBuffers::new(gpu, candidates)?,
            visibility: gpu
                .buffer::<u32>("penumbra/shadow/visibility", (candidates * sizes.visibility_words) as usize)?,
            shadow_samples: classes_shown.then(shadow_samples).transpose()?,
        };
        let wide = gpu_scene.lights.lights.iter().any(|light| !light.punctual && light.radius > WIDE_LIGHT);
        let map = inputs.visibility_map;
        let fixed_dilation = match (map, settings.image.piece) {
            (Some(_), None) => settings.visibility_map.dilate.or(wide.then_some(1)),
            // The pixels next to a boundary may be those of another piece.
            _ => Some(0),
        };
        let mut direct = DirectLight {
            bound: None,
            buffers,
            sizes,
            fixed_dilation,
            precautions: Precautions::default(),
            repair_capacity: map.map_or(0, VisibilityMap::repair_capacity),
            kernels,
        };
        direct.bind(shared, inputs)?;
        Ok(direct)
    }

    /// Releases all that is bound, including the tables of the visibility map.
    pub fn unbind(&mut self) {
        self.bound = None;
    }

    /// Binds the passes if they are not bound.
    pub fn bind(&mut self, shared: &Shared<'_>, inputs: DirectInputs<'_>) -> Result<()> {
        if self.bound.is_some() {
            return Ok(());
        }
        let Shared { gpu, gpu_scene, tile, .. } = *shared;
        let Buffers { classify, visibility, shadow_samples } = &self.buffers;
        let (sampled, fine_cells) = inputs.bindings();
        let scene: [&dyn Bindings; 3] = [gpu_scene, &sampled, &fine_cells];
        let shadow = ShadowBuffers {
            classes: &classify.classes,
            boundary_queue: &classify.boundary_queue,
            audit_queue: &classify.audit_queue,
            queue_lengths: &classify.queue_lengths,
            visibility,
            repairs: inputs.visibility_map.map(VisibilityMap::repairs),
        };
        let shade = ShadeBuffers {
            classes: &classify.classes,
            visibility,
            shadow_samples: shadow_samples.as_ref(),
            sampled_points: classify.sampled_points(),
            queue_lengths: &classify.queue_lengths,
        };
        let grid = inputs.visibility_map.and_then(VisibilityMap::grid);
        self.bound = Some(Bound {
            classify: self.kernels.classify.bind(gpu, tile, grid, classify, &scene)?,
            shadow: self.kernels.shadow.bind(gpu, tile, &shadow, &scene)?,
            shade: self.kernels.shade.bind(gpu, tile, &shade, &scene)?,
        });
        Ok(())
    }

    /// Binds the kernel that shows the cells of a map or of the shadow rays, if there are cells.
    pub fn bind_shown_cells(
        &self,
        shared: &Shared<'_>,
        features: &Features,
        nearest: u32,
        inputs: DirectInputs<'_>,
    ) -> Result<Option<BoundShowCells>> {
        let grid = inputs.visibility_map.and_then(VisibilityMap::grid);
        let Shared { gpu, gpu_scene, tile, .. } = *shared;
        if grid.is_none() && inputs.fine_cells.is_none() {
            return Ok(None);
        }
        let (sampled, fine_cells) = inputs.bindings();
        let scene: [&dyn Bindings; 3] = [gpu_scene, &sampled, &fine_cells];
        let kernel = ShowCells::new(gpu, features, nearest)?;
        Ok(Some(kernel.bind(gpu, tile, grid, &self.buffers.classify, &scene)?))
    }

    fn bound(&self) -> &Bound {
        self.bound.as_ref().expect("a map that cannot be sorted ends the batch before this is called")
    }

    /// Sets audit probabilities and dilation for the next batch, if the kernels audit. Call it before each batch.
    pub fn set_precautions(&mut self, precautions: Precautions) {
        if self.kernels.audits {
            self.precautions = precautions;
        }
    }

    /// The lights, some at a time.
    pub fn chunks(&self) -> impl Iterator<Item = Chunk> + use<> {
        let Sizes { lights, lights_in_chunk, .. } = self.sizes;
        let Precautions { audits, dilate } = self.precautions;
        let dilate = self.fixed_dilation.unwrap_or(u32::from(dilate));
        (0..lights).step_by(lights_in_chunk as usize).map(move |first_light| Chunk {
            first_light,
            lights: lights_in_chunk.min(lights - first_light),
            dilate,
            audits,
        })
    }

    /// See [`BoundClassify::classify`].
    pub fn classify(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound().classify.classify(frame, &self.buffers.classify, tile, chunk);
    }

    /// See [`BoundClassify::look_up`].
    pub fn look_up_map_cells(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound().classify.look_up(frame, &self.buffers.classify, tile, chunk);
    }

    /// See [`BoundClassify::classify_requested_cells`].
    pub fn classify_requested_cells(&self, frame: &mut Frame<'_>) {
        self.bound().classify.classify_requested_cells(frame);
    }

    /// See [`BoundClassify::query`].
    pub fn query(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound().classify.query(frame, &self.buffers.classify, tile, chunk);
    }

    /// See [`BoundClassify::dilate`].
    pub fn dilate(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound().classify.dilate(frame, &self.buffers.classify, tile, chunk);
    }

    /// Empties the queues, for [`DirectLight::compact`] after classes that pass `classify` did not write.
    pub fn clear_queues(&self, frame: &mut Frame<'_>) {
        frame.clear(&self.buffers.classify.queue_lengths);
    }

    /// See [`BoundClassify::compact`].
    pub fn compact(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        self.bound().classify.compact(frame, tile, chunk);
    }

    /// Traces the shadow rays of the boundary queue.
    pub fn trace_shadow_rays(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        let arguments = self.arrange(frame, tile, chunk, Queue::Boundary);
        let offset = Queue::Boundary.arguments_offset();
        self.bound().shadow.trace(frame, arguments, offset, &self.shadow_parameters(tile, chunk));
    }

    /// Traces the shadow rays of the audit queue, if there are audits.
    pub fn audit(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        let arguments = self.arrange(frame, tile, chunk, Queue::Audit);
        let offset = Queue::Audit.arguments_offset();
        self.bound().shadow.audit(frame, arguments, offset, &self.shadow_parameters(tile, chunk));
    }

    /// Computes the arguments of the indirect dispatch of pass `shadow` over a queue. Returns the buffer that has them.
    fn arrange(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk, queue: Queue) -> &Buffer {
        self.bound().classify.record_arguments(frame, tile, chunk, queue, self.kernels.shadow.workgroup_size());
        &self.buffers.classify.queue_arguments
    }

    fn shadow_parameters(&self, tile: &Tile, chunk: &Chunk) -> ShadowParameters {
        ShadowParameters {
            tile: *tile,
            first_light: chunk.first_light,
            light_samples: self.sizes.light_samples,
            visibility_words: self.sizes.visibility_words,
            repair_capacity: self.repair_capacity,
        }
    }

    /// Adds the light of the chunk to the tile's points; see [`ShadeParameters::at_once`].
    pub fn shade(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk, at_once: bool) {
        let Bound { classify, shade, .. } = self.bound();
        let parameters = ShadeParameters {
            tile: *tile,
            first_light: chunk.first_light,
            lights_in_chunk: chunk.lights,
            light_samples: self.sizes.light_samples,
            visibility_words: self.sizes.visibility_words,
            audit_away: chunk.audits.away,
            audit_near: chunk.audits.near,
            at_once: at_once.into(),
        };
        let arrange = |frame: &mut Frame<'_>, group| {
            classify.record_arguments(frame, tile, chunk, Queue::Sampled, group);
        };
        let arguments = (&self.buffers.classify.queue_arguments, Queue::Sampled.arguments_offset());
        shade.record(frame, &parameters, arrange, arguments);
    }

    /// Adds the classes of the chunk to their films, one per light, if there are films.
    pub fn add_classes_to_film(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk, films: &[Plane]) {
        for light in 0..chunk.lights.min(films.len() as u32) {
            films[(chunk.first_light + light) as usize].record_from(frame, tile, light * tile.point_count);
        }
    }

    /// The films of all lights' classes for a tile of `pixels` pixels: class of the first sample (x) and visibility,
    /// n_i and n_s of all. Empty if the AOV was not requested.
    pub fn class_films(&self, gpu: &Gpu, film: &Film, pixels: u32, inputs: Inputs<'_>) -> Result<Vec<Plane>> {
        let Some(samples) = &self.buffers.shadow_samples else { return Ok(Vec::new()) };
        (0..self.sizes.lights).map(|_| film.plane(gpu, pixels, samples, inputs)).collect()
    }

    /// The buffers of pass `classify`.
    pub fn classify_buffers(&self) -> &ClassifyBuffers {
        &self.buffers.classify
    }

    /// For each candidate, a bit per light point: whether the light point is visible.
    pub fn visibility(&self) -> &Buffer {
        &self.buffers.visibility
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        let Buffers { classify, visibility, shadow_samples } = &self.buffers;
        classify.bytes() + visibility.bytes + shadow_samples.as_ref().map_or(0, |b| b.bytes)
    }
}
