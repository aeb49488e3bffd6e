//! The albedos of fibres on the device.

use kernel_kit::{Buffer, Gpu};

use crate::Result;
use crate::scene::sheen;

/// Uploads the uniform buffer `sheen_albedos`, which `shaders/lib/bsdf/sheen.wgsl` interpolates.
///
/// # Errors
/// As [`Gpu::upload`].
pub fn upload(gpu: &Gpu) -> Result<Buffer> {
    Ok(gpu.upload("penumbra/scene/sheen_albedos", &sheen::albedos())?)
}
