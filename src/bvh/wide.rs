//! Collapses the binary tree to four children per node at the minimum expected cost.

use super::aabb::Aabb;
use super::binary;
use super::node::WIDTH;

/// Maximum number of triangles in a leaf.
pub(super) const MAX_LEAF: u32 = 4;

/// Cost of a triangle test over the cost of a node visit. Both fetch three texels, and a node visit ends with a sort.
/// On lavapipe no value from 0.35 to 1 makes a measurable difference.
const TRIANGLE_COST: f32 = 0.6;

/// A child of a wide node: a wide node or a leaf that replaces a subtree of the binary tree.
#[derive(Clone, Copy)]
pub(super) struct Child {
    pub bounds: Aabb,
    /// Index of the root of that subtree.
    pub at: usize,
    /// Number of triangles of a leaf, 0 for a wide node.
    pub leaf_count: u32,
}

/// For each binary node, the minimum cost of representing its triangles by at most 1, 2 or 3 children of a wide node,
/// and how that cost is reached (Ylitie, Karras and Laine 2017, section 3.1, for four children).
pub(super) struct Collapse<'a> {
    nodes: &'a [binary::Node],
    choices: Vec<[Choice; WIDTH - 1]>,
    /// If the node becomes a wide node: the number of its four children that represent the left binary child.
    left_shares: Vec<u8>,
}

#[derive(Clone, Copy)]
struct Choice {
    cost: f32,
    kind: Kind,
}

#[derive(Clone, Copy)]
enum Kind {
    Leaf,
    Wide,
    /// The left binary child gets this number of children, the right one the rest.
    Split(u8),
    /// The same as with one child fewer.
    Fewer,
}

impl<'a> Collapse<'a> {
    /// The collapse to leaves of at most `max_leaf` triangles.
    pub fn new(nodes: &'a [binary::Node], max_leaf: u32) -> Self {
        let none = Choice { cost: f32::INFINITY, kind: Kind::Leaf };
        let mut choices = vec![[none; WIDTH - 1]; nodes.len()];
        let mut left_shares = vec![0; nodes.len()];
        // Children follow their parents, so the reverse order visits them first.
        for (at, node) in nodes.iter().enumerate().rev() {
            let area = node.bounds.half_area();
            let mut leaf = none;
            if node.count <= max_leaf {
                leaf.cost = area * node.count as f32 * TRIANGLE_COST;
            }
            if node.is_leaf() {
                choices[at] = [leaf; WIDTH - 1];
                continue;
            }
            let [left, right] = node.children(at);
            let split = |budget: usize| {
                // The even share comes first, so that it is kept at equal costs. This keeps the tree shallow.
                [2, 1, 3]
                    .into_iter()
                    .filter(|&share| share < budget)
                    .map(|share| {
                        let cost = cost_below(&choices, left, share) + cost_below(&choices, right, budget - share);
                        Choice { cost, kind: Kind::Split(share as u8) }
                    })
                    .min_by(|a, b| a.cost.total_cmp(&b.cost))
                    .expect("the budget is at least two")
            };
            let wide = split(WIDTH);
            let Kind::Split(share) = wide.kind else { unreachable!("split only splits") };
            left_shares[at] = share;
            let wide = Choice { cost: wide.cost + area, kind: Kind::Wide };
            let mut best = [if node.count <= max_leaf && leaf.cost <= wide.cost { leaf } else { wide }; WIDTH - 1];
            for budget in 2..WIDTH {
                let fewer = Choice { cost: best[budget - 2].cost, kind: Kind::Fewer };
                let split = split(budget);
                best[budget - 1] = if split.cost < fewer.cost { split } else { fewer };
            }
            choices[at] = best;
        }
        Collapse { nodes, choices, left_shares }
    }

    /// The one to four children of the wide node that replaces the binary node with index `at`.
    pub fn children(&self, at: usize) -> Vec<Child> {
        let mut children = Vec::with_capacity(WIDTH);
        let node = &self.nodes[at];
        if node.is_leaf() {
            // The root is a wide node even if the tree has a single triangle.
            children.push(Child { bounds: node.bounds, at, leaf_count: node.count });
        } else {
            let [left, right] = node.children(at);
            let share = self.left_shares[at] as usize;
            self.gather(left, share, &mut children);
            self.gather(right, WIDTH - share, &mut children);
        }
        children
    }

    fn gather(&self, at: usize, budget: usize, children: &mut Vec<Child>) {
        let node = &self.nodes[at];
        match self.choices[at][budget - 1].kind {
            Kind::Leaf => children.push(Child { bounds: node.bounds, at, leaf_count: node.count }),
            Kind::Wide => children.push(Child { bounds: node.bounds, at, leaf_count: 0 }),
            Kind::Fewer => self.gather(at, budget - 1, children),
            Kind::Split(share) => {
                let [left, right] = node.children(at);
                self.gather(left, share as usize, children);
                self.gather(right, budget - share as usize, children);
            }
        }
    }
}

fn cost_below(choices: &[[Choice; WIDTH - 1]], at: usize, budget: usize) -> f32 {
    choices[at][budget - 1].cost
}
