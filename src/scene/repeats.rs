//! Which meshes of a file are stored once, however often nodes place them.

use std::cmp::Reverse;
use std::collections::HashMap;

use glam::{DAffine3, DMat3, Vec3};

use super::instance::MAX_STRETCH;
use super::material::Material;
use super::mesh::Mesh;

/// Triangles up to which every copy of a mesh has its own. The BVH is then one tree, in which rays take fewer steps and
/// software devices trace them in packets; such a scene needs some 1.6 GB of the host's memory.
const MAX_COPIED: usize = 1 << 22;

/// Minimum number of triangles of a mesh that is stored once. An instance takes 112 bytes and its share of the upper
/// part of the BVH, and a copied triangle 64 bytes or more.
const MIN_TRIANGLES: usize = 4;

/// Maximum number of copies in a file whose meshes are stored once. Each takes up to a kilobyte of the host's memory.
const MAX_INSTANCES: usize = 1 << 22;

/// Limit of the index that kernels give to a triangle of an instance. Below 2^30 its bits, read as a float, are no NaN,
/// and it is not the index of a procedural object.
pub(crate) const MAX_PRIMITIVES: usize = 1 << 30;

/// Decides which meshes are stored once.
pub(super) struct Repeats {
    limit: usize,
    meshes: Vec<Repeated>,
    /// For each node, by its index, how many of its copies can be instances.
    shareable: HashMap<usize, usize>,
}

/// A mesh and its copies.
#[derive(Default)]
struct Repeated {
    triangles: usize,
    copies: usize,
    /// Copies that can be instances.
    shareable: usize,
    is_shared: bool,
}

impl Repeated {
    fn copied_triangles(&self) -> usize {
        self.triangles.saturating_mul(self.copies)
    }

    /// Number of triangles that storing the mesh once saves.
    fn saved_triangles(&self) -> usize {
        self.triangles.saturating_mul(self.shareable.saturating_sub(1))
    }
}

impl Repeats {
    /// No mesh is stored once if all copies have at most `limit` triangles in total (`None`: the default).
    pub fn new(meshes: &[Mesh], limit: Option<usize>) -> Repeats {
        let triangles = |mesh: &Mesh| mesh.primitives.iter().map(|primitive| primitive.triangles.len()).sum();
        let meshes = meshes.iter().map(|mesh| Repeated { triangles: triangles(mesh), ..Repeated::default() }).collect();
        Repeats { limit: limit.unwrap_or(MAX_COPIED), meshes, shareable: HashMap::new() }
    }

    /// Counts copies of a mesh.
    pub fn add_copies(&mut self, mesh: usize, copies: usize) {
        let copied = &mut self.meshes[mesh].copies;
        *copied = copied.saturating_add(copies);
    }

    /// Counts the copies of a mesh at a node that can be instances.
    pub fn add_shareable(&mut self, mesh: usize, node: usize, count: usize) {
        self.meshes[mesh].shareable += count;
        self.shareable.insert(node, count);
    }

    /// Whether there are enough triangles to store meshes once, and not too many copies to visit each.
    pub fn are_worthwhile(&self) -> bool {
        let copies = self.meshes.iter().fold(0usize, |sum, mesh| sum.saturating_add(mesh.copies));
        self.copied_triangles() > self.limit && copies <= MAX_INSTANCES
    }

    fn copied_triangles(&self) -> usize {
        self.meshes.iter().fold(0, |sum, mesh| sum.saturating_add(mesh.copied_triangles()))
    }

    /// Selects meshes to be stored once, the ones that save most triangles first, until the rest is within the limit.
    pub fn decide(&mut self) {
        let mut rest = self.copied_triangles();
        let mut order: Vec<usize> = (0..self.meshes.len()).collect();
        order.sort_by_key(|&i| Reverse(self.meshes[i].saved_triangles()));
        let (mut instances, mut largest) = (0, 1);
        for i in order {
            let mesh = &mut self.meshes[i];
            if rest <= self.limit || mesh.saved_triangles() == 0 {
                break;
            }
            let all_instances = instances + mesh.shareable;
            let all_largest = mesh.triangles.next_power_of_two().max(largest);
            let left = rest - mesh.saved_triangles();
            // The same count as in src/bvh/instanced.rs, with one instance for the rest.
            let indices = all_largest.saturating_mul(all_instances + 1).saturating_add(left);
            if mesh.triangles >= MIN_TRIANGLES && indices <= MAX_PRIMITIVES {
                (mesh.is_shared, rest, instances, largest) = (true, left, all_instances, all_largest);
            }
        }
    }

    /// Number of instances at a node of the mesh.
    pub fn instances_at(&self, node: usize, mesh: usize) -> usize {
        if self.meshes[mesh].is_shared { self.shareable.get(&node).copied().unwrap_or(0) } else { 0 }
    }
}

/// Whether copies of the mesh can be instances. Lights are lists of triangles, and joints and morph targets move each
/// copy's vertices by themselves.
pub(super) fn is_rigid(mesh: &Mesh, weights: &[f64], skinned: bool, materials: &[Material]) -> bool {
    let shines = |material: Option<usize>| material.is_some_and(|m| materials[m].emissive != Vec3::ZERO);
    let emits = mesh.primitives.iter().any(|primitive| shines(primitive.material));
    !skinned && !emits && weights.iter().all(|weight| *weight == 0.0)
}

/// Whether a mesh that is placed by the transform can be an instance.
pub(super) fn is_shareable(world: &DAffine3) -> bool {
    let frobenius = |m: &DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
    let stretch = frobenius(&world.matrix3) * frobenius(&world.matrix3.inverse()) / 3.0;
    // False for NaN, which matrices without an inverse give.
    world.is_finite() && stretch <= MAX_STRETCH
}
