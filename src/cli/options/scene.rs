//! Options that name a scene and place its camera.

#[cfg(feature = "view")]
use std::path::Path;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use glam::DVec3;
use penumbra::internal::scene::{
    Extent, Focus, Framing, ImportOptions, Iris, LookAt, Panorama, Projection, load_and_list,
};
#[cfg(feature = "view")]
use penumbra::internal::view::Pose;
use penumbra::{Camera, Error, Result, Scene};

use super::values::{blades, direction, field_of_view, finite, focus, position, positive, up};

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

    /// Place the camera at this position, in the file's coordinates
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

    /// Position that a placed camera looks at, in the file's coordinates
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

    /// Make the placed camera orthographic, with a view of this height in the file's units
    #[arg(
        long,
        value_name = "HEIGHT",
        value_parser = positive,
        requires = "look_from",
        conflicts_with_all = ["fov", "aperture"],
        help_heading = "Scene"
    )]
    orthographic: Option<f64>,

    /// Vertical field of view of a perspective camera [default: the camera's own; 40 for a camera that is placed or
    /// that frames the scene]
    #[arg(long, value_name = "DEGREES", value_parser = field_of_view, help_heading = "Scene")]
    fov: Option<f64>,

    /// F-number of the camera's lens, which blurs what is out of focus; the film is 24 mm high, and a unit of the file
    /// is a metre [default: a pinhole]
    #[arg(long, value_name = "F", value_parser = positive, help_heading = "Scene")]
    aperture: Option<f64>,

    /// Distance at which the lens is in focus, in metres along the viewing direction; auto: the distance of the surface
    /// in the centre of the image
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

    /// Add a soft light above and in front of the scene if the file has no light
    #[arg(long, help_heading = "Scene")]
    default_light: bool,

    /// Accept files with certain faults instead of refusing them: drop primitives with NaN or infinite numbers; drop
    /// textures whose image is missing or damaged; read textures at 0, 0 where a primitive lacks texture coordinates;
    /// replace negative, NaN or infinite values of a panorama by 0
    #[arg(long, help_heading = "Scene")]
    lenient: bool,

    /// Pose the scene at this time after the beginning of an animation, with its nodes, skins, morph targets, cameras,
    /// lights and materials. An animation stands still before its first key and after its last one [default: the pose
    /// of the file]
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

    /// Repeat the animation after its last key
    #[arg(long = "loop", requires = "moment", help_heading = "Scene")]
    repeat: bool,

    /// Material variant to use (KHR_materials_variants) [default: none]
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

    /// Multiply the radiance of the panorama by this factor
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

/// What `--camera` must be for the camera `index` of a file whose cameras have these names: its name, or its index if
/// the name is not unique or reads as an index. Names come before indices, but an index may begin with zeros.
#[cfg(feature = "view")]
pub fn camera_word(names: &[String], index: usize) -> String {
    let is_another = |word: &str| names.iter().enumerate().any(|(i, name)| i != index && name == word);
    if let Some(name) = names.get(index).filter(|name| !is_another(name) && name.parse::<usize>().is_err()) {
        return name.clone();
    }
    let mut word = index.to_string();
    while is_another(&word) {
        word.insert(0, '0');
    }
    word
}

/// For the window, which changes some of the options.
#[cfg(feature = "view")]
impl SceneOptions {
    /// The same options for another file and pose.
    pub fn of_file(self, file: &Path, pose: &Pose) -> Self {
        let environment_rotation = pose.environment_rotation.unwrap_or(self.environment_rotation);
        SceneOptions { scene: file.to_owned(), environment_rotation, variant: pose.variant.clone(), ..self }
    }

    /// The same options with this field of view, if it is given, and with this f-number or none.
    pub fn through(self, fov: Option<f64>, f_number: Option<f64>) -> Self {
        SceneOptions { fov: fov.or(self.fov), aperture: f_number, ..self }
    }

    /// A camera of the file, or its default one, with this field of view or its own.
    pub fn through_camera(self, camera: Option<String>, fov: Option<f64>) -> Self {
        let (look_from, look_at, look_up, orthographic) = (None, None, None, None);
        SceneOptions { camera, from: None, look_from, look_at, look_up, fov, orthographic, ..self }
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
        Pose { time: self.at, variant: self.variant.clone(), environment_rotation: self.rotation() }
    }

    /// The field of view.
    pub fn fov(&self) -> Option<f64> {
        self.fov
    }

    /// The f-number.
    pub fn f_number(&self) -> Option<f64> {
        self.aperture
    }

    /// Whether there is a panorama around the scene.
    pub fn has_panorama(&self) -> bool {
        self.environment.is_some()
    }

    /// The rotation of the environment, if one is given.
    pub fn rotation(&self) -> Option<f64> {
        Some(self.environment_rotation).filter(|degrees| self.environment.is_some() && *degrees != 0.0)
    }
}

/// A panorama, and the notes on its file.
pub struct LoadedPanorama {
    panorama: Arc<Panorama>,
    notes: Vec<String>,
}

impl SceneOptions {
    /// The files that the options name besides the scene.
    pub fn other_files(&self) -> Vec<PathBuf> {
        self.environment.iter().cloned().collect()
    }

