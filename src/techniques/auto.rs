//! The technique of a render that names none, and how its samples are distributed over pixels.

use kernel_kit::Gpu;

use super::view_sketch::{shows_isolated_model, shows_open_scene};
use crate::scene::{Camera, Light, LightKind, Scene};
use crate::settings::{
    Aov, IrradianceCacheSettings, Sampling, Settings, ShadowRaySettings, Technique, VisibilityMapSettings,
};
use crate::specialisation::Specialisation;
use crate::specialisation::features::Feature;

/// A technique, and why it was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// The technique.
    pub technique: Technique,
    /// The reason; `None` for the default.
    pub reason: Option<String>,
    /// How samples are distributed over pixels.
    pub sampling: Sampling,
    /// Expected seconds from the imported scene to the first sample, before the speed of the machine is known. `None`
    /// for another technique than the default, and for devices and settings that were not measured.
    pub first_sample: Option<f64>,
}

/// Parts of the time of the default technique's first sample, in seconds, on a software device of two cores after the
/// scene is imported. Fitted to the scenes of `scenes/` at 128, 256 and 512 pixels each way, with kernels compiled
/// before (docs/decisions.md, "Choosing a technique for a time budget").
mod seconds {
    /// Composing kernels of Lambertian surfaces.
    pub const KERNELS: f64 = 0.26;
    /// More for kernels with glossy lobes.
    pub const GLOSSY_KERNELS: f64 = 0.07;
    /// More for kernels of caustics or of procedural objects.
    pub const LARGE_KERNELS: f64 = 0.28;
    /// The BVH, for a triangle.
    pub const TRIANGLE: f64 = 1.5e-6;
    /// Irradiance records and camera rays, for a pixel.
    pub const PIXEL: f64 = 4.4e-7;
    /// More for each doubling of the triangles.
    pub const PIXEL_LEVEL: f64 = 2.6e-8;
    /// Paths and photons of caustics, or functions of procedural objects, for a pixel.
    pub const LARGE_PIXEL: f64 = 1.5e-6;
    /// A shadow ray with its share of shading.
    pub const SHADOW_RAY: f64 = 1.2e-7;
    /// More for each doubling of the triangles.
    pub const SHADOW_RAY_LEVEL: f64 = 8e-9;
    /// Photons that show which lights reach a zone, for each of many lights.
    pub const LIGHT_OF_ZONES: f64 = 1.2e-3;
}

/// Cores for which these were measured.
const MEASURED_CORES: f64 = 2.0;

/// The default technique is used if the time is at least this multiple of the expected time of its first sample. It is
/// below 1: in rooms that sample has a twentieth of the error that `path` reaches by then, which is worth ending late
/// by a tenth of the time.
const MIN_TIMES: f64 = 0.9;

/// Like [`MIN_TIMES`], for open scenes. In the crowd, a single sample has 3 to 4.5 times the error of the samples that
/// `path` has by then, two samples have 1.6 times its error, and four 0.7 times. In the scenes with the ball and with
/// procedural objects, two samples have half the error of `path`. Further samples take little time: two to four fit.
const MIN_TIMES_OF_OPEN_SCENE: f64 = 1.25;

/// Adaptive sampling is used if the time is at least this multiple of the expected time of the first sample. In less
/// time hardly more than four samples fit. The noise estimates that it needs each take half as long as a sample, and
/// then cost as much as they gain.
const MIN_TIMES_TO_SHARE: f64 = 2.6;

/// For an isolated model `path` has less error, or about the same, up to about this multiple of the expected time of
/// the first sample of the default technique (docs/decisions.md, "Isolated models").
const MAX_TIMES_OF_PATHS: f64 = 5.0;

/// As [`MAX_TIMES_OF_PATHS`], if a panorama is the only light. At about this multiple `path` has 0.7 to 0.95 of the
/// error of the default technique, and at sixty about the same error.
const MAX_TIMES_OF_PATHS_UNDER_SKY: f64 = 25.0;

/// Samples that `path` takes of an isolated model in the expected time of the first sample of the default technique,
/// with a margin: 5 to 11 were measured with times of 4 to 30 s. If fewer samples are requested, the render ends early,
/// and `path` is not used: one of its samples has no less noise than one of the default technique.
const MAX_PATHS_IN_FIRST_SAMPLE: f64 = 13.0;

/// As [`MIN_TIMES_TO_SHARE`], for `path` and an isolated model. The first sample of `path` takes about half as long.
const MIN_TIMES_TO_SHARE_PATHS: f64 = 1.7;

