//! The paper's box, on the tests' device.

use std::path::Path;

use penumbra::internal::report::reference::Goal;
use penumbra::internal::report::run::Subject;
use penumbra::internal::scene::ImportOptions;
use penumbra::{Camera, Scene, Settings};

use crate::device::gpu;

pub struct Box {
    pub scene: Scene,
    pub camera: Camera,
}

impl Box {
    pub fn load() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/box.glb");
        let scene = Scene::load(&file, &ImportOptions::default()).unwrap();
        Box { camera: scene.cameras[0].clone(), scene }
    }

    pub fn subject<'a>(&'a self, settings: &'a Settings) -> Subject<'a> {
        Subject { gpu: gpu(), scene: &self.scene, camera: &self.camera, settings, slowness: 1.0 }
    }
}

/// A goal without a time limit.
pub fn goal(standard_error: f64) -> Goal {
    Goal { standard_error, seconds: f64::INFINITY }
}

/// A temporary folder that is removed when dropped.
pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap()
}
