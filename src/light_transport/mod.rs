//! The two-pass method of the paper, in parts that techniques share. [`first_pass`] and [`second_pass`] have the steps,
//! and are the place to begin.
//!
//! - Photons that tell light from shadow: [`visibility_map`], and [`fine_cells`], which are not in the paper.
//! - Direct light by the classes of points: [`direct_light`], and [`audits`], which keep it unbiased.
//! - Many lights: [`light_sampler`] (the paper's zones).
//! - Indirect light: [`global_map`], [`irradiance_cache`] and [`caustic_map`], put together in [`indirect_light`].
//! - Earlier methods, for comparison: [`cell_visibility`] and [`adaptive_testing`].

pub(crate) mod adaptive_testing;
pub(crate) mod audits;
pub(crate) mod caustic_map;
pub(crate) mod cell_visibility;
pub(crate) mod direct_light;
pub(crate) mod fine_cells;
pub(crate) mod first_pass;
pub(crate) mod global_map;
pub(crate) mod indirect_light;
pub(crate) mod irradiance_cache;
mod irradiance_filter;
pub(crate) mod kernels;
pub(crate) mod light_sampler;
pub(crate) mod lighting;
mod noisy_records;
mod record_limits;
mod record_tree;
pub(crate) mod second_pass;
pub(crate) mod shared;
pub(crate) mod visibility_map;
