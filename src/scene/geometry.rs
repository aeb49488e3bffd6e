//! Triangles in world space (f64), and their way into normalised space.

use std::collections::HashMap;
use std::iter::Peekable;
use std::ops::Range;

use glam::{DMat3, DVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::description::Scene;
use super::light::{self, Emission, EmitterTriangle, Light, LightKind};
use super::limits::{MAX_CORNERS, MAX_VERTICES};
use super::material::Material;
use super::mesh::Primitive;
use super::node::Node;
use super::normalisation::Normalisation;
use super::notes::Notes;
use super::triangle::{NO_LIGHT, Triangle, Vertex};
use crate::Result;

/// Objects that are no wider than this, over the scene's radius, are told of: three times the gap that rays skip where they
/// leave a surface (`offset_origin` in `shaders/lib/ray.wgsl`, at both ends of a ray).
const SMALL_OBJECT: f64 = 1e-4;

/// Refuses a scene that is too large before any of it is placed. A small file may place a mesh many times.
pub(super) fn check_size<'a>(placed: impl Iterator<Item = (&'a Node<'a>, &'a [Primitive])>) -> Result<()> {
    let (mut corners, mut vertices) = (0, 0);
    for (node, primitives) in placed {
        corners += primitives.iter().map(|primitive| 3 * primitive.triangles.len()).sum::<usize>();
        vertices += primitives.iter().map(|primitive| primitive.positions.len()).sum::<usize>();
        if corners > MAX_CORNERS || vertices > MAX_VERTICES {
            let most = MAX_CORNERS / 3;
            return Err(node
                .json
                .error(format!("the scene has more than {most} triangles or {MAX_VERTICES} vertices")));
        }
    }
    Ok(())
}

/// The triangles of one node and one emissive material.
struct MeshLight {
    node: usize,
    material: u32,
}

/// Mesh lights with the triangles that are left of them, in the order of their nodes.
pub(super) struct PlacedMeshLight {
    node: usize,
    material: u32,
    emitters: Vec<EmitterTriangle>,
}

/// World-space triangles. [`Triangle::light`] indexes the mesh lights here.
#[derive(Default)]
pub(super) struct Geometry {
    world: Vec<DVec3>,
    /// Everything but the position.
    vertices: Vec<Vertex>,
    triangles: Vec<Triangle>,
    mesh_lights: Vec<MeshLight>,
    /// Vertices of each node that emits nothing.
    objects: Vec<Range<usize>>,
    /// Corners of the boxes of procedural objects.
    pub procedural_corners: Vec<DVec3>,
    /// Mean radiance by triangle.
    radiance: Vec<Vec3>,
    default_material: Option<u32>,
    degenerate: usize,
}

impl Geometry {
    /// Adds the primitives of a node's mesh. A material is added for those that name none.
    pub fn add(
        &mut self,
        index: usize,
        node: &Node,
        primitives: &[Primitive],
        materials: &mut Vec<Material>,
    ) -> Result<()> {
        let mut lights = HashMap::new();
        let first = self.world.len();
        for primitive in primitives {
            let material = primitive.material.map(|m| m as u32).unwrap_or_else(|| {
                *self.default_material.get_or_insert_with(|| {
                    materials.push(Material::default());
                    materials.len() as u32 - 1
                })
            });
            let light = if materials[material as usize].emissive == Vec3::ZERO {
                NO_LIGHT
            } else {
                *lights.entry(material).or_insert_with(|| {
                    self.mesh_lights.push(MeshLight { node: index, material });
                    self.mesh_lights.len() as u32 - 1
                })
            };
            self.instantiate(node, primitive, material, light)?;
        }
        if lights.is_empty() {
            self.objects.push(first..self.world.len());
        }
        Ok(())
    }

