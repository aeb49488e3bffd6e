//! Triangles in world space, in f64, and their transform to normalised space.

use std::collections::{BTreeMap, HashMap};
use std::iter::Peekable;
use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use super::description::Scene;
use super::instance::{Instance, SharedMesh};
use super::light::{self, Emission, EmitterTriangle, Light, LightKind};
use super::limits::{MAX_CORNERS, MAX_DISPLACEMENTS, MAX_VERTICES};
use super::material::Material;
use super::mesh::{Mesh, Primitive};
use super::morph::Displaced;
use super::node::Node;
use super::normalisation::{Normalisation, is_in_range};
use super::notes::Notes;
use super::skin::Influences;
use super::triangle::{NO_LIGHT, Triangle, Vertex};
use crate::Result;
use crate::count::count;
use crate::procedural::box_corners;

/// Width of an object over the radius of the scene below which a note is added: three times the gap that rays skip at a
/// surface (`offset_origin` in `shaders/lib/ray.wgsl`, at both ends of a ray).
const SMALL_OBJECT: f64 = 1e-4;

/// An instance is left out if its size over the scene's size is below this: it would cover a hundredth of a pixel in an
/// image of 2,600 pixels that shows the whole scene. With smaller instances, small triangles would have to be dropped
/// from all copies, because no area may underflow.
const SMALLEST_INSTANCE: f64 = 1.0 / 262144.0;

/// A mesh at a node, and its pose.
pub(super) struct PlacedMesh<'p, 'r, 'a> {
    /// The node.
    pub node: &'p Node<'a>,
    pub mesh: &'p Mesh<'r, 'a>,
    /// Weights of the morph targets.
    pub weights: &'p [f64],
    /// Matrices from the mesh's space to world space, by joint of its skin. `None`: the node's matrix.
    pub joints: Option<Arc<[DAffine3]>>,
}

/// Which mesh instances share, and whether it is mirrored. Kernels support no mirroring transforms.
pub(super) type SharedKey = (usize, bool);

/// A mesh that is stored once, in its own space.
struct Shared {
    geometry: Geometry,
    /// The vertices that its triangles use, and their bounds.
    corners: Vec<DVec3>,
    bounds: Option<[DVec3; 2]>,
    /// The transforms of its instances to world space.
    placements: Vec<DAffine3>,
}

/// Refuses a scene that is too large before any mesh is transformed. A small file may place a mesh many times: the last
/// member of an item is the number of copies.
pub(super) fn check_size<'p, 'r: 'p, 'a: 'r>(
    placed: impl Iterator<Item = (&'p Node<'a>, &'p Mesh<'r, 'a>, &'p [f64], usize)>,
) -> Result<()> {
    let (mut corners, mut vertices, mut displacements) = (0usize, 0usize, 0usize);
    for (node, Mesh { primitives, .. }, weights, copies) in placed {
        let sum = |count: fn(&Primitive) -> usize| primitives.iter().map(count).sum::<usize>().saturating_mul(copies);
        corners = corners.saturating_add(sum(|primitive| 3 * primitive.triangles.len()));
        let own_vertices = sum(|primitive| primitive.positions.len());
        vertices = vertices.saturating_add(own_vertices);
        let moved = weights.iter().filter(|weight| **weight != 0.0).count().saturating_mul(own_vertices);
        displacements = displacements.saturating_add(moved);
        if displacements > MAX_DISPLACEMENTS {
            let problem = format!("the scene has more than {MAX_DISPLACEMENTS} displacements by morph targets");
            return Err(node.json.error(problem));
        }
        if corners > MAX_CORNERS || vertices > MAX_VERTICES {
            let max_triangles = MAX_CORNERS / 3;
            let problem = format!("the scene has more than {max_triangles} triangles or {MAX_VERTICES} vertices");
            return Err(node.json.error(problem));
        }
    }
    Ok(())
}

/// A mesh light: the triangles of one node, or of one of its instances, with the same emissive material.
struct MeshLight {
    node: usize,
    material: u32,
}

/// A mesh light with its emitter triangles in the scene.
pub(super) struct PlacedMeshLight {
    node: usize,
    material: u32,
    emitters: Vec<EmitterTriangle>,
}

