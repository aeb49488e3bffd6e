//! The device that tests run on.

use std::io::Write as _;
use std::sync::OnceLock;

use crate::adapter::{DeviceChoice, DeviceLimits};
use crate::device::Gpu;

/// The environment variable that names the tests' device, where a crate has none of its own.
pub const VARIABLE: &str = "KERNEL_KIT_DEVICE";

/// The device of this test program. The environment variable chooses it (its text is parsed to a [`DeviceChoice`]); a
/// software device if it is not set. The variable with the suffix `_LIMITS` sets its [`DeviceLimits`]; the device's own
/// if it is not set. The device is opened once, by the first call, whose variable counts, and its name is then written
/// to standard error.
///
/// # Panics
/// If there is no such device: tests that have none have failed, and are not skipped.
pub fn device(variable: &str) -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| {
        let choice = std::env::var(variable).unwrap_or_else(|_| "software".to_owned());
        let choice = choice.parse().unwrap_or(DeviceChoice::Software);
        let limits = std::env::var(format!("{variable}_LIMITS")).map_or(Ok(DeviceLimits::Own), |limits| limits.parse());
        let gpu = limits.and_then(|limits| Gpu::open_with(&choice, limits));
        let gpu = gpu.unwrap_or_else(|e| panic!("{e}; the tests' device is chosen by {variable}"));
        let info = &gpu.info;
        // Not by `eprintln!`, whose output the test harness captures.
        let _ = writeln!(std::io::stderr(), "device: {} ({}, {})", info.name, info.kind, info.driver);
        gpu
    })
}
