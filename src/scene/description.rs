//! The scene: what import makes of a file, and what the renderer starts from.

use glam::Vec3;

use super::camera::Camera;
use super::light::{Light, LightKind};
use super::material::Material;
use super::normalisation::Normalisation;
use super::texture::{Texture, TextureImage};
use super::triangle::{Triangle, Vertex};
use crate::procedural::{Functions, Procedural};

/// A scene ready to render.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Corners of the triangles. Shared between triangles of one mesh primitive.
    pub vertices: Vec<Vertex>,
    /// The triangles, none of zero area.
    pub triangles: Vec<Triangle>,
    /// At least one material when there is a triangle.
    pub materials: Vec<Material>,
    /// Image, sampler and colour space, as materials use them.
    pub textures: Vec<Texture>,
    /// Decoded images.
    pub images: Vec<TextureImage>,
    /// Objects that functions describe, no more than [`crate::procedural::MAX_OBJECTS`].
    pub procedurals: Vec<Procedural>,
    /// Their functions.
    pub functions: Functions,
    /// Lights in the order of the file's nodes, emissive meshes and punctual lights alike; last the environment, where there
    /// is one.
    pub lights: Vec<Light>,
    /// Cameras in the order of the file's nodes; empty if the file has none.
    pub cameras: Vec<Camera>,
    /// How normalised space lies in the file's world space.
    pub normalisation: Normalisation,
    /// One line each: what the file has and the image will not show, extensions that are not
    /// known, degenerate triangles that were dropped. Each said once.
    pub notes: Vec<String>,
}

impl Scene {
    /// The triangle has no shading normals, or they are its own.
    pub fn is_flat(&self, triangle: &Triangle) -> bool {
        let corners = triangle.vertices.map(|v| &self.vertices[v as usize]);
        let [a, b, c] = corners.map(|v| v.position);
        let flat = (b - a).cross(c - a).normalize_or_zero();
        // 1e-4: normals that files store of flat faces are as far off as their decimals and their packing.
        corners.iter().any(|v| v.normal == Vec3::ZERO) || corners.iter().all(|v| v.normal.dot(flat) >= 1.0 - 1e-4)
    }

    /// Multiplies the power of every light by `factor`, at least 0. Light seen directly changes with it.
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

    /// Puts the triangles in another order: the new i-th is the old `order[i]`. The lights follow.
    pub fn reorder_triangles(&mut self, order: &[u32]) {
        let mut place = vec![0u32; order.len()];
        for (new, old) in order.iter().enumerate() {
            place[*old as usize] = new as u32;
        }
        self.triangles = order.iter().map(|old| self.triangles[*old as usize]).collect();
        for light in &mut self.lights {
            if let LightKind::Mesh { emitters, .. } = &mut light.kind {
                for emitter in emitters {
                    emitter.triangle = place[emitter.triangle as usize];
                }
            }
        }
    }

    /// Positions of the corners of triangle `index`.
    pub fn triangle_positions(&self, index: usize) -> [Vec3; 3] {
        self.triangles[index].vertices.map(|vertex| self.vertices[vertex as usize].position)
    }

    /// There is nothing that a ray could meet.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty() && self.procedurals.is_empty()
    }

    /// Lower and upper corner of the bounding box of all triangles and procedural objects; None where there is none.
    pub fn bounds(&self) -> Option<[Vec3; 2]> {
        self.bounds_of(0..self.triangles.len())
    }

    /// Lower and upper corner of the bounding box of the triangles that `indices` names, and of all procedural objects.
    pub(super) fn bounds_of(&self, indices: impl Iterator<Item = usize>) -> Option<[Vec3; 2]> {
        let corners = indices.flat_map(|index| self.triangle_positions(index));
        let corners = corners.chain(self.procedurals.iter().flat_map(Procedural::corners));
        corners.map(|p| [p, p]).reduce(|[lower, upper], [p, _]| [lower.min(p), upper.max(p)])
    }
}
