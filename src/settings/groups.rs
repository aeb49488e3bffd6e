//! The groups of [`Settings`].

use std::fmt;
use std::str::FromStr;

use super::{Aov, Denoise, LightSampling, Sampling, Settings};

/// The image: its size, samples and channels.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct ImageSettings {
    /// Width of the whole image in pixels, 1 to [`Settings::MAX_SIDE`].
    pub width: u32,
    /// Height of the whole image in pixels, 1 to [`Settings::MAX_SIDE`].
    pub height: u32,
    /// The part that is rendered. `None`: all of it.
    pub crop: Option<Crop>,
    /// Samples per pixel, 1 to [`Settings::UNLIMITED_SPP`]: the number of each pixel, or the mean, depending on
    /// `sampling`. A single sample goes through the centre of the pixel.
    pub spp: u32,
    /// How samples are distributed over pixels. [`Sampling::Adaptive`] is not for pieces.
    pub sampling: Sampling,
    /// The samples of a piece; other pieces have the rest. No sample then learns from another one, so that pieces have
    /// the same bits however the image is divided. `None`: all samples; later ones learn from earlier ones.
    #[serde(rename = "samples")]
    pub piece: Option<SampleRange>,
    /// Seed of all random numbers.
    pub seed: u32,
    /// Channels in addition to the picture.
    pub aovs: Vec<Aov>,
    /// The denoiser whose input the film keeps; see [`crate::Denoiser`].
    pub denoise: Denoise,
    /// Estimated relMSE at which a block of pixels gets no more samples (adaptive sampling), above 0. The image must be
    /// unbiased ([`Settings::is_unbiased`]). `None`: each pixel gets `spp` samples.
    pub noise: Option<f64>,
    /// What the camera sees where there is no surface.
    pub background: Background,
}

/// A part of an image, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// First column.
    pub x: u32,
    /// First row, from the top.
    pub y: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

impl Crop {
    /// Number of pixels.
    pub fn pixels(self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// The samples of each pixel from number `first` to number `end` - 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SampleRange {
    /// The first one; a pixel's samples are counted from 0.
    pub first: u32,
    /// The one after the last.
    pub end: u32,
}

/// What the camera sees where there is no surface. The environment lights the scene whichever is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Background {
    /// The environment; black without one.
    #[default]
    Environment,
    /// Nothing: the alpha of the image is the share of a pixel that surfaces cover, and a PNG has it too.
    Transparent,
    /// This linear Rec.709 radiance.
    Colour([f32; 3]),
}

impl fmt::Display for Crop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{},{}", self.x, self.y, self.width, self.height)
    }
}

impl fmt::Display for SampleRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}..{}", self.first, self.end)
    }
}

impl FromStr for SampleRange {
    type Err = String;

    /// A range as in 0..16.
    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.trim().parse().ok();
        let range = text.split_once("..").and_then(|(first, end)| Some((number(first)?, number(end)?)));
        let (first, end) = range.ok_or("it must be a range of samples, as in 0..16, the last number not included")?;
        Ok(SampleRange { first, end })
    }
}

impl fmt::Display for Background {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Background::Environment => f.write_str("environment"),
            Background::Transparent => f.write_str("transparent"),
            Background::Colour([r, g, b]) => write!(f, "{r},{g},{b}"),
        }
    }
}

impl serde::Serialize for Crop {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl serde::Serialize for SampleRange {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl serde::Serialize for Background {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl SampleRange {
    /// The number of samples.
    pub fn count(&self) -> u32 {
        self.end.saturating_sub(self.first)
    }
}

impl ImageSettings {
    /// The pixels that are rendered: the crop, or all of them.
    pub fn crop_window(&self) -> Crop {
        self.crop.unwrap_or(self.whole())
    }

    /// All pixels.
    pub(crate) fn whole(&self) -> Crop {
        Crop { x: 0, y: 0, width: self.width, height: self.height }
    }

    /// The samples that are made of each pixel.
    pub fn range(&self) -> SampleRange {
        self.piece.unwrap_or(SampleRange { first: 0, end: self.spp })
    }