/// World-space triangles. [`Triangle::light`] is an index into `mesh_lights`.
#[derive(Default)]
pub(super) struct Geometry {
    world: Vec<DVec3>,
    /// The vertices without their positions.
    vertices: Vec<Vertex>,
    triangles: Vec<Triangle>,
    mesh_lights: Vec<MeshLight>,
    /// The vertices of each node without a light.
    objects: Vec<Range<usize>>,
    /// Corners of the bounding boxes of procedural objects.
    pub procedural_corners: Vec<DVec3>,
    /// Mean emitted radiance of each triangle.
    radiance: Vec<Vec3>,
    default_material: Option<u32>,
    degenerate: usize,
    /// The triangles of each placed primitive.
    primitives: Vec<Range<usize>>,
    shared: BTreeMap<SharedKey, Shared>,
}

/// The placed primitives, except those of shared meshes.
pub(super) struct PlacedPrimitives<'g> {
    pub world: &'g [DVec3],
    pub triangles: &'g mut [Triangle],
    /// The triangles of each primitive.
    pub ranges: &'g [Range<usize>],
}

impl Geometry {
    /// Adds the primitives of a node's mesh. Primitives without a material get a default one.
    pub fn add(&mut self, index: usize, placed: &PlacedMesh, materials: &mut Vec<Material>) -> Result<()> {
        let mut lights = HashMap::new();
        let first = self.world.len();
        for primitive in &placed.mesh.primitives {
            let material = self.material_of(primitive, materials);
            let light = if materials[material as usize].emissive == Vec3::ZERO {
                NO_LIGHT
            } else {
                *lights.entry(material).or_insert_with(|| {
                    self.mesh_lights.push(MeshLight { node: index, material });
                    self.mesh_lights.len() as u32 - 1
                })
            };
            self.instantiate(placed, primitive, material, light)?;
        }
        if lights.is_empty() {
            self.objects.push(first..self.world.len());
        }
        Ok(())
    }

