//! Builds the BVH in the form that kernels read.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::aabb::Aabb;
use super::binary;
use super::instance_table::InstanceTable;
use super::node::{self, Node};
use super::wide::{Collapse, MAX_LEAF};
use crate::{Error, Result};

/// Maximum coordinate. Kernels divide it by components of directions as small as 2^-80, and the quotient must be
/// finite.
pub(super) const MAX_COORDINATE: f32 = (1u64 << 40) as f32;

/// Maximum depth of the binary tree in the first attempt: twice that of a balanced tree over the maximum number of
/// triangles.
pub(super) const INITIAL_MAX_DEPTH: u32 = 56;

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

/// Maximum depth of a BVH whose traversal stack fits in four registers (the feature `shallow_bvh`).
const MAX_SHALLOW_DEPTH: u32 = 5;

/// A BVH over triangles, in the form that kernels read.
///
/// Kernels identify a triangle by its *primitive index*, its position in the order of the leaves.
#[derive(Clone, Debug)]
pub struct Bvh {
    /// Three texels per node, the root first, in the layout of `shaders/lib/bvh.wgsl`.
    pub nodes: Vec<[u32; 4]>,
    /// Three texels per triangle: its corners in scene units. The fourth component of the first texel is the triangle's
    /// word ([`set_triangle_word`](Self::set_triangle_word)), those of the others are 0. An empty BVH has one triangle
    /// of zeros that no leaf refers to, so that no buffer is empty.
    pub triangles: Vec<[f32; 4]>,
    /// For each primitive index, the index of its triangle in the input of [`build`](Self::build).
    pub order: Vec<u32>,
    /// Number of levels of nodes, 1 if the root has no child nodes. A traversal stack needs an entry for each level but
    /// the last.
    pub depth: u32,
    /// The bounding box of all triangles, [`Aabb::EMPTY`] if there are none.
    pub bounds: Aabb,
    /// Where kernels find the instances, if there are any.
    pub instances: Option<InstanceTable>,
}

impl Bvh {
    /// Whether kernels can be composed with the feature `shallow_bvh`, which makes traversal faster.
    pub fn is_shallow(&self) -> bool {
        self.depth <= MAX_SHALLOW_DEPTH && self.instances.is_none()
    }

    /// Builds the BVH over triangles given by their corners. Any number of triangles of any shape is allowed.
    ///
    /// The result does not depend on the number of threads.
    ///
    /// # Errors
    ///
    /// [`Error::Usage`] if a coordinate is not finite or its magnitude exceeds 2^40; scenes are normalised first.
    /// [`Error::Buffer`] for 2^28 triangles or more, and for more than 2^24 nodes (about twice as many triangles).
    pub fn build(positions: &[[Vec3; 3]]) -> Result<Bvh> {
        Bvh::over(positions.len(), |triangle| positions[triangle])
    }

    /// Like [`build`](Self::build), over `count` triangles whose corners `positions` returns. A copy of the corners of
    /// the largest scenes would take another gigabyte.
    pub(super) fn over(count: usize, positions: impl Fn(usize) -> [Vec3; 3] + Sync) -> Result<Bvh> {
        check(count, &positions)?;
        // A balanced tree has at most 28 levels of nodes, as many as the binary tree, and each level but the last needs
        // at most one entry on the stack.
        const { assert!(STACK_SIZE >= node::MAX_INDEX.ilog2()) };
        let Tree { nodes, order, depth, bounds } = Tree::of_triangles(0..count, &positions, STACK_SIZE + 1)?;
        let triangles: Vec<_> =
            order.par_iter().flat_map_iter(|&triangle| texels(positions(triangle as usize))).collect();
        Ok(Bvh {
            nodes: nodes.iter().flat_map(Node::pack).collect(),
            triangles: if triangles.is_empty() { vec![[0.0; 4]; 3] } else { triangles },
            order,
            depth,
            bounds,
            instances: None,
        })
    }

    /// Sets the word of a triangle, initially 0. Kernels read it from the bits of w of the triangle's first texel.
    ///
    /// The renderer may store any flags there. In kernels composed with `alpha_test`, bit 0 means that `alpha_blocks`
    /// decides whether the triangle stops a ray.
    pub fn set_triangle_word(&mut self, primitive: u32, word: u32) {
        self.triangles[3 * primitive as usize][3] = f32::from_bits(word);
    }
}

