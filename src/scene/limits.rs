//! Limits on the size of a scene.

/// Maximum number of triangle corners in a scene. Each instance of a mesh counts. Three times an index to a corner must
/// fit in a u32.
pub(super) const MAX_CORNERS: usize = 3 << 25;

/// Maximum number of vertices in a scene. Each instance of a mesh counts. Import needs up to 270 bytes for each.
pub(super) const MAX_VERTICES: usize = 1 << 25;
