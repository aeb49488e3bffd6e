//! The window of `penumbra view`: sessions without a window, the panel without a display, and real windows under Xvfb.

#[allow(dead_code)]
#[path = "../scene/builder.rs"]
mod builder;
#[path = "../common/device.rs"]
mod device;

mod panel;
mod sessions;
mod setup;
#[cfg(target_os = "linux")]
mod windows;
#[cfg(target_os = "linux")]
mod xvfb;
