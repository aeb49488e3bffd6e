//! What a render notices of itself, and what it survives: numbers that are none, devices that are lost, disks that are full,
//! signals, and processes that share a cache.

mod cache;
#[path = "../common/device.rs"]
mod common;
mod conditioning;
mod device;
#[cfg(unix)]
mod disk;
// Other tests use the rest of these.
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
