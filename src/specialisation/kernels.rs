//! Features of kernels that differ from the features of the render.

use crate::specialisation::features::{Feature, Features};

/// Pass `photons` for light zones: each photon stores its light, even without a visibility map.
pub(crate) fn photons_of_zones(features: &Features) -> Features {
    features.clone().with(Feature::LightTags, true)
}

/// Pass `grid` for maps other than the visibility map, and pass `zones`: photons are sorted by cell alone.
pub fn sorting_grid(features: &Features) -> Features {
    features.clone().with(Feature::VisibilityMap, false).with(Feature::LightTags, false)
}
