//! Options that are settings of a render.

use clap::Args;
use penumbra::internal::gpu_scene::camera::CameraUniform;
use penumbra::settings::{Background, Crop, LightSampling, SampleRange, Sampling};
use penumbra::{Camera, Result, Settings, Technique};

use super::values::{
    AovList, TechniqueChoice, background, crop, light_samplings, positive, samplings, technique_or_auto,
};

/// The pixels and the samples that are rendered.
#[derive(Args, Default)]
#[command(next_help_heading = "Image")]
pub struct ExtentOptions {
    /// Render only this part of the image; X and Y are pixels from the left and from the top
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = crop, allow_hyphen_values = true)]
    crop: Option<Crop>,

    /// Render a piece of the image: samples A to B - 1 of the --spp samples of every pixel. `penumbra merge` joins the
    /// pieces. On devices of one kind, the merged image has the same bits as --samples 0..SPP in one process, however
    /// the samples are split and the image is cropped. Samples of a piece do not reuse results of other samples
    #[arg(long, value_name = "A..B", allow_hyphen_values = true)]
    samples: Option<SampleRange>,
}

impl ExtentOptions {
    /// The user requests a piece of the image.
    pub fn is_piece(&self) -> bool {
        self.samples.is_some()
    }
}

/// The settings of one render, except which pixels and samples of the image are rendered.
#[derive(Args)]
#[command(next_help_heading = "Image")]
pub struct RenderOptions {
    /// How light is computed
    #[arg(long, value_name = "T", default_value = "auto", value_parser = technique_or_auto())]
    technique: TechniqueChoice,

    #[arg(
        long,
        value_name = "SAMPLES",
        help = format!("Samples per pixel [default: {}]", Settings::default().image.spp)
    )]
    pub spp: Option<u32>,

    /// How samples are distributed over the pixels, unless --noise decides it [default: uniform; for `render --time`
    /// without a technique or a checkpoint, adaptive on a software device if the time is enough for several samples]
    #[arg(long, value_name = "SAMPLING", value_parser = samplings())]
    sampling: Option<Sampling>,

    /// Render until the estimated relMSE (squared error relative to the brightness) of every block of 8 x 8 pixels is T
    /// or less: samples go where the image is noisiest, or the denoised image if there is one. The estimate leaves out
    /// the error of indirect light that all samples share. --spp is then only an upper limit for each pixel; by
    /// default, `render` does not limit the number of samples
    #[arg(long, value_name = "T", value_parser = positive)]
    pub noise: Option<f64>,

    /// Channels besides the image, for .exr: names separated by commas, or all [default: none]
    #[arg(long, value_name = "LIST", long_help = AovList::help())]
    aov: Option<AovList>,

    /// What is seen where there is no surface: environment, transparent, or a colour as #RRGGBB or #RGB (sRGB) or as
    /// R,G,B (linear radiance), which .png tone-maps like the rest; the environment lights the scene in any case
    #[arg(
        long,
        value_name = "BACKGROUND",
        default_value = "environment",
        value_parser = background,
        allow_hyphen_values = true
    )]
    background: Background,

    #[command(flatten)]
    settings: SettingsOptions,
}

impl RenderOptions {
    /// As [`SettingsOptions::aspect`].
    pub fn aspect(&self) -> f32 {
        self.settings.aspect()
    }

    /// As [`SettingsOptions::check`].
    pub fn check(&self, extent: &ExtentOptions) -> Result<()> {
        self.of_aspect(1.0, extent).check()
    }

    /// As [`SettingsOptions::settings`].
    pub fn settings(&self, camera: &Camera, extent: &ExtentOptions) -> Result<Settings> {
        let settings = self.of_aspect(CameraUniform::aspect(camera), extent);
        settings.check()?;
        Ok(settings)
    }

    /// As [`settings`](Self::settings), but without a limit on samples where the user gives none and something else
    /// ends the render: --noise, or `has_other_end`.
    pub fn settings_to_end(&self, camera: &Camera, extent: &ExtentOptions, has_other_end: bool) -> Result<Settings> {
        let mut settings = self.settings(camera, extent)?;
        if self.spp.is_none() && (has_other_end || self.noise.is_some()) {
            settings.image.spp = Settings::UNLIMITED_SPP;
        }
        Ok(settings)
    }

    fn of_aspect(&self, aspect: f32, extent: &ExtentOptions) -> Settings {
        let mut settings = self.settings.settings_of_aspect(aspect);
        settings.technique = self.technique.0.unwrap_or_default();
        settings.image.spp = self.spp.unwrap_or(settings.image.spp);
        settings.image.sampling = self.sampling.unwrap_or_default();
        settings.image.aovs = self.aov.clone().unwrap_or_default().0;
        settings.image.crop = extent.crop;
        settings.image.piece = extent.samples;
        settings.image.background = self.background;
        settings.image.noise = self.noise;
        settings
    }

    /// The user names no technique.
    pub fn is_automatic(&self) -> bool {
        self.technique.0.is_none()
    }