    /// The placed primitives.
    pub fn placed_primitives(&mut self) -> PlacedPrimitives<'_> {
        PlacedPrimitives { world: &self.world, triangles: &mut self.triangles, ranges: &self.primitives }
    }

    fn material_of(&mut self, primitive: &Primitive, materials: &mut Vec<Material>) -> u32 {
        primitive.material.map(|m| m as u32).unwrap_or_else(|| {
            *self.default_material.get_or_insert_with(|| {
                materials.push(Material::default());
                materials.len() as u32 - 1
            })
        })
    }

    /// Adds a node's mesh as an instance of mesh number `mesh`.
    pub fn add_instance(&mut self, mesh: usize, placed: &PlacedMesh, materials: &mut Vec<Material>) -> Result<()> {
        let world = placed.node.world;
        let mirrors = world.matrix3.determinant() < 0.0;
        let mirror = DAffine3::from_scale(DVec3::new(if mirrors { -1.0 } else { 1.0 }, 1.0, 1.0));
        if !self.shared.contains_key(&(mesh, mirrors)) {
            let mut geometry = Geometry::default();
            let own = Node { world: mirror, json: placed.node.json.clone(), ..*placed.node };
            let own = PlacedMesh { node: &own, mesh: placed.mesh, weights: placed.weights, joints: None };
            for primitive in &placed.mesh.primitives {
                let material = self.material_of(primitive, materials);
                geometry.instantiate(&own, primitive, material, NO_LIGHT)?;
            }
            let mut used = vec![false; geometry.world.len()];
            geometry.triangles.iter().flat_map(|t| t.vertices).for_each(|vertex| used[vertex as usize] = true);
            let used = geometry.world.iter().zip(used).filter(|(_, used)| *used);
            let corners: Vec<DVec3> = used.map(|(p, _)| *p).collect();
            let bounds = corners.iter().map(|p| [*p, *p]).reduce(joined);
            let shared = Shared { geometry, corners, bounds, placements: Vec::new() };
            self.shared.insert((mesh, mirrors), shared);
        }
        let shared = self.shared.get_mut(&(mesh, mirrors)).expect("it is there now");
        // Mirrored twice, which cancels out.
        let placement = world * mirror;
        if shared
            .bounds
            .is_some_and(|bounds| !box_corners(bounds).iter().all(|p| is_in_range(placement.transform_point3(*p))))
        {
            return Err(placed.node.json.error("its world matrix moves vertices out of range"));
        }
        shared.placements.push(placement);
        Ok(())
    }

    fn instantiate(&mut self, placed: &PlacedMesh, primitive: &Primitive, material: u32, light: u32) -> Result<()> {
        let (first, first_triangle) = (self.vertices.len() as u32, self.triangles.len());
        let shape = Shape::new(primitive, placed.weights)?;
        let transforms = match (&placed.joints, &primitive.influences) {
            (Some(joints), Some(influences)) => Transforms::Skin { influences, joints },
            _ => Transforms::Rigid(Transform::new(placed.node.world)),
        };
        for (i, position) in shape.positions.iter().enumerate() {
            let transform = transforms.of(i);
            let world = transform.affine.transform_point3(*position);
            if !is_in_range(world) {
                let mover = if placed.joints.is_some() { "a joint" } else { "its world matrix" };
                return Err(placed.node.json.error(format!("{mover} moves vertices out of range")));
            }
            self.world.push(world);
            self.vertices.push(Vertex {
                position: Vec3::ZERO,
                normal: shape.normals.get(i).map_or(Vec3::ZERO, |n| unit(transform.normal_matrix * *n)),
                // Tangents without normals must be ignored (glTF 3.7.2.1).
                tangent: shape.tangents.get(i).filter(|_| !shape.normals.is_empty()).map_or(Vec4::ZERO, |t| {
                    let tangent = unit(transform.affine.matrix3 * *t);
                    let mirrored = transform.mirrors != (primitive.tangents[i].w < 0.0);
                    let handedness = if mirrored { -1.0 } else { 1.0 };
                    if tangent == Vec3::ZERO { Vec4::ZERO } else { tangent.extend(handedness) }
                }),
                uv: [0, 1].map(|set| shape.uvs[set].get(i).copied().unwrap_or_default()),
                colour: shape.colours.get(i).copied().unwrap_or(Vec4::ONE),
            });
        }
        for corners in &primitive.triangles {
            let [a, b, c] = corners.map(|corner| first + corner);
            let vertices = if transforms.mirror(*corners) { [a, c, b] } else { [a, b, c] };
            let [p, q, r] = vertices.map(|v| self.world[v as usize]);
            if (q - p).cross(r - p) == DVec3::ZERO {
                self.degenerate += 1;
            } else {
                self.triangles.push(Triangle { vertices, material, light });
            }
        }
        self.primitives.push(first_triangle..self.triangles.len());
        Ok(())
    }

    /// Computes the emitted radiance of each triangle.
    pub fn find_emitters(&mut self, scene: &Scene) {
        if self.mesh_lights.is_empty() {
            self.radiance = vec![Vec3::ZERO; self.triangles.len()];
            return;
        }
        let emitting = self.triangles.iter().filter(|triangle| triangle.light != NO_LIGHT).count();
        let emission = Emission::new(&scene.materials, &scene.textures, &scene.images, emitting);
        let mean = |t: &Triangle| match t.light {
            NO_LIGHT => Vec3::ZERO,
            _ => emission.mean(t.material as usize, t.vertices.map(|v| self.vertices[v as usize].uv)),
        };
        self.radiance = self.triangles.par_iter().map(mean).collect();
    }

    /// Whether any triangle emits light.
    pub fn emits(&self) -> bool {
        self.radiance.iter().any(|radiance| *radiance != Vec3::ZERO)
    }

    /// Adds the default light as a part of node `node`. Returns false if the scene is empty.
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

    /// The bounding sphere: the centre of the bounding box, and the distance from it to the farthest corner.
    fn bounding_sphere(&self) -> Option<(DVec3, f64)> {
        let corners = || {
            let corners = self.triangles.iter().flat_map(|t| t.vertices).map(|v| self.world[v as usize]);
            corners.chain(self.procedural_corners.iter().copied())
        };
        let shared = self.shared_bounds();
        let lower = corners().chain(shared.map(|[lower, _]| lower)).reduce(DVec3::min)?;
        let upper = corners().chain(shared.map(|[_, upper]| upper)).reduce(DVec3::max)?;
        // The sum of the corners could overflow, so their halves are added.
        let centre = 0.5 * lower + 0.5 * upper;
        let extent = (upper - centre).max(centre - lower).max_element();
        // Divided first, because the square of 1e200 overflows.
        let squared = |p: DVec3| ((p - centre) / extent).length_squared();
        let radius = self.shared_corners().map(squared).reduce(|| 0.0, f64::max);
        Some((centre, corners().map(squared).fold(radius, f64::max).sqrt() * extent))
    }

    /// The corners of all instances in world space.
    fn shared_corners(&self) -> impl ParallelIterator<Item = DVec3> {
        let placements = self.shared.values().flat_map(|shared| shared.placements.iter().map(move |p| (shared, p)));
        let placements: Vec<(&Shared, &DAffine3)> = placements.collect();
        placements.into_par_iter().flat_map_iter(|(shared, placement)| {
            shared.corners.iter().map(|corner| placement.transform_point3(*corner))
        })
    }

    /// The bounding box of all instances.
    fn shared_bounds(&self) -> Option<[DVec3; 2]> {
        self.shared_corners().map(|p| [p, p]).reduce_with(joined)
    }

    /// The map to normalised space.
    pub fn normalisation(&self) -> Normalisation {
        let Some((centre, radius)) = self.bounding_sphere() else { return Normalisation::default() };
        // The square of the scale must be finite and not zero. No real scene is near these limits.
        let mut exponent = (-radius.log2().ceil()).clamp(-1000.0, 1000.0) as i32;
        // The logarithm is rounded, so the exponent may be off by one near powers of two.
        if radius * 2f64.powi(exponent) > 1.0 {
            exponent -= 1;
        } else if radius * 2f64.powi(exponent) <= 0.5 {
            exponent += 1;
        }
        Normalisation { centre, exponent }
    }

    /// Moves the triangles that have an area in f32, and the vertices that they use, to `scene` in its normalised
    /// space. Returns the mesh lights in the order of their nodes.
    pub fn finish(self, scene: &mut Scene, notes: &mut Notes) -> Vec<PlacedMeshLight> {
        let (mut degenerate, mut rounded_off) = (self.degenerate, 0);
        let normalisation = scene.normalisation;
        let positions: Vec<Vec3> = self.world.par_iter().map(|world| normalisation.apply(*world)).collect();
        let mut lights: Vec<PlacedMeshLight> = self
            .mesh_lights
            .iter()
            .map(|light| PlacedMeshLight { node: light.node, material: light.material, emitters: Vec::new() })
            .collect();
        let mut new_index = vec![u32::MAX; positions.len()];
        let own_vertices = Arc::make_mut(&mut scene.vertices);
        scene.triangles.reserve(self.triangles.len());
        for (triangle, radiance) in self.triangles.iter().zip(&self.radiance) {
            let corners = triangle.vertices.map(|v| positions[v as usize]);
            if !has_area(corners) {
                // Corners that only coincide in f32 mean that the triangle has an area in the file's coordinates.
                let [a, b, c] = corners;
                let coincide = a == b || b == c || c == a;
                *if coincide { &mut rounded_off } else { &mut degenerate } += 1;
                continue;
            }
            let vertices = adopt_vertices(own_vertices, triangle.vertices, &self.vertices, &positions, &mut new_index);
            if *radiance != Vec3::ZERO {
                let emitter = EmitterTriangle { triangle: scene.triangles.len() as u32, radiance: *radiance };
                lights[triangle.light as usize].emitters.push(emitter);
            }
            scene.triangles.push(Triangle { vertices, light: NO_LIGHT, ..*triangle });
        }
        let left_out: usize = self.shared.values().map(|shared| shared.finish(scene, &mut degenerate)).sum();
        if left_out > 0 {
            let copies = count(left_out, "copy of a mesh is", "copies of meshes are");
            notes.push(format!("{copies} below {SMALLEST_INSTANCE:.0e} of the scene's size and left out"));
        }
        if degenerate > 0 {
            let triangles = count(degenerate, "triangle has no area and is", "triangles have no area and are");
            notes.push(format!("{triangles} left out"));
        }
        if rounded_off > 0 {
            let triangles = count(rounded_off, "triangle is", "triangles are");
            notes.push(format!(
                "{triangles} below 6e-8 of the scene's size and left out, because single precision cannot represent \
                 less: remove distant objects from the scene instead"
            ));
        }
        self.note_small_objects(normalisation.scale(), notes);
        lights
    }

    /// Adds a note on objects that are so small for their scene that rays skip a part of them.
    fn note_small_objects(&self, scale: f64, notes: &mut Notes) {
        let small = self.objects.iter().filter(|vertices| {
            let corners = &self.world[(*vertices).clone()];
            let [lower, upper] =
                corners.iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[lower, upper], corner| {
                    [lower.min(*corner), upper.max(*corner)]
                });
            let width = (upper - lower).length() * scale;
            width > 0.0 && width < SMALL_OBJECT
        });
        let width = |placement: &DAffine3, size: DVec3| (placement.matrix3 * size).length() * scale;
        let of_shared = self.shared.values().map(|shared| {
            let size = shared.bounds.map_or(DVec3::ZERO, |[lower, upper]| upper - lower);
            let is_small = |placement: &&DAffine3| (SMALLEST_INSTANCE..SMALL_OBJECT).contains(&width(placement, size));
            shared.placements.iter().filter(is_small).count()
        });
        let small = small.count() + of_shared.sum::<usize>();
        if small > 0 {
            let objects = count(small, "object is", "objects are");
            notes.push(format!(
                "{objects} less than {SMALL_OBJECT:.0e} of the scene's size across and shaded wrongly, because rays \
                 skip gaps of 3e-5 of that size: remove distant objects from the scene, or render small ones alone"
            ));
        }
    }
}

