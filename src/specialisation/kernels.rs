//! Features of single kernels that differ from those of the render.

use crate::gpu::Features;

/// Pass `photons` for light zones: each photon tells its light, even where no visibility map does.
pub(crate) fn photons_of_zones(features: &Features) -> Features {
    features.clone().with("light_tags", true)
}

/// Pass `grid` for the visibility map: it sorts photons and classifies cells.
pub(crate) fn grid_of_visibility_map(features: &Features) -> Features {
    features.clone().with("visibility_map", true)
}

/// Pass `grid` for every other map: it sorts photons by cell alone.
pub(crate) fn sorting_grid(features: &Features) -> Features {
    features.clone().with("visibility_map", false).with("light_tags", false)
}

/// Pass `zones`: its photons are sorted by zone, not by light.
pub(crate) fn zones(features: &Features) -> Features {
    features.clone().with("light_tags", false)
}

/// Whether pass `classify` must count n_i and n_s exactly at boundaries: where they are shown. Elsewhere the photons'
/// visibility is a control variate, for which any estimate will do.
pub(crate) fn has_exact_counts(features: &Features) -> bool {
    features.has("aov_shadow") || features.has("visibility_estimate")
}
