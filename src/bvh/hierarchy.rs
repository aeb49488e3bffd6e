//! Building the hierarchy in the form that kernels read.

use glam::Vec3;
use rayon::prelude::*;

use super::aabb::Aabb;
use super::binary;
use super::node::{self, Node};
use super::wide::Collapse;
use crate::{Error, Result};

/// Largest coordinate: kernels divide it by directions' components of 2^-80, and the quotient must be finite.
const LARGEST: f32 = (1u64 << 40) as f32;

/// Depth of the binary tree that is allowed at first: twice that of a balanced tree over the most triangles.
const FIRST_DEPTH: u32 = 56;

/// Entries of a kernel's traversal stack.
pub(super) const STACK_SIZE: u32 = constant_in(include_str!("../../shaders/lib/bvh.wgsl"), "const STACK_SIZE = ");

/// Most levels of a hierarchy whose traversals keep their stack in four registers (the feature `shallow_bvh`).
const SHALLOW: u32 = 5;

/// A hierarchy over triangles, in the form that kernels read.
///
/// Triangles are known to kernels by their *slot*, their place in the order of the leaves.
#[derive(Clone, Debug)]
pub struct Bvh {
    /// Three texels a node, the root first; the layout is that of `shaders/lib/bvh.wgsl`.
    pub nodes: Vec<[u32; 4]>,
    /// Three texels a slot: the three corners, in scene units. The fourth component of the first is the slot's word
    /// ([`set_triangle_word`](Self::set_triangle_word)), those of the others are 0. Without triangles there is one
    /// slot, of zeros, that no leaf names, so that no buffer is empty.
    pub triangles: Vec<[f32; 4]>,
    /// The triangle, as an index into what was built from, of each slot.
    pub order: Vec<u32>,
    /// Levels of nodes; 1 where the root has no child nodes. A traversal's stack needs an entry for each but the last.
    pub depth: u32,
    /// The box around all triangles; [`Aabb::EMPTY`] without any.
    pub bounds: Aabb,
}

impl Bvh {
    /// Whether kernels can be composed with the feature `shallow_bvh`, which traverses it faster.
    pub fn is_shallow(&self) -> bool {
        self.depth <= SHALLOW
    }

    /// Builds the hierarchy over triangles given by their corners, of any number (0 included) and shape.
    ///
    /// The same triangles give the same hierarchy, however many threads there are.
    ///
    /// # Errors
    ///
    /// [`Error::Usage`] where a coordinate is not finite or its size is above 2^40: a scene is normalised first. [`Error::Buffer`] for 2^28 triangles or more, and for
    /// more than 2^24 nodes (about twice as many triangles).
    pub fn build(positions: &[[Vec3; 3]]) -> Result<Bvh> {
        if positions.len() >= node::MAX_INDEX {
            return Err(too_large("bvh_triangles", positions.len(), node::MAX_INDEX));
        }
        let usable = |corners: &[Vec3; 3]| corners.iter().all(|corner| corner.abs().cmple(Vec3::splat(LARGEST)).all());
        if let Some(at) = positions.par_iter().position_first(|corners| !usable(corners)) {
            return Err(Error::Usage(format!("triangle {at} has a corner that is not finite or beyond {LARGEST:e}")));
        }
        let mut items: Vec<_> = positions
            .par_iter()
            .enumerate()
            .map(|(at, corners)| binary::Item { bounds: Aabb::of(corners), triangle: at as u32 })
            .collect();
        let mut max_depth = FIRST_DEPTH;
        loop {
            let tree = binary::build(&mut items, max_depth);
            let bvh = flatten(&tree, &items, positions);
            // This ends: once nothing but a balanced tree is allowed, there are at most 28 levels of nodes, as many
            // as binary ones, and each but the last leaves at most one entry on the stack.
            const { assert!(STACK_SIZE >= node::MAX_INDEX.ilog2()) };
            if bvh.nodes.len() / 3 > node::MAX_NODES {
                return Err(too_large("bvh_nodes", bvh.nodes.len() / 3, node::MAX_NODES));
            }
            if bvh.depth <= STACK_SIZE + 1 {
                return Ok(bvh);
            }
            max_depth /= 2;
        }
    }