    /// The user does not request a distribution of samples over pixels.
    pub fn leaves_sampling(&self) -> bool {
        self.sampling.is_none()
    }

    /// The user states the size of the image.
    #[cfg(feature = "view")]
    pub fn has_size(&self) -> bool {
        self.settings.width.is_some() || self.settings.height.is_some()
    }

    /// The user requests channels besides the image.
    pub fn has_aovs(&self) -> bool {
        self.aov.is_some()
    }
}

/// The settings that the renders of one scene share, whatever the technique.
#[derive(Args)]
#[command(next_help_heading = "Image")]
pub struct SettingsOptions {
    /// Width in pixels [default: the height times the camera's aspect ratio]
    #[arg(long, value_name = "PIXELS")]
    width: Option<u32>,

    #[arg(
        long,
        value_name = "PIXELS",
        help = format!(
            "Height in pixels [default: {}, or the width over the aspect ratio]",
            Settings::default().image.height
        )
    )]
    height: Option<u32>,

    /// Seed of all random numbers: the same seed on the same device gives the same bits
    #[arg(long, value_name = "N", default_value_t = Settings::default().image.seed)]
    seed: u32,

    /// Multiply the power of every light by this factor
    #[arg(long, value_name = "X", default_value_t = Settings::default().light_scale)]
    light_scale: f32,

    #[command(flatten)]
    indirect: IndirectOptions,

    #[command(flatten)]
    visibility_map: VisibilityMapOptions,

    #[command(flatten)]
    light_sampling: LightSamplingOptions,

    #[command(flatten)]
    earlier: EarlierOptions,
}

impl SettingsOptions {
    /// Width over height of the image, if the camera does not decide it.
    pub fn aspect(&self) -> f32 {
        let image = self.settings_of_aspect(1.0).image;
        image.width as f32 / image.height as f32
    }

    /// Checks the settings for a technique before a file is opened.
    ///
    /// # Errors
    /// As [`Settings::check`].
    pub fn check(&self, technique: Technique) -> Result<()> {
        self.settings_of_aspect(1.0).with(|s| s.technique = technique).check()
    }

    /// The settings for an image through `camera`.
    ///
    /// # Errors
    /// As [`Settings::check`]: the side that follows from the aspect ratio may be out of range.
    pub fn settings(&self, camera: &Camera) -> Result<Settings> {
        let settings = self.settings_of_aspect(CameraUniform::aspect(camera));
        settings.check()?;
        Ok(settings)
    }

    fn settings_of_aspect(&self, aspect: f32) -> Settings {
        let mut settings = Settings::default();
        let side = |length: f64| (length.round() as u32).max(1);
        let aspect = f64::from(aspect);
        let (width, height) = match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, side(f64::from(width) / aspect)),
            (None, height) => {
                let height = height.unwrap_or(settings.image.height);
                (side(f64::from(height) * aspect), height)
            }
        };
        (settings.image.width, settings.image.height) = (width, height);
        settings.image.seed = self.seed;
        settings.light_scale = self.light_scale;
        self.indirect.apply(&mut settings);
        self.visibility_map.apply(&mut settings);
        self.light_sampling.apply(&mut settings);
        self.earlier.apply(&mut settings);
        settings
    }
}

/// Options of [`IndirectSettings`](penumbra::settings::IndirectSettings).
#[derive(Args)]
#[command(next_help_heading = "Indirect light")]
struct IndirectOptions {
    /// Maximum number of bounces of indirect light; 0 for direct light only. Mirrors and clear glass before the first
    /// other surface do not count as bounces, except with --technique path
    #[arg(long, value_name = "N", default_value_t = Settings::default().indirect.max_bounces)]
    max_bounces: u32,

    /// Photons emitted for the global photon map, by all lights together. This is the number for the first 24 samples
    /// per pixel; it grows with the samples after that [default: 4096 for the first sample, then 256 times the number
    /// of gather rays of a record]
    #[arg(long, value_name = "N")]
    flux_photons: Option<u32>,

    /// Limit the indirect light of each path to this radiance, which removes fireflies but biases the image. Light from
    /// the irradiance cache and from the caustic map is not limited
    #[arg(long, value_name = "RADIANCE")]
    clamp: Option<f32>,

    /// Radius of an irradiance record, relative to the distance of the surfaces around it: smaller is more accurate,
    /// and slower
    #[arg(long, value_name = "A", default_value_t = Settings::default().indirect.irradiance_cache.accuracy)]
    accuracy: f32,

    /// Final gather rays of each irradiance record, rounded up to a power of two. This is the number for the first 24
    /// samples per pixel; it grows with the samples after that [default: 16 for the first sample, then up to 4096, as
    /// long as more rays reduce the error more than more samples would]
    #[arg(long, value_name = "N")]
    gather_rays: Option<u32>,

    /// Trace one gather ray from every point instead of interpolating between irradiance records
    #[arg(long)]
    no_cache: bool,
}

