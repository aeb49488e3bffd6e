//! A session: a scene, a camera, and a render of both that continues until the picture is complete. It has no window:
//! commands change it, and each step returns a picture to show.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DVec3;
use kernel_kit::Gpu;

use super::navigation;
use super::overlay::{self, Display, Seen};
use super::pick::{Hit, pick};
use crate::kernels::Class;
use crate::render::film::write_atomically;
use crate::render::photons::{NearestPhotons, SurfacePoint, VisibilityPhoton};
use crate::scene::{AddedCamera, Camera, Extent, Framing, LookAt, Projection, Scene, with_camera};
use crate::settings::{Aov, Denoise, Settings};
use crate::{Denoiser, Error, Image, Renderer, Result, Statistics};

/// Time without a movement after which the picture is rendered at its full size.
const SETTLED: Duration = Duration::from_millis(250);

/// The time of a picture while the camera moves: twelve pictures a second.
const MOVING_PICTURE: Duration = Duration::from_millis(80);

/// Divisor of the sides of the first picture: 640 x 360 pixels become 160 x 90. At that size preparation takes longer
/// than the sample (docs/view.md), and the scene can still be recognised.
const FIRST_DIVISOR: u32 = 4;

/// Largest factor by which the sides of the picture are divided while the camera moves.
const MAX_DIVISOR: u32 = 8;

/// The share of the distance to a point that remains after moving the camera towards it.
const NEARER: f64 = 0.5;

/// Depth of the camera's target if nothing is in the centre of its image: about the size of the scene.
const EMPTY_DEPTH: f32 = 1.0;

/// The channels that the film keeps besides the picture. They do not change it, and without them another overlay would
/// begin the picture again.
const KEPT: [Aov; 4] = [Aov::Albedo, Aov::Normal, Aov::Depth, Aov::Samples];

/// The state of the scene that is shown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// Seconds after the beginning of the animation; `None` for the pose of the file.
    pub time: Option<f64>,
    /// Variant of the materials; `None` for those of the file.
    pub variant: Option<String>,
    /// Rotation of the environment in degrees; `None` for that of the command.
    pub environment_rotation: Option<f64>,
}

/// Where the camera is.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Viewpoint {
    /// The camera of the command.
    #[default]
    Given,
    /// A camera of the file, by its index.
    File(usize),
    /// Where the user moved it.
    Placed(LookAt),
}

/// The state of the camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Eye {
    /// Where it is.
    pub viewpoint: Viewpoint,
    /// Vertical field of view in degrees of a camera that was not moved; `None` for its own.
    pub fov: Option<f64>,
    /// F-number of the lens; `None` for the command's.
    pub f_number: Option<f64>,
}

/// The user's choices besides the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Choices {
    /// The settings of the render, with the size of the picture.
    pub settings: Settings,
    /// The state of the scene.
    pub pose: Pose,
    /// How the picture is shown.
    pub display: Display,
}

/// Everything that decides the picture.
#[derive(Clone, Debug)]
pub struct Picture {
    /// The scene's file.
    pub file: PathBuf,
    /// The camera.
    pub eye: Eye,
    /// The user's choices.
    pub choices: Choices,
}

/// Where scenes and cameras come from, and commands go: the options of the program.
pub trait Source: Send + Sync {
    /// Reads a scene.
    ///
    /// # Errors
    /// As [`Scene::load`].
    fn load(&self, file: &Path, pose: &Pose) -> Result<Scene>;

    /// The camera, for an image of `aspect` times its height.
    ///
    /// # Errors
    /// [`Error::Usage`] if the scene has no such camera.
    fn camera(&self, scene: &Scene, eye: &Eye, aspect: f32) -> Result<Camera>;

    /// The denoiser; without one, why.
    fn denoiser(&self) -> (Denoiser, Option<String>);

    /// The command that renders a picture.
    fn command(&self, picture: &Picture) -> String;

    /// The files besides the scene's that it reads.
    fn files(&self) -> Vec<PathBuf>;

    /// Whether one of them is a panorama, which can be turned: an environment of the scene's file cannot.
    fn has_panorama(&self) -> bool;
}

