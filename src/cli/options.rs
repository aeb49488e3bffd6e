//! Options that several commands share. The defaults are those of [`Settings`].

use std::env;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, Args, Command};
use glam::DVec3;
use kernel_kit::{DeviceChoice, DeviceLimits, Gpu};
use penumbra::internal::gpu_scene::camera::CameraUniform;
use penumbra::internal::render::film::linear_from_srgb;
use penumbra::internal::report::entrant::Entrant;
use penumbra::internal::report::reference::Reference;
use penumbra::internal::scene::{Extent, Focus, Framing, ImportOptions, Iris, LookAt, Panorama, Projection};
#[cfg(feature = "view")]
use penumbra::internal::view::Pose;
use penumbra::settings::{Background, Crop, Denoise, LightSampling, SampleRange, Sampling};
use penumbra::{Aov, Camera, Denoiser, Error, Image, Result, Scene, Settings, Technique};

/// Maximum number of blades of an iris. No eye sees that the blur of so many is not round.
const MAX_BLADES: u32 = 64;

#[derive(Args, Clone)]
pub struct SceneOptions {
    /// The scene, .gltf or .glb
    pub scene: PathBuf,

    /// Camera, by name or index [default: the first of the file, or one that frames the scene]
    #[arg(long, value_name = "NAME|INDEX", help_heading = "Scene")]
    camera: Option<String>,

    /// Frame the scene from this direction, in degrees: the azimuth counter-clockwise seen from above, 0 from the front
    /// (+Z) and 90 from +X; the elevation above the horizon [default: 0,15 if the file has no camera]
    #[arg(
        long,
        value_name = "AZIMUTH,ELEVATION",
        value_parser = direction,
        allow_hyphen_values = true,
        conflicts_with = "camera",
        help_heading = "Scene"
    )]
    from: Option<[f32; 2]>,

    /// Place the camera here, in the file's coordinates
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = position,
        allow_hyphen_values = true,
        requires = "look_at",
        conflicts_with_all = ["camera", "from"],
        help_heading = "Scene"
    )]
    look_from: Option<DVec3>,

    /// What a placed camera looks at
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = position,
        allow_hyphen_values = true,
        requires = "look_from",
        help_heading = "Scene"
    )]
    look_at: Option<DVec3>,

    /// The direction that is up in the image of a placed camera [default: 0,1,0]
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = up,
        allow_hyphen_values = true,
        requires = "look_from",
        help_heading = "Scene"
    )]
    look_up: Option<DVec3>,

    /// Make the placed camera orthographic: it sees this height, in the file's units
    #[arg(
        long,
        value_name = "HEIGHT",
        value_parser = positive,
        requires = "look_from",
        conflicts_with_all = ["fov", "aperture"],
        help_heading = "Scene"
    )]
    orthographic: Option<f64>,

    /// Vertical field of view of a perspective camera [default: the camera's own; 40 of one that is placed or frames
    /// the scene]
    #[arg(long, value_name = "DEGREES", value_parser = field_of_view, help_heading = "Scene")]
    fov: Option<f64>,

    /// F-number of the camera's lens, which blurs what is out of focus; the film is 24 mm high, and a unit of the file
    /// is a metre [default: a pinhole]
    #[arg(long, value_name = "F", value_parser = positive, help_heading = "Scene")]
    aperture: Option<f64>,

    /// Distance at which the lens is in focus, in metres along the viewing direction; auto: that of the surface in the
    /// centre of the image
    #[arg(
        long,
        value_name = "METRES|auto",
        default_value = "auto",
        value_parser = focus,
        requires = "aperture",
        help_heading = "Scene"
    )]
    focus: Focus,

    /// Blades of the iris, at least 3, which give the blur its shape; 0: round
    #[arg(
        long,
        value_name = "N",
        default_value_t = 0,
        value_parser = blades,
        requires = "aperture",
        help_heading = "Scene"
    )]
    iris_blades: u32,

    /// Add a soft light above and before the scene if the file has no light
    #[arg(long, help_heading = "Scene")]
    default_light: bool,

    /// Drop primitives with NaN or infinite numbers, and textures whose image is missing or damaged, instead of
    /// refusing the file; set texels of a panorama that are not finite to 0
    #[arg(long, help_heading = "Scene")]
    lenient: bool,

    /// Show an animation at this time after its beginning: nodes, skins, morph targets, cameras, lights and materials.
    /// Before its first key and after its last one it stands still [default: the pose of the file]
    #[arg(
        long,
        value_name = "SECONDS",
        value_parser = finite::<f64>,
        allow_negative_numbers = true,
        group = "moment",
        help_heading = "Scene"
    )]
    at: Option<f64>,

    /// Animation, by name or index [default: the first of the file]
    #[arg(long, value_name = "NAME|INDEX", requires = "moment", help_heading = "Scene")]
    animation: Option<String>,

    /// Begin the animation again after its last key
    #[arg(long = "loop", requires = "moment", help_heading = "Scene")]
    repeat: bool,

    /// Variant of the materials (KHR_materials_variants) [default: none of them]
    #[arg(long, value_name = "NAME", help_heading = "Scene")]
    variant: Option<String>,

    /// Equirectangular panorama around the scene, .exr or .hdr, of linear Rec.709 radiance: its centre lies towards +X,
    /// the column a quarter of its width left of the centre towards -Z, as in Blender and the Khronos viewers
    #[arg(long, value_name = "FILE", help_heading = "Scene")]
    environment: Option<PathBuf>,

    /// Rotation of the panorama about +Y, counter-clockwise seen from above
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

