//! Images: files, tone mapping and metrics.

mod atomic;
mod chance;
mod exr;
mod metrics;
mod mixture;
mod png;
mod random;
mod stratification;
mod tone_map;
