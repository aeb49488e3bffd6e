//! The user's cache folder: references of reports, kernels that were composed, and times of first samples.

use std::path::PathBuf;

use kernel_kit::Gpu;

/// The folder for files that later commands use again; `None` if the user has no cache folder.
pub fn folder() -> Option<PathBuf> {
    dirs::cache_dir().map(|folder| folder.join("penumbra"))
}

/// The folder of composed kernels.
pub fn kernels() -> Option<PathBuf> {
    folder().map(|folder| folder.join("kernels"))
}

/// The device, which takes kernels from [`kernels`] and keeps them there.
pub fn with_kernels(gpu: Gpu) -> Gpu {
    if let Some(folder) = kernels() {
        gpu.keep_composed(folder);
    }
    gpu
}