/// For the window: what it changes of a scene and of its camera.
#[cfg(feature = "view")]
impl SceneOptions {
    /// Another file, in another state.
    pub fn of_file(self, file: &Path, pose: &Pose) -> Self {
        let environment_rotation = pose.environment_rotation.unwrap_or(self.environment_rotation);
        SceneOptions { scene: file.to_owned(), environment_rotation, variant: pose.variant.clone(), ..self }
    }

    /// Another field of view or f-number, if there are any.
    pub fn through(self, fov: Option<f64>, f_number: Option<f64>) -> Self {
        SceneOptions { fov: fov.or(self.fov), aperture: f_number.or(self.aperture), ..self }
    }

    /// A camera of the file.
    pub fn through_camera(self, index: usize) -> Self {
        let camera = Some(index.to_string());
        let (look_from, look_at, look_up, orthographic) = (None, None, None, None);
        SceneOptions { camera, from: None, look_from, look_at, look_up, orthographic, ..self }
    }

    /// A placed camera.
    pub fn placed(self, view: &LookAt) -> Self {
        let (look_from, look_at, look_up) = (Some(view.from), Some(view.at), Some(view.up));
        let (fov, orthographic) = match view.extent {
            Extent::FieldOfView(fov) => (Some(fov), None),
            Extent::Height(height) => (None, Some(height)),
        };
        SceneOptions { camera: None, from: None, look_from, look_at, look_up, fov, orthographic, ..self }
    }

    /// The state of the scene.
    pub fn pose(&self) -> Pose {
        Pose { time: self.at, variant: self.variant.clone(), environment_rotation: None }
    }

    /// The field of view.
    pub fn fov(&self) -> Option<f64> {
        self.fov
    }

    /// The f-number.
    pub fn f_number(&self) -> Option<f64> {
        self.aperture
    }

    /// The rotation of the environment, if one is given.
    pub fn rotation(&self) -> Option<f64> {
        Some(self.environment_rotation).filter(|degrees| self.environment.is_some() && *degrees != 0.0)
    }

    /// The files besides that of the scene.
    pub fn other_files(&self) -> Vec<PathBuf> {
        self.environment.iter().cloned().collect()
    }
}

