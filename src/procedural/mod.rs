//! Procedural objects: surfaces that WGSL functions beside the scene describe, composed into the kernels that trace.
//!
//! `docs/procedurals.md` says how a file asks for them and what its functions are to give. [`Builder`] takes the files, and
//! makes of the functions that a scene names the module `package::lib::procedural_functions`, which `shaders/lib/procedural.wgsl`
//! calls.

mod check;
mod functions;
mod limits;
mod object;
mod role;

pub use functions::{Builder, Functions};
pub use limits::MAX_OBJECTS;
pub(crate) use limits::{PROCEDURAL, RAY_TURNS, TURNS};
pub use object::Procedural;
pub(crate) use object::{RECORDS, box_corners, to_own};
pub use role::Role;
