//! Collapses the binary tree to four children per node at the minimum expected cost.

use super::aabb::Aabb;
use super::binary;
use super::node::WIDTH;

/// Maximum number of triangles in a leaf: of the sizes that were measured on lavapipe, up to four were the fastest.
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

/// For each binary node, how its triangles are represented at the minimum cost by at most 1, 2 or 3 children of a wide
/// node (Ylitie, Karras and Laine 2017, section 3.1, for four children).
pub(super) struct Collapse<'a> {
    nodes: &'a [binary::Node],
    choices: Vec<NodeChoice>,
}

/// The choices for a binary node: four bytes, because the largest scenes have 40 million of them.
#[derive(Clone, Copy)]
struct NodeChoice {
    /// The best kinds with at most 1, 2 and 3 children.
    kinds: [Kind; WIDTH - 1],
    /// If the node becomes a wide node: the number of its four children that represent the left binary child.
    left_share: Share,
}

#[derive(Clone, Copy)]
enum Kind {
    Leaf,
    Wide,
    /// The left binary child gets this number of children, the right one the rest.
    Split(Share),
    /// The same as with one child fewer.
    Fewer,
}

/// A number of children from 1 to 3. An enum, because with an integer a [`Kind`] would take two bytes.
#[derive(Clone, Copy)]
enum Share {
    One = 1,
    Two,
    Three,
}

/// The minimum costs with at most 1, 2 and 3 children.
type Costs = [f32; WIDTH - 1];

/// A number of children for the left binary child that costs least.
#[derive(Clone, Copy)]
struct Split {
    cost: f32,
    share: Share,
}

impl Split {
    /// The best split of `budget` children, at least two, between binary children of these costs.
    fn of(budget: usize, left: &Costs, right: &Costs) -> Split {
        // The even share comes first, so that it is kept at equal costs. This keeps the tree shallow.
        [Share::Two, Share::One, Share::Three]
            .into_iter()
            .filter(|&share| (share as usize) < budget)
            .map(|share| Split { cost: left[share as usize - 1] + right[budget - share as usize - 1], share })
            .min_by(|a, b| a.cost.total_cmp(&b.cost))
            .expect("the budget is at least two")
    }
}

impl<'a> Collapse<'a> {
    /// The collapse to leaves of at most `max_leaf` triangles.
    pub fn new(nodes: &'a [binary::Node], max_leaf: u32) -> Self {
        let leaf = NodeChoice { kinds: [Kind::Leaf; WIDTH - 1], left_share: Share::Two };
        let mut choices = vec![leaf; nodes.len()];
        // The costs of subtrees whose parent has not been visited yet. Children follow their parents, so the reverse
        // order visits them first; the left child, which is next to its parent, comes last.
        let mut costs: Vec<Costs> = Vec::new();
        for (node, choice) in nodes.iter().zip(&mut choices).rev() {
            let area = node.bounds.half_area();
            let may_be_leaf = node.count <= max_leaf;
            let leaf_cost = if may_be_leaf { area * node.count as f32 * TRIANGLE_COST } else { f32::INFINITY };
            if node.is_leaf() {
                costs.push([leaf_cost; WIDTH - 1]);
                continue;
            }
            let (left, right) = costs.pop().zip(costs.pop()).expect("both subtrees came before");
            let whole = Split::of(WIDTH, &left, &right);
            let wide_cost = whole.cost + area;
            let is_leaf = may_be_leaf && leaf_cost <= wide_cost;
            choice.left_share = whole.share;
            choice.kinds[0] = if is_leaf { Kind::Leaf } else { Kind::Wide };
            let mut own = [if is_leaf { leaf_cost } else { wide_cost }; WIDTH - 1];
            for budget in 2..WIDTH {
                let split = Split::of(budget, &left, &right);
                let fewer = own[budget - 2];
                (own[budget - 1], choice.kinds[budget - 1]) = match split.cost < fewer {
                    true => (split.cost, Kind::Split(split.share)),
                    false => (fewer, Kind::Fewer),
                };
            }
            costs.push(own);
        }
        Collapse { nodes, choices }
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
            let share = self.choices[at].left_share as usize;
            self.gather(left, share, &mut children);
            self.gather(right, WIDTH - share, &mut children);
        }
        children
    }

    fn gather(&self, at: usize, budget: usize, children: &mut Vec<Child>) {
        let node = &self.nodes[at];
        match self.choices[at].kinds[budget - 1] {
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
