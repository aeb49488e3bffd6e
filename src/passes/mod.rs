//! The passes of a frame: one host file each, one kernel of the same stem in `shaders/`.

pub mod classify;
pub mod grid;
