//! Options that several commands share. Every default is that of [`Settings`], so no number is written twice.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use penumbra::gpu::{DeviceChoice, Gpu};
use penumbra::gpu_scene::camera::CameraUniform;
use penumbra::report::reference::Reference;
use penumbra::scene::{ImportOptions, Panorama};
use penumbra::settings::LightSampling;
use penumbra::{Aov, Camera, Error, Image, Result, Scene, Settings, Technique};

#[derive(Args)]
pub struct SceneOptions {
    /// The scene, .gltf or .glb
    pub scene: PathBuf,

    /// Camera, by its name or its index [default: the file's first, or one that frames the scene]
    #[arg(long, value_name = "NAME|INDEX", help_heading = "Scene")]
    camera: Option<String>,

    /// Add a soft light above the scene if the file has no light
    #[arg(long, help_heading = "Scene")]
    default_light: bool,

    /// Drop a primitive with NaN or infinite numbers instead of refusing the file; take such texels of a panorama as 0
    #[arg(long, help_heading = "Scene")]
    lenient: bool,

    /// Panorama around the scene, equirectangular .exr or .hdr: linear Rec.709 radiance, its middle seen along +X and what is
    /// a quarter of its width to the left of that along -Z, as in Blender and the Khronos viewers
    #[arg(long, value_name = "FILE", help_heading = "Scene")]
    environment: Option<PathBuf>,

    /// Turn the panorama about +Y, counter-clockwise seen from above
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 0.0,
        value_parser = finite::<f64>,
        allow_negative_numbers = true,
        requires = "environment",
        help_heading = "Scene"
    )]
    environment_rotation: f64,

    /// Factor on the panorama's radiance
    #[arg(
        long,
        value_name = "X",
        default_value_t = 1.0,
        value_parser = finite::<f32>,
        allow_negative_numbers = true,
        requires = "environment",
        help_heading = "Scene"
    )]
    environment_strength: f32,
}

impl SceneOptions {
    /// The scene, and the camera to render it with.
    pub fn load(&self) -> Result<(Scene, Camera)> {
        let options = ImportOptions { default_light: self.default_light, lenient: self.lenient };
        let mut scene = Scene::load(&self.scene, &options)?;
        if let Some(path) = &self.environment {
            let (panorama, notes) = Panorama::load(path, self.lenient)?;
            scene.set_environment(Arc::new(panorama), self.environment_rotation, self.environment_strength)?;
            scene.notes.extend(notes);
        }
        let camera = self.select_camera(&scene)?;
        if scene.cameras.is_empty() {
            scene.notes.push("the view is that of a camera that frames the scene".into());
        }
        Ok((scene, camera))
    }

    fn select_camera(&self, scene: &Scene) -> Result<Camera> {
        let cameras = &scene.cameras;
        let Some(wanted) = &self.camera else {
            return Ok(cameras.first().cloned().unwrap_or_else(|| scene.frame_camera()));
        };
        let by_name = cameras.iter().find(|camera| camera.name == *wanted);
        let camera = by_name.or_else(|| cameras.get(wanted.parse::<usize>().ok()?));
        camera.cloned().ok_or_else(|| {
            let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
            let names = if names.is_empty() { "none".into() } else { names.join(", ") };
            Error::Usage(format!("no camera is called '{wanted}' or has that index; there is: {names}"))
        })
    }
}

#[derive(Args)]
pub struct DeviceOptions {
    /// Device: best, software, an index or a part of a name of `penumbra devices`
    #[arg(long, value_name = "D", default_value = "best", help_heading = "Device")]
    device: DeviceChoice,
}

impl DeviceOptions {
    /// As [`Gpu::open`].
    pub fn open(&self) -> Result<Gpu> {
        Gpu::open(&self.device)
    }
}

/// The settings of one render.
#[derive(Args)]
#[command(next_help_heading = "Image")]
pub struct RenderOptions {
    /// How light is computed
    #[arg(long, value_name = "T", default_value_t = Settings::default().technique, value_parser = techniques())]
    technique: Technique,

    #[arg(
        long,
        value_name = "SAMPLES",
        help = format!("Samples a pixel [default: {}]", Settings::default().spp)
    )]
    pub spp: Option<u32>,

    /// Channels beside the picture, for .exr: a list with commas, or all [default: none]
    #[arg(long, value_name = "LIST", long_help = AovList::help())]
    aov: Option<AovList>,

    #[command(flatten)]
    settings: SettingsOptions,
}