/// A command to a session.
#[derive(Clone, Debug)]
pub enum Command {
    /// Turn about the target, by shares of half a turn: right, up.
    Orbit([f64; 2]),
    /// Move along the image, by shares of its height: right, up.
    Pan([f64; 2]),
    /// Approach the target; see `navigation.rs`.
    Dolly(f64),
    /// Move right, up and forward, by shares of the scene's size.
    Fly([f64; 3]),
    /// Set the vertical field of view in degrees.
    FieldOfView(f64),
    /// Set the f-number; `None` for the lens of the command.
    Aperture(Option<f64>),
    /// See the whole scene from this side.
    FrameAll,
    /// Look at what is at a point of the image, from 0 to 1 each way, from nearer.
    FrameAt([f32; 2]),
    /// Take a camera.
    Camera(Viewpoint),
    /// Set all else but the size of the picture.
    Choose(Box<Choices>),
    /// Set the size of the picture.
    Resize([u32; 2]),
    /// Tell about a point of the image, from 0 to 1 each way.
    Pick([f32; 2]),
    /// Tell about no point.
    Unpick,
    /// Show another scene.
    Open(PathBuf),
    /// Read the scene again.
    Reload,
    /// Write the picture.
    Save(PathBuf),
    /// Write a copy of the scene's file that has the camera, under this name.
    SaveCamera {
        /// The copy.
        file: PathBuf,
        /// The name.
        name: String,
        /// Take the place of a file that is there already.
        replaces: bool,
    },
}

/// The photons' classification of a pixel for a light.
#[derive(Clone, Debug, PartialEq)]
pub struct PickedLight {
    /// The light's name.
    pub name: String,
    /// Its class.
    pub class: &'static str,
    /// Visibility of the light, 0 to 1.
    pub visibility: f32,
    /// Illumination photons and shadow photons among the nearest.
    pub photons: [f32; 2],
}

/// Data about a pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Picked {
    /// The point of the image, from 0 to 1 each way.
    pub at: [f32; 2],
    /// The surface; `None` where there is nothing.
    pub hit: Option<Hit>,
    /// The picture's radiance.
    pub radiance: Option<[f32; 3]>,
    /// The photons' classification for each light; empty unless the overlay of classes is shown.
    pub lights: Vec<PickedLight>,
    /// The point that is shaded there, behind mirrors and glass; `None` before the picture is there.
    pub point: Option<SurfacePoint>,
    /// The photons that decide it for the light that is shown; `None` without a visibility map.
    pub nearest: Option<NearestPhotons>,
}

/// A picture to show, and data about it.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// 8-bit RGB, row by row from the top.
    pub pixels: Arc<Vec<u8>>,
    /// Width and height of `pixels`; smaller than the picture's while the camera moves.
    pub size: [u32; 2],
    /// Samples of the pixels that have most.
    pub samples: u32,
    /// Whether the picture has all its samples.
    pub is_complete: bool,
    /// Seconds that the last step took.
    pub seconds: f64,
    /// All that decides the picture.
    pub picture: Picture,
    /// The field of view in degrees; `None` if the camera is orthographic.
    pub fov: Option<f64>,
    /// Names of the file's cameras.
    pub cameras: Vec<String>,
    /// Names of the lights.
    pub lights: Vec<String>,
    /// Names of the variants of the materials.
    pub variants: Vec<String>,
    /// End of the animation in seconds; `None` without one.
    pub animation_end: Option<f64>,
    /// Whether the scene is shown with a panorama of the command line.
    pub has_panorama: bool,
    /// The last message, an error or what was done.
    pub message: Option<String>,
    /// Data about the pixel that was clicked last.
    pub picked: Option<Picked>,
}

/// The part of a session that does not depend on the device.
pub struct State {
    source: Arc<dyn Source>,
    file: PathBuf,
    eye: Eye,
    choices: Choices,
    scene: Option<Loaded>,
    /// The scene that was last read, successfully or not.
    tried: Option<Origin>,
    /// How often the scene was to be read again.
    reloads: u64,
    message: Option<String>,
    moved: Option<Instant>,
    /// Divisor of the picture's sides while the camera moves.
    divisor: u32,
    image: Option<Image>,
    pixels: Arc<Vec<u8>>,
    size: [u32; 2],
    samples: u32,
    is_complete: bool,
    seconds: f64,
    picked: Option<Picked>,
    /// The point of what was picked is to be found once the picture is there.
    is_point_due: bool,
}

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq)]
struct Origin {
    file: PathBuf,
    pose: Pose,
    reloads: u64,
}

