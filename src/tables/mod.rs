//! The scene's tables on the device, as the modules of `shaders/lib/` read them.

pub mod lights;
pub mod sobol;

pub use lights::LightTables;