impl Shared {
    /// Adds the mesh, at unit size about the origin, and its instances to `scene`, whose normalisation is known.
    /// Returns the number of instances that are too small.
    fn finish(&self, scene: &mut Scene, degenerate: &mut usize) -> usize {
        *degenerate += self.geometry.degenerate;
        let Some([lower, upper]) = self.bounds else { return 0 };
        let centre = 0.5 * lower + 0.5 * upper;
        let extent = (upper - centre).max_element();
        // A power of two, so that positions keep their digits.
        let unit = 2f64.powi(extent.log2().ceil().clamp(-1000.0, 1000.0) as i32);
        let mesh = scene.shared_meshes.len();
        let normalisation = scene.normalisation;
        let first = scene.instances.len();
        scene.instances.extend(self.placements.iter().filter_map(|placement| {
            let linear = (placement.matrix3 * (unit * normalisation.scale())).as_mat3();
            let is_large = linear.determinant().cbrt() >= SMALLEST_INSTANCE as f32;
            let origin = normalisation.apply(placement.transform_point3(centre));
            is_large.then_some(Instance { mesh, linear, origin })
        }));
        let added = scene.instances.len() - first;
        if added > 0 {
            let positions: Vec<Vec3> = self.geometry.world.iter().map(|p| ((*p - centre) / unit).as_vec3()).collect();
            let (first_triangle, first_vertex) = (scene.triangles.len(), scene.vertices.len());
            // No instance makes the mesh smaller than that in any direction.
            let norm = |i: &Instance| i.linear.inverse().to_cols_array().iter().map(|x| x * x).sum::<f32>().sqrt();
            let smallest = scene.instances[first..].iter().map(|i| 1.0 / norm(i)).fold(1.0, f32::min);
            let mut new_index = vec![u32::MAX; positions.len()];
            let own_vertices = Arc::make_mut(&mut scene.vertices);
            for triangle in &self.geometry.triangles {
                if has_area(triangle.vertices.map(|v| smallest * positions[v as usize])) {
                    let stored = &self.geometry.vertices;
                    let vertices = adopt_vertices(own_vertices, triangle.vertices, stored, &positions, &mut new_index);
                    scene.triangles.push(Triangle { vertices, ..*triangle });
                } else {
                    *degenerate += 1;
                }
            }
            let (triangles, vertices) = (first_triangle..scene.triangles.len(), first_vertex..scene.vertices.len());
            scene.shared_meshes.push(SharedMesh { triangles, vertices });
        }
        self.placements.len() - added
    }
}

