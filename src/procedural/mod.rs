//! Procedural objects: surfaces described by WGSL functions that come with the scene.
//!
//! `docs/procedurals.md` describes the file format and the functions. [`Builder`] composes the functions of a scene
//! into the module `package::lib::procedural_functions`, which `shaders/lib/procedural.wgsl` calls.

mod check;
mod functions;
mod limits;
mod object;
mod role;

pub use functions::{Builder, Functions};
pub use limits::MAX_OBJECTS;
pub(crate) use limits::{INDEX_MASK, ITERATIONS, PROCEDURAL, RAY_ITERATIONS};
pub use object::Procedural;
pub(crate) use object::{COLOUR_PARAMETERS, HIGH, LOW, PARAMETERS, TEXELS, TO_OBJECT, TRAITS, box_corners, to_own};
pub use role::Role;
