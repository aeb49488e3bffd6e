//! A tree over boxes that is searched on the CPU, for queries of few rays.

use rayon::prelude::*;

use super::aabb::Aabb;
use super::binary::{self, Item, Node};
use super::hierarchy::INITIAL_MAX_DEPTH;

/// A binary tree over boxes.
pub struct BoxTree {
    nodes: Vec<Node>,
    /// The indices of the boxes in the order of the leaves.
    order: Vec<u32>,
}

impl BoxTree {
    /// Builds a tree over boxes. Queries return the index of a box in `boxes`.
    pub fn new(boxes: impl IndexedParallelIterator<Item = Aabb>) -> BoxTree {
        let item = |(index, bounds)| Item { bounds, index: index as u32 };
        let mut items: Vec<_> = boxes.enumerate().map(item).collect();
        let nodes = binary::build(&mut items, INITIAL_MAX_DEPTH);
        BoxTree { nodes, order: items.iter().map(|item| item.index).collect() }
    }

    /// The bounding box of all boxes.
    pub fn bounds(&self) -> Aabb {
        self.nodes.first().map_or(Aabb::EMPTY, |root| root.bounds)
    }

    /// The boxes that a ray enters, each with the distance at which it does. `enters` returns that distance for a box,
    /// or `None` if the ray misses it.
    pub fn entered(&self, enters: impl Fn(Aabb) -> Option<f64>) -> Vec<(f64, usize)> {
        let mut found = Vec::new();
        // Nodes, each with the position of its first leaf.
        let mut waiting = if self.nodes.is_empty() { Vec::new() } else { vec![(0, 0)] };
        while let Some((at, first)) = waiting.pop() {
            let node = &self.nodes[at];
            let Some(enter) = enters(node.bounds) else { continue };
            if node.is_leaf() {
                found.push((enter, self.order[first] as usize));
            } else {
                let [a, b] = node.children(at);
                waiting.extend([(b, first + node.left_count as usize), (a, first)]);
            }
        }
        found
    }
}
