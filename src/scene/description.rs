//! The scene: the result of import and the input of the renderer.

use std::sync::Arc;

use glam::Vec3;

use super::camera::Camera;
use super::instance::{Instance, SharedMesh};
use super::light::{Light, LightKind};
use super::material::Material;
use super::normalisation::Normalisation;
use super::texture::{Texture, TextureImage};
use super::triangle::{Triangle, Vertex};
use crate::procedural::{Functions, Procedural};

/// A scene ready to render.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Vertices. Triangles of the same mesh primitive share them, and so do copies of the scene.
    pub vertices: Arc<Vec<Vertex>>,
    /// Triangles, all of nonzero area. Triangles of shared meshes come last.
    pub triangles: Vec<Triangle>,
    /// Meshes that are stored once and placed by instances.
    pub shared_meshes: Vec<SharedMesh>,
    /// The copies of the shared meshes.
    pub instances: Vec<Instance>,
    /// Materials. There is at least one if there is a triangle.
    pub materials: Vec<Material>,
    /// Textures: an image, a sampler and a colour space.
    pub textures: Vec<Texture>,
    /// Decoded images, which copies of the scene share.
    pub images: Arc<Vec<TextureImage>>,
    /// Procedural objects, at most [`crate::procedural::MAX_OBJECTS`].
    pub procedurals: Vec<Procedural>,
    /// The functions of the procedural objects.
    pub functions: Functions,
    /// Emissive meshes and punctual lights in the order of the file's nodes, followed by the environment if there is
    /// one.
    pub lights: Vec<Light>,
    /// Cameras in the order of the file's nodes.
    pub cameras: Vec<Camera>,
    /// The map between the file's world space and normalised space.
    pub normalisation: Normalisation,
    /// Remarks on the file, one line each and without repetition: content that is not rendered, unknown extensions,
    /// degenerate triangles that were dropped.
    pub notes: Vec<String>,
    /// Names of the file's variants of materials.
    pub variants: Vec<String>,
    /// Time of the last key of the animation that is or would be played, in seconds; `None` without animations.
    pub animation_end: Option<f64>,
    /// The files that it refers to, besides its own: those that it was read from, and missing ones.
    pub files: Vec<std::path::PathBuf>,
}

impl Scene {
    /// Whether the triangle is flat: it has no shading normals, or they equal its geometric normal.
    pub fn is_flat(&self, triangle: &Triangle) -> bool {
        let corners = triangle.vertices.map(|v| &self.vertices[v as usize]);
        let [a, b, c] = corners.map(|v| v.position);
        let flat = (b - a).cross(c - a).normalize_or_zero();
        // The tolerance of 1e-4 covers the rounding of the normals that files store for flat faces.
        corners.iter().any(|v| v.normal == Vec3::ZERO) || corners.iter().all(|v| v.normal.dot(flat) >= 1.0 - 1e-4)
    }

    /// Multiplies the power of every light by `factor`, which must be at least 0. Directly visible lights change too.
    pub fn scale_lights(&mut self, factor: f32) {
        self.materials.iter_mut().for_each(|material| material.emissive *= factor);
        for light in &mut self.lights {
            match &mut light.kind {
                LightKind::Mesh { emitters, .. } => emitters.iter_mut().for_each(|emitter| emitter.radiance *= factor),
                LightKind::Point { intensity, .. } | LightKind::Spot { intensity, .. } => *intensity *= factor,
                LightKind::Directional { irradiance, .. } => *irradiance *= factor,
                LightKind::Environment { strength, .. } => *strength *= factor,
            }
        }
    }

    /// Reorders the triangles: the new triangle `i` is the old triangle `order[i]`. Updates the indices of the lights.
    /// The triangles of a shared mesh must stay together.
    pub fn reorder_triangles(&mut self, order: &[u32]) {
        let mut new_index = vec![0u32; order.len()];
        for (new, old) in order.iter().enumerate() {
            new_index[*old as usize] = new as u32;
        }
        self.triangles = order.iter().map(|old| self.triangles[*old as usize]).collect();
        for light in &mut self.lights {
            if let LightKind::Mesh { emitters, .. } = &mut light.kind {
                for emitter in emitters {
                    emitter.triangle = new_index[emitter.triangle as usize];
                }
            }
        }
    }

    /// The positions of the corners of triangle `index`; of a shared mesh in its own space.
    pub fn triangle_positions(&self, index: usize) -> [Vec3; 3] {
        self.triangles[index].vertices.map(|vertex| self.vertices[vertex as usize].position)
    }

    /// Whether the scene has no surface that a ray could hit.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty() && self.procedurals.is_empty()
    }

    /// Lower and upper corner of the bounding box of all triangles and procedural objects. `None` for an empty scene.
    pub fn bounds(&self) -> Option<[Vec3; 2]> {
        let corners = self.corners().map(|p| [p, p]);
        corners.reduce(|[lower, upper], [p, _]| [lower.min(p), upper.max(p)])
    }

    /// The corners of all triangles, and of the boxes of all procedural objects.
    pub(super) fn corners(&self) -> impl Iterator<Item = Vec3> {
        let unshared = (0..self.unshared_triangles()).flat_map(|index| self.triangle_positions(index));
        unshared.chain(self.corners_of_others())
    }

    /// The corners of surfaces that are stored otherwise: of instances, and of the boxes of all procedural objects.
    pub(super) fn corners_of_others(&self) -> impl Iterator<Item = Vec3> {
        self.instance_vertices().chain(self.procedurals.iter().flat_map(Procedural::corners))
    }
}
