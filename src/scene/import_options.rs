//! Options of import.

/// Options of [`Scene::load`](super::Scene::load).
///
/// ```
/// use penumbra::{ImportOptions, Scene};
///
/// // The second animation of the file, half a second after its beginning, from the beginning again after its end.
/// let options =
///     ImportOptions { animation: Some("1".into()), time: Some(0.5), repeat: true, ..ImportOptions::default() };
/// let still = Scene::load("scenes/box.glb", &options);
/// assert!(still.is_err(), "this file has no animation");
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportOptions {
    /// Add a soft area light above and in front of the scene (+Z) if the file has no light.
    pub default_light: bool,
    /// Skip primitives with NaN or infinite numbers, and textures whose image is missing or damaged, and read textures
    /// at 0, 0 where a primitive lacks coordinates, instead of refusing the file. Each leaves a note. A surface without
    /// its emissive texture does not emit.
    pub lenient: bool,
    /// The animation that [`time`](Self::time) is of, by name or index. `None`: the first one of the file.
    pub animation: Option<String>,
    /// Seconds from the beginning of the animation. Before its first key and after its last one it stands still.
    /// `None`: the pose of the file's nodes, which no animation has changed.
    pub time: Option<f64>,
    /// The animation begins again after its last key.
    pub repeat: bool,
    /// Name of the variant of materials (KHR_materials_variants) to render. `None`: the materials without a variant.
    pub variant: Option<String>,
    /// Number of triangles up to which each copy of a mesh has its own. If all copies have more in total, meshes that
    /// are repeated are stored once. `None`: about four million.
    pub max_copied_triangles: Option<usize>,
}