/// Refuses triangles that are too many or too large.
pub(super) fn check(count: usize, positions: &(impl Fn(usize) -> [Vec3; 3] + Sync)) -> Result<()> {
    if count >= node::MAX_INDEX {
        return Err(too_large("bvh_triangles", count, node::MAX_INDEX));
    }
    let usable =
        |corners: [Vec3; 3]| corners.iter().all(|corner| corner.abs().cmple(Vec3::splat(MAX_COORDINATE)).all());
    if let Some(at) = (0..count).into_par_iter().find_first(|&at| !usable(positions(at))) {
        return Err(Error::Usage(format!(
            "triangle {at} has a corner that is not finite or beyond {MAX_COORDINATE:e}"
        )));
    }
    Ok(())
}

/// The texels of a triangle, whose word is 0.
pub(super) fn texels(corners: [Vec3; 3]) -> [[f32; 4]; TRIANGLE_TEXELS as usize] {
    corners.map(|corner| corner.extend(0.0).to_array())
}

/// The error for too many nodes or triangles, which have 48 bytes each.
pub(super) fn too_large(buffer: &str, count: usize, max: usize) -> Error {
    let [needed, limit] = [count, max].map(|count| count as u64 * 48);
    Error::Buffer { buffer: buffer.into(), needed, limit, remedy: "use fewer triangles".into() }
}

/// A tree of wide nodes, the root first.
pub(super) struct Tree {
    pub nodes: Vec<Node>,
    /// The indices of the triangles in the order of the leaves.
    pub order: Vec<u32>,
    /// Number of levels of nodes.
    pub depth: u32,
    pub bounds: Aabb,
}

impl Tree {
    /// The tree over a range of triangles, of at most `max_depth` levels; a balanced tree must not have more. Its
    /// indices count from the first triangle of the range.
    pub fn of_triangles(
        triangles: Range<usize>,
        positions: &(impl Fn(usize) -> [Vec3; 3] + Sync),
        max_depth: u32,
    ) -> Result<Tree> {
        let first = triangles.start;
        Tree::of_boxes(triangles.len(), |at| Aabb::of(positions(first + at)), MAX_LEAF, max_depth)
    }

    /// Like [`of_triangles`](Self::of_triangles), over `count` boxes, at most `max_leaf` of them in a leaf.
    pub fn of_boxes(
        count: usize,
        bounds: impl Fn(usize) -> Aabb + Sync,
        max_leaf: u32,
        max_depth: u32,
    ) -> Result<Tree> {
        let item = |at: usize| binary::Item { bounds: bounds(at), index: at as u32 };
        let mut binary_depth = INITIAL_MAX_DEPTH;
        loop {
            let mut items: Vec<_> = (0..count).into_par_iter().map(item).collect();
            let binary = binary::build(&mut items, binary_depth);
            // Only the indices are kept: the tree has the boxes.
            let sorted: Vec<u32> = items.par_iter().map(|item| item.index).collect();
            drop(items);
            let tree = flatten(&binary, &sorted, max_leaf);
            if tree.nodes.len() > node::MAX_NODES {
                return Err(too_large("bvh_nodes", tree.nodes.len(), node::MAX_NODES));
            }
            if tree.depth <= max_depth {
                return Ok(tree);
            }
            if binary_depth == 0 {
                return Err(Error::Usage(format!("a hierarchy over {count} instances or triangles is too deep")));
            }
            binary_depth /= 2;
        }
    }
}

/// Lays out the wide nodes such that the children of each node are contiguous. `sorted`: the triangles in the order of
/// the leaves of the binary tree.
fn flatten(tree: &[binary::Node], sorted: &[u32], max_leaf: u32) -> Tree {
    let mut first_items = vec![0u32; tree.len()];
    for (at, node) in tree.iter().enumerate().filter(|(_, node)| !node.is_leaf()) {
        let [left, right] = node.children(at);
        first_items[left] = first_items[at];
        first_items[right] = first_items[at] + node.left_count;
    }
    let collapse = Collapse::new(tree, max_leaf);
    let mut nodes = vec![Node::around(&[])];
    let mut order = Vec::with_capacity(sorted.len());
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
                order.extend_from_slice(&sorted[first..first + child.leaf_count as usize]);
            }
        }
        nodes[index] = node;
    }
    Tree { nodes, order, depth, bounds: tree.first().map_or(Aabb::EMPTY, |root| root.bounds) }
}
