//! Limits on the size of a scene.

/// Maximum number of triangle corners in a scene. Each instance of a mesh counts. Three times an index to a corner must
/// fit in a u32.
pub(super) const MAX_CORNERS: usize = 3 << 25;

/// Maximum number of displacements by morph targets: of each vertex, target and instance. A face of a million vertices
/// has some fifty targets; these are read and added in seconds.
pub(super) const MAX_DISPLACEMENTS: usize = 1 << 28;

/// Maximum number of vertices in a scene. Each instance of a mesh counts. Import needs up to 270 bytes for each.
pub(super) const MAX_VERTICES: usize = 1 << 25;
