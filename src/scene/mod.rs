//! What a scene is: triangles, materials, textures, lights and cameras in normalised space.
//!
//! Import works in f64. The finished scene is recentred and scaled by a power of two so that its
//! bounding sphere is about unit size ([`Normalisation`]); everything here is in that space unless
//! a field says otherwise. Radiance keeps the file's units.

mod accessor;
mod camera;
mod container;
mod environment;
mod geometry;
mod gltf;
mod json;
mod light;
mod material;
mod mesh;
mod node;
mod notes;
mod procedural;
mod texture;

pub use environment::Panorama;
pub use gltf::ImportOptions;
pub use material::*;
pub(crate) use material::{TEXTURE_USES, constants as material_constants, sheen};

use std::sync::Arc;

use glam::{DVec3, Vec2, Vec3, Vec4};

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
}

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

/// Wrap mode of a sampler, per axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Wrap {
    /// Tiles.
    #[default]
    Repeat,
    /// Tiles, every other one mirrored.
    Mirror,
    /// Edge texels extend.
    Clamp,
}

/// Magnification filter of a sampler. Minification is left to the samples of the pixel: there are
/// no mip levels, as in Cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Filter {
    /// Bilinear.
    #[default]
    Linear,
    /// The nearest texel.
    Nearest,
}

/// What the numbers of a texture mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ColourSpace {
    /// sRGB-coded colour; alpha is linear.
    Srgb,
    /// Plain numbers.
    Linear,
}

/// An image seen through a sampler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Texture {
    /// Index into [`Scene::images`].
    pub image: u32,
    /// Wrap mode along u and v.
    pub wrap: [Wrap; 2],
    /// Filter.
    pub filter: Filter,
    /// Colour space, by the material slots that use it.
    pub space: ColourSpace,
}

/// A decoded image, rows top to bottom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextureImage {
    /// Name, URI or `image N`.
    pub name: String,
    /// Width in texels, at least 1.
    pub width: u32,
    /// Height in texels, at least 1.
    pub height: u32,
    /// RGBA, as coded in the file (16-bit images are reduced to 8).
    pub texels: Vec<[u8; 4]>,
}

/// A light: what the photon map tags its photons with.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// The node's or light's name, or `light N`.
    pub name: String,
    /// Where and how it emits.
    pub kind: LightKind,
}

/// Where and how a light emits.
#[derive(Clone, Debug, PartialEq)]
pub enum LightKind {
    /// The triangles of one node and one emissive material.
    Mesh {
        /// Index into [`Scene::materials`]: its emission, and whether both faces emit.
        material: u32,
        /// The triangles that emit.
        emitters: Vec<EmitterTriangle>,
    },
    /// KHR_lights_punctual point light.
    Point {
        /// Position.
        position: Vec3,
        /// Radiant intensity per steradian, scaled to normalised space (times scale squared).
        intensity: Vec3,
        /// Range, normalised; infinite where the file has none.
        range: f32,
    },
    /// KHR_lights_punctual spot light.
    Spot {
        /// Position.
        position: Vec3,
        /// Unit vector the light looks along.
        direction: Vec3,
        /// As for [`LightKind::Point`].
        intensity: Vec3,
        /// Cosine of the inner cone angle; greater than [`cos_outer`](LightKind::Spot::cos_outer).
        cos_inner: f32,
        /// Cosine of the outer cone angle.
        cos_outer: f32,
        /// As for [`LightKind::Point`].
        range: f32,
    },
    /// KHR_lights_punctual directional light.
    Directional {
        /// Unit vector the light travels along.
        direction: Vec3,
        /// Irradiance on a plane across the direction.
        irradiance: Vec3,
    },
    /// What is all around the scene, infinitely far away; see [`Scene::set_environment`].
    Environment {
        /// The radiance from each direction, shared: it may be large.
        panorama: Arc<Panorama>,
        /// Rotation about +Y in turns, 0 to 1, counter-clockwise seen from above.
        turn: f32,
        /// Factor on the radiance, at least 0.
        strength: f32,
    },
}

/// An emitter triangle: a triangle of a mesh light and what it emits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmitterTriangle {
    /// Index into [`Scene::triangles`].
    pub triangle: u32,
    /// Mean emitted radiance over the triangle (the emissive texture averaged over it).
    pub radiance: Vec3,
}

/// A camera: looks along -z of its own axes, +y up (glTF 3.10).
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// The node's or camera's name, or `camera N`.
    pub name: String,
    /// Position.
    pub position: Vec3,
    /// Unit axes: right (+x), up (+y), backward (+z).
    pub axes: [Vec3; 3],
    /// Projection.
    pub projection: Projection,
    /// Near plane distance, normalised.
    pub near: f32,
    /// Far plane distance, normalised; infinite where the file has none.
    pub far: f32,
}

/// Projection of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Perspective.
    Perspective {
        /// Vertical field of view in radians.
        yfov: f32,
        /// Width over height, where the file states one.
        aspect: Option<f32>,
    },
    /// Orthographic.
    Orthographic {
        /// Half the width of the view, normalised.
        xmag: f32,
        /// Half the height of the view, normalised.
        ymag: f32,
    },
}

/// Normalised space: `normalised = (world - centre) * 2^exponent`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Normalisation {
    /// Centre of the scene's bounding box, in world space.
    pub centre: DVec3,
    /// Power of two that brings the bounding sphere's radius into (1/2, 1].
    pub exponent: i32,
}

impl Normalisation {
    /// The factor from world lengths to normalised ones: `2^exponent`.
    pub fn scale(&self) -> f64 {
        2f64.powi(self.exponent)
    }

    /// From world space to normalised space.
    pub fn apply(&self, world: DVec3) -> Vec3 {
        ((world - self.centre) * self.scale()).as_vec3()
    }

    /// From normalised space to world space.
    pub fn undo(&self, normalised: Vec3) -> DVec3 {
        self.undo_f64(normalised.as_dvec3())
    }

    /// From normalised space, in double precision, to world space.
    pub fn undo_f64(&self, normalised: DVec3) -> DVec3 {
        normalised / self.scale() + self.centre
    }
}

impl Scene {
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
    fn bounds_of(&self, indices: impl Iterator<Item = usize>) -> Option<[Vec3; 2]> {
        let corners = indices.flat_map(|index| self.triangle_positions(index));
        let corners = corners.chain(self.procedurals.iter().flat_map(Procedural::corners));
        corners.map(|p| [p, p]).reduce(|[lower, upper], [p, _]| [lower.min(p), upper.max(p)])
    }
}
