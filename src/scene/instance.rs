//! Meshes that are stored once, and their copies, each with a transform of its own.

use std::ops::Range;

use glam::{DVec3, Mat3, Vec3};

use super::triangle::Vertex;

/// A mesh that is stored once: its parts of the scene's lists. It is in a space of its own, of unit size about the
/// origin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SharedMesh {
    /// Its triangles in [`Scene::triangles`](super::Scene::triangles).
    pub triangles: Range<usize>,
    /// Its vertices in [`Scene::vertices`](super::Scene::vertices).
    pub vertices: Range<usize>,
}

/// A copy of a shared mesh: the point p of the mesh is at `linear * p + origin`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// Index into [`Scene::shared_meshes`](super::Scene::shared_meshes).
    pub mesh: usize,
    /// Its determinant is positive. It stretches by at most `MAX_STRETCH`.
    pub linear: Mat3,
    /// Where the mesh's origin is.
    pub origin: Vec3,
}

/// Limit of the product of the Frobenius norms of a transform and of its inverse, over 3. The value is 1 if the
/// transform keeps angles, and 3 if one axis is stretched six times as far as the others.
///
/// The errors of rays in the mesh's space are proportional to this value. At 3, errors of points are below 1e-5 of
/// their distance from the ray's origin (`ray_in_mesh` in `shaders/lib/instance.wgsl`), and errors of normals are below
/// 3e-4 rad, six times the error of `oct_encode16`.
pub const MAX_STRETCH: f64 = 3.0;

impl Instance {
    /// The position of a point of its mesh.
    pub fn apply(&self, point: Vec3) -> Vec3 {
        self.linear * point + self.origin
    }

    /// [`apply`](Self::apply) in double precision.
    pub fn apply_f64(&self, point: Vec3) -> DVec3 {
        self.linear.as_dmat3() * point.as_dvec3() + self.origin.as_dvec3()
    }

    /// A vertex of its mesh in the scene.
    pub(super) fn apply_to_vertex(&self, vertex: &Vertex) -> Vertex {
        let normals = self.linear.as_dmat3().inverse().transpose();
        let normal = (normals * vertex.normal.as_dvec3()).normalize_or_zero().as_vec3();
        let tangent = (self.linear * vertex.tangent.truncate()).normalize_or_zero().extend(vertex.tangent.w);
        Vertex { position: self.apply(vertex.position), normal, tangent, ..*vertex }
    }
}