impl Choice {
    /// The technique for an image that must be ready within `within` seconds from now, when the scene is imported;
    /// `None`: no limit. `slowness`: time of first samples on this machine over the expected time, 1 if nothing is
    /// known.
    ///
    /// The default technique had the smallest error of many samples in all scenes that were measured. But its first
    /// sample comes later than that of `path`, which needs neither photons nor records.
    ///
    /// For a model in front of an empty background `path` is used for longer, because its samples cost little there.
    /// The exception is a render that is complete sooner, as one sample of the default technique has no more noise than
    /// one of `path`.
    ///
    /// Adaptive sampling removes up to half of the error at equal time (docs/decisions.md, "Adaptive sampling with a
    /// fixed budget"). Nothing was measured on a GPU, where the estimates of noise may cost more than they gain.
    pub fn new(
        gpu: &Gpu,
        scene: &Scene,
        camera: &Camera,
        settings: &Settings,
        within: Option<f64>,
        slowness: f64,
    ) -> Choice {
        let technique = Technique::default();
        let usual = Choice { technique, reason: None, sampling: settings.image.sampling, first_sample: None };
        if !gpu.is_software() {
            return usual;
        }
        let unscaled = first_sample(scene, camera, settings);
        let is_free = is_free(settings);
        let usual = Choice { first_sample: is_free.then_some(unscaled), ..usual };
        let Some(within) = within else { return usual };
        let expected = slowness * unscaled;
        let times = within / expected;
        let size = [settings.image.width, settings.image.height];
        let reason = if !is_free {
            None
        } else if times < MIN_TIMES || (times < MIN_TIMES_OF_OPEN_SCENE && shows_open_scene(scene, camera, size)) {
            Some(format!("photons and records would take about {expected:.1} s before the first image"))
        } else if times < max_times_of_paths(scene)
            && f64::from(settings.image.spp) >= MAX_PATHS_IN_FIRST_SAMPLE * times
            && shows_isolated_model(scene, camera, size)
        {
            Some("most of the image is empty, and few paths would meet a second surface".into())
        } else {
            None
        };
        let (technique, min_times_to_share) = match reason {
            Some(_) => (Technique::PATH, MIN_TIMES_TO_SHARE_PATHS),
            None => (usual.technique, MIN_TIMES_TO_SHARE),
        };
        let is_decided = settings.image.noise.is_some() || settings.image.piece.is_some();
        let is_shared = !is_decided && times >= min_times_to_share;
        let sampling = if is_shared { Sampling::Adaptive } else { usual.sampling };
        Choice { technique, sampling, first_sample: usual.first_sample.filter(|_| reason.is_none()), reason }
    }
}

/// The multiple of the expected time of the first sample up to which `path` renders an isolated model.
fn max_times_of_paths(scene: &Scene) -> f64 {
    let is_sky = |light: &Light| matches!(light.kind, LightKind::Environment { .. });
    if scene.lights.iter().all(is_sky) { MAX_TIMES_OF_PATHS_UNDER_SKY } else { MAX_TIMES_OF_PATHS }
}

/// Whether `path` can satisfy all settings: none is set that affects only photons, records or shadow rays.
fn is_free(settings: &Settings) -> bool {
    let Settings { visibility_map, shadow_rays, indirect, image, .. } = settings;
    let is_usual = *visibility_map == VisibilityMapSettings::default()
        && *shadow_rays == ShadowRaySettings::default()
        && indirect.irradiance_cache == IrradianceCacheSettings::default()
        && indirect.photons.is_none();
    is_usual
        && !image.aovs.contains(&Aov::Shadow)
        && settings.clone().with(|s| s.technique = Technique::PATH).check().is_ok()
}

/// Expected seconds from the imported scene to the first sample of the default technique.
fn first_sample(scene: &Scene, camera: &Camera, settings: &Settings) -> f64 {
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as f64;
    let settings = settings.clone().with(|s| s.technique = Technique::default());
    let features = Specialisation::new(scene, Some(camera), &settings).features;
    let is_large = features.has(Feature::Caustics) || features.has(Feature::Procedurals);
    let if_any = |condition: bool, seconds: f64| if condition { seconds } else { 0.0 };
    let kernels = seconds::KERNELS
        + if_any(features.has(Feature::Glossy), seconds::GLOSSY_KERNELS)
        + if_any(is_large, seconds::LARGE_KERNELS);
    let has_zones = features.has(Feature::Zones);
    let is_sampled = features.has(Feature::LightSampling);
    let lights = if is_sampled { settings.light_sampling.sampled_lights as usize } else { scene.lights.len() } as f64;
    let zones = if_any(has_zones, scene.lights.len() as f64 * seconds::LIGHT_OF_ZONES);
    let crop = settings.image.crop_window();
    let pixels = f64::from(crop.width) * f64::from(crop.height);
    let triangles = scene.triangles.len() as f64;
    let levels = triangles.max(1.0).log2();
    let rays_of = |light: &Light| f64::from(light.kind.max_light_points(settings.shadow_rays.samples));
    let rays = lights * scene.lights.iter().map(rays_of).sum::<f64>() / scene.lights.len().max(1) as f64;
    let pixel = seconds::PIXEL + levels * seconds::PIXEL_LEVEL + if_any(is_large, seconds::LARGE_PIXEL);
    let ray = seconds::SHADOW_RAY + levels * seconds::SHADOW_RAY_LEVEL;
    let parallel = zones + triangles * seconds::TRIANGLE + pixels * (pixel + rays * ray);
    kernels + parallel * MEASURED_CORES / cores
}
