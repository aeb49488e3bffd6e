//! The device that tests run on.

use kernel_kit::Gpu;

/// The device of the tests: lavapipe unless `PENUMBRA_DEVICE` names another. No device is a failure, not a skip.
pub fn gpu() -> &'static Gpu {
    kernel_kit::test::device("PENUMBRA_DEVICE")
}