/// The bounding box of two.
pub(super) fn joined([lower, upper]: [DVec3; 2], [low, high]: [DVec3; 2]) -> [DVec3; 2] {
    [lower.min(low), upper.max(high)]
}

/// Adds the vertices of a triangle that are not in `adopted` yet, with their positions. Returns their new indices.
fn adopt_vertices(
    adopted: &mut Vec<Vertex>,
    corners: [u32; 3],
    vertices: &[Vertex],
    positions: &[Vec3],
    new_index: &mut [u32],
) -> [u32; 3] {
    corners.map(|v| {
        let index = &mut new_index[v as usize];
        if *index == u32::MAX {
            *index = adopted.len() as u32;
            adopted.push(Vertex { position: positions[v as usize], ..vertices[v as usize] });
        }
        *index
    })
}

impl Scene {
    /// Adds the mesh lights of `node`, which must come next in `lights`. Lights without emitters are dropped.
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

/// Whether the normal of the triangle, computed in f32 as in the kernels, has a length whose square does not underflow.
fn has_area([a, b, c]: [Vec3; 3]) -> bool {
    (b - a).cross(c - a).length_squared() >= f32::MIN_POSITIVE
}

/// The vertices of a primitive in its own space, displaced by morph targets.
struct Shape {
    positions: Vec<DVec3>,
    /// The normal of each vertex, or empty; as in the file, not of unit length. The same holds for tangents.
    normals: Vec<DVec3>,
    tangents: Vec<DVec3>,
    uvs: [Vec<Vec2>; 2],
    colours: Vec<Vec4>,
}

impl Shape {
    fn new(primitive: &Primitive, weights: &[f64]) -> Result<Shape> {
        let mut shape = Shape {
            positions: primitive.positions.iter().map(|p| p.as_dvec3()).collect(),
            normals: primitive.normals.iter().map(|n| n.as_dvec3()).collect(),
            tangents: primitive.tangents.iter().map(|t| t.truncate().as_dvec3()).collect(),
            uvs: primitive.uvs.clone(),
            colours: primitive.colours.clone(),
        };
        if let Some(morph) = &primitive.morph {
            let Shape { positions, normals, tangents, uvs: [uv0, uv1], colours } = &mut shape;
            morph.apply(Displaced { vectors: [positions, normals, tangents], uvs: [uv0, uv1], colours }, weights)?;
        }
        Ok(shape)
    }
}

/// The transform of a vertex to world space.
#[derive(Clone, Copy)]
struct Transform {
    affine: DAffine3,
    /// Its cofactor matrix, negated if it mirrors: the winding of triangles is then flipped, and normals must stay on
    /// their front.
    normal_matrix: DMat3,
    mirrors: bool,
}

impl Transform {
    fn new(affine: DAffine3) -> Transform {
        let mirrors = affine.matrix3.determinant() < 0.0;
        let sign = if mirrors { -1.0 } else { 1.0 };
        Transform { affine, normal_matrix: cofactor(&affine.matrix3) * sign, mirrors }
    }
}

/// The transforms of a primitive's vertices.
enum Transforms<'p> {
    Rigid(Transform),
    Skin { influences: &'p Influences<'p>, joints: &'p [DAffine3] },
}

impl Transforms<'_> {
    fn of(&self, vertex: usize) -> Transform {
        match self {
            Transforms::Rigid(transform) => *transform,
            Transforms::Skin { influences, joints } => Transform::new(influences.matrix(vertex, joints)),
        }
    }

    /// Whether a triangle is mirrored. Joints may mirror one corner and not the others.
    fn mirror(&self, corners: [u32; 3]) -> bool {
        match self {
            Transforms::Rigid(transform) => transform.mirrors,
            Transforms::Skin { influences, joints } => {
                let determinant = |vertex: u32| influences.matrix(vertex as usize, joints).matrix3.determinant();
                corners.map(determinant).iter().sum::<f64>() < 0.0
            }
        }
    }
}

/// The cofactor matrix, which is the determinant times the inverse transpose. It exists even if the inverse does not.
fn cofactor(m: &DMat3) -> DMat3 {
    DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
}

/// The unit vector along `v`, or zero if `v` has no direction.
fn unit(v: DVec3) -> Vec3 {
    let largest = v.abs().max_element();
    // Divided first, because the squares of large or small scales could overflow or underflow.
    (v / largest).try_normalize().map_or(Vec3::ZERO, |v| v.as_vec3())
}
