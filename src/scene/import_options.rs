//! Options of import.

/// Options of [`Scene::load`](super::Scene::load).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// Add a soft area light above the scene if the file has no light.
    pub default_light: bool,
    /// Skip primitives with NaN or infinite numbers, and textures whose image is missing or damaged, instead of
    /// refusing the file. Each leaves a note. A surface without its emissive texture does not emit.
    pub lenient: bool,
    /// Name of the variant of materials (KHR_materials_variants) to render. None: the materials of no variant.
    pub variant: Option<String>,
}
