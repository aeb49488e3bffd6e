//! A binary BVH built with the binned surface-area heuristic. Its depth is bounded by construction.

use glam::Vec3;

use super::aabb::Aabb;

/// Number of bins per axis. More bins lower the SAH cost of the scenes that were tried by less than 1 %.
const BINS: usize = 32;
/// Up to this number of triangles every split is tried instead, because bins would be wider than the gaps between
/// centroids.
const MAX_SWEEP: usize = 32;
/// Minimum number of triangles below a node for its children to be built in parallel: a task costs about as much as
/// sorting this many.
const MIN_PARALLEL: usize = 2048;

/// A node of the binary tree. Nodes are stored in pre-order: a subtree of `count` triangles has `2 count - 1` nodes,
/// the left child follows its parent, and the right child follows the subtree of the left one.
#[derive(Clone, Copy, Default)]
pub(super) struct Node {
    pub bounds: Aabb,
    /// Number of triangles in the subtree.
    pub count: u32,
    /// Number of triangles below the left child. 0 for a leaf, which holds one triangle.
    pub left_count: u32,
}

impl Node {
    pub fn is_leaf(&self) -> bool {
        self.left_count == 0
    }

    /// The indices of the children of the node with index `at`.
    pub fn children(&self, at: usize) -> [usize; 2] {
        [at + 1, at + 2 * self.left_count as usize]
    }
}

/// A triangle during the build, or whatever else has a box.
#[derive(Clone, Copy)]
pub(super) struct Item {
    pub bounds: Aabb,
    pub index: u32,
}

impl Item {
    fn centroid(&self) -> Vec3 {
        0.5 * self.bounds.min + 0.5 * self.bounds.max
    }
}

/// Builds the tree over `items` and sorts them in the order of its leaves. No leaf is more than `max_depth` levels
/// below the root, or than the depth of a balanced tree if that is larger.
pub(super) fn build(items: &mut [Item], max_depth: u32) -> Vec<Node> {
    let mut nodes = vec![Node::default(); (2 * items.len()).saturating_sub(1)];
    if !items.is_empty() {
        build_node(items, &mut nodes, max_depth.max(levels(items.len())));
    }
    nodes
}

/// Number of levels below the root of a balanced tree over `count` triangles.
fn levels(count: usize) -> u32 {
    count.next_power_of_two().trailing_zeros()
}

fn build_node(items: &mut [Item], nodes: &mut [Node], depth_left: u32) {
    let bounds = items.iter().fold(Aabb::EMPTY, |all, item| all.union(&item.bounds));
    let (node, below) = nodes.split_first_mut().expect("there are 2 count - 1 nodes");
    let count = items.len();
    *node = Node { bounds, count: count as u32, left_count: 0 };
    if count == 1 {
        return;
    }
    // A split is allowed only if both sides fit in the remaining depth when their items are halved by index. Halving
    // always fits, and is the only split if all centroids coincide.
    let fits = |left: usize| {
        left > 0 && left < count && levels(left) < depth_left.max(1) && levels(count - left) < depth_left.max(1)
    };
    let left_count = if count <= MAX_SWEEP { split_by_sweep(items, fits) } else { split_by_bins(items, fits) };
    let left_count = left_count.unwrap_or(count / 2);
    node.left_count = left_count as u32;
    let (left_items, right_items) = items.split_at_mut(left_count);
    let (left_nodes, right_nodes) = below.split_at_mut(2 * left_count - 1);
    let depth_left = depth_left.saturating_sub(1);
    if count < MIN_PARALLEL {
        build_node(left_items, left_nodes, depth_left);
        build_node(right_items, right_nodes, depth_left);
    } else {
        rayon::join(
            || build_node(left_items, left_nodes, depth_left),
            || build_node(right_items, right_nodes, depth_left),
        );
    }
}

/// The split of the sorted centroids with the minimum cost. Sorts `items` along its axis and returns the number of
/// items on the left.
fn split_by_sweep(items: &mut [Item], fits: impl Fn(usize) -> bool) -> Option<usize> {
    let mut best: Option<(f32, usize, usize)> = None;
    let mut right_costs = [0.0; MAX_SWEEP];
    for axis in 0..3 {
        sort_along(items, axis);
        let mut right = Aabb::EMPTY;
        for (at, item) in items.iter().enumerate().rev() {
            right = right.union(&item.bounds);
            right_costs[at] = right.half_area() * (items.len() - at) as f32;
        }
        let mut left = Aabb::EMPTY;
        for count in 1..items.len() {
            left = left.union(&items[count - 1].bounds);
            let cost = left.half_area() * count as f32 + right_costs[count];
            if fits(count) && best.is_none_or(|(min, ..)| cost < min) {
                best = Some((cost, axis, count));
            }
        }
    }
    let (_, axis, count) = best?;
    sort_along(items, axis);
    Some(count)
}

/// Sorts by centroid, then by index, so that the tree does not depend on the order of `items`.
fn sort_along(items: &mut [Item], axis: usize) {
    items.sort_unstable_by(|a, b| a.centroid()[axis].total_cmp(&b.centroid()[axis]).then(a.index.cmp(&b.index)));
}

/// The split between bins of equal width with the minimum cost. Partitions `items` and returns the number of items on
/// the left. Returns `None` if all centroids are in one bin or no split fits.
fn split_by_bins(items: &mut [Item], fits: impl Fn(usize) -> bool) -> Option<usize> {
    let centroids = items.iter().fold(Aabb::EMPTY, |all, item| all.extended(item.centroid()));
    let extent = centroids.max - centroids.min;
    let bin_of = |item: &Item, axis: usize| {
        let position = (item.centroid()[axis] - centroids.min[axis]) / extent[axis];
        ((position * BINS as f32) as usize).min(BINS - 1)
    };
    let axes = (0..3).filter(|&axis| extent[axis] > 0.0);
    let mut bins = [[(Aabb::EMPTY, 0usize); BINS]; 3];
    for item in items.iter() {
        for axis in axes.clone() {
            let (bounds, count) = &mut bins[axis][bin_of(item, axis)];
            *bounds = bounds.union(&item.bounds);
            *count += 1;
        }
    }
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in axes {
        let mut right_costs = [0.0; BINS];
        let (mut right, mut right_count) = (Aabb::EMPTY, 0);
        for (at, (bounds, count)) in bins[axis].iter().enumerate().rev() {
            right = right.union(bounds);
            right_count += count;
            right_costs[at] = right.half_area() * right_count as f32;
        }
        let (mut left, mut left_count) = (Aabb::EMPTY, 0);
        for at in 1..BINS {
            let (bounds, count) = &bins[axis][at - 1];
            left = left.union(bounds);
            left_count += count;
            let cost = left.half_area() * left_count as f32 + right_costs[at];
            if fits(left_count) && best.is_none_or(|(min, ..)| cost < min) {
                best = Some((cost, axis, at));
            }
        }
    }
    let (_, axis, first_right) = best?;
    let mut left_count = 0;
    for at in 0..items.len() {
        if bin_of(&items[at], axis) < first_right {
            items.swap(at, left_count);
            left_count += 1;
        }
    }
    Some(left_count)
}
