//! Triangles and their corners.

use glam::{Vec2, Vec3, Vec4};

/// A corner of a triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vertex {
    /// Position.
    pub position: Vec3,
    /// Unit shading normal; zero where the file has none (the triangle is flat).
    pub normal: Vec3,
    /// Unit tangent and its handedness (w = 1 or -1); zero where the file has none.
    pub tangent: Vec4,
    /// Texture coordinates 0 and 1, as in the file (v down); zero where absent.
    pub uv: [Vec2; 2],
    /// Linear RGBA that multiplies the base colour; one where absent.
    pub colour: Vec4,
}

/// Three corners and what they are made of. Counter-clockwise seen from the front, also where the
/// node's matrix mirrors (import flips the winding once, by the determinant's sign).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Indices into [`Scene::vertices`].
    pub vertices: [u32; 3],
    /// Index into [`Scene::materials`].
    pub material: u32,
    /// Index into [`Scene::lights`] of the light this triangle is a part of, or [`NO_LIGHT`].
    pub light: u32,
}

/// [`Triangle::light`] of a triangle that emits nothing.
pub const NO_LIGHT: u32 = u32::MAX;
