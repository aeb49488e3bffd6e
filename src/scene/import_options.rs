//! Options of import.

/// Options of [`Scene::load`](super::Scene::load).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// Add a soft area light above the scene if the file has no light.
    pub default_light: bool,
    /// Skip primitives with NaN or infinite numbers instead of refusing the file.
    pub lenient: bool,
}
