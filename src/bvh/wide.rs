//! The binary tree collapsed to four children a node at the least expected cost.

use super::aabb::Aabb;
use super::binary;
use super::node::WIDTH;

/// Most triangles of a leaf.
const MAX_LEAF: u32 = 4;

/// Cost of testing a triangle over that of visiting a node: both fetch three texels, and a node is followed by a sort. On
/// lavapipe 0.35 to 1 make no difference that shows.
const TRIANGLE_COST: f32 = 0.6;

/// A child of a wide node: a wide node or a leaf, by the place of the binary node that it stands for.
#[derive(Clone, Copy)]
pub(super) struct Child {
    pub bounds: Aabb,
    /// Place of the binary node.
    pub at: usize,
    /// Triangles of a leaf; 0 for a wide node.
    pub leaf_count: u32,
}

/// For each binary node, the least cost of putting its triangles below at most 1, 2 or 3 children of a wide node,
/// and how that is done (Ylitie, Karras and Laine 2017, section 3.1, for four children).
pub(super) struct Collapse<'a> {
    nodes: &'a [binary::Node],
    choices: Vec<[Choice; WIDTH - 1]>,
    /// How many of the four children the left binary child gets, where the node is made a wide one.
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
    /// The left binary child takes so many of the places, the right one the rest.
    Split(u8),
    /// As with one place fewer.
    Fewer,
}

impl<'a> Collapse<'a> {
    pub fn new(nodes: &'a [binary::Node]) -> Self {
        let none = Choice { cost: f32::INFINITY, kind: Kind::Leaf };
        let mut choices = vec![[none; WIDTH - 1]; nodes.len()];
        let mut left_shares = vec![0; nodes.len()];
        // Children lie behind their parents, so this meets them first.
        for (at, node) in nodes.iter().enumerate().rev() {
            let area = node.bounds.half_area();
            let mut leaf = none;
            if node.count <= MAX_LEAF {
                leaf.cost = area * node.count as f32 * TRIANGLE_COST;
            }
            if node.is_leaf() {
                choices[at] = [leaf; WIDTH - 1];
                continue;
            }
            let [left, right] = node.children(at);
            let split = |places: usize| {
                // Even shares first: they are kept where costs are equal, and keep the tree shallow.
                [2, 1, 3]
                    .into_iter()
                    .filter(|&share| share < places)
                    .map(|share| {
                        let cost = cost_below(&choices, left, share) + cost_below(&choices, right, places - share);
                        Choice { cost, kind: Kind::Split(share as u8) }
                    })
                    .min_by(|a, b| a.cost.total_cmp(&b.cost))
                    .expect("two places or more")
            };
            let wide = split(WIDTH);
            let Kind::Split(share) = wide.kind else { unreachable!("split only splits") };
            left_shares[at] = share;
            let wide = Choice { cost: wide.cost + area, kind: Kind::Wide };
            let mut best = [if node.count <= MAX_LEAF && leaf.cost <= wide.cost { leaf } else { wide }; WIDTH - 1];
            for places in 2..WIDTH {
                let fewer = Choice { cost: best[places - 2].cost, kind: Kind::Fewer };
                let split = split(places);
                best[places - 1] = if split.cost < fewer.cost { split } else { fewer };
            }
            choices[at] = best;
        }
        Collapse { nodes, choices, left_shares }
    }

    /// The children of the wide node that stands for the binary node at `at`: one to four.
    pub fn children(&self, at: usize) -> Vec<Child> {
        let mut children = Vec::with_capacity(WIDTH);
        let node = &self.nodes[at];
        if node.is_leaf() {
            // The root of a tree of one triangle is a wide node all the same.
            children.push(Child { bounds: node.bounds, at, leaf_count: node.count });
        } else {
            let [left, right] = node.children(at);
            let share = self.left_shares[at] as usize;
            self.gather(left, share, &mut children);
            self.gather(right, WIDTH - share, &mut children);
        }
        children
    }

    fn gather(&self, at: usize, places: usize, children: &mut Vec<Child>) {
        let node = &self.nodes[at];
        match self.choices[at][places - 1].kind {
            Kind::Leaf => children.push(Child { bounds: node.bounds, at, leaf_count: node.count }),
            Kind::Wide => children.push(Child { bounds: node.bounds, at, leaf_count: 0 }),
            Kind::Fewer => self.gather(at, places - 1, children),
            Kind::Split(share) => {
                let [left, right] = node.children(at);
                self.gather(left, share as usize, children);
                self.gather(right, places - share as usize, children);
            }
        }
    }
}

fn cost_below(choices: &[[Choice; WIDTH - 1]], at: usize, places: usize) -> f32 {
    choices[at][places - 1].cost
}
