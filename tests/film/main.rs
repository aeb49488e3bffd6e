//! Images: files, tone mapping and metrics.

mod atomic;
mod exr;
mod metrics;
mod png;
mod tone_map;