impl RenderOptions {
    /// As [`SettingsOptions::check`].
    pub fn check(&self) -> Result<()> {
        self.complete(self.settings.settings_of_aspect(1.0)).check()
    }

    /// As [`SettingsOptions::settings`].
    pub fn settings(&self, camera: &Camera) -> Result<Settings> {
        let settings = self.complete(self.settings.settings_of_aspect(CameraUniform::aspect(camera)));
        settings.check()?;
        Ok(settings)
    }

    fn complete(&self, settings: Settings) -> Settings {
        Settings {
            technique: self.technique,
            spp: self.spp.unwrap_or(settings.spp),
            aovs: self.aov.clone().unwrap_or_default().0,
            ..settings
        }
    }

    /// As [`Settings::is_unbiased`].
    pub fn is_unbiased(&self) -> bool {
        self.complete(self.settings.settings_of_aspect(1.0)).is_unbiased()
    }

    /// Channels beside the picture are asked for.
    pub fn has_aovs(&self) -> bool {
        self.aov.is_some()
    }

    /// These are.
    pub fn has_aov(&self, aov: Aov) -> bool {
        self.aov.as_ref().is_some_and(|list| list.0.contains(&aov))
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
        help = format!("Height in pixels [default: {}, or the width over the aspect ratio]", Settings::default().height)
    )]
    height: Option<u32>,

    /// Seed of all random choices: the same seed on the same device gives the same bits
    #[arg(long, value_name = "N", default_value_t = Settings::default().seed)]
    seed: u32,

    /// Most bounces of indirect light; 0 for direct light alone
    #[arg(long, value_name = "N", default_value_t = Settings::default().max_bounces)]
    max_bounces: u32,

    /// Rays from all lights together whose photons carry flux: the global map
    #[arg(
        long,
        value_name = "N",
        default_value_t = Settings::default().flux_photons,
        help_heading = "Indirect light"
    )]
    flux_photons: u32,

    /// Radius of an irradiance record over the distance of its surroundings: smaller is more accurate, and slower
    #[arg(long, value_name = "A", default_value_t = Settings::default().accuracy, help_heading = "Indirect light")]
    accuracy: f32,

    /// Rays of the final gather at each irradiance record
    #[arg(long, value_name = "N", default_value_t = Settings::default().gather_rays, help_heading = "Indirect light")]
    gather_rays: u32,

    /// Gather along one ray from every point, instead of interpolating between irradiance records
    #[arg(long, help_heading = "Indirect light")]
    no_cache: bool,

    /// Factor on the power of every light
    #[arg(long, value_name = "X", default_value_t = Settings::default().light_scale)]
    light_scale: f32,

    /// Visibility photons emitted from each light
    #[arg(long, value_name = "N", default_value_t = Settings::default().photons, help_heading = "Visibility map")]
    photons: u32,

    /// Photons that classify a point (k of the paper)
    #[arg(long, value_name = "K", default_value_t = Settings::default().nearest, help_heading = "Visibility map")]
    nearest: u32,

    /// Shadow photons that are kept of one ray
    #[arg(
        long,
        value_name = "N",
        default_value_t = Settings::default().shadow_photons_per_ray,
        help_heading = "Visibility map"
    )]
    shadow_photons_per_ray: u32,

    /// Light points, and so shadow rays, of a boundary point
    #[arg(
        long,
        value_name = "N",
        default_value_t = Settings::default().shadow_samples,
        help_heading = "Visibility map"
    )]
    shadow_samples: u32,

    /// Pixels by which boundaries are widened, 0 or 1 [default: 1 for lights with wide penumbrae, else 0]
    #[arg(long, value_name = "PIXELS", help_heading = "Visibility map")]
    dilate: Option<u32>,

    /// Lights that a point asks, and by what they are chosen [default: zones of many lights where there are photons, else all;
    /// power of paths]
    #[arg(long, value_name = "CHOICE", value_parser = light_samplings(), help_heading = "Many lights")]
    light_sampling: Option<LightSampling>,

    /// Lights that a point asks where they are chosen
    #[arg(long, value_name = "N", default_value_t = Settings::default().sampled_lights, help_heading = "Many lights")]
    sampled_lights: u32,

    /// Probability of a shadow ray where the photons decide: keeps the image unbiased; 0 is the paper, and biased
    #[arg(long, value_name = "P", default_value_t = Settings::default().audit, help_heading = "Visibility map")]
    audit: f32,

    /// Count photons without regard to their normals, as the paper does
    #[arg(long, help_heading = "Visibility map")]
    paper_counting: bool,

    /// Cells along the longest side of the scene: visibility-cells, voxel-tags
    #[arg(long, value_name = "N", default_value_t = Settings::default().cells, help_heading = "Earlier methods")]
    cells: u32,

    /// Rays from each cell to each light: visibility-cells, voxel-tags
    #[arg(long, value_name = "N", default_value_t = Settings::default().cell_rays, help_heading = "Earlier methods")]
    cell_rays: u32,

    /// Share of a point's light below which the lights that are left are guessed: ward-adaptive; 0 tests all
    #[arg(
        long,
        value_name = "X",
        default_value_t = Settings::default().shadow_tolerance,
        help_heading = "Earlier methods"
    )]
    shadow_tolerance: f32,
}