#[derive(Clone)]
struct Loaded {
    scene: Arc<Scene>,
    origin: Origin,
}

impl State {
    /// A session that shows `file`, whose scene is already read, as the command says.
    pub fn new(source: Arc<dyn Source>, file: PathBuf, scene: Scene, choices: Choices) -> State {
        let origin = Origin { file: file.clone(), pose: choices.pose.clone(), reloads: 0 };
        State {
            source,
            file,
            eye: Eye::default(),
            choices,
            scene: Some(Loaded { scene: Arc::new(scene), origin: origin.clone() }),
            tried: Some(origin),
            reloads: 0,
            message: None,
            moved: None,
            divisor: 2,
            image: None,
            pixels: Arc::default(),
            size: [0, 0],
            samples: 0,
            is_complete: false,
            seconds: 0.0,
            picked: None,
            is_point_due: false,
        }
    }

    /// Shows a message.
    pub fn say(&mut self, message: String) {
        self.message = Some(message);
    }

    /// The file that is shown, and those that it was read with.
    pub fn files(&self) -> Vec<PathBuf> {
        let referred = self.scene.iter().flat_map(|loaded| loaded.scene.files.iter().cloned());
        std::iter::once(self.file.clone()).chain(referred).chain(self.source.files()).collect()
    }

    /// The file of the scene that is shown: the previous one, if another could not be read.
    fn shown_file(&self) -> &Path {
        self.scene.as_ref().map_or(&self.file, |loaded| &loaded.origin.file)
    }

    fn full_size(&self) -> [u32; 2] {
        [self.choices.settings.image.width, self.choices.settings.image.height]
    }

    /// The size of a picture whose sides are divided.
    fn divided_size(&self, divisor: u32) -> [u32; 2] {
        self.full_size().map(|side| (side / divisor).max(1))
    }

    fn camera(&self, scene: &Scene) -> Result<Camera> {
        let [width, height] = self.full_size();
        self.source.camera(scene, &self.eye, width as f32 / height as f32)
    }

    fn is_moving(&self) -> bool {
        self.moved.is_some_and(|moved| moved.elapsed() < SETTLED)
    }

    /// What is shown.
    pub fn snapshot(&self) -> Snapshot {
        let scene = self.scene.as_ref().map(|loaded| &loaded.scene);
        let camera = scene.and_then(|scene| self.camera(scene).ok());
        let fov = camera.and_then(|camera| match camera.projection {
            Projection::Perspective { yfov, .. } => Some(f64::from(yfov).to_degrees()),
            Projection::Orthographic { .. } => None,
        });
        Snapshot {
            pixels: self.pixels.clone(),
            size: self.size,
            samples: self.samples,
            is_complete: self.is_complete,
            seconds: self.seconds,
            picture: Picture {
                file: self.shown_file().to_owned(),
                eye: self.eye.clone(),
                choices: self.choices.clone(),
            },
            fov,
            cameras: scene.map(|s| s.cameras.iter().map(|c| c.name.clone()).collect()).unwrap_or_default(),
            lights: scene.map(|s| s.lights.iter().map(|l| l.name.clone()).collect()).unwrap_or_default(),
            variants: scene.map(|scene| scene.variants.clone()).unwrap_or_default(),
            animation_end: scene.and_then(|scene| scene.animation_end),
            has_panorama: scene.is_some() && self.source.has_panorama(),
            message: self.message.clone(),
            picked: self.picked.clone(),
        }
    }

    /// The scene, and the camera as a movable one; `None` without a scene.
    fn view(&self) -> Result<Option<(Arc<Scene>, LookAt)>> {
        let Some(Loaded { scene, .. }) = self.scene.clone() else { return Ok(None) };
        if let Viewpoint::Placed(view) = self.eye.viewpoint {
            return Ok(Some((scene, view)));
        }
        let camera = self.camera(&scene)?;
        let scale = scene.normalisation.scale();
        let centre = pick(&scene, &camera, self.full_size(), [0.5, 0.5]);
        let depth = centre.map_or(EMPTY_DEPTH, |hit| (hit.depth * scale) as f32);
        let view = navigation::placed(&scene, &camera, depth);
        Ok(Some((scene, view)))
    }

