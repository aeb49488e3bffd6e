//! Options that several commands share. The defaults are those of [`Settings`].

mod scene;
mod settings;
mod values;

use std::env;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use kernel_kit::{DeviceChoice, DeviceLimits, Gpu};
use penumbra::internal::render::film::Window;
use penumbra::internal::report::reference::Reference;
use penumbra::settings::Denoise;
use penumbra::{Denoiser, Error, Image, Result, Settings};

use super::cache;

#[cfg(feature = "view")]
pub use scene::camera_word;
pub use scene::{LoadedPanorama, SceneOptions};
pub use settings::{ExtentOptions, RenderOptions, SettingsOptions};
pub use values::{EntrantParser, denoisers, finite, positive};

#[derive(Args)]
pub struct DeviceOptions {
    /// Device: best, software, or the index or a part of the name that `penumbra devices` prints
    #[arg(long, value_name = "D", default_value = "best", help_heading = "Device")]
    device: DeviceChoice,

    /// For tests: which of the device's limits are used. `own`: its own; `least`: the minimum of desktop devices;
    /// `gpu`: its own, with a software device used like a GPU
    #[arg(long, value_name = "L", default_value = "own", value_parser = device_limits(), hide = true)]
    device_limits: DeviceLimits,
}

/// `own`, `least` or `gpu`.
fn device_limits() -> impl TypedValueParser<Value = DeviceLimits> {
    PossibleValuesParser::new(["own", "least", "gpu"]).try_map(|name| name.parse())
}

impl DeviceOptions {
    /// The device, and the limits under which it is used.
    #[cfg(feature = "view")]
    pub fn choice(&self) -> (DeviceChoice, DeviceLimits) {
        (self.device.clone(), self.device_limits)
    }

    /// As [`Gpu::open_with`], with the user's folder of kernels.
    pub fn open(&self) -> Result<Gpu> {
        Ok(cache::with_kernels(Gpu::open_with(&self.device, self.device_limits)?))
    }
}

#[derive(Args, Clone)]
pub struct OidnOptions {
    /// The library of Open Image Denoise 2 [default: the environment variable OIDN_LIBRARY, else
    /// libOpenImageDenoise.so.2 where the system finds it]
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    oidn: Option<PathBuf>,
}

impl OidnOptions {
    /// Refuses a library that `choice` would not use.
    pub fn check(&self, choice: Denoise) -> Result<()> {
        match &self.oidn {
            Some(library) if !choice.uses_oidn() => {
                let problem = "is used only with --denoise auto or --denoise oidn";
                Err(Error::Usage(format!("--oidn {} {problem}", library.display())))
            }
            _ => Ok(()),
        }
    }

    /// As [`Denoiser::new`].
    pub fn denoiser(&self, choice: Denoise) -> Result<Denoiser> {
        let variable = || env::var_os("OIDN_LIBRARY").filter(|name| !name.is_empty()).map(PathBuf::from);
        Denoiser::new(choice, self.oidn.clone().or_else(variable).as_deref())
    }
}

/// The reference image, which must have the size of the settings, and show the same part if it states one.
pub fn read_reference(path: &Path, settings: &Settings) -> Result<Reference> {
    let reference = Reference::read(path)?;
    let crop = settings.image.crop_window();
    let part =
        settings.image.crop.map(|_| Window { at: [crop.x, crop.y], of: [settings.image.width, settings.image.height] });
    let (Image { width, height, crop: shown, .. }, own) = (&reference.image, [crop.width, crop.height]);
    if [*width, *height] != own {
        let sizes = format!("its size is {width} x {height} pixels, not {} x {}", own[0], own[1]);
        let remedy = match part {
            None => "set --width and --height accordingly",
            Some(_) => "a part of an image needs a reference of that part",
        };
        return Err(Error::input(path, "file", format!("{sizes}; {remedy}")));
    }
    if shown.zip(part).is_some_and(|(shown, part)| shown != part) {
        return Err(Error::input(path, "file", "it shows another part of the image than --crop"));
    }
    Ok(reference)
}
