//! The commands to a session, and what each does.

use std::path::PathBuf;
use std::time::Instant;

use glam::DVec3;

use super::movement::{NEARER, framed};
use super::picture::{Choices, Eye, Viewpoint};
use super::state::State;
use crate::Result;
use crate::scene::Extent;
use crate::settings::Settings;
use crate::view::navigation;

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
    /// Set the f-number; `None` to have no lens.
    Aperture(Option<f64>),
    /// See the whole scene from this side.
    FrameAll,
    /// Move nearer to what is at a point of the image, from 0 to 1 each way, and look at it.
    FrameAt([f32; 2]),
    /// See through another camera.
    Camera(Viewpoint),
    /// Set all choices but the size of the picture.
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

impl State {
    /// Executes a command.
    pub(super) fn apply(&mut self, command: Command) -> Result<()> {
        match command {
            Command::Orbit(by) => self.navigate(|_, view| Some(navigation::orbit(view, by)))?,
            Command::Pan(by) => self.navigate(|_, view| Some(navigation::pan(view, by)))?,
            Command::Dolly(by) => self.navigate(|_, view| Some(navigation::dolly(view, by)))?,
            Command::Fly(movement) => self.navigate(|scene, view| {
                Some(navigation::fly(view, DVec3::from(movement) / scene.normalisation.scale()))
            })?,
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
            Command::Camera(viewpoint) => {
                let eye = Eye { viewpoint, fov: None, f_number: self.eye.f_number };
                self.check_camera(&eye)?;
                self.eye = eye;
                self.close_missing_iris()?;
            }
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
}
