//! Images: named channels of scene-linear f32, written to EXR, or tone-mapped to PNG.
//!
//! The colour of an image is in its root channels `R`, `G` and `B` (Rec.709 primaries, scene-linear). If there is an
//! alpha channel `A`, the colour is premultiplied, as in OpenEXR. All other data has channels of other names. An EXR
//! stores all channels without loss; a PNG stores one [`View`] of the colour. Files are replaced whole or not at all.

mod atomic;
mod camera;
mod exr;
mod fingerprint;
mod formats;
mod image;
mod names;
mod panorama;
mod png;
mod tone_map;

pub use atomic::{abandon_writes, check_target, write_atomically};
pub(super) use exr::{MAX_NAME_BYTES, decode_metadata};
pub use fingerprint::fingerprint;
pub(crate) use formats::read_file;
pub use formats::{check_writable, is_exr};
pub use image::{Channel, Image, Metadata, Window};
pub use names::{check_names, is_same_file};
pub use png::{encode_colours, write_colours};
pub use tone_map::View;