    /// Replaces the camera by the result of `change`, unless that is `None`.
    fn navigate(&mut self, change: impl FnOnce(&Scene, &LookAt) -> Option<LookAt>) -> Result<()> {
        let Some((scene, view)) = self.view()? else { return Ok(()) };
        let Some(changed) = change(&scene, &view) else { return Ok(()) };
        let rounded = navigation::rounded(&changed, scene.normalisation.scale());
        // A camera at its own target would have no direction.
        if rounded.axes().is_some() {
            (self.eye.viewpoint, self.eye.fov) = (Viewpoint::Placed(rounded), None);
            self.moved = Some(Instant::now());
        }
        Ok(())
    }

    fn hit(&self, scene: &Scene, at: [f32; 2]) -> Result<Option<Hit>> {
        Ok(pick(scene, &self.camera(scene)?, self.full_size(), at))
    }

    fn pick(&self, at: [f32; 2]) -> Result<Option<Picked>> {
        let Some(Loaded { scene, .. }) = &self.scene else { return Ok(None) };
        let hit = self.hit(scene, at)?;
        let there = Picked { at, hit, radiance: None, lights: Vec::new(), point: None, nearest: None };
        let Some(image) = &self.image else { return Ok(Some(there)) };
        let index = |x: f32, side: u32| ((x * side as f32) as usize).min(side as usize - 1);
        let pixel = index(at[1], image.height) * image.width as usize + index(at[0], image.width);
        let radiance = image.rgb().ok().map(|rgb| rgb.map(|channel| channel[pixel]));
        let value = |name: &str| image.channel(name).map_or(0.0, |samples| samples[pixel]);
        let classes = image.channels.iter().filter(|channel| overlay::is_class(&channel.name));
        let light = |channel: &crate::Channel| {
            let stem = channel.name.trim_end_matches(".class");
            PickedLight {
                name: stem.trim_start_matches("shadow.").to_owned(),
                class: class_name(channel.samples[pixel]),
                visibility: value(&format!("{stem}.visibility")),
                photons: ["ni", "ns"].map(|kind| value(&format!("{stem}.{kind}"))),
            }
        };
        Ok(Some(Picked { radiance, lights: classes.map(light).collect(), ..there }))
    }

    fn save(&self, path: &Path) -> Result<String> {
        let Some(image) = &self.image else { return Ok("there is no picture yet".to_owned()) };
        self.check_kept(path, None)?;
        let is_exr = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
        let Display { view, exposure, .. } = self.choices.display;
        // Like `penumbra render`: an .exr has all channels, a .png shows one picture.
        let denoised = image.denoised().filter(|_| !is_exr);
        denoised.as_ref().unwrap_or(image).write(path, view, exposure)?;
        Ok(format!("wrote {}", path.display()))
    }

    /// Checks that `path` is none of the files that the picture is made from, but for one that may be `replaced`.
    fn check_kept(&self, path: &Path, replaced: Option<&Path>) -> Result<()> {
        let whole = |file: &Path| file.canonicalize().ok();
        let is_input = whole(path).is_some_and(|path| {
            let mut kept = self.files().into_iter().filter_map(|file| whole(&file));
            Some(&path) != replaced.and_then(whole).as_ref() && kept.any(|file| file == path)
        });
        let shown = path.display();
        match is_input {
            true => Err(Error::Usage(format!("{shown} is an input, which would be overwritten: choose another name"))),
            false => Ok(()),
        }
    }

    /// Writes a copy of the scene's file that has the camera.
    fn save_camera(&self, file: &Path, name: &str, replaces: bool) -> Result<String> {
        let Some(Loaded { scene, .. }) = &self.scene else { return Ok("there is no scene yet".to_owned()) };
        let shown = file.display();
        if file.exists() && !replaces {
            let same = |file: &Path| file.canonicalize().ok();
            let is_open = if same(file) == same(self.shown_file()) { "is the open file" } else { "exists" };
            return Err(Error::Usage(format!("{shown} {is_open}: tick `replace` to overwrite it")));
        }
        self.check_kept(file, Some(self.shown_file()))?;
        let kind = |file: &Path| file.extension().map(|extension| extension.to_ascii_lowercase());
        if kind(file) != kind(self.shown_file()) {
            let problem = format!("{shown}: a copy of {} needs the same extension", self.shown_file().display());
            return Err(Error::Usage(problem));
        }
        let camera = self.camera(scene)?;
        let placed = match &self.eye.viewpoint {
            Viewpoint::Placed(view) => view.axes().map(|axes| (view.from, axes)),
            _ => None,
        };
        let name = if name.trim().is_empty() { "view" } else { name.trim() };
        let camera = AddedCamera::new(name, scene, &camera, placed);
        let (bytes, name) = with_camera(self.shown_file(), file.parent().unwrap_or(Path::new("")), &camera)?;
        write_atomically(file, |output| Ok(output.write_all(&bytes)?))?;
        Ok(format!("wrote {shown} with the camera `{name}`"))
    }