    /// Whether adaptive sampling has a fixed budget: pixels with noise around them get more samples than others. With
    /// `noise`, blocks get samples until their error is small enough instead.
    pub(crate) fn allocates_samples(&self) -> bool {
        self.sampling == Sampling::Adaptive && self.spp > 2 && self.noise.is_none()
    }
}

impl Default for ImageSettings {
    fn default() -> Self {
        ImageSettings {
            width: 512,
            height: 512,
            crop: None,
            spp: 16,
            sampling: Sampling::Uniform,
            piece: None,
            seed: 0,
            aovs: Vec::new(),
            denoise: Denoise::None,
            noise: None,
            background: Background::Environment,
        }
    }
}

/// The visibility map: illumination and shadow photons, and how they classify points.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct VisibilityMapSettings {
    /// Visibility photons emitted from each light, 1 to [`Settings::MAX_PHOTONS`]. `None`: the number of
    /// [`Settings::photons_per_light`].
    #[serde(rename = "photons")]
    pub photons_per_light: Option<u32>,
    /// Nearest photons that classify a point: k of the paper, 1 to [`Settings::MAX_NEAREST`].
    pub nearest: u32,
    /// Maximum number of shadow photons stored along one photon ray, 1 to [`Settings::MAX_SHADOW_PHOTONS`].
    pub shadow_photons_per_ray: u32,
    /// Pixels by which boundaries are widened, 0 or 1. `None`: 1 for lights with wide penumbrae, and where audits find
    /// many mistakes near boundaries, else 0.
    pub dilate: Option<u32>,
    /// Minimum probability that a lit or shadowed point is audited by a shadow ray, 0 to 1. It is larger near
    /// boundaries, and, where fine cells learn from samples, after audits that contradicted a class. 0 is the paper's
    /// method, which is biased; zones are then not audited either.
    pub audit: f32,
    /// Count photons regardless of their normals, as the paper does.
    pub paper_counting: bool,
    /// Let the shadow rays of earlier samples decide where photons do not. `false`: photons alone decide.
    pub fine_cells: bool,
}

impl Default for VisibilityMapSettings {
    fn default() -> Self {
        VisibilityMapSettings {
            photons_per_light: None,
            // At 50 the sphere of the paper keeps 7.0 % of its shadow rays, at 36 it keeps 5.8 %. The error of the box
            // is the same.
            nearest: 36,
            // As in the paper.
            shadow_photons_per_ray: 10,
            dilate: None,
            // Where nothing raises it, audits cost a 64th of the shadow rays that classes save.
            audit: 1.0 / 64.0,
            paper_counting: false,
            fine_cells: true,
        }
    }
}

/// Shadow rays of the points that need them.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct ShadowRaySettings {
    /// Light points, each with a shadow ray, that a boundary point samples: 1 to [`Settings::MAX_SHADOW_SAMPLES`]. For
    /// point, spot and directional lights it is one, because their light comes from a single direction.
    #[serde(rename = "shadow_samples")]
    pub samples: u32,
}

impl Default for ShadowRaySettings {
    fn default() -> Self {
        // Half as many save 7 % of the time but have 1.5 times the error. 8 and 16 in penumbrae were tried and not kept
        // (docs/experiments.md, "Light points").
        ShadowRaySettings { samples: 4 }
    }
}

/// Light sampling in scenes of many lights.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct LightSamplingSettings {
    /// Probabilities by which lights are sampled. `None`: `zones` for `shadow-photons` in scenes of more than
    /// [`Settings::MANY_LIGHTS`] lights, `power` for paths, otherwise `all`.
    #[serde(rename = "light_sampling")]
    pub strategy: Option<LightSampling>,
    /// Lights sampled at each point, unless all are used: 1 to [`Settings::MAX_SAMPLED_LIGHTS`], with zones at least 2.
    pub sampled_lights: u32,
}

impl Default for LightSamplingSettings {
    fn default() -> Self {
        // Of 16 lamps, eight take half to a sixth of the time of all (docs/decisions.md, "The threshold of 16 lights").
        // Other numbers were not compared.
        LightSamplingSettings { strategy: None, sampled_lights: 8 }
    }
}

/// Indirect light.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct IndirectSettings {
    /// Maximum number of bounces of indirect light; 0 for direct light alone. Mirrors and clear glass before the first
    /// other surface that a camera ray meets are no bounces, except with `path`. A gather ray that hits a surface too
    /// near continues for one more bounce: with irradiance records, a room rendered with two bounces also has about
    /// 0.2 % of the light of a third.
    pub max_bounces: u32,
    /// Photons emitted for the global map, from all lights together and by their power: 1 to [`Settings::MAX_PHOTONS`].
    /// `None`: the number of [`Settings::flux_photons`].
    #[serde(rename = "flux_photons")]
    pub photons: Option<u32>,
    /// Upper limit of the indirect light that a path adds to its sample, for each of red, green and blue: more than 0,
    /// in units of radiance. It removes fireflies, and with them light: the image is biased. Light that points take
    /// from the caustic map or from irradiance records is not limited. `None`: no limit.
    pub clamp: Option<f32>,
    /// The irradiance cache.
    #[serde(flatten)]
    pub irradiance_cache: IrradianceCacheSettings,
}

impl Default for IndirectSettings {
    fn default() -> Self {
        IndirectSettings {
            // Russian roulette ends paths long before; this bounds a path in a scene that absorbs nothing.
            max_bounces: 64,
            photons: None,
            clamp: None,
            irradiance_cache: IrradianceCacheSettings::default(),
        }
    }
}