/// A panorama, and the notes on its file.
pub struct Surroundings {
    panorama: Arc<Panorama>,
    notes: Vec<String>,
}

impl SceneOptions {
    /// The scene, and the camera to render it with. `aspect` is the image's width over its height if the camera does
    /// not decide it.
    pub fn load(&self, aspect: f32) -> Result<(Scene, Camera)> {
        self.load_first(None, self.surroundings()?.as_ref(), aspect)
    }

    /// As [`load`](Self::load), after so many seconds of the animation if any are given, and within that panorama.
    pub fn load_first(
        &self,
        time: Option<f64>,
        surroundings: Option<&Surroundings>,
        aspect: f32,
    ) -> Result<(Scene, Camera)> {
        let mut scene = self.load_at(time.or(self.at))?;
        if let Some(surroundings) = surroundings {
            self.surround(&mut scene, surroundings)?;
        }
        let camera = self.camera(&scene, aspect)?;
        if scene.cameras.is_empty() && self.from.is_none() && self.look_from.is_none() {
            scene.notes.push("the view is that of a camera that frames the scene".into());
        }
        scene.notes.extend(scene.clipped_away(&camera));
        Ok((scene, camera))
    }

    /// The scene after so many seconds of its animation, without surroundings.
    pub fn load_at(&self, time: Option<f64>) -> Result<Scene> {
        let Self { default_light, lenient, repeat, .. } = *self;
        let (animation, variant) = (self.animation.clone(), self.variant.clone());
        let max_copied_triangles = None;
        let options = ImportOptions { default_light, lenient, repeat, time, animation, variant, max_copied_triangles };
        Scene::load(&self.scene, &options)
    }

    /// The panorama around the scene.
    pub fn surroundings(&self) -> Result<Option<Surroundings>> {
        let load = |path: &PathBuf| {
            let (panorama, notes) = Panorama::load(path, self.lenient)?;
            Ok(Surroundings { panorama: Arc::new(panorama), notes })
        };
        self.environment.as_ref().map(load).transpose()
    }

    /// Puts the panorama around a scene.
    pub fn surround(&self, scene: &mut Scene, Surroundings { panorama, notes }: &Surroundings) -> Result<()> {
        scene.set_environment(panorama.clone(), self.environment_rotation, self.environment_strength)?;
        scene.notes.extend_from_slice(notes);
        Ok(())
    }

    /// Whether the camera is one that frames the scene, and not one of the file.
    pub fn frames(&self, scene: &Scene) -> bool {
        self.from.is_some() || (self.look_from.is_none() && self.camera.is_none() && scene.cameras.is_empty())
    }

    /// The camera that the user selects, with its lens; `aspect` as for [`load`](Self::load).
    pub fn camera(&self, scene: &Scene, aspect: f32) -> Result<Camera> {
        self.with_lens(scene, self.select_camera(scene, aspect)?)
    }

    /// The cameras of a turntable with so many views.
    pub fn turntable(&self, scene: &Scene, aspect: f32, views: u32) -> Result<Vec<Camera>> {
        let cameras = scene.turntable(&self.framing(aspect), views);
        cameras.into_iter().map(|camera| self.with_lens(scene, camera)).collect()
    }

    /// From where a camera that frames the scene looks at it.
    fn framing(&self, aspect: f32) -> Framing {
        let framing = Framing { aspect, ..Framing::default() };
        self.from.map_or(framing, |[azimuth, elevation]| Framing { azimuth, elevation, ..framing })
    }

    fn with_lens(&self, scene: &Scene, mut camera: Camera) -> Result<Camera> {
        if let Some(fov) = self.fov {
            let Projection::Perspective { yfov, .. } = &mut camera.projection else {
                let problem = format!("--fov: camera `{}` is orthographic, which has no field of view", camera.name);
                return Err(Error::Usage(problem));
            };
            *yfov = fov.to_radians() as f32;
        }
        if let Some(f_number) = self.aperture {
            let iris = Iris { f_number, blades: self.iris_blades };
            let refused = |problem| Error::Usage(format!("--aperture: {problem}"));
            scene.open_iris(&mut camera, iris, self.focus).map_err(refused)?;
        }
        Ok(camera)
    }

