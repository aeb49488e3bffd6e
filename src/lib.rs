//! Penumbra renders glTF scenes with shadow photons (Jensen and Christensen 1995) in Vulkan compute kernels.
//!
//! A render takes four steps: read a [`Scene`], open a [`Device`], make a [`Renderer`] with [`Settings`], and render
//! batches of samples until the [`Image`] is good enough.
//!
//! ```
//! use penumbra::{Device, DeviceChoice, ImportOptions, Renderer, Scene, Settings};
//!
//! let scene = Scene::load("scenes/box.glb", &ImportOptions::default())?;
//! let camera = scene.cameras.first().cloned().unwrap_or_else(|| scene.frame_camera());
//! let settings = Settings::builder().size(16, 16).spp(2).photons_per_light(4096).max_bounces(0).build()?;
//! let device = Device::open(&DeviceChoice::Best)?;
//! let mut renderer = Renderer::new(&device, scene, &camera, &settings)?;
//! while renderer.samples() < settings.image.spp {
//!     renderer.render_batch()?;
//! }
//! let image = renderer.image()?;
//! assert!(image.channel("R").is_some_and(|red| red.iter().any(|value| *value > 0.0)));
//! # Ok::<(), penumbra::Error>(())
//! ```
//!
//! The library prints nothing, reads no environment variables and never exits. Its messages name settings by their
//! fields; see [`Error`]. `ARCHITECTURE.md` maps the steps of the paper to files.
//!
//! # Features
//!
//! All are on by default and can be left out with `default-features = false`.
//!
//! - `cli`: the program `penumbra`. It includes `report`.
//! - `oidn`: denoising by Open Image Denoise, which is loaded at run time where it is found.
//! - `report`: comparisons of techniques, error metrics, plots, and families of extreme scenes. It needs a C++
//!   compiler.
//! - `view`: the window of `penumbra view`.
#![warn(missing_docs)]

mod bvh;
mod count;
mod error;
mod fingerprint;
mod gpu_scene;
mod input;
mod kernels;
mod light_transport;
mod memory;
mod passes;
mod procedural;
mod random;
mod render;
#[cfg(feature = "report")]
mod report;
mod scene;
pub mod settings;
mod specialisation;
pub mod statistics;
#[cfg(feature = "report")]
mod stress;
mod techniques;
#[cfg(feature = "view")]
mod view;

pub use error::{Error, Result};
/// # Example
///
/// ```
/// use penumbra::DeviceChoice;
///
/// let choice: DeviceChoice = "software".parse().unwrap();
/// assert_eq!(choice, DeviceChoice::Software);
/// ```
pub use kernel_kit::DeviceChoice;
pub use kernel_kit::DeviceInfo;
/// # Example
///
/// ```no_run
/// use penumbra::{Device, DeviceChoice};
///
/// let device = Device::open(&DeviceChoice::Software)?;
/// println!("{}", device.info.name);
/// # Ok::<(), penumbra::Error>(())
/// ```
pub use kernel_kit::Gpu as Device;
pub use render::Checkpoint;
pub use render::Denoiser;
/// # Example
///
/// ```
/// let mut image = penumbra::Image::new(2, 1);
/// image.add_channel("R", vec![0.5, 1.0]);
/// assert_eq!(image.channel("R"), Some(&[0.5, 1.0][..]));
/// assert_eq!(image.channel("G"), None);
/// ```
pub use render::Image;
/// # Example
///
/// ```
/// # fn show(renderer: &mut penumbra::Renderer) -> penumbra::Result<()> {
/// let progress: penumbra::Progress = renderer.render_batch()?;
/// println!("{} samples per pixel, {} rays", progress.samples, progress.rays);
/// # Ok(())
/// # }
/// ```
pub use render::Progress;
/// # Example
///
/// ```
/// use penumbra::{Device, DeviceChoice, ImportOptions, Renderer, Scene, Settings, Technique};
///
/// let scene = Scene::load("scenes/box.glb", &ImportOptions::default())?;
/// let camera = scene.frame_camera();
/// let settings = Settings::builder().technique(Technique::PATH).size(8, 8).spp(1).build()?;
/// let device = Device::open(&DeviceChoice::Best)?;
/// let mut renderer = Renderer::new(&device, scene, &camera, &settings)?;
/// renderer.render_batch()?;
/// assert_eq!(renderer.samples(), 1);
/// assert_eq!(renderer.image()?.pixels(), 64);
/// assert!(renderer.statistics()?.rays.total > 0);
/// # Ok::<(), penumbra::Error>(())
/// ```
pub use render::Renderer;
pub use render::film::{Channel, Metadata, View, Window};
pub use render::pieces::{MissingSamples, Pieces};
/// # Example
///
/// ```
/// use penumbra::{Camera, ImportOptions, Scene};
///
/// let scene = Scene::load("scenes/box.glb", &ImportOptions::default())?;
/// let camera: Camera = scene.frame_camera();
/// assert!(camera.near < camera.far);
/// # Ok::<(), penumbra::Error>(())
/// ```
pub use scene::Camera;
/// # Example
///
/// ```
/// use penumbra::{Focus, Framing, ImportOptions, Iris, Scene};
///
/// let scene = Scene::load("scenes/box.glb", &ImportOptions::default())?;
/// let mut camera = scene.frame(&Framing { azimuth: 30.0, elevation: 20.0, aspect: 16.0 / 9.0, fov: 40.0 });
/// scene.open_iris(&mut camera, Iris { f_number: 2.8, blades: 0 }, Focus::Distance(1.5)).unwrap();
/// assert!(camera.lens.is_some());
/// # Ok::<(), penumbra::Error>(())
/// ```
pub use scene::Framing;
/// # Example
///
/// ```
/// use penumbra::{ImportOptions, Scene};
///
/// let scene = Scene::load("scenes/box.glb", &ImportOptions::default())?;
/// assert_eq!(scene.lights.len(), 1);
/// # Ok::<(), penumbra::Error>(())
/// ```
pub use scene::Scene;
pub use scene::{Focus, Iris, Lens};
pub use scene::{ImportOptions, Panorama};
/// # Example
///
/// ```
/// use penumbra::Aov;
///
/// let aov: Aov = "albedo".parse().unwrap();
/// assert_eq!(aov, Aov::Albedo);
/// ```
pub use settings::Aov;
pub use settings::Settings;
/// # Example
///
/// ```
/// use penumbra::Technique;
///
/// let technique: Technique = "two-pass".parse().unwrap();
/// assert_eq!(technique, Technique::TWO_PASS);
/// assert_eq!(Technique::default(), Technique::SHADOW_PHOTONS);
/// ```
pub use settings::Technique;
/// # Example
///
/// ```
/// # fn show(renderer: &penumbra::Renderer) -> penumbra::Result<()> {
/// let statistics: penumbra::Statistics = renderer.statistics()?;
/// println!("{:.1} % boundary points", 100.0 * statistics.points.boundary_share);
/// # Ok(())
/// # }
/// ```
pub use statistics::Statistics;

/// All modules, for Penumbra's own program, tests, benchmarks and fuzz targets. They may change with every version.
#[doc(hidden)]
pub mod internal {
    macro_rules! reexport {
        ($($(#[$attribute:meta])* $module:ident)*) => {
            $($(#[$attribute])* pub mod $module {
                pub use crate::$module::*;
            })*
        };
    }

    reexport! {
        bvh error fingerprint gpu_scene kernels memory passes procedural random render
        #[cfg(feature = "report")] report
        scene settings specialisation statistics
        #[cfg(feature = "report")] stress
        techniques
        #[cfg(feature = "view")] view
    }
}
