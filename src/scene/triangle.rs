//! Triangles and their corners.

use glam::{Vec2, Vec3, Vec4};

/// A vertex: a corner of one or more triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vertex {
    /// Position.
    pub position: Vec3,
    /// Unit shading normal. Zero if the file has none; the triangle is then flat.
    pub normal: Vec3,
    /// Unit tangent and its handedness (w = 1 or -1). Zero if the file has none.
    pub tangent: Vec4,
    /// Texture coordinate sets 0 and 1 as in the file (v down). Zero if absent.
    pub uv: [Vec2; 2],
    /// Linear RGBA factor on the base colour. One if absent.
    pub colour: Vec4,
}

/// A triangle. Its corners are counter-clockwise as seen from the front, even if the node's matrix mirrors it: import
/// flips the winding if the determinant is negative.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Indices into [`Scene::vertices`](super::Scene::vertices).
    pub vertices: [u32; 3],
    /// Index into [`Scene::materials`](super::Scene::materials).
    pub material: u32,
    /// Index into [`Scene::lights`](super::Scene::lights) of the light that this triangle belongs to, or [`NO_LIGHT`].
    pub light: u32,
}

/// The value of [`Triangle::light`] for a triangle that emits no light.
pub const NO_LIGHT: u32 = u32::MAX;
