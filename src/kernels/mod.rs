//! The kernels: how they are composed, and what they share with the host in addition to the layouts of structs.
//!
//! `package::lib::constants`, which the kernels import, is generated from these numbers: none is written in both
//! languages.

mod compose;
mod constants;
mod each;
pub mod grid_shape;
pub(crate) mod light_texels;
mod numbers;
pub(crate) mod scene_texels;

pub use compose::{compose, compose_for, compose_source, features_of, kernel_stems};
pub use constants::constant;
pub use each::expand_each;
pub use grid_shape::GridShape;
pub use numbers::*;