/// The irradiance cache of diffuse indirect light (Ward and Heckbert 1992).
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct IrradianceCacheSettings {
    /// Interpolate irradiance between records. `false`: every point traces one gather ray.
    #[serde(rename = "cache")]
    pub enabled: bool,
    /// Radius of a record over the harmonic mean distance of the surfaces around it (a of Ward and Heckbert 1992):
    /// smaller is more accurate. More than 0, at most [`Settings::MAX_ACCURACY`].
    pub accuracy: f32,
    /// Gather rays per record, 1 to [`Settings::MAX_GATHER_RAYS`], rounded up to a power of two. `None`: the number of
    /// [`Settings::gather_rays`].
    pub gather_rays: Option<u32>,
}

impl Default for IrradianceCacheSettings {
    fn default() -> Self {
        // With 0.1, indirect light changes by no more than its standard error: by 0.2 % in `scenes/lamps.glb` and by
        // 0.1 % in `box.glb` (docs/experiments.md, "Discs of photons").
        IrradianceCacheSettings { enabled: true, accuracy: 0.25, gather_rays: None }
    }
}

/// The grid of the techniques `visibility-cells` and `voxel-tags`.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct CellSettings {
    /// Cells along the longest side of the scene, 1 to [`Settings::MAX_CELLS`].
    #[serde(rename = "cells")]
    pub resolution: u32,
    /// Rays from each cell to each light, 1 to [`Settings::MAX_CELL_RAYS`].
    #[serde(rename = "cell_rays")]
    pub rays_per_light: u32,
}

impl Default for CellSettings {
    fn default() -> Self {
        // Zimmerman and Shirley 1995 trace up to 100 rays. Up to 16 lights have room for 64^3 cells each
        // (`MAX_CELLS` in src/kernels/grid_shape.rs).
        CellSettings { resolution: 64, rays_per_light: 100 }
    }
}

/// The technique `light-buffer` (Haines and Greenberg 1986).
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct LightBufferSettings {
    /// Cells along a side of each face of the cube around a light, 1 to [`Settings::MAX_LIGHT_BUFFER_CELLS`]. Fewer
    /// where many lights share the memory.
    #[serde(rename = "light_buffer_cells")]
    pub resolution: u32,
}

impl Default for LightBufferSettings {
    fn default() -> Self {
        // In the sphere scene, twice as many leave 4 % fewer shadow rays, and half as many 7 % more
        // (docs/experiments.md, "The earlier methods").
        LightBufferSettings { resolution: 64 }
    }
}

/// The technique `ward-adaptive` (Ward 1991).
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct WardSettings {
    /// Lights are tested until the remaining ones could contribute less than this share of the point's light, 0 to 1. 0
    /// tests all.
    #[serde(rename = "shadow_tolerance")]
    pub tolerance: f32,
}

impl Default for WardSettings {
    fn default() -> Self {
        // The default of Radiance (-dt), the renderer that the method was made for.
        WardSettings { tolerance: 0.05 }
    }
}

impl Settings {
    /// Largest side of an image.
    pub const MAX_SIDE: u32 = 16_384;
    /// Maximum number of samples per pixel: the film counts them in f32, which represents every integer up to this one.
    /// Renders that end by time have it as their number of samples, and never reach it. It is a power of two, so that
    /// the samples of a pixel stay well stratified.
    pub const UNLIMITED_SPP: u32 = 1 << 24;
    /// Largest k: a class word has room for no more.
    pub const MAX_NEAREST: u32 = 511;
    /// Maximum number of light points sampled by a boundary point. With as many, the visibilities of a full tile take
    /// 64 MiB for a light, half of the smallest storage binding that devices offer.
    pub const MAX_SHADOW_SAMPLES: u32 = 1024;
    /// Maximum number of shadow photons stored along one ray: an invocation has registers for no more.
    pub const MAX_SHADOW_PHOTONS: u32 = 64;
    /// Number of lights up to which all points use all of them by default. With 16 small lamps, sampling eight takes
    /// half to a sixth of the time at the same error (docs/decisions.md, "The threshold of 16 lights").
    pub const MANY_LIGHTS: u32 = 16;
    /// Maximum number of lights sampled at a point: as many as a zone lists.
    pub const MAX_SAMPLED_LIGHTS: u32 = 64;
    /// Maximum number of photons: of 16 bytes each, they fill a storage binding of 128 MiB eight times.
    pub const MAX_PHOTONS: u32 = 1 << 26;
    /// Maximum number of cells along a side. Cells are larger where all lights together would have more than 2^22.
    pub const MAX_CELLS: u32 = 256;
    /// Maximum number of rays from a cell to a light: half a word counts them, and has room for 16 times as many.
    pub const MAX_CELL_RAYS: u32 = 4096;
    /// Maximum number of cells along a side of a light buffer: one light then has three quarters of all cells.
    pub const MAX_LIGHT_BUFFER_CELLS: u32 = 256;
    /// Largest ratio of a record's radius to the distance of the surfaces around it.
    pub const MAX_ACCURACY: f32 = 10.0;
    /// Maximum number of gather rays per record: as many as one invocation can sum up on software devices.
    pub const MAX_GATHER_RAYS: u32 = 16_384;
}