    fn apply(&mut self, command: Command) -> Result<()> {
        match command {
            Command::Orbit(by) => self.navigate(|_, view| Some(navigation::orbit(view, by)))?,
            Command::Pan(by) => self.navigate(|_, view| Some(navigation::pan(view, by)))?,
            Command::Dolly(by) => self.navigate(|_, view| Some(navigation::dolly(view, by)))?,
            Command::Fly(way) => self
                .navigate(|scene, view| Some(navigation::fly(view, DVec3::from(way) / scene.normalisation.scale())))?,
            Command::FieldOfView(fov) => match &mut self.eye.viewpoint {
                Viewpoint::Placed(view) => {
                    (view.extent, self.moved) = (Extent::FieldOfView(fov), Some(Instant::now()));
                }
                _ => (self.eye.fov, self.moved) = (Some(fov), Some(Instant::now())),
            },
            Command::Aperture(f_number) => self.eye.f_number = f_number,
            Command::FrameAll => {
                let size = self.full_size();
                self.navigate(|scene, view| framed(scene, view, size))?;
            }
            Command::FrameAt(at) => {
                let Some((scene, _)) = self.view()? else { return Ok(()) };
                if let Some(hit) = self.hit(&scene, at)? {
                    self.navigate(|_, view| Some(navigation::centre(view, hit.position, NEARER)))?;
                }
            }
            Command::Camera(viewpoint) => self.eye = Eye { viewpoint, fov: None, f_number: self.eye.f_number },
            Command::Choose(choices) => {
                let [width, height] = self.full_size();
                self.choices = *choices;
                (self.choices.settings.image.width, self.choices.settings.image.height) = (width, height);
            }
            Command::Resize([width, height]) => {
                let [width, height] = [width, height].map(|side| side.clamp(1, Settings::MAX_SIDE));
                if [width, height] != self.full_size() {
                    (self.choices.settings.image.width, self.choices.settings.image.height) = (width, height);
                    self.moved = Some(Instant::now());
                }
            }
            Command::Pick(at) => (self.picked, self.is_point_due) = (self.pick(at)?, true),
            Command::Unpick => self.picked = None,
            Command::Open(file) => {
                self.file = file;
                self.reloads += 1;
            }
            Command::Reload => self.reloads += 1,
            Command::Save(path) => self.message = Some(self.save(&path)?),
            Command::SaveCamera { file, name, replaces } => {
                self.message = Some(self.save_camera(&file, &name, replaces)?);
            }
        }
        Ok(())
    }

    /// Reads the scene if another one is requested. If it cannot be read, the last one stays.
    fn load(&mut self) -> Result<()> {
        let mut pose = self.choices.pose.clone();
        let is_another = self.scene.as_ref().is_some_and(|loaded| loaded.origin.file != self.file);
        if is_another {
            // A file has animations and variants of its own.
            (pose.time, pose.variant) = (None, None);
        }
        let origin = Origin { file: self.file.clone(), pose, reloads: self.reloads };
        if self.tried.as_ref() == Some(&origin) {
            return Ok(());
        }
        self.tried = Some(origin.clone());
        let scene = self.source.load(&origin.file, &origin.pose)?;
        // The view of a file that is read again stays.
        if is_another {
            (self.eye, self.choices.pose) = (Eye::default(), origin.pose.clone());
        }
        self.picked = None;
        self.scene = Some(Loaded { scene: Arc::new(scene), origin });
        self.message = None;
        Ok(())
    }
}