    /// The scene, and the camera to render it with. `aspect` is the image's width over its height if the camera does
    /// not decide it.
    pub fn load(&self, aspect: f32) -> Result<(Scene, Camera)> {
        self.load_first(None, self.load_panorama()?.as_ref(), aspect)
    }

    /// Like [`load`](Self::load), but in the pose at `time` seconds after the beginning of the animation, if that is
    /// given, and within this panorama.
    pub fn load_first(
        &self,
        time: Option<f64>,
        panorama: Option<&LoadedPanorama>,
        aspect: f32,
    ) -> Result<(Scene, Camera)> {
        let mut scene = self.load_at(time.or(self.at)).map_err(|error| match error {
            Error::Setting { name: "time", problem } if self.at.is_none() => Error::setting("frames", problem),
            other => other,
        })?;
        if let Some(panorama) = panorama {
            self.set_panorama(&mut scene, panorama)?;
        }
        let camera = self.camera(&scene, aspect)?;
        self.add_notes(&mut scene, &camera);
        Ok((scene, camera))
    }

    /// Adds notes on what `camera` shows of the scene.
    pub fn add_notes(&self, scene: &mut Scene, camera: &Camera) {
        if scene.cameras.is_empty() && self.from.is_none() && self.look_from.is_none() {
            scene.notes.push("the view is that of a camera that frames the scene".into());
        }
        scene.notes.extend(scene.clipped_away(camera));
    }

    /// The scene at this time of its animation in seconds, without the panorama.
    pub fn load_at(&self, time: Option<f64>) -> Result<Scene> {
        self.load_and_list(time, &mut Vec::new())
    }

    /// Like [`load_at`](Self::load_at); `files` are then those that the scene refers to, even if it is refused.
    pub fn load_and_list(&self, time: Option<f64>, files: &mut Vec<PathBuf>) -> Result<Scene> {
        let Self { default_light, lenient, repeat, .. } = *self;
        let (animation, variant) = (self.animation.clone(), self.variant.clone());
        let max_copied_triangles = None;
        let options = ImportOptions { default_light, lenient, repeat, time, animation, variant, max_copied_triangles };
        load_and_list(&self.scene, &options, files)
    }

    /// The panorama around the scene.
    pub fn load_panorama(&self) -> Result<Option<LoadedPanorama>> {
        let load = |path: &PathBuf| {
            let (panorama, notes) = Panorama::load(path, self.lenient)?;
            Ok(LoadedPanorama { panorama: Arc::new(panorama), notes })
        };
        self.environment.as_ref().map(load).transpose()
    }

    /// Puts the panorama around a scene.
    pub fn set_panorama(&self, scene: &mut Scene, LoadedPanorama { panorama, notes }: &LoadedPanorama) -> Result<()> {
        scene.set_environment(panorama.clone(), self.environment_rotation, self.environment_strength)?;
        scene.notes.extend_from_slice(notes);
        Ok(())
    }

    /// Whether the camera frames the scene: it is neither one of the file nor placed by the user.
    pub fn frames(&self, scene: &Scene) -> bool {
        self.from.is_some() || (self.look_from.is_none() && self.camera.is_none() && scene.cameras.is_empty())
    }

    /// The camera that the user selects, with its lens; `aspect` as for [`load`](Self::load).
    pub fn camera(&self, scene: &Scene, aspect: f32) -> Result<Camera> {
        self.with_lens(scene, self.select_camera(scene, aspect)?)
    }

    /// The cameras of a turntable with `views` views.
    pub fn turntable(&self, scene: &Scene, aspect: f32, views: u32) -> Result<Vec<Camera>> {
        let cameras = scene.turntable(&self.framing(aspect), views);
        cameras.into_iter().map(|camera| self.with_lens(scene, camera)).collect()
    }

    /// From where a camera that frames the scene looks at it.
    fn framing(&self, aspect: f32) -> Framing {
        let default = Framing::default();
        let [azimuth, elevation] = self.from.unwrap_or([default.azimuth, default.elevation]);
        Framing { azimuth, elevation, aspect, fov: self.fov.map_or(default.fov, |fov| fov as f32) }
    }

    fn with_lens(&self, scene: &Scene, mut camera: Camera) -> Result<Camera> {
        if let Some(fov) = self.fov {
            let Projection::Perspective { yfov, .. } = &mut camera.projection else {
                let problem = format!("--fov: camera \"{}\" is orthographic, which has no field of view", camera.name);
                return Err(Error::Usage(problem));
            };
            *yfov = fov.to_radians() as f32;
        }
        if let Some(f_number) = self.aperture {
            let iris = Iris { f_number, blades: self.iris_blades };
            let options = if matches!(self.focus, Focus::Distance(_)) { "--aperture, --focus" } else { "--aperture" };
            let refused = |problem| Error::Usage(format!("{options}: {problem}"));
            scene.open_iris(&mut camera, iris, self.focus).map_err(refused)?;
        }
        Ok(camera)
    }

    fn select_camera(&self, scene: &Scene, aspect: f32) -> Result<Camera> {
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
        match &self.camera {
            Some(wanted) => scene.camera(wanted).cloned(),
            None => Ok(scene.cameras.first().cloned().unwrap_or_else(framed)),
        }
    }
}
