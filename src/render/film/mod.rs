//! Images: named channels of scene-linear f32, written to EXR and tone-mapped to PNG.
//!
//! The colour of an image is its root channels `R`, `G` and `B` (Rec.709 primaries, scene-linear), with `A` where it
//! has alpha (colour is then premultiplied, as OpenEXR has it). Everything else is a channel of its own name. An EXR
//! keeps all of it, bit for bit; a PNG is one [`View`] of the colour. Files are replaced whole or not at all.

mod atomic;
mod camera;
mod exr;
mod formats;
mod image;
mod panorama;
mod png;
mod tone_map;

pub use atomic::{abandon_writes, check_target, write_atomically};
pub use formats::check_writable;
pub(crate) use formats::read_file;
pub use image::{Channel, Image, Metadata};
pub use tone_map::View;