/// The whole scene from the side of `view`, for an image of this size.
fn framed(scene: &Scene, view: &LookAt, [width, height]: [u32; 2]) -> Option<LookAt> {
    let [_, _, backward] = view.axes()?;
    let aspect = width as f32 / height as f32;
    let [lower, upper] = scene.bounds()?;
    let fov = match view.extent {
        Extent::FieldOfView(fov) if view.up == DVec3::Y => Some(fov as f32),
        _ => None,
    };
    let Some(fov) = fov else {
        let centre = scene.normalisation.undo(0.5 * (lower + upper));
        let radius = 0.5 * f64::from((upper - lower).length()) / scene.normalisation.scale();
        return navigation::around(view, centre, radius, aspect.into());
    };
    let framing = Framing {
        azimuth: backward.x.atan2(backward.z).to_degrees() as f32,
        elevation: backward.y.clamp(-1.0, 1.0).asin().to_degrees() as f32,
        aspect,
        fov,
    };
    let camera = scene.frame(&framing);
    let depth = (camera.position - 0.5 * (lower + upper)).dot(camera.axes[2]);
    Some(navigation::placed(scene, &camera, depth))
}

fn class_name(class: f32) -> &'static str {
    const NAMES: [&str; Class::COUNT] = ["dark", "lit", "shadowed", "boundary", "unknown"];
    NAMES.get(class as usize).copied().unwrap_or("unknown")
}

/// The inputs that a renderer was made for. The camera may change, and while it moves so may the size.
#[derive(Clone, Debug, PartialEq)]
struct Subject {
    origin: Origin,
    settings: Settings,
    has_lens: bool,
}

impl Subject {
    /// Whether they differ in the size of the picture alone.
    fn is_resized(&self, other: &Subject) -> bool {
        let mut settings = other.settings.clone();
        (settings.image.width, settings.image.height) = (self.settings.image.width, self.settings.image.height);
        *self == Subject { settings, ..other.clone() }
    }
}

struct Render<'g> {
    renderer: Renderer<'g>,
    subject: Subject,
    eye: Eye,
    camera: Camera,
    size: [u32; 2],
    /// It is seen for a moment only.
    is_preview: bool,
    /// It is the first picture.
    is_first: bool,
    photons: Option<Vec<VisibilityPhoton>>,
}

/// A session on a device.
pub struct Session<'g> {
    gpu: &'g Gpu,
    denoiser: Denoiser,
    state: State,
    render: Option<Render<'g>>,
    /// The inputs that could not be rendered.
    failed: Option<(Subject, Eye)>,
    /// The picture is to be shown anew without being rendered anew.
    is_stale: bool,
    /// Whether the camera moved when the last step began.
    was_moving: bool,
}

