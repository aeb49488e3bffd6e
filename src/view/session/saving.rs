//! Files that a session writes: the picture, and a copy of the scene with the camera.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::picture::Viewpoint;
use super::state::{Loaded, State};
use crate::render::film::{check_names, check_writable, is_exr, is_same_file, write_atomically, write_colours};
use crate::scene::{AddedCamera, with_camera};
use crate::view::overlay::Overlay;
use crate::{Error, Result};

impl State {
    /// Writes the picture.
    pub(super) fn save(&self, path: &Path) -> Result<String> {
        let Some(image) = &self.image else { return Ok("there is no picture yet".to_owned()) };
        self.check_kept(path, None)?;
        let display = self.choices.display;
        // An .exr has all channels, a .png what is shown.
        if !is_exr(path) && display.overlay != Overlay::Picture {
            check_writable(path)?;
            write_colours(path, self.size, &self.pixels)?;
        } else {
            let denoised = display.denoised_of(image).filter(|_| !is_exr(path));
            denoised.as_ref().unwrap_or(image).write(path, display.view, display.exposure)?;
        }
        Ok(format!("wrote {}", path.display()))
    }

    /// Checks that `path` is none of the files that the picture is made from, but for one that may be `replaced`.
    fn check_kept(&self, path: &Path, replaced: Option<&Path>) -> Result<()> {
        let is_kept = |file: &PathBuf| !replaced.is_some_and(|replaced| is_same_file(file, replaced));
        check_names(self.files().into_iter().filter(is_kept), [path])
    }

    /// Writes a copy of the scene's file that has the camera.
    pub(super) fn save_camera(&self, file: &Path, name: &str, replaces: bool) -> Result<String> {
        let Some(Loaded { scene, .. }) = &self.scene else { return Ok("there is no scene yet".to_owned()) };
        let shown = file.display();
        if file.exists() && !replaces {
            let is_open = if is_same_file(file, self.shown_file()) { "is the open file" } else { "exists" };
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
        Ok(format!("wrote {shown} with the camera \"{name}\""))
    }
}
