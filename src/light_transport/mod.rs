//! The parts that techniques share: light sampler, visibility map, cells, adaptive shadow testing, direct light, global
//! map, irradiance cache and caustic map; and the steps of the first and the second pass.

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
mod record_grid;
mod record_limits;
pub(crate) mod second_pass;
pub(crate) mod shared;
pub(crate) mod visibility_map;
