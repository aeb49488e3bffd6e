//! Sessions for tests.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use kernel_kit::Gpu;
use penumbra::internal::render::film::View;
use penumbra::internal::scene::load_and_list;
use penumbra::internal::view::{
    Choices, Command, Eye, Overlay, Picture, Pose, Session, Shown, Snapshot, Source, State, Viewpoint,
};
use penumbra::{Camera, Denoiser, Error, Focus, ImportOptions, Iris, Result, Scene, Settings};

pub const BOX: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/box.glb");
pub const SPHERE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/sphere.glb");

/// A folder that is removed when it is dropped.
pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap()
}

/// Scenes from files, without options, and the other files that a command names.
pub struct Files(pub Vec<PathBuf>);

impl Source for Files {
    fn load(&self, file: &Path, pose: &Pose, files: &mut Vec<PathBuf>) -> Result<Scene> {
        let (time, variant) = (pose.time, pose.variant.clone());
        load_and_list(file, &ImportOptions { time, variant, ..ImportOptions::default() }, files)
    }

    fn camera(&self, scene: &Scene, eye: &Eye, _: f32) -> Result<Camera> {
        let mut camera = match &eye.viewpoint {
            Viewpoint::Given | Viewpoint::Default => scene.cameras[0].clone(),
            Viewpoint::File(index) => scene.cameras[*index].clone(),
            Viewpoint::Placed(view) => scene.look_at(view).unwrap(),
        };
        if let Some(f_number) = eye.f_number {
            scene.open_iris(&mut camera, Iris { f_number, blades: 0 }, Focus::Auto).map_err(Error::Usage)?;
        }
        Ok(camera)
    }

    fn denoiser(&self) -> (Denoiser, Option<String>) {
        (Denoiser::default(), None)
    }

    fn command(&self, _: &Picture, _: &[String]) -> String {
        String::new()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.0.clone()
    }

    fn has_panorama(&self) -> bool {
        false
    }
}

/// A small picture with few samples.
pub fn settings() -> Settings {
    Settings::builder().size(48, 36).spp(4).build().unwrap()
}

pub fn choices(settings: Settings) -> Choices {
    let display = Shown { overlay: Overlay::Picture, light: 0, view: View::Neutral, exposure: 0.0, denoised: false };
    Choices { settings, pose: Pose::default(), display }
}

pub fn state(file: &Path, settings: Settings) -> State {
    state_with(file, settings, Vec::new())
}

/// With further files that the command names.
pub fn state_with(file: &Path, settings: Settings, others: Vec<PathBuf>) -> State {
    let files = Files(others);
    let scene = files.load(file, &Pose::default(), &mut Vec::new()).unwrap();
    State::new(Arc::new(files), file.to_owned(), scene, choices(settings))
}

pub fn session<'g>(gpu: &'g Gpu, file: &Path, settings: Settings) -> Session<'g> {
    Session::new(gpu, state(file, settings))
}

/// Executes the commands, and steps until nothing is left to do. Returns the last picture.
pub fn settle(session: &mut Session<'_>, commands: impl IntoIterator<Item = Command>) -> Snapshot {
    commands.into_iter().for_each(|command| session.command(command));
    loop {
        let (_, worked) = session.step().unwrap();
        match session.wait() {
            _ if worked => {}
            Some(wait) => std::thread::sleep(wait),
            None => return session.snapshot(),
        }
    }
}
