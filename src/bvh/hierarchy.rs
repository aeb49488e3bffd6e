//! Building the hierarchy in the form that kernels read.

use glam::Vec3;
use rayon::prelude::*;

use super::aabb::Aabb;
use super::binary;
use super::node::{self, Node};
use super::wide::Collapse;
use crate::{Error, Result};

/// Maximum coordinate. Kernels divide it by components of directions as small as 2^-80, and the quotient must be
/// finite.
pub(super) const MAX_COORDINATE: f32 = (1u64 << 40) as f32;

/// Maximum depth of the binary tree in the first attempt: twice that of a balanced tree over the maximum number of
/// triangles.
const INITIAL_MAX_DEPTH: u32 = 56;

/// Entries of a kernel's traversal stack: one for each level that a balanced tree over the maximum number of triangles
/// can have.
pub(crate) const STACK_SIZE: u32 = 28;

/// Texels of a node in [`Bvh::nodes`].
pub(crate) const NODE_TEXELS: u32 = node::WORDS as u32 / 4;

/// Texels of a triangle in [`Bvh::triangles`].
pub(crate) const TRIANGLE_TEXELS: u32 = 3;

/// Bits of a node's word that hold the index of a node or a triangle.
pub(crate) const INDEX_MASK: u32 = node::MAX_INDEX as u32 - 1;

/// Bits of a word on a kernel's stack that hold the index of a node.
pub(crate) const NODE_INDEX_MASK: u32 = node::MAX_NODES as u32 - 1;

/// Maximum depth of a hierarchy whose traversal stack fits in four registers (the feature `shallow_bvh`).
const MAX_SHALLOW_DEPTH: u32 = 5;

/// A hierarchy over triangles, in the form that kernels read.
///
/// Kernels identify a triangle by its *primitive index*, its position in the order of the leaves.
#[derive(Clone, Debug)]
pub struct Bvh {
    /// Three texels per node, the root first, in the layout of `shaders/lib/bvh.wgsl`.
    pub nodes: Vec<[u32; 4]>,
    /// Three texels per triangle: its corners in scene units. The fourth component of the first texel is the triangle's
    /// word ([`set_triangle_word`](Self::set_triangle_word)), those of the others are 0. An empty hierarchy has one
    /// triangle of zeros that no leaf refers to, so that no buffer is empty.
    pub triangles: Vec<[f32; 4]>,
    /// For each primitive index, the index of its triangle in the input of [`build`](Self::build).
    pub order: Vec<u32>,
    /// Number of levels of nodes, 1 if the root has no child nodes. A traversal stack needs an entry for each level but
    /// the last.
    pub depth: u32,
    /// The bounding box of all triangles, [`Aabb::EMPTY`] if there are none.
    pub bounds: Aabb,
}

impl Bvh {
    /// Whether kernels can be composed with the feature `shallow_bvh`, which makes traversal faster.
    pub fn is_shallow(&self) -> bool {
        self.depth <= MAX_SHALLOW_DEPTH
    }

    /// Builds the hierarchy over triangles given by their corners. Any number of triangles of any shape is allowed.
    ///
    /// The result does not depend on the number of threads.
    ///
    /// # Errors
    ///
    /// [`Error::Usage`] if a coordinate is not finite or its magnitude exceeds 2^40; scenes are normalised first.
    /// [`Error::Buffer`] for 2^28 triangles or more, and for more than 2^24 nodes (about twice as many triangles).
    pub fn build(positions: &[[Vec3; 3]]) -> Result<Bvh> {
        if positions.len() >= node::MAX_INDEX {
            return Err(too_large("bvh_triangles", positions.len(), node::MAX_INDEX));
        }
        let usable =
            |corners: &[Vec3; 3]| corners.iter().all(|corner| corner.abs().cmple(Vec3::splat(MAX_COORDINATE)).all());
        if let Some(at) = positions.par_iter().position_first(|corners| !usable(corners)) {
            return Err(Error::Usage(format!(
                "triangle {at} has a corner that is not finite or beyond {MAX_COORDINATE:e}"
            )));
        }
        let mut items: Vec<_> = positions
            .par_iter()
            .enumerate()
            .map(|(at, corners)| binary::Item { bounds: Aabb::of(corners), triangle: at as u32 })
            .collect();
        let mut max_depth = INITIAL_MAX_DEPTH;
        loop {
            let tree = binary::build(&mut items, max_depth);
            let bvh = flatten(&tree, &items, positions);
            // The loop ends, because a balanced tree has at most 28 levels of nodes, as many as the binary tree, and
            // each level but the last needs at most one entry on the stack.
            const { assert!(STACK_SIZE >= node::MAX_INDEX.ilog2()) };
            if bvh.nodes.len() / NODE_TEXELS as usize > node::MAX_NODES {
                return Err(too_large("bvh_nodes", bvh.nodes.len() / NODE_TEXELS as usize, node::MAX_NODES));
            }
            if bvh.depth <= STACK_SIZE + 1 {
                return Ok(bvh);
            }
            max_depth /= 2;
        }
    }

    /// Sets the word of a triangle, initially 0. Kernels read it from the bits of w of the triangle's first texel.
    ///
    /// The renderer may store any flags there. In kernels composed with `alpha_test`, bit 0 means that `alpha_blocks`
    /// decides whether the triangle stops a ray.
    pub fn set_triangle_word(&mut self, primitive: u32, word: u32) {
        self.triangles[3 * primitive as usize][3] = f32::from_bits(word);
    }
}

/// The error for too many nodes or triangles, which have 48 bytes each.
fn too_large(buffer: &str, count: usize, max: usize) -> Error {
    let [needed, limit] = [count, max].map(|count| count as u64 * 48);
    Error::Buffer { buffer: buffer.into(), needed, limit, remedy: "use fewer triangles".into() }
}

/// Lays out the wide nodes such that the children of each node are contiguous.
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
    // Wide nodes to be filled: index, index of the binary node, level.
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
        for (i, child) in children.iter().enumerate() {
            node.leaf_counts[i] = child.leaf_count;
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
