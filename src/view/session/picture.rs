//! Everything that decides a picture: scene, camera, settings, and where they come from.

use std::path::{Path, PathBuf};

use crate::scene::{Camera, LookAt, Scene};
use crate::settings::Settings;
use crate::view::overlay::Display;
use crate::{Denoiser, Result};

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
    /// The first camera of a file that lacks the command's, or one that frames its scene.
    Default,
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
    /// F-number of the lens; `None` without one.
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
    /// Reads a scene. `files` are then those that it refers to, even if it is refused.
    ///
    /// # Errors
    /// As [`Scene::load`].
    fn load(&self, file: &Path, pose: &Pose, files: &mut Vec<PathBuf>) -> Result<Scene>;

    /// The camera, for an image of `aspect` times its height.
    ///
    /// # Errors
    /// [`Error::Usage`](crate::Error::Usage) if the scene has no such camera.
    fn camera(&self, scene: &Scene, eye: &Eye, aspect: f32) -> Result<Camera>;

    /// The state of the camera at first.
    fn eye(&self) -> Eye {
        Eye::default()
    }

    /// The denoiser; without one, why.
    fn denoiser(&self) -> (Denoiser, Option<String>);

    /// The command that renders a picture. `cameras` are the names of the file's cameras.
    fn command(&self, picture: &Picture, cameras: &[String]) -> String;

    /// The files besides the scene's that it reads.
    fn files(&self) -> Vec<PathBuf>;

    /// Whether one of them is a panorama, which can be turned: an environment of the scene's file cannot.
    fn has_panorama(&self) -> bool;
}
