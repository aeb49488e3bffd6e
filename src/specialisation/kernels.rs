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

/// Whether pass `classify` must count n_i and n_s exactly at boundaries, because the image shows them. Otherwise the
/// photons' visibility is only a control variate, for which any estimate will do.
pub(crate) fn has_exact_counts(features: &Features) -> bool {
    features.has(Feature::AovShadow) || features.has(Feature::VisibilityEstimate)
}
