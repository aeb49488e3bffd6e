//! The state of a session: what is shown, and what was requested.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::picture::{Choices, Eye, Picture, Pose, Source, Viewpoint};
use super::snapshot::{Picked, Snapshot};
use crate::scene::{Camera, Projection, Scene};
use crate::{Image, Result};

/// Time without a movement after which the picture is rendered at its full size.
pub(super) const SETTLED: Duration = Duration::from_millis(250);

/// The part of a session that does not depend on the device.
pub struct State {
    pub(super) source: Arc<dyn Source>,
    pub(super) file: PathBuf,
    pub(super) eye: Eye,
    pub(super) choices: Choices,
    pub(super) scene: Option<Loaded>,
    /// The scene that was last read, successfully or not.
    pub(super) tried: Option<Origin>,
    /// The files that it refers to.
    tried_files: Vec<PathBuf>,
    /// How often the scene was to be read again.
    pub(super) reloads: u64,
    pub(super) message: Option<String>,
    pub(super) moved: Option<Instant>,
    /// Divisor of the picture's sides while the camera moves.
    pub(super) divisor: u32,
    pub(super) image: Option<Image>,
    pub(super) pixels: Arc<Vec<u8>>,
    pub(super) size: [u32; 2],
    pub(super) samples: u32,
    pub(super) is_complete: bool,
    pub(super) seconds: f64,
    pub(super) picked: Option<Picked>,
    /// Whether the shading point of the picked pixel must be found once the picture is there.
    pub(super) is_point_due: bool,
}

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Origin {
    pub file: PathBuf,
    pub pose: Pose,
    pub reloads: u64,
}

/// A scene that was read.
#[derive(Clone)]
pub(super) struct Loaded {
    pub scene: Arc<Scene>,
    pub origin: Origin,
}

impl State {
    /// A session that shows `file`, whose scene is already read, as the command says.
    pub fn new(source: Arc<dyn Source>, file: PathBuf, scene: Scene, choices: Choices) -> State {
        let origin = Origin { file: file.clone(), pose: choices.pose.clone(), reloads: 0 };
        State {
            eye: source.eye(),
            source,
            file,
            choices,
            tried_files: scene.files.clone(),
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

    /// The files of the scene that is shown, and of one that could not be read: it may be read once they change.
    pub fn files(&self) -> Vec<PathBuf> {
        let shown = self.scene.iter().flat_map(|loaded| &loaded.scene.files);
        let referred = shown.chain(&self.tried_files).cloned();
        std::iter::once(self.file.clone()).chain(referred).chain(self.source.files()).collect()
    }

    /// The file of the scene that is shown: the previous one, if another could not be read.
    pub(super) fn shown_file(&self) -> &Path {
        self.scene.as_ref().map_or(&self.file, |loaded| &loaded.origin.file)
    }

    pub(super) fn full_size(&self) -> [u32; 2] {
        [self.choices.settings.image.width, self.choices.settings.image.height]
    }

    /// The size of a picture whose sides are divided.
    pub(super) fn divided_size(&self, divisor: u32) -> [u32; 2] {
        self.full_size().map(|side| (side / divisor).max(1))
    }

    pub(super) fn camera(&self, scene: &Scene) -> Result<Camera> {
        self.camera_of(scene, &self.eye)
    }

    fn camera_of(&self, scene: &Scene, eye: &Eye) -> Result<Camera> {
        let [width, height] = self.full_size();
        self.source.camera(scene, eye, width as f32 / height as f32)
    }

    /// Checks that the scene has the camera of `eye`, whatever its lens.
    pub(super) fn check_camera(&self, eye: &Eye) -> Result<()> {
        let Some(Loaded { scene, .. }) = &self.scene else { return Ok(()) };
        self.camera_of(scene, &Eye { f_number: None, ..eye.clone() }).map(|_| ())
    }

    /// Ends depth of field if the camera is orthographic. Such a camera has no iris, and the panel no f-number for it.
    pub(super) fn close_missing_iris(&mut self) -> Result<()> {
        let Some(Loaded { scene, .. }) = &self.scene else { return Ok(()) };
        let closed = Eye { f_number: None, ..self.eye.clone() };
        if let Projection::Orthographic { .. } = self.camera_of(scene, &closed)?.projection {
            self.eye = closed;
        }
        Ok(())
    }

    pub(super) fn is_moving(&self) -> bool {
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

    /// Reads the scene if another one is requested. If it cannot be read, the last one stays.
    pub(super) fn load(&mut self) -> Result<()> {
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
        let scene = self.source.load(&origin.file, &origin.pose, &mut self.tried_files)?;
        // The view of a file that is read again stays.
        if is_another {
            (self.eye, self.choices.pose) = (self.source.eye(), origin.pose.clone());
        }
        self.picked = None;
        self.scene = Some(Loaded { scene: Arc::new(scene), origin });
        self.message = None;
        if is_another && self.check_camera(&self.eye).is_err() {
            self.eye.viewpoint = Viewpoint::Default;
        }
        self.close_missing_iris()
    }
}