    fn instantiate(&mut self, node: &Node, primitive: &Primitive, material: u32, light: u32) -> Result<()> {
        let first = self.vertices.len() as u32;
        let matrix = &node.world.matrix3;
        let mirrors = matrix.determinant() < 0.0;
        let sign = if mirrors { -1.0 } else { 1.0 };
        let normal_matrix = cofactor(matrix) * sign;
        for (i, position) in primitive.positions.iter().enumerate() {
            let world = node.world.transform_point3(position.as_dvec3());
            if !world.is_finite() {
                return Err(node.json.error("its world matrix moves vertices out of range"));
            }
            self.world.push(world);
            self.vertices.push(Vertex {
                position: Vec3::ZERO,
                normal: primitive.normals.get(i).map_or(Vec3::ZERO, |n| unit(normal_matrix * n.as_dvec3())),
                tangent: primitive.tangents.get(i).map_or(Vec4::ZERO, |t| {
                    let tangent = unit(*matrix * t.truncate().as_dvec3());
                    let handedness = if t.w < 0.0 { -sign } else { sign };
                    if tangent == Vec3::ZERO { Vec4::ZERO } else { tangent.extend(handedness as f32) }
                }),
                uv: [0, 1].map(|set| primitive.uvs[set].get(i).copied().unwrap_or_default()),
                colour: primitive.colours.get(i).copied().unwrap_or(Vec4::ONE),
            });
        }
        for corners in &primitive.triangles {
            let [a, b, c] = corners.map(|corner| first + corner);
            let vertices = if mirrors { [a, c, b] } else { [a, b, c] };
            let [p, q, r] = vertices.map(|v| self.world[v as usize]);
            if (q - p).cross(r - p) == DVec3::ZERO {
                self.degenerate += 1;
            } else {
                self.triangles.push(Triangle { vertices, material, light });
            }
        }
        Ok(())
    }

    /// Finds what each triangle of a mesh light emits.
    pub fn find_emitters(&mut self, scene: &Scene) {
        if self.mesh_lights.is_empty() {
            self.radiance = vec![Vec3::ZERO; self.triangles.len()];
            return;
        }
        let emission = Emission::new(&scene.materials, &scene.textures, &scene.images);
        let mean = |t: &Triangle| match t.light {
            NO_LIGHT => Vec3::ZERO,
            _ => emission.mean(t.material as usize, t.vertices.map(|v| self.vertices[v as usize].uv)),
        };
        self.radiance = self.triangles.par_iter().map(mean).collect();
    }

    /// Some triangle emits.
    pub fn emits(&self) -> bool {
        self.radiance.iter().any(|radiance| *radiance != Vec3::ZERO)
    }

    /// Adds the default light, as of a node `node`; false where there is nothing to light.
    pub fn add_default_light(&mut self, node: usize, materials: &mut Vec<Material>) -> bool {
        let Some((centre, radius)) = self.bounding_sphere() else { return false };
        let (corners, material) = light::default_light(centre, radius);
        let radiance = material.emissive;
        let (first, index) = (self.vertices.len() as u32, materials.len() as u32);
        materials.push(material);
        self.world.extend(corners);
        self.vertices.extend([Vertex { colour: Vec4::ONE, ..Default::default() }; 4]);
        self.mesh_lights.push(MeshLight { node, material: index });
        let light = self.mesh_lights.len() as u32 - 1;
        for corners in [[0, 1, 2], [0, 2, 3]] {
            let vertices = corners.map(|corner| first + corner);
            self.triangles.push(Triangle { vertices, material: index, light });
            self.radiance.push(radiance);
        }
        true
    }

    /// Centre of the bounding box of all triangles and procedural objects, and the distance from it to their farthest corner.
    fn bounding_sphere(&self) -> Option<(DVec3, f64)> {
        let corners = || {
            let corners = self.triangles.iter().flat_map(|t| t.vertices).map(|v| self.world[v as usize]);
            corners.chain(self.procedural_corners.iter().copied())
        };
        let lower = corners().reduce(DVec3::min)?;
        let upper = corners().reduce(DVec3::max)?;
        // Halves are added, as the sum might overflow.
        let centre = 0.5 * lower + 0.5 * upper;
        let extent = (upper - centre).max(centre - lower).max_element();
        // Divided first: squares of 1e200 overflow.
        let radius = corners().map(|p| ((p - centre) / extent).length_squared()).fold(0.0, f64::max).sqrt() * extent;
        Some((centre, radius))
    }

    /// How normalised space lies.
    pub fn normalisation(&self) -> Normalisation {
        let Some((centre, radius)) = self.bounding_sphere() else { return Normalisation::default() };
        // 2^-1000 to 2^1000 leaves room for the scale's square to mean something; nothing real is near it.
        let mut exponent = (-radius.log2().ceil()).clamp(-1000.0, 1000.0) as i32;
        // The logarithm is rounded: at a power of two it may be off by one.
        if radius * 2f64.powi(exponent) > 1.0 {
            exponent -= 1;
        } else if radius * 2f64.powi(exponent) <= 0.5 {
            exponent += 1;
        }
        Normalisation { centre, exponent }
    }

