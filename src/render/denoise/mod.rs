//! Denoisers of rendered images.

pub mod statistical;
