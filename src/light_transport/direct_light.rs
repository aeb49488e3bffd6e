//! Direct light by shadow photons: the techniques `two-pass`, `shadow-photons` and `visibility-estimate`; and by the earlier
//! methods that they are compared with (`earlier.rs`).
//!
//! They differ in what `needs` keeps: without a visibility map every point is unknown and asks all shadow rays; with
//! one only boundary and unknown points do; and the visibility estimate asks none where there are photons at all.

use crate::Result;
use crate::gpu::{Bindings, Buffer, Features, Frame, Gpu};
use crate::gpu_scene::GpuScene;
use crate::passes::classify::{BoundClassify, Chunk, Classify, ClassifyBuffers, Queue};
use crate::passes::film::{Film, Plane};
use crate::passes::sample_lights::BoundSampleLights;
use crate::passes::shade::{BoundShade, Shade, ShadeBuffers, ShadeParameters};
use crate::passes::shadow::{BoundShadow, Shadow, ShadowBuffers, ShadowParameters};
use crate::passes::{Tile, TileBuffers};
use crate::scene::Scene;
use crate::settings::{Aov, Settings};

use super::earlier::{BoundEarlier, Earlier, EarlierKernels};
use super::light_sampler::{LightSampler, LightSamplerKernels};
use super::visibility_map::{MapKernels, MapState, VisibilityMap};
use crate::statistics::totals::Totals;

/// Most slots (points times lights) that are worked on at once, where one light's points are not more.
const CHUNK_SLOTS: u32 = 1 << 21;

/// Most points of a tile that the technique can work on at once, all lights of a point together where it must, and so that what is
/// counted of a tile, light points of all lights at most, fits a word.
pub(crate) fn most_points(features: &Features, lights: usize, settings: &Settings) -> u32 {
    let lights = lights.max(1) as u32;
    if features.has("ward") {
        return (CHUNK_SLOTS / lights).max(1);
    }
    let asked = if features.has("light_sampling") { settings.light_sampling.sampled_lights } else { lights };
    (u32::MAX / asked.saturating_mul(settings.shadow_rays.samples)).max(1)
}

/// Most words of visibilities at once: half of the smallest storage binding that devices offer.
const CHUNK_WORDS: u32 = 1 << 24;

/// Turns of loops that `shade` takes at most for the lights of a chunk: lavapipe ends all loops of an invocation in silence after
/// 65,535 of them. Ten thousand lights in one chunk lost half of their light.
const SHADE_TURNS: u32 = 32_768;

/// A light wider than this share of the scene's radius has penumbrae so wide that faint ones would be missed without
/// dilation; the boundaries of a narrower one are too wide already (the two scenes of the paper: 0.33 and 0.02).
const WIDE_LIGHT: f32 = 0.05;

pub(crate) struct Kernels {
    classify: Classify,
    shadow: Shadow,
    shade: Shade,
    map: Option<MapKernels>,
    earlier: Option<EarlierKernels>,
    choice: Option<LightSamplerKernels>,
    /// They audit.
    audit: bool,
}

impl Kernels {
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)], settings: &Settings) -> Result<Kernels> {
        // Elsewhere the photons' visibility is a control variate, for which any guess will do.
        let exact_counts = features.has("aov_shadow") || features.has("visibility_estimate");
        let ((classify, (map, (earlier, choice))), (shadow, shade)) = rayon::join(
            || {
                let map =
                    || features.has("visibility_map").then(|| MapKernels::new(gpu, features, constants, settings));
                let choice = || LightSamplerKernels::new(gpu, features, constants, settings);
                rayon::join(
                    || Classify::new(gpu, features, settings.visibility_map.nearest, exact_counts),
                    || rayon::join(map, || rayon::join(|| EarlierKernels::new(gpu, features, constants), choice)),
                )
            },
            || rayon::join(|| Shadow::new(gpu, features, constants), || Shade::new(gpu, features, constants)),
        );
        let (map, earlier, choice) = (map.transpose()?, earlier?, choice?);
        let audit = features.has("audit");
        Ok(Kernels { classify: classify?, shadow: shadow?, shade: shade?, map, earlier, choice, audit })
    }
}

