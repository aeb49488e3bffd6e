//! The device that tests run on.

use kernel_kit::Gpu;

/// The device of the tests: lavapipe unless `PENUMBRA_DEVICE` names another. No device is a failure, not a skip.
///
/// It keeps its kernels, as the program, the window and the Python package have it do: most tests need the same few.
pub fn gpu() -> &'static Gpu {
    let gpu = kernel_kit::test::device("PENUMBRA_DEVICE");
    gpu.keep_kernels();
    gpu
}