    fn select_camera(&self, scene: &Scene, aspect: f32) -> Result<Camera> {
        let cameras = &scene.cameras;
        if let (Some(from), Some(at)) = (self.look_from, self.look_at) {
            let fov = || self.fov.map_or(Extent::default(), Extent::FieldOfView);
            let extent = self.orthographic.map_or_else(fov, Extent::Height);
            let placed = LookAt { from, at, up: self.look_up.unwrap_or(DVec3::Y), extent };
            return scene.look_at(&placed).map_err(|problem| Error::Usage(format!("--look-from: {problem}")));
        }
        let framed = || scene.frame(&self.framing(aspect));
        if self.from.is_some() {
            return Ok(framed());
        }
        let Some(wanted) = &self.camera else {
            return Ok(cameras.first().cloned().unwrap_or_else(framed));
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
    /// Device: best, software, or the index or a part of the name that `penumbra devices` prints
    #[arg(long, value_name = "D", default_value = "best", help_heading = "Device")]
    device: DeviceChoice,

    /// For tests: what of the device is used. `least` stands for the least that a desktop's device has,
    /// `gpu` for all of it, used as that of a GPU
    #[arg(long, value_name = "L", default_value = "own", value_parser = device_limits(), hide = true)]
    device_limits: DeviceLimits,
}

/// `own`, `least` or `gpu`.
fn device_limits() -> impl TypedValueParser<Value = DeviceLimits> {
    PossibleValuesParser::new(["own", "least", "gpu"]).try_map(|name| name.parse())
}

impl DeviceOptions {
    /// The choice, and what of the device is used.
    #[cfg(feature = "view")]
    pub fn choice(&self) -> (DeviceChoice, DeviceLimits) {
        (self.device.clone(), self.device_limits)
    }

    /// As [`Gpu::open_with`].
    pub fn open(&self) -> Result<Gpu> {
        Ok(Gpu::open_with(&self.device, self.device_limits)?)
    }
}

#[derive(Args, Clone)]
pub struct OidnOptions {
    /// The library of Open Image Denoise 2 [default: the environment variable OIDN_LIBRARY, else
    /// libOpenImageDenoise.so.2 where the system finds it]
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    oidn: Option<PathBuf>,
}

impl OidnOptions {
    /// As [`Denoiser::new`].
    pub fn denoiser(&self, choice: Denoise) -> Result<Denoiser> {
        let variable = || env::var_os("OIDN_LIBRARY").filter(|name| !name.is_empty()).map(PathBuf::from);
        Denoiser::new(choice, self.oidn.clone().or_else(variable).as_deref())
    }
}

/// The settings of one render.
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

    /// Which pixels get how many of the samples; --noise has a rule of its own
    #[arg(long, value_name = "SAMPLING", default_value_t, value_parser = samplings())]
    sampling: Sampling,

    /// Channels besides the image, for .exr: names separated by commas, or all [default: none]
    #[arg(long, value_name = "LIST", long_help = AovList::help())]
    aov: Option<AovList>,

    /// Render only this part of the image, in pixels from the left and from the top
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = crop)]
    crop: Option<Crop>,

    /// Make a piece of the image, of the samples A to B - 1 of the --spp of every pixel, which `penumbra merge` puts
    /// together with the others. Whatever the cut by samples and by --crop, on devices of one kind the whole has the
    /// same bits, those of --samples 0..SPP in one process. No sample learns from others then
    #[arg(long, value_name = "A..B")]
    samples: Option<SampleRange>,

    /// What is seen where there is no surface: environment, transparent, or a colour as #RRGGBB (sRGB) or R,G,B (linear
    /// radiance), which .png tone-maps like the rest; the environment lights the scene in any case
    #[arg(long, value_name = "BACKGROUND", default_value = "environment", value_parser = background)]
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
    pub fn check(&self) -> Result<()> {
        self.complete(self.settings.settings_of_aspect(1.0)).check()
    }

    /// As [`SettingsOptions::settings`].
    pub fn settings(&self, camera: &Camera) -> Result<Settings> {
        let settings = self.complete(self.settings.settings_of_aspect(CameraUniform::aspect(camera)));
        settings.check()?;
        Ok(settings)
    }

    fn complete(&self, mut settings: Settings) -> Settings {
        settings.technique = self.technique.0.unwrap_or_default();
        settings.image.spp = self.spp.unwrap_or(settings.image.spp);
        settings.image.sampling = self.sampling;
        settings.image.aovs = self.aov.clone().unwrap_or_default().0;
        settings.image.crop = self.crop;
        settings.image.piece = self.samples;
        settings.image.background = self.background;
        settings
    }

    /// As [`Settings::is_unbiased`].
    pub fn is_unbiased(&self) -> bool {
        self.complete(self.settings.settings_of_aspect(1.0)).is_unbiased()
    }

    /// The user names no technique.
    pub fn is_automatic(&self) -> bool {
        self.technique.0.is_none()
    }

    /// The user requests a piece of the image.
    pub fn is_piece(&self) -> bool {
        self.samples.is_some()
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

    /// Factor on the power of every light
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

    /// Checks the settings before a file is opened.
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
    /// Maximum number of bounces of indirect light; 0 for direct light only
    #[arg(long, value_name = "N", default_value_t = Settings::default().indirect.max_bounces)]
    max_bounces: u32,

    /// Photons emitted for the global map, from all lights together, for the first 24 samples per pixel; more follow.
    /// By default 4,096 for the first sample, and then 256 for each gather ray
    #[arg(long, value_name = "N")]
    flux_photons: Option<u32>,

    /// Limit the indirect light of each path to this radiance, which removes fireflies; the image is then biased
    #[arg(long, value_name = "RADIANCE")]
    clamp: Option<f32>,

    /// Radius of an irradiance record over the distance of the surfaces around it: smaller is more accurate, and slower
    #[arg(long, value_name = "A", default_value_t = Settings::default().indirect.irradiance_cache.accuracy)]
    accuracy: f32,

    /// Gather rays per irradiance record, rounded up to a power of two, for the first 24 samples per pixel; more
    /// follow. By default 16 for the first sample, and then up to 4,096 as long as these gain more than samples do
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
    /// Visibility photons emitted from each light [default: 16384, or one for 64 shadow rays to the light where that is
    /// less, but at least 4096; up to 131072 with one sample a pixel, 131072 where photons alone decide]
    #[arg(long, value_name = "N")]
    photons: Option<u32>,

    /// Nearest photons that classify a point (k of the paper)
    #[arg(long, value_name = "K", default_value_t = Settings::default().visibility_map.nearest)]
    nearest: u32,

    /// Maximum number of shadow photons stored along one photon ray
    #[arg(long, value_name = "N", default_value_t = Settings::default().visibility_map.shadow_photons_per_ray)]
    shadow_photons_per_ray: u32,

    /// Light points sampled at a boundary point, each with a shadow ray; point, spot and directional lights have one
    #[arg(long, value_name = "N", default_value_t = Settings::default().shadow_rays.samples)]
    shadow_samples: u32,

    /// Pixels by which boundaries are widened, 0 or 1 [default: 1 for lights with wide penumbrae, or where audits find
    /// many mistakes near boundaries; else 0]
    #[arg(long, value_name = "PIXELS")]
    dilate: Option<u32>,

    /// Minimum probability that a lit or shadowed point still traces a shadow ray, which keeps the image unbiased; more
    /// of them do where such rays find mistakes. 0 is the paper's method, which is biased
    #[arg(long, value_name = "P", default_value_t = Settings::default().visibility_map.audit)]
    audit: f32,

    /// Count photons regardless of their normals, as the paper does
    #[arg(long)]
    paper_counting: bool,

    /// Let photons alone decide, without the shadow rays of earlier samples
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

    /// Lights sampled at a point, unless all are used
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

    /// Cells along a side of the six faces around each light, for light-buffer
    #[arg(long, value_name = "N", default_value_t = Settings::default().light_buffer.resolution)]
    light_buffer_cells: u32,

    /// Share of a point's light below which the remaining lights trace no shadow rays and their visibility is
    /// estimated, for ward-adaptive; 0 tests all lights
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

/// A technique; none for `auto`.
#[derive(Clone, Copy)]
struct TechniqueChoice(Option<Technique>);

/// One of the techniques, by name, or `auto`.
fn technique_or_auto() -> impl TypedValueParser<Value = TechniqueChoice> {
    let help = "shadow-photons, or path if the time is too short for photons";
    let auto = PossibleValue::new("auto").help(help);
    PossibleValuesParser::new(std::iter::once(auto).chain(Technique::all().map(possible)))
        .map(|name| TechniqueChoice(name.parse().ok()))
}

fn possible(technique: Technique) -> PossibleValue {
    PossibleValue::new(technique.name()).help(technique.help())
}

/// A technique by name, alone or with a denoiser: `TECHNIQUE+DENOISER`.
#[derive(Clone)]
pub struct EntrantParser;

impl TypedValueParser for EntrantParser {
    type Value = Entrant;

    fn parse_ref(
        &self,
        command: &Command,
        arg: Option<&Arg>,
        value: &OsStr,
    ) -> std::result::Result<Entrant, clap::Error> {
        let text = value.to_string_lossy();
        let (technique, denoiser) = text.split_once('+').map_or((&*text, None), |(name, with)| (name, Some(with)));
        let TechniqueChoice(technique) = technique_or_auto().parse(command, arg, OsString::from(technique))?;
        let Some(denoiser) = denoiser else { return Ok(Entrant { technique, denoise: Denoise::None }) };
        let denoisers = PossibleValuesParser::new(Entrant::denoisers().map(Denoise::name));
        let denoise = denoisers.try_map(|name| name.parse()).parse(command, arg, OsString::from(denoiser))?;
        Ok(Entrant { technique, denoise })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        technique_or_auto().possible_values().map(|values| Box::new(values.collect::<Vec<_>>().into_iter()) as _)
    }
}

/// One of the strategies of light sampling, by name.
fn light_samplings() -> impl TypedValueParser<Value = LightSampling> {
    let values = LightSampling::ALL.map(|strategy| {
        PossibleValue::new(strategy.name()).help(match strategy {
            LightSampling::All => "all lights",
            LightSampling::Uniform => "a few lights, with equal probability",
            LightSampling::Power => "a few lights: half of the time by power, else with equal probability",
            LightSampling::Contribution => "a few lights, by what each would send to the point without occluders",
            LightSampling::Zones => "a few of the lights whose photons reach the zone of the point",
        })
    });
    PossibleValuesParser::new(values).try_map(|name| name.parse())
}

/// One of the ways to share samples out, by name.
fn samplings() -> impl TypedValueParser<Value = Sampling> {
    let values = Sampling::ALL.map(|sampling| {
        PossibleValue::new(sampling.name()).help(match sampling {
            Sampling::Uniform => "--spp samples of every pixel",
            Sampling::Adaptive => {
                "--spp samples of a pixel in the mean: up to eight times as many where there is noise, and half as \
                 many where there is none"
            }
        })
    });
    PossibleValuesParser::new(values).try_map(|name| name.parse())
}

/// One of the denoisers, by name.
pub fn denoisers() -> impl TypedValueParser<Value = Denoise> {
    let values = Denoise::ALL.map(|denoise| {
        PossibleValue::new(denoise.name()).help(match denoise {
            Denoise::Auto => "the mixture of the raw image and all available denoisers with the least estimated error",
            Denoise::None => "no denoiser",
            Denoise::Statistical => "the statistical denoiser alone, which needs no library",
            Denoise::Oidn => "Open Image Denoise alone",
        })
    });
    PossibleValuesParser::new(values).try_map(|name| name.parse())
}

/// A list of groups of channels, separated by commas.
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

/// Numbers separated by commas.
fn numbers<T: FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// The azimuth and the elevation of a view, in degrees.
fn direction(text: &str) -> std::result::Result<[f32; 2], String> {
    let is_direction = |[azimuth, elevation]: &[f32; 2]| azimuth.is_finite() && elevation.abs() <= 90.0;
    let direction = numbers(text).filter(is_direction);
    direction.ok_or_else(|| "it must be two numbers as in 30,15; the elevation is from -90 to 90".into())
}

/// A position.
fn position(text: &str) -> std::result::Result<DVec3, String> {
    let position = numbers(text).map(DVec3::from_array).filter(|position| position.is_finite());
    position.ok_or_else(|| "it must be three finite numbers as in 1,0.5,-2".into())
}

fn up(text: &str) -> std::result::Result<DVec3, String> {
    let up = position(text).ok().filter(|up| up.try_normalize().is_some());
    up.ok_or_else(|| "it must be three finite numbers as in 0,1,0, and not all of them 0".into())
}

fn field_of_view(text: &str) -> std::result::Result<f64, String> {
    positive(text).ok().filter(|fov| *fov < 180.0).ok_or_else(|| "it must be more than 0 and less than 180".into())
}

fn focus(text: &str) -> std::result::Result<Focus, String> {
    match text {
        "auto" => Ok(Focus::Auto),
        _ => positive(text).map(Focus::Distance).map_err(|problem| problem + ", or auto"),
    }
}

fn blades(text: &str) -> std::result::Result<u32, String> {
    let blades = text.parse().ok().filter(|blades| *blades == 0 || (3..=MAX_BLADES).contains(blades));
    blades.ok_or_else(|| format!("it must be 0, or from 3 to {MAX_BLADES}"))
}

fn crop(text: &str) -> std::result::Result<Crop, String> {
    let parts = numbers(text).map(|[x, y, width, height]| Crop { x, y, width, height });
    parts.ok_or_else(|| "it must be four whole numbers of pixels, as in 0,0,64,48".into())
}

fn background(text: &str) -> std::result::Result<Background, String> {
    match text {
        "environment" => return Ok(Background::Environment),
        "transparent" => return Ok(Background::Transparent),
        _ => {}
    }
    let linear = || numbers(text).filter(|colour: &[f32; 3]| colour.iter().all(|x| x.is_finite() && *x >= 0.0));
    let coded = || {
        let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6)?;
        let code = u32::from_str_radix(digits, 16).ok()?.to_be_bytes();
        Some([1, 2, 3].map(|i| linear_from_srgb(f32::from(code[i]) / 255.0)))
    };
    let problem = "it must be environment, transparent, a colour as #RRGGBB or three numbers that are 0 or more";
    coded().or_else(linear).map(Background::Colour).ok_or_else(|| problem.into())
}

/// The reference image, which must have the size of the settings.
pub fn read_reference(path: &Path, settings: &Settings) -> Result<Reference> {
    let reference = Reference::read(path)?;
    let part = settings.image.part();
    let (Image { width, height, .. }, own) = (&reference.image, [part.width, part.height]);
    if [*width, *height] != own {
        let sizes = format!("is {width} x {height} pixels, not {} x {}", own[0], own[1]);
        return Err(Error::input(path, "file", format!("{sizes}; set --width and --height to its size")));
    }
    Ok(reference)
}