pub(crate) struct Direct {
    buffers: Buffers,
    map: Option<VisibilityMap>,
    earlier: Option<Earlier>,
    choice: Option<LightSampler>,
    passes: Passes,
    /// None while the map is sorted anew.
    bound: Option<Bound>,
    /// That each point asks.
    lights: u32,
    lights_in_chunk: u32,
    /// Words of visibilities of a slot.
    words: u32,
    settings: Settings,
    dilate: u32,
    /// Of a decided point; 0 where nothing is audited.
    audit_probability: f32,
}

struct Passes {
    classify: Classify,
    shadow: Shadow,
    shade: Shade,
}

/// What the passes hand to each other for a chunk of lights.
struct Buffers {
    classify: ClassifyBuffers,
    visibility: Buffer,
    /// Class, visibility, n_i and n_s of each slot, for the AOV.
    shadow_samples: Option<Buffer>,
}

/// The passes bound to the current map: a new grid binds anew.
struct Bound {
    choose: Option<BoundSampleLights>,
    classify: BoundClassify,
    earlier: Option<BoundEarlier>,
    shadow: BoundShadow,
    shade: BoundShade,
}

/// The film of one light's classes: that of the first sample (x) and visibility, n_i and n_s of all.
pub(crate) struct ShadowFilm(Plane);

impl ShadowFilm {
    pub fn plane(&self) -> &Plane {
        &self.0
    }
}

/// What the passes share with the rest of the render.
pub(crate) struct Shared<'a> {
    pub gpu: &'a Gpu,
    pub scene: &'a Scene,
    pub gpu_scene: &'a GpuScene,
    pub tile: &'a TileBuffers,
}

