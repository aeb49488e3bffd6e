//! Pieces: images of some of the samples, or of a part of the pixels. Merged, they give an image with the same bits
//! however it was divided.
//!
//! A sample of a piece depends only on its number, its pixel, the scene and the settings. Everything that samples
//! otherwise pass on to later ones is left out (`ImageSettings::piece`). The order of additions is fixed by a binary
//! tree over the numbers of the samples; a piece holds the largest nodes of this tree that lie in its range: see
//! `sums.rs`. A piece is an EXR file that shows the image of its own samples; further channels hold the sums: see
//! `file.rs`.

mod coverage;
mod file;
mod merge;
pub(in crate::render) mod sums;

pub use coverage::MissingSamples;
pub use merge::Pieces;

pub(super) use file::Piece;
pub(super) use sums::PieceSums;
