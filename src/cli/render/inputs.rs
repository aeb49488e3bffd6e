//! The inputs of a render: they are read while the device opens.

use std::panic::resume_unwind;
use std::thread;
use std::time::Instant;

use kernel_kit::Gpu;
use penumbra::internal::report::reference::Reference;
use penumbra::{Camera, Denoiser, Result, Scene, Settings};

use super::arguments::Arguments;
use crate::cli::options::{LoadedPanorama, read_reference};

/// What is rendered.
pub struct Subject {
    pub scene: Scene,
    pub camera: Camera,
    pub settings: Settings,
}

/// The inputs of a render, and the seconds that it took to load them.
pub struct Inputs {
    /// For a sequence, its first frame.
    pub subject: Subject,
    /// The panorama, which all frames of a sequence share.
    pub panorama: Option<LoadedPanorama>,
    pub reference: Option<Reference>,
    pub gpu: Gpu,
    pub import: f64,
    pub start: f64,
}

impl Inputs {
    /// Imports the scene while the device opens. The error of a bad file comes before that of the device.
    pub fn load(arguments: &Arguments, denoiser: &Denoiser) -> Result<Inputs> {
        let timed = |start: Instant| start.elapsed().as_secs_f64();
        thread::scope(|scope| {
            let device = scope.spawn(|| {
                let start = Instant::now();
                arguments.device.open().map(|gpu| (gpu, timed(start)))
            });
            let start = Instant::now();
            let panorama = arguments.scene.load_panorama()?;
            let (scene, camera) = load_scene(arguments, panorama.as_ref())?;
            let import = timed(start);
            arguments.check_names(&scene.files)?;
            let settings = settings(arguments, &camera, denoiser)?;
            let reference = arguments.reference.as_deref().map(|path| read_reference(path, &settings)).transpose()?;
            let (gpu, start) = device.join().unwrap_or_else(|panic| resume_unwind(panic))?;
            Ok(Inputs { subject: Subject { scene, camera, settings }, panorama, reference, gpu, import, start })
        })
    }
}

/// The scene within the panorama, and its camera. For a sequence, those of the first frame.
fn load_scene(arguments: &Arguments, panorama: Option<&LoadedPanorama>) -> Result<(Scene, Camera)> {
    let time = arguments.sequence.first().and_then(|frame| frame.seconds);
    let (scene, camera) = arguments.scene.load_first(time, panorama, arguments.settings.aspect())?;
    let first = turntable(arguments, &scene)?.and_then(|views| views.into_iter().next());
    Ok((scene, first.unwrap_or(camera)))
}

/// The cameras of a turntable, if that is what is rendered.
pub fn turntable(arguments: &Arguments, scene: &Scene) -> Result<Option<Vec<Camera>>> {
    let cameras = |views| arguments.scene.turntable(scene, arguments.settings.aspect(), views);
    arguments.sequence.views().map(cameras).transpose()
}

/// The settings of the render through this camera.
fn settings(arguments: &Arguments, camera: &Camera, denoiser: &Denoiser) -> Result<Settings> {
    let has_time = arguments.time.is_some();
    let mut settings = arguments.settings.settings_to_end(camera, &arguments.extent, has_time)?;
    // A piece keeps what the denoisers of the merged image need.
    let is_piece = arguments.extent.is_piece();
    settings.image.denoise = if is_piece { arguments.denoise.unwrap_or_default() } else { denoiser.choice() };
    Ok(settings)
}