impl Direct {
    /// Makes the map and the buffers for tiles of `points` points.
    pub fn new(
        shared: &Shared<'_>,
        kernels: Kernels,
        points: u32,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<Direct> {
        let Shared { gpu, scene, gpu_scene, .. } = *shared;
        let Kernels { classify, shadow, shade, map, earlier, choice, audit } = kernels;
        let audit_probability = if audit { settings.visibility_map.audit } else { 0.0 };
        let choice = choice
            .map(|kernels| LightSampler::new(gpu, kernels, scene, gpu_scene, points, settings, totals))
            .transpose()?;
        let lights = choice.as_ref().map_or(scene.lights.len() as u32, LightSampler::slots);
        let words = settings.shadow_rays.samples.div_ceil(32);
        let fitting = (CHUNK_SLOTS / points).min(CHUNK_WORDS / (points * words));
        // Of a light `shade` takes a turn, one for each light point, and those of the closed form.
        let edges = gpu_scene.lights.lights.iter().map(|light| light.contour_edges as u32).max().unwrap_or(0);
        let fitting = fitting.min(SHADE_TURNS / (2 + settings.shadow_rays.samples + 2 * edges)).clamp(1, lights.max(1));
        let lights_in_chunk = if matches!(earlier, Some(EarlierKernels::Ward(_))) { lights } else { fitting };
        let slots = points * lights_in_chunk;
        let film = settings.image.aovs.contains(&Aov::Shadow);
        let buffers = Buffers {
            classify: ClassifyBuffers::new(gpu, slots)?,
            visibility: gpu.buffer::<u32>("penumbra/shadow/visibility", (slots * words) as usize)?,
            shadow_samples: film
                .then(|| gpu.buffer::<[f32; 4]>("penumbra/shade/shadow_samples", slots as usize))
                .transpose()?,
        };
        let map =
            map.map(|kernels| VisibilityMap::new(gpu, kernels, scene, gpu_scene, settings, totals)).transpose()?;
        let earlier = earlier
            .map(|kernels| Earlier::new(gpu, kernels, scene, gpu_scene, points, settings, totals))
            .transpose()?;
        let wide = gpu_scene.lights.lights.iter().any(|light| !light.punctual && light.radius > WIDE_LIGHT);
        let dilate = if map.is_some() { settings.visibility_map.dilate.unwrap_or(u32::from(wide)) } else { 0 };
        let passes = Passes { classify, shadow, shade };
        let bound = passes.bind(shared, &buffers, map.as_ref(), earlier.as_ref(), choice.as_ref(), dilate)?;
        let settings = settings.clone();
        Ok(Direct {
            buffers,
            map,
            earlier,
            choice,
            passes,
            bound: Some(bound),
            lights,
            lights_in_chunk,
            words,
            settings,
            dilate,
            audit_probability,
        })
    }

    /// Adds the direct light of every light to the tile's points.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile, films: &[ShadowFilm]) {
        let bound = self.bound.as_ref().expect("a map that could not be sorted ends the batch before");
        if let Some(choose) = &bound.choose {
            choose.record(frame, tile);
        }
        for first_light in (0..self.lights).step_by(self.lights_in_chunk as usize) {
            let lights = self.lights_in_chunk.min(self.lights - first_light);
            let audit_probability = self.audit_probability;
            let chunk = Chunk { first_light, lights, dilate: self.dilate, audit_probability };
            let group = self.passes.shadow.workgroup_size();
            let shadow = ShadowParameters {
                tile: *tile,
                first_light,
                light_samples: self.settings.shadow_rays.samples,
                visibility_words: self.words,
                heal_capacity: self.map.as_ref().map_or(0, VisibilityMap::heal_capacity),
            };
            let buffers = &self.buffers.classify;
            let trace = |frame: &mut Frame<'_>| {
                let [boundary, audit] = [Queue::Boundary, Queue::Audit].map(Queue::arguments_offset);
                bound.shadow.record(frame, &buffers.queue_arguments, boundary, audit, &shadow);
            };
            let Bound { classify, earlier, .. } = bound;
            if let Some(earlier) = earlier {
                earlier.record(frame, buffers, tile, &chunk, &self.settings, |frame| {
                    classify.record_arguments(frame, tile, &chunk, Queue::Boundary, group);
                    trace(frame);
                });
                frame.clear(&buffers.queue_lengths);
                classify.record_queues(frame, buffers, tile, &chunk, group);
            } else {
                classify.record(frame, buffers, tile, &chunk, group);
            }
            if !earlier.as_ref().is_some_and(BoundEarlier::has_tested) {
                trace(frame);
            }
            let shade = ShadeParameters {
                tile: *tile,
                first_light,
                lights_in_chunk: lights,
                light_samples: self.settings.shadow_rays.samples,
                visibility_words: self.words,
                audit_probability,
                padding: 0,
            };
            let arrange = |frame: &mut Frame<'_>, group| {
                classify.record_arguments(frame, tile, &chunk, Queue::Sampled, group);
            };
            let arguments = (&buffers.queue_arguments, Queue::Sampled.arguments_offset());
            bound.shade.record(frame, &shade, arrange, arguments);
            for light in 0..lights.min(films.len() as u32) {
                films[(first_light + light) as usize].0.record_from(frame, tile, light * tile.point_count);
            }
        }
    }

    /// Films of all lights for a tile of `pixels` pixels; none where they are not asked for.
    pub fn films(&self, gpu: &Gpu, film: &Film, pixels: u32, counters: &Buffer) -> Result<Vec<ShadowFilm>> {
        let Some(samples) = &self.buffers.shadow_samples else { return Ok(Vec::new()) };
        (0..self.lights).map(|_| Ok(ShadowFilm(film.plane(gpu, pixels, samples, counters)?))).collect()
    }

    /// Adds the photons that audits left to the map and sorts it anew, if that is `due` or there is little room for more.
    pub fn heal(&mut self, shared: &Shared<'_>, due: bool, totals: &mut Totals) -> Result<()> {
        let Some(map) = &mut self.map else { return Ok(()) };
        if map.take_healed(shared.gpu, due, totals)? {
            self.bound = None;
            map.sort(shared.gpu)?;
        }
        self.bind_anew(shared)
    }

    /// Binds the map where nothing is bound, as it was sorted since.
    fn bind_anew(&mut self, shared: &Shared<'_>) -> Result<()> {
        if self.bound.is_none() {
            let map = self.map.as_ref();
            self.bound = Some(self.passes.bind(shared, &self.buffers, map, None, None, self.dilate)?);
        }
        Ok(())
    }

    /// What samples have left in the map, or in what stands in for it.
    pub fn map_state(&self, gpu: &Gpu) -> Result<MapState> {
        match (&self.map, &self.earlier) {
            (Some(map), _) => map.state(gpu),
            (None, Some(earlier)) => Ok(MapState { rest: earlier.state(gpu)?, ..MapState::default() }),
            (None, None) => Ok(MapState::default()),
        }
    }

    /// Puts back what samples had left in a map that has nothing of it; false where it is not of this map.
    pub fn restore(&mut self, shared: &Shared<'_>, state: &MapState, totals: &mut Totals) -> Result<bool> {
        let Some(map) = &mut self.map else {
            let fits = |earlier: &Earlier| earlier.restore(shared.gpu, &state.rest);
            return Ok(self.earlier.as_ref().map_or(state.rest.is_empty(), fits));
        };
        self.bound = None;
        let fits = map.restore(shared.gpu, state, totals)?;
        self.bind_anew(shared)?;
        Ok(fits)
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        self.buffers.classify.bytes()
            + self.buffers.visibility.bytes
            + self.buffers.shadow_samples.as_ref().map_or(0, |b| b.bytes)
            + self.earlier.as_ref().map_or(0, Earlier::frame_bytes)
            + self.choice.as_ref().map_or(0, LightSampler::frame_bytes)
    }
}

