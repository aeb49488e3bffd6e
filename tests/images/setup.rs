//! Rendering scenes of the repository on the tests' device.

use std::path::{Path, PathBuf};

use penumbra::internal::scene::ImportOptions;
use penumbra::{Aov, Camera, Image, Renderer, Scene, Settings, Statistics, Technique};

pub use crate::device::gpu;

/// A file of `scenes/`.
pub fn scene_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)
}

/// A file of the folder `reference` in `PENUMBRA_SHARED`. Prints a line and returns `None` if that variable is not set.
pub fn reference_file(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("PENUMBRA_SHARED");
    if folder.is_none() {
        println!("left out: reference/{name}, as PENUMBRA_SHARED is not set");
    }
    Some(Path::new(&folder?).join("reference").join(name))
}

/// Renders all samples of the settings, with a default light if the file has none.
pub fn render(file: &Path, settings: &Settings) -> (Image, Statistics) {
    let scene = Scene::load(file, &ImportOptions { default_light: true, ..ImportOptions::default() }).unwrap();
    let camera = scene.cameras.first().cloned().unwrap_or_else(|| scene.frame_camera());
    render_scene(scene, &camera, settings)
}

/// As [`render`], for a scene in memory. Images so small would have no photons unless their number is requested.
pub fn render_scene(scene: Scene, camera: &Camera, settings: &Settings) -> (Image, Statistics) {
    let photons = settings.photons_per_light();
    let settings = settings.clone().with(|s| s.visibility_map.photons_per_light = Some(photons));
    let mut renderer = Renderer::new(gpu(), scene, camera, &settings).unwrap();
    while renderer.samples() < settings.image.spp {
        renderer.render_batch().unwrap();
    }
    (renderer.image().unwrap(), renderer.statistics().unwrap())
}

/// Settings of an image with the variance channels, for [`mean_and_error`].
pub fn settings(technique: Technique, [width, height]: [u32; 2], spp: u32, max_bounces: u32) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        (s.image.width, s.image.height, s.image.spp) = (width, height, spp);
        s.indirect.max_bounces = max_bounces;
        s.image.aovs = vec![Aov::Variance];
    })
}

/// Mean of a channel.
pub fn mean(image: &Image, channel: &str) -> f64 {
    let samples = image.channel(channel).unwrap();
    samples.iter().map(|v| f64::from(*v)).sum::<f64>() / samples.len() as f64
}

/// Mean of a channel, and the standard error of that mean from its variance channel (`variance.R` for `R`).
pub fn mean_and_error(image: &Image, channel: &str) -> (f64, f64) {
    let pixels = f64::from(image.width) * f64::from(image.height);
    (mean(image, channel), (mean(image, &format!("variance.{channel}")) / pixels).sqrt())
}

/// The mean of each colour is that of the reference, within a part `off` of it plus three standard errors.
#[track_caller]
pub fn assert_means(image: &Image, reference: &Image, off: f64, what: &str) {
    for channel in ["R", "G", "B"] {
        let (expected, (mean, error)) = (mean(reference, channel), mean_and_error(image, channel));
        let limit = off * expected + 3.0 * error;
        assert!((mean - expected).abs() < limit, "{what} {channel}: {mean} +- {error}, expected {expected}");
    }
}

/// The distance of two means in standard errors.
pub fn deviation((a, error_a): (f64, f64), (b, error_b): (f64, f64)) -> f64 {
    (a - b).abs() / error_a.hypot(error_b)
}

/// Both have the same channels, bits and metadata.
#[track_caller]
pub fn assert_same(a: &Image, b: &Image, what: &str) {
    assert_eq!(a.metadata, b.metadata, "{what}");
    let names = |image: &Image| image.channels.iter().map(|channel| channel.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(a), names(b), "{what}");
    for (a, b) in a.channels.iter().zip(&b.channels) {
        let different = a.samples.iter().zip(&b.samples).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
        assert_eq!(different, 0, "{what}: pixels of {}", a.name);
    }
}