    /// Moves everything into `scene`, by its normalisation: vertices that triangles use, triangles
    /// that have an area in f32 too.
    pub fn finish(self, scene: &mut Scene, notes: &mut Notes) -> Vec<PlacedMeshLight> {
        let (mut degenerate, mut rounded_off) = (self.degenerate, 0);
        let normalisation = scene.normalisation;
        let positions: Vec<Vec3> = self.world.par_iter().map(|world| normalisation.apply(*world)).collect();
        let mut lights: Vec<PlacedMeshLight> = self
            .mesh_lights
            .iter()
            .map(|light| PlacedMeshLight { node: light.node, material: light.material, emitters: Vec::new() })
            .collect();
        let mut place = vec![u32::MAX; positions.len()];
        scene.triangles.reserve(self.triangles.len());
        for (triangle, radiance) in self.triangles.iter().zip(self.radiance) {
            let corners = triangle.vertices.map(|v| positions[v as usize]);
            if !has_area(corners) {
                // In the file's own coordinates the corners are apart, and it has an area.
                let [a, b, c] = corners;
                let coincide = a == b || b == c || c == a;
                *if coincide { &mut rounded_off } else { &mut degenerate } += 1;
                continue;
            }
            let vertices = triangle.vertices.map(|v| {
                let place = &mut place[v as usize];
                if *place == u32::MAX {
                    *place = scene.vertices.len() as u32;
                    scene.vertices.push(Vertex { position: positions[v as usize], ..self.vertices[v as usize] });
                }
                *place
            });
            if radiance != Vec3::ZERO {
                let emitter = EmitterTriangle { triangle: scene.triangles.len() as u32, radiance };
                lights[triangle.light as usize].emitters.push(emitter);
            }
            scene.triangles.push(Triangle { vertices, light: NO_LIGHT, ..*triangle });
        }
        if degenerate > 0 {
            notes.push(format!("{degenerate} triangles have no area and are left out"));
        }
        if rounded_off > 0 {
            notes.push(format!(
                "{rounded_off} triangles are below 6e-8 of the scene's size, too small for it in single precision, and left out: \
                 leave out what is far away instead"
            ));
        }
        let small = self.objects.iter().filter(|vertices| {
            let corners = &self.world[(*vertices).clone()];
            let [lower, upper] =
                corners.iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[lower, upper], corner| {
                    [lower.min(*corner), upper.max(*corner)]
                });
            let width = (upper - lower).length() * normalisation.scale();
            width > 0.0 && width < SMALL_OBJECT
        });
        let small = small.count();
        if small > 0 {
            notes.push(format!(
                "{small} objects are less than {SMALL_OBJECT:.0e} of the scene's size across: rays skip gaps of 3e-5 of it, so that \
                 what they shade is not right; leave out what is far away, or render them by themselves"
            ));
        }
        lights
    }
}

impl Scene {
    /// Takes over the mesh lights of `node`, which come next; those without emitters are none.
    pub(super) fn adopt_mesh_lights(
        &mut self,
        lights: &mut Peekable<impl Iterator<Item = PlacedMeshLight>>,
        node: usize,
        name: Option<String>,
    ) {
        while let Some(light) = lights.next_if(|light| light.node == node) {
            if light.emitters.is_empty() {
                continue;
            }
            let index = self.lights.len();
            for emitter in &light.emitters {
                self.triangles[emitter.triangle as usize].light = index as u32;
            }
            let name = name.clone().unwrap_or_else(|| format!("light {index}"));
            let kind = LightKind::Mesh { material: light.material, emitters: light.emitters };
            self.lights.push(Light { name, kind });
        }
    }
}

/// The triangle's normal, computed as kernels do in f32, is one: neither zero nor so small that its
/// square vanishes.
fn has_area([a, b, c]: [Vec3; 3]) -> bool {
    (b - a).cross(c - a).length_squared() >= f32::MIN_POSITIVE
}

/// Cofactor matrix: the determinant times the inverse transpose, and defined without an inverse.
fn cofactor(m: &DMat3) -> DMat3 {
    DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
}

/// The unit vector along `v`; zero where there is none.
fn unit(v: DVec3) -> Vec3 {
    let largest = v.abs().max_element();
    // Divided first: the squares of a matrix with large or small scales could overflow or vanish.
    (v / largest).try_normalize().map_or(Vec3::ZERO, |v| v.as_vec3())
}