impl Passes {
    fn bind(
        &self,
        shared: &Shared<'_>,
        buffers: &Buffers,
        map: Option<&VisibilityMap>,
        earlier: Option<&Earlier>,
        choice: Option<&LightSampler>,
        dilate: u32,
    ) -> Result<Bound> {
        let Shared { gpu, gpu_scene, tile, .. } = *shared;
        let chosen = choice.map(LightSampler::resources).unwrap_or_default();
        let scene: [&dyn Bindings; 2] = [gpu_scene, &chosen];
        let classes = buffers.classify.final_classes(dilate);
        let shadow = ShadowBuffers {
            classes,
            boundary_queue: &buffers.classify.boundary_queue,
            audit_queue: &buffers.classify.audit_queue,
            queue_lengths: &buffers.classify.queue_lengths,
            visibility: &buffers.visibility,
            heal: map.map(VisibilityMap::heal_buffers),
        };
        let shade = ShadeBuffers {
            classes,
            visibility: &buffers.visibility,
            shadow_samples: buffers.shadow_samples.as_ref(),
            sampled_points: buffers.classify.sampled_points(),
            queue_lengths: &buffers.classify.queue_lengths,
        };
        let bind = |earlier: &Earlier| earlier.bind(gpu, tile, &buffers.classify, &buffers.visibility, gpu_scene);
        Ok(Bound {
            earlier: earlier.map(bind).transpose()?,
            choose: choice.map(|choice| choice.bind(gpu, tile, gpu_scene)).transpose()?,
            classify: self.classify.bind(gpu, tile, map.and_then(VisibilityMap::grid), &buffers.classify, &scene)?,
            shadow: self.shadow.bind(gpu, tile, &shadow, &scene)?,
            shade: self.shade.bind(gpu, tile, &shade, &scene)?,
        })
    }
}
