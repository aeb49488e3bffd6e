//! What techniques share: direct light, the visibility map and its rivals, the global map, the caustic map, the irradiance
//! cache, the light sampler.

pub(crate) mod caustic_map;
mod cell_visibility;
pub(crate) mod direct_light;
mod earlier;
pub(crate) mod global_map;
pub(crate) mod irradiance_cache;
mod light_sampler;
pub(crate) mod visibility_map;

/// Most samples of a pixel in one tile, so that audits mend the map early and a render can stop soon.
pub(crate) const TILE_SAMPLES: u32 = 8;
