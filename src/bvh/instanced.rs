//! Two levels: a tree over instances, and below it a tree for each shared mesh and one for all other triangles.

use std::ops::Range;

use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::aabb::Aabb;
use super::hierarchy::{Bvh, STACK_SIZE, TRIANGLE_TEXELS, Tree, check, texels, too_large};
use super::instance_table::{INSTANCE_TEXELS, InstanceTable};
use super::node::{self, Node};
use crate::scene::repeats::MAX_PRIMITIVES;
use crate::scene::{Instance, Scene, Vertex};
use crate::{Error, Result};

/// Maximum number of levels of the tree over the instances, unless a balanced one has more. It leaves 14 for each mesh:
/// with leaves of up to four triangles enough for tens of millions.
const TOP_DEPTH: u32 = 15;

impl Bvh {
    /// The BVH over the triangles and instances of a scene.
    ///
    /// # Errors
    /// As [`Bvh::build`].
    pub fn of(scene: &Scene) -> Result<Bvh> {
        match scene.instances.is_empty() {
            true => Bvh::over(scene.triangles.len(), |triangle| scene.triangle_positions(triangle)),
            false => build(scene),
        }
    }
}

/// An instance of a mesh, or all triangles that are in no mesh, as one at the origin.
#[derive(Clone, Copy)]
struct Placed<'a> {
    mesh: Option<usize>,
    vertices: &'a [Vertex],
    instance: Instance,
}

impl Placed<'_> {
    /// A box around all points that kernels find in it.
    fn bounds(&self) -> Aabb {
        let corners = self.vertices.iter().map(|vertex| self.instance.apply_f64(vertex.position));
        let none = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let [low, high] = corners.fold(none, |[low, high], p| [low.min(p), high.max(p)]);
        let outwards = |p: DVec3, towards: f32| {
            p.as_vec3().to_array().map(|x| if towards < 0.0 { x.next_down() } else { x.next_up() })
        };
        Aabb { min: Vec3::from(outwards(low, -1.0)), max: Vec3::from(outwards(high, 1.0)) }
    }

    fn texels(&self, root: u32, offset: u32) -> [[f32; 4]; INSTANCE_TEXELS as usize] {
        let Instance { linear, origin, .. } = self.instance;
        let inverse = linear.as_dmat3().inverse().as_mat3();
        let row = |m: &Mat3, axis: usize| m.row(axis).extend(origin[axis]).to_array();
        let tree = [f32::from_bits(root), f32::from_bits(offset), 0.0, 0.0];
        let [a, b] = [&inverse, &linear].map(|m| [0, 1, 2].map(|axis| row(m, axis)));
        [a[0], a[1], a[2], tree, b[0], b[1], b[2]]
    }
}

/// The instances of a scene, and behind them the triangles that are in no shared mesh, as one more.
fn placed_instances(scene: &Scene) -> Vec<Placed<'_>> {
    let placed = |instance: &Instance| {
        let vertices = &scene.vertices[scene.shared_meshes[instance.mesh].vertices.clone()];
        Placed { mesh: Some(instance.mesh), vertices, instance: *instance }
    };
    let mut all: Vec<Placed> = scene.instances.iter().map(placed).collect();
    if scene.unshared_triangles() > 0 {
        let vertices = &scene.vertices[..scene.shared_meshes[0].vertices.start];
        let instance = Instance { mesh: 0, linear: Mat3::IDENTITY, origin: Vec3::ZERO };
        all.push(Placed { mesh: None, vertices, instance });
    }
    all
}

/// The trees of the lower level, behind the nodes of the tree over the instances.
struct LowerTrees {
    nodes: Vec<Node>,
    /// The stored triangles in the order of the leaves.
    order: Vec<u32>,
    /// Levels of the deepest.
    depth: u32,
}

impl LowerTrees {
    /// Adds a tree over some triangles, of at most `max_depth` levels. Returns the index of its root.
    fn add(
        &mut self,
        triangles: Range<usize>,
        positions: &(impl Fn(usize) -> [Vec3; 3] + Sync),
        max_depth: u32,
    ) -> Result<u32> {
        let (root, first) = (self.nodes.len() as u32, triangles.start as u32);
        let tree = Tree::of_triangles(triangles, positions, max_depth)?;
        self.depth = self.depth.max(tree.depth);
        let moved = |node: Node| Node {
            first_node: node.first_node + root,
            first_triangle: node.first_triangle + first,
            ..node
        };
        self.nodes.extend(tree.nodes.into_iter().map(moved));
        self.order.extend(tree.order.into_iter().map(|triangle| triangle + first));
        Ok(root)
    }
}

/// Where the instances are, behind `triangles` texels of triangles.
///
/// # Errors
/// [`Error::Usage`] if the triangles of all instances have more primitive indices than kernels can tell apart.
fn instance_table(scene: &Scene, instances: usize, triangles: usize) -> Result<InstanceTable> {
    let largest = scene.shared_meshes.iter().map(|mesh| mesh.triangles.len()).max().unwrap_or(1);
    let shift = largest.next_power_of_two().ilog2();
    let unshared = scene.unshared_triangles();
    let indices = unshared + (instances << shift);
    if indices > MAX_PRIMITIVES {
        return Err(Error::Usage(format!("instances have {indices} triangles in all, more than {MAX_PRIMITIVES}")));
    }
    Ok(InstanceTable { base: triangles as u32, unshared: unshared as u32, shift })
}

fn build(scene: &Scene) -> Result<Bvh> {
    let positions = |triangle: usize| scene.triangle_positions(triangle);
    check(scene.triangles.len(), &positions)?;
    let placed = placed_instances(scene);
    let boxes: Vec<Aabb> = placed.par_iter().map(Placed::bounds).collect();
    let balanced = placed.len().next_power_of_two().ilog2() + 1;
    let top = Tree::of_boxes(boxes.len(), |at| boxes[at], 1, balanced.max(TOP_DEPTH))?;

    let mut trees = LowerTrees { nodes: top.nodes, order: Vec::with_capacity(scene.triangles.len()), depth: 0 };
    let mut add = |triangles| trees.add(triangles, &positions, STACK_SIZE + 1 - top.depth);
    let unshared_root = add(0..scene.unshared_triangles())?;
    let roots = scene.shared_meshes.iter().map(|mesh| add(mesh.triangles.clone())).collect::<Result<Vec<_>>>()?;
    let LowerTrees { nodes, order, depth } = trees;
    if nodes.len() > node::MAX_NODES {
        return Err(too_large("bvh_nodes", nodes.len(), node::MAX_NODES));
    }

    let texels_of = |&triangle: &u32| texels(positions(triangle as usize));
    let table = instance_table(scene, placed.len(), order.len() * TRIANGLE_TEXELS as usize)?;
    let mut triangles: Vec<_> = order.par_iter().flat_map_iter(texels_of).collect();
    for (number, &index) in top.order.iter().enumerate() {
        let placed = &placed[index as usize];
        triangles.extend(match placed.mesh {
            None => placed.texels(unshared_root, 0),
            Some(mesh) => {
                // Added to the index of a stored triangle (modulo 2^32), the second number gives the primitive index
                // that the triangle has in this instance.
                let first = scene.shared_meshes[mesh].triangles.start as u32;
                placed.texels(roots[mesh], (table.unshared + ((number as u32) << table.shift)).wrapping_sub(first))
            }
        });
    }
    Ok(Bvh {
        nodes: nodes.iter().flat_map(Node::pack).collect(),
        triangles,
        order,
        depth: top.depth + depth,
        bounds: top.bounds,
        instances: Some(table),
    })
}