impl SettingsOptions {
    /// Says what is out of range before a file is opened.
    ///
    /// # Errors
    /// As [`Settings::check`].
    pub fn check(&self) -> Result<()> {
        self.settings_of_aspect(1.0).check()
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
        let defaults = Settings::default();
        let side = |length: f64| (length.round() as u32).max(1);
        let aspect = f64::from(aspect);
        let (width, height) = match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, side(f64::from(width) / aspect)),
            (None, height) => {
                let height = height.unwrap_or(defaults.height);
                (side(f64::from(height) * aspect), height)
            }
        };
        Settings {
            width,
            height,
            seed: self.seed,
            photons: self.photons,
            nearest: self.nearest,
            shadow_photons_per_ray: self.shadow_photons_per_ray,
            shadow_samples: self.shadow_samples,
            dilate: self.dilate,
            light_sampling: self.light_sampling,
            sampled_lights: self.sampled_lights,
            audit: self.audit,
            paper_counting: self.paper_counting,
            cells: self.cells,
            cell_rays: self.cell_rays,
            shadow_tolerance: self.shadow_tolerance,
            max_bounces: self.max_bounces,
            flux_photons: self.flux_photons,
            cache: !self.no_cache,
            accuracy: self.accuracy,
            gather_rays: self.gather_rays,
            light_scale: self.light_scale,
            ..defaults
        }
    }
}

/// One of the techniques, by name.
pub fn techniques() -> impl TypedValueParser<Value = Technique> {
    let values = Technique::all().map(|technique| PossibleValue::new(technique.name()).help(technique.help()));
    PossibleValuesParser::new(values).try_map(|name| name.parse())
}

/// One of the choices of lights, by name.
fn light_samplings() -> impl TypedValueParser<Value = LightSampling> {
    let values = LightSampling::ALL.map(|choice| {
        PossibleValue::new(choice.name()).help(match choice {
            LightSampling::All => "all lights",
            LightSampling::Uniform => "a few, each as likely as the other",
            LightSampling::Power => "a few, half by power and half alike",
            LightSampling::Zones => "a few of those that reach the zone, as photons tell",
        })
    });
    PossibleValuesParser::new(values).try_map(|name| name.parse())
}

/// Groups of channels, as a list with commas.
#[derive(Clone, Default)]
struct AovList(Vec<Aov>);

impl AovList {
    fn help() -> String {
        let names = Aov::ALL.map(Aov::name).join(", ");
        format!("Channels beside the picture, for .exr: a list with commas of {names}; or all [default: none]")
    }
}

impl FromStr for AovList {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if text == "all" {
            return Ok(AovList(Aov::ALL.into()));
        }
        let mut aovs = text.split(',').map(|name| name.trim().parse()).collect::<std::result::Result<Vec<Aov>, _>>()?;
        aovs.sort();
        aovs.dedup();
        Ok(AovList(aovs))
    }
}

/// A number that is not NaN or infinite.
pub fn finite<T: FromStr + Into<f64> + Copy>(text: &str) -> std::result::Result<T, String> {
    let number = text.parse::<T>().ok().filter(|number| (*number).into().is_finite());
    number.ok_or_else(|| "it must be a finite number".into())
}

/// A number above 0.
pub fn positive(text: &str) -> std::result::Result<f64, String> {
    finite(text).ok().filter(|x| *x > 0.0).ok_or_else(|| "it must be a finite number, more than 0".into())
}

/// The image to compare with, which must be of the settings' size.
pub fn read_reference(path: &Path, settings: &Settings) -> Result<Reference> {
    let reference = Reference::read(path)?;
    let (Image { width, height, .. }, own) = (&reference.image, [settings.width, settings.height]);
    if [*width, *height] != own {
        let sizes = format!("is {width} x {height} pixels, not {} x {}", own[0], own[1]);
        return Err(Error::input(path, "file", format!("{sizes}; set --width and --height to its size")));
    }
    Ok(reference)
}
