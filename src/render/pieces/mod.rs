//! Pieces: images of some of the samples, or of a part of the pixels, that are put together to an image with the same
//! bits whatever the cut.
//!
//! A sample of a piece depends on its number, its pixel, the scene and the settings alone: what samples otherwise leave
//! behind for later ones is left out (`ImageSettings::piece`). The order of additions is fixed by a binary tree over
//! the numbers of the samples, of which a piece holds the largest parts that it has: see `sums.rs`. A piece is an EXR
//! file that shows its own samples; further channels have the sums: see [`file`].

mod coverage;
mod file;
mod merge;
mod sums;

pub use coverage::MissingSamples;
pub use merge::Pieces;

pub(super) use file::Piece;
pub(super) use sums::PieceSums;