    /// Sets the word of a slot, 0 at first, which kernels read as the bits of `bvh_triangles`' first texel's w.
    ///
    /// The word is free for the renderer's flags. Kernels composed with `alpha_test` take bit 0 to mean that
    /// `alpha_blocks` decides whether a ray is stopped.
    pub fn set_triangle_word(&mut self, slot: u32, word: u32) {
        self.triangles[3 * slot as usize][3] = f32::from_bits(word);
    }
}

/// Nodes and triangles are 48 bytes each.
fn too_large(buffer: &str, count: usize, most: usize) -> Error {
    let [needed, limit] = [count, most].map(|count| count as u64 * 48);
    Error::Buffer { buffer: buffer.into(), needed, limit, remedy: "use fewer triangles".into() }
}

/// Lays the wide nodes out, the children of each together.
fn flatten(tree: &[binary::Node], items: &[binary::Item], positions: &[[Vec3; 3]]) -> Bvh {
    let mut first_items = vec![0u32; tree.len()];
    for (at, node) in tree.iter().enumerate().filter(|(_, node)| !node.is_leaf()) {
        let [left, right] = node.children(at);
        first_items[left] = first_items[at];
        first_items[right] = first_items[at] + node.left_count;
    }
    let collapse = Collapse::new(tree);
    let mut nodes = vec![Node::around(&[])];
    let mut order = Vec::with_capacity(items.len());
    let mut depth = 1;
    // A wide node to be filled: its index, its binary node and its level.
    let mut open = Vec::new();
    if !tree.is_empty() {
        open.push((0usize, 0usize, 1u32));
    }
    while let Some((index, at, level)) = open.pop() {
        let mut children = collapse.children(at);
        children.sort_by_key(|child| child.leaf_count != 0);
        let bounds: Vec<_> = children.iter().map(|child| child.bounds).collect();
        let mut node = Node::around(&bounds);
        node.first_node = nodes.len() as u32;
        node.first_triangle = order.len() as u32;
        depth = depth.max(level);
        for (place, child) in children.iter().enumerate() {
            node.leaf_counts[place] = child.leaf_count;
            if child.leaf_count == 0 {
                node.node_count += 1;
                open.push((nodes.len(), child.at, level + 1));
                nodes.push(Node::around(&[]));
            } else {
                let first = first_items[child.at] as usize;
                order.extend(items[first..first + child.leaf_count as usize].iter().map(|item| item.triangle));
            }
        }
        nodes[index] = node;
    }
    let triangles = order
        .par_iter()
        .flat_map_iter(|&triangle| positions[triangle as usize].map(|corner| corner.extend(0.0).to_array()))
        .collect::<Vec<_>>();
    Bvh {
        nodes: nodes.iter().flat_map(Node::pack).collect(),
        triangles: if triangles.is_empty() { vec![[0.0; 4]; 3] } else { triangles },
        order,
        depth,
        bounds: tree.first().map_or(Aabb::EMPTY, |root| root.bounds),
    }
}

/// The number that follows `name` in `source`: what a kernel and the host must agree on stands in the kernel alone.
const fn constant_in(source: &str, name: &str) -> u32 {
    let (source, name) = (source.as_bytes(), name.as_bytes());
    let mut at = 0;
    loop {
        let mut same = 0;
        while same < name.len() && source[at + same] == name[same] {
            same += 1;
        }
        if same == name.len() {
            break;
        }
        at += 1;
    }
    at += name.len();
    let mut value = 0;
    while source[at].is_ascii_digit() {
        value = 10 * value + (source[at] - b'0') as u32;
        at += 1;
    }
    value
}
