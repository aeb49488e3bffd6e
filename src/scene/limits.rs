//! Limits on the size of a scene.

/// Most corners of triangles that a scene may have, instances counted each: indices to them, times
/// three, stay within u32.
pub(super) const MAX_CORNERS: usize = 3 << 25;

/// Most vertices that a scene may have, instances counted each: while they are placed each takes up to 270 bytes.
pub(super) const MAX_VERTICES: usize = 1 << 25;