impl<'g> Session<'g> {
    /// Continues `state` on a device, which from now on keeps its kernels.
    pub fn new(gpu: &'g Gpu, mut state: State) -> Session<'g> {
        gpu.keep_kernels();
        let (denoiser, problem) = state.source.denoiser();
        if let Some(problem) = problem {
            state.say(format!("{problem}; the picture stays raw"));
        }
        Session { gpu, denoiser, state, render: None, failed: None, is_stale: true, was_moving: false }
    }

    /// The part that does not depend on the device, for another one.
    pub fn into_state(self) -> State {
        self.state
    }

    /// The part that does not depend on the device.
    pub fn state(&mut self) -> &mut State {
        &mut self.state
    }

    /// What is shown.
    pub fn snapshot(&self) -> Snapshot {
        self.state.snapshot()
    }

    /// Statistics of the picture; `None` before there is one.
    ///
    /// # Errors
    /// As [`Renderer::statistics`].
    pub fn statistics(&self) -> Result<Option<Statistics>> {
        self.render.as_ref().map(|render| render.renderer.statistics()).transpose()
    }

    /// Executes a command. One that fails leaves a message.
    pub fn command(&mut self, command: Command) {
        // A movement is shown once it is rendered.
        let moves = matches!(command, Command::Orbit(_) | Command::Pan(_) | Command::Dolly(_) | Command::Fly(_));
        if let Err(problem) = self.state.apply(command) {
            self.state.say(problem.to_string());
        }
        self.is_stale |= !moves;
    }

    /// How long the next step can wait if nothing is to be done; `None` means for ever.
    pub fn wait(&self) -> Option<Duration> {
        let moved = self.state.moved.filter(|_| self.was_moving);
        moved.map(|moved| SETTLED.saturating_sub(moved.elapsed()))
    }

    /// Does a part of what is left to do, such as a batch of samples. Returns a picture if there is a new one, and
    /// whether more is left.
    ///
    /// # Errors
    /// [`Error::DeviceLost`]: continue [the state](Session::into_state) on another device. Other errors leave a
    /// message.
    pub fn step(&mut self) -> Result<(Option<Snapshot>, bool)> {
        let started = Instant::now();
        let said = self.state.message.clone();
        let worked = match self.advance() {
            Err(lost @ Error::DeviceLost { .. }) => return Err(lost),
            Err(problem) => {
                self.state.say(problem.to_string());
                false
            }
            Ok(worked) => worked,
        };
        if worked {
            self.state.seconds = started.elapsed().as_secs_f64();
            self.adapt();
        }
        if !worked && !self.is_stale && said == self.state.message {
            return Ok((None, false));
        }
        self.is_stale = false;
        match self.show() {
            Err(lost @ Error::DeviceLost { .. }) => return Err(lost),
            Err(problem) => self.state.say(problem.to_string()),
            Ok(()) => {}
        }
        Ok((Some(self.state.snapshot()), worked))
    }

    /// Divides the picture more or less while the camera moves, by the time of the last step.
    fn adapt(&mut self) {
        let full = self.state.full_size();
        let is_divided = self.render.as_ref().is_some_and(|render| render.size != full);
        if !self.was_moving || !is_divided {
            return;
        }
        let took = Duration::from_secs_f64(self.state.seconds);
        if took > 2 * MOVING_PICTURE {
            self.state.divisor = (2 * self.state.divisor).min(MAX_DIVISOR);
        } else if took < MOVING_PICTURE / 4 {
            // A quarter as many pixels take more than a quarter of the time.
            self.state.divisor = (self.state.divisor / 2).max(1);
        }
    }

    /// Loads, prepares or renders. Returns whether there was anything to do.
    fn advance(&mut self) -> Result<bool> {
        let is_moving = self.state.is_moving();
        self.was_moving = is_moving;
        self.state.load()?;
        let Some(Loaded { scene, origin }) = self.state.scene.clone() else { return Ok(false) };
        let eye = self.state.eye.clone();
        let camera = self.state.camera(&scene)?;
        let settings = self.settings();
        let subject = Subject { origin, settings, has_lens: camera.lens.is_some() };
        if self.failed.as_ref().is_some_and(|failed| *failed == (subject.clone(), eye.clone())) {
            return Ok(false);
        }
        let outcome = match &mut self.render {
            Some(render) if render.subject == subject => {
                let full = self.state.full_size();
                let size = if is_moving { self.state.divided_size(self.state.divisor) } else { full };
                let is_there = render.size == size || (is_moving && render.size == full);
                let keeps = render.eye == eye && is_there && (is_moving || !render.is_preview);
                if keeps { Ok(()) } else { render.set_view(&eye, camera, size, is_moving) }
            }
            // The last picture is shown in the new size until the size stays.
            Some(render) if is_moving && render.subject.is_resized(&subject) => return Ok(false),
            _ => self.prepare(&scene, subject.clone(), eye.clone(), camera),
        };
        if let Err(problem) = outcome {
            (self.render, self.failed) = (None, Some((subject, eye)));
            return Err(problem);
        }
        self.failed = None;
        self.sample(is_moving)
    }

    /// The settings of the renderer.
    fn settings(&self) -> Settings {
        let Choices { settings, display, .. } = &self.state.choices;
        settings.clone().with(|s| {
            s.image.denoise = self.denoiser.choice();
            s.image.aovs.extend(KEPT);
            s.image.aovs.extend(display.overlay.aov());
            if display.overlay.shows_photons() {
                s.visibility_map.photons_per_light = Some(settings.photons_per_light());
            }
            s.image.aovs.sort();
            s.image.aovs.dedup();
        })
    }

    fn prepare(&mut self, scene: &Scene, subject: Subject, eye: Eye, camera: Camera) -> Result<()> {
        // Two renderers would need twice the memory.
        self.render = None;
        // Another render may have other photons.
        self.state.picked.iter_mut().for_each(|picked| picked.nearest = None);
        // A small picture comes first, as while the camera moves; visibility photons come after it.
        let size = self.state.divided_size(FIRST_DIVISOR);
        let renderer = Renderer::with_preview(self.gpu, scene.clone(), &camera, &subject.settings, size)?;
        self.state.message = None;
        let (is_preview, is_first) = (true, true);
        self.render = Some(Render { renderer, subject, eye, camera, size, is_preview, is_first, photons: None });
        Ok(())
    }

    /// Renders a batch and takes the image, unless all samples are there. While the camera moves, one is enough.
    fn sample(&mut self, is_moving: bool) -> Result<bool> {
        let Some(render) = &mut self.render else { return Ok(false) };
        let renderer = &mut render.renderer;
        let is_first = renderer.samples() == 0;
        if (is_moving && !is_first) || !renderer.wants_samples(&self.denoiser)? {
            return Ok(false);
        }
        if is_first {
            renderer.render_up_to(1)?
        } else {
            renderer.render_batch()?
        };
        self.state.is_complete = !render.is_preview && !renderer.wants_samples(&self.denoiser)?;
        self.state.samples = renderer.samples();
        let is_denoised = self.state.choices.display.denoised && self.denoiser.choice() != Denoise::None;
        // Denoising takes as long as some samples.
        if is_denoised && !self.state.samples.is_power_of_two() && !self.state.is_complete {
            return Ok(true);
        }
        let mut image = renderer.image()?;
        // Denoisers take long to begin, and the first picture is not to wait for them.
        if !render.is_first {
            renderer.add_denoised(&mut image, &self.denoiser)?;
        }
        self.state.image = Some(image);
        Ok(true)
    }

    /// Makes the pixels that are shown.
    fn show(&mut self) -> Result<()> {
        let (Some(image), Some(render)) = (&self.state.image, &mut self.render) else { return Ok(()) };
        let display = self.state.choices.display;
        let is_same_size = [image.width, image.height] == render.size;
        let picked = &mut self.state.picked;
        if let Some(picked) = picked.as_mut().filter(|_| is_same_size && render.eye == self.state.eye)
            && std::mem::take(&mut self.state.is_point_due)
        {
            picked.point = render.point(picked.at)?;
        }
        let is_other = |nearest: &NearestPhotons| nearest.light as usize != display.light;
        if let Some(picked) = picked.as_mut().filter(|picked| picked.nearest.as_ref().is_none_or(is_other)) {
            picked.nearest = picked.point.map(|point| render.nearest(point, display.light)).transpose()?.flatten();
        }
        let nearest = picked.as_ref().and_then(|picked| picked.nearest.as_ref()).filter(|_| is_same_size);
        let is_photons = display.overlay == overlay::Overlay::Photons;
        if is_photons {
            render.photons()?;
        }
        let photons = render.photons.as_deref().filter(|_| is_photons && is_same_size).unwrap_or_default();
        let is_cells = display.overlay == overlay::Overlay::Cells && is_same_size;
        let cells = if is_cells { render.renderer.shown_cells(display.light as u32)? } else { None };
        let scale = self.state.scene.as_ref().map_or(1.0, |loaded| loaded.scene.normalisation.scale());
        let seen = Seen { photons, cells: cells.as_deref(), nearest, camera: &render.camera, scale };
        self.state.pixels = Arc::new(overlay::pixels(image, &display, seen));
        self.state.size = [image.width, image.height];
        Ok(())
    }
}

impl Render<'_> {
    fn set_view(&mut self, eye: &Eye, camera: Camera, size: [u32; 2], is_preview: bool) -> Result<()> {
        if is_preview {
            self.renderer.preview(&camera, size)?;
        } else {
            self.renderer.set_view(&camera, size)?;
            // It may have made others.
            self.photons = None;
        }
        (self.eye, self.camera, self.size) = (eye.clone(), camera, size);
        (self.is_preview, self.is_first) = (is_preview, false);
        Ok(())
    }

    /// The photons of the visibility map.
    fn photons(&mut self) -> Result<&[VisibilityPhoton]> {
        if self.photons.is_none() {
            self.photons = Some(self.renderer.visibility_photons()?);
        }
        Ok(self.photons.as_deref().unwrap_or_default())
    }

    /// The point that is lit at a point of the image, from 0 to 1 each way.
    fn point(&self, at: [f32; 2]) -> Result<Option<SurfacePoint>> {
        let index = |x: f32, side: u32| ((x * side as f32) as u32).min(side - 1);
        self.renderer.surface_point([index(at[0], self.size[0]), index(at[1], self.size[1])])
    }

    /// The photons that decide a point for a light.
    fn nearest(&mut self, point: SurfacePoint, light: usize) -> Result<Option<NearestPhotons>> {
        self.photons()?;
        let photons = self.photons.as_deref().unwrap_or_default();
        Ok(self.renderer.nearest_photons(photons, point, light as u32))
    }
}