impl IndirectOptions {
    fn apply(&self, settings: &mut Settings) {
        let indirect = &mut settings.indirect;
        indirect.max_bounces = self.max_bounces;
        indirect.photons = self.flux_photons;
        indirect.clamp = self.clamp;
        indirect.irradiance_cache.enabled = !self.no_cache;
        indirect.irradiance_cache.accuracy = self.accuracy;
        indirect.irradiance_cache.gather_rays = self.gather_rays;
    }
}

/// Options of [`VisibilityMapSettings`](penumbra::settings::VisibilityMapSettings) and of shadow rays.
#[derive(Args)]
#[command(next_help_heading = "Visibility map")]
struct VisibilityMapOptions {
    /// Visibility photons emitted from each light, at most 4194304 from all lights together [default: 16384, or one for
    /// every 64 shadow rays to the light if that is fewer, but at least 4096; up to 131072 with one sample per pixel;
    /// 131072 where photons alone decide]
    #[arg(long, value_name = "N")]
    photons: Option<u32>,

    /// Number of nearest photons that decide whether a point is lit, in shadow, or at a shadow boundary (k in the
    /// paper)
    #[arg(long, value_name = "K", default_value_t = Settings::default().visibility_map.nearest)]
    nearest: u32,

    /// Maximum number of shadow photons stored along the ray of one photon
    #[arg(long, value_name = "N", default_value_t = Settings::default().visibility_map.shadow_photons_per_ray)]
    shadow_photons_per_ray: u32,

    /// Shadow rays from a point to each light, to different positions on the light; point, spot and directional lights
    /// get one
    #[arg(long, value_name = "N", default_value_t = Settings::default().shadow_rays.samples)]
    shadow_samples: u32,

    /// Widen shadow boundaries by this number of pixels, 0 or 1 [default: 1 for lights with wide penumbrae, or where
    /// audits find many mistakes near boundaries; else 0]
    #[arg(long, value_name = "PIXELS")]
    dilate: Option<u32>,

    /// Minimum probability of an audit: a shadow ray from a point that photons classify as lit or in shadow. Audits
    /// keep the image unbiased, and become more frequent where they find mistakes. 0 is the paper's method, which is
    /// biased
    #[arg(long, value_name = "P", default_value_t = Settings::default().visibility_map.audit)]
    audit: f32,

    /// Count photons regardless of their normals, as the paper does
    #[arg(long)]
    paper_counting: bool,

    /// Classify points by photons alone, without the results of earlier shadow rays
    #[arg(long)]
    no_fine_cells: bool,
}

impl VisibilityMapOptions {
    fn apply(&self, settings: &mut Settings) {
        let map = &mut settings.visibility_map;
        map.photons_per_light = self.photons;
        map.nearest = self.nearest;
        map.shadow_photons_per_ray = self.shadow_photons_per_ray;
        map.dilate = self.dilate;
        map.audit = self.audit;
        map.paper_counting = self.paper_counting;
        map.fine_cells = !self.no_fine_cells;
        settings.shadow_rays.samples = self.shadow_samples;
    }
}

/// Options of [`LightSamplingSettings`](penumbra::settings::LightSamplingSettings).
#[derive(Args)]
#[command(next_help_heading = "Many lights")]
struct LightSamplingOptions {
    /// How lights are sampled at a point [default: zones for shadow-photons in scenes of many lights, power for path,
    /// else all]
    #[arg(long, value_name = "STRATEGY", value_parser = light_samplings())]
    light_sampling: Option<LightSampling>,

    /// Number of lights sampled at a point, unless --light-sampling is all
    #[arg(long, value_name = "N", default_value_t = Settings::default().light_sampling.sampled_lights)]
    sampled_lights: u32,
}

impl LightSamplingOptions {
    fn apply(&self, settings: &mut Settings) {
        settings.light_sampling.strategy = self.light_sampling;
        settings.light_sampling.sampled_lights = self.sampled_lights;
    }
}

/// Options of the methods that preceded the paper.
#[derive(Args)]
#[command(next_help_heading = "Earlier methods")]
struct EarlierOptions {
    /// Cells along the longest side of the scene, for visibility-cells and voxel-tags
    #[arg(long, value_name = "N", default_value_t = Settings::default().cells.resolution)]
    cells: u32,

    /// Rays from each cell to each light, for visibility-cells and voxel-tags
    #[arg(long, value_name = "N", default_value_t = Settings::default().cells.rays_per_light)]
    cell_rays: u32,

    /// Cells along a side of each of the six faces around a light, for light-buffer
    #[arg(long, value_name = "N", default_value_t = Settings::default().light_buffer.resolution)]
    light_buffer_cells: u32,

    /// For ward-adaptive: no shadow rays are traced to the least important lights of a point, which together contribute
    /// less than this share of its light; their visibility is estimated. 0 tests all lights
    #[arg(long, value_name = "X", default_value_t = Settings::default().ward.tolerance)]
    shadow_tolerance: f32,
}

impl EarlierOptions {
    fn apply(&self, settings: &mut Settings) {
        settings.cells.resolution = self.cells;
        settings.cells.rays_per_light = self.cell_rays;
        settings.light_buffer.resolution = self.light_buffer_cells;
        settings.ward.tolerance = self.shadow_tolerance;
    }
}
