//! Images: files, tone mapping and metrics.

mod atomic;
mod chance;
mod exr;
mod metrics;
mod mixture;
mod png;
#[allow(dead_code)]
#[path = "../common/random.rs"]
mod random;
mod stratification;
mod tone_map;
