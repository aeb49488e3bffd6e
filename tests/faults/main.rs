//! Faults that a render reports or survives: invalid samples, lost devices, full disks, signals, and processes that
//! share a cache.

mod cache;
#[path = "../common/device.rs"]
mod common;
mod conditioning;
mod device;
#[cfg(unix)]
mod disk;
// Other test binaries use the remaining functions of these files.
#[allow(dead_code)]
#[path = "../common/meshes.rs"]
mod meshes;
#[allow(dead_code)]
#[path = "../common/procedurals.rs"]
mod procedurals;
#[allow(dead_code)]
#[path = "../cli/program.rs"]
mod program;
#[cfg(unix)]
mod signals;
