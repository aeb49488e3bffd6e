//! The node layout that kernels read: three texels, 48 bytes.
//!
//! | word | bits | content |
//! | --- | --- | --- |
//! | 0 to 2 | 32 | origin of the node's grid, x y z, f32 |
//! | 3 to 5 | 4 x 8 | lower planes of the four children, x, y, z: `origin + q * step` |
//! | 6 to 8 | 4 x 8 | upper planes |
//! | 9 | 3 x 8 | exponents of the steps, x, y, z: `step` is the f32 with that exponent field and no mantissa |
//! | 9 | 24 to 27 | number of children that are nodes; nodes come first, then leaves, then unused children |
//! | 10 | 0 to 27 | index of the first child node; the others follow it |
//! | 11 | 0 to 27 | primitive index of the first triangle of the first leaf; those of the other leaves follow it |
//! | 9, 10, 11 | 28 to 31 | triangles of each child, 3 bits per child, child 0 lowest; 0 if it is a node or unused |

#[cfg(test)]
use glam::DVec3;
use glam::Vec3;

use super::aabb::Aabb;

/// Maximum number of children of a node. When the layout was chosen (lavapipe, 200,012 triangles), nodes of four
/// children with quantised boxes traced 4.9 million camera rays a second, and nodes of two 3.7.
pub(super) const WIDTH: usize = 4;

/// Limit on the number of triangles, whose indices have 28 bits.
pub(super) const MAX_INDEX: usize = 1 << 28;

/// Maximum number of nodes, whose indices have 24 bits on the stack of a kernel.
pub(super) const MAX_NODES: usize = 1 << 24;

/// Words of a node.
pub(super) const WORDS: usize = 12;

/// Minimum distance, in steps, of a child's planes from its bounds. The kernel scales a plane's `q * step` by the
/// inverse direction with three roundings, each of at most 255 steps * 2^-24: less than 2^-14 steps in total.
const MARGIN: f64 = 1.0 / 4096.0;

/// Minimum exponent of a step. The kernel clamps the components of a direction to at least 2^-80, so a ray
/// perpendicular to an axis seems to move along it by at most 2^-80 times its length. With steps of 2^-40 the margin of
/// 2^-52 covers lengths up to 2^28.
const MIN_EXPONENT: i32 = -40;

/// A node before it is packed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Node {
    pub origin: Vec3,
    /// Powers of two.
    pub step: Vec3,
    pub lower: [[u8; 3]; WIDTH],
    pub upper: [[u8; 3]; WIDTH],
    /// Number of children that are nodes. They come first.
    pub node_count: u32,
    pub first_node: u32,
    pub first_triangle: u32,
    /// Number of triangles of each child that is a leaf.
    pub leaf_counts: [u32; WIDTH],
}

impl Node {
    /// A node whose grid holds the boxes of `children` with their margins. Its links are not set.
    pub fn around(children: &[Aabb]) -> Node {
        let bounds = children.iter().fold(Aabb::EMPTY, |all, child| all.union(child));
        let mut node = Node {
            origin: Vec3::ZERO,
            step: Vec3::ONE,
            lower: [[0; 3]; WIDTH],
            upper: [[0; 3]; WIDTH],
            node_count: 0,
            first_node: 0,
            first_triangle: 0,
            leaf_counts: [0; WIDTH],
        };
        if children.is_empty() {
            return node;
        }
        for axis in 0..3 {
            let (low, high) = (f64::from(bounds.min[axis]), f64::from(bounds.max[axis]));
            let mut exponent = (((high - low) / 255.0).log2().floor() as i32).max(MIN_EXPONENT);
            let (origin, step) = loop {
                let step = f64::from(exponent).exp2();
                let origin = f32_below(low - MARGIN * step);
                if (high + MARGIN * step - f64::from(origin)) / step <= 255.0 {
                    break (origin, step);
                }
                exponent += 1;
            };
            node.origin[axis] = origin;
            node.step[axis] = step as f32;
            for (child, bounds) in children.iter().enumerate() {
                let in_steps = |plane: f64| (plane - f64::from(origin)) / step;
                node.lower[child][axis] = in_steps(f64::from(bounds.min[axis]) - MARGIN * step).floor() as u8;
                node.upper[child][axis] = in_steps(f64::from(bounds.max[axis]) + MARGIN * step).ceil() as u8;
            }
        }
        node
    }

    /// The exact box of a child, as the node stores it.
    #[cfg(test)]
    pub fn child_bounds(&self, child: usize) -> [DVec3; 2] {
        let plane = |steps: [u8; 3]| self.origin.as_dvec3() + DVec3::from(steps.map(f64::from)) * self.step.as_dvec3();
        [plane(self.lower[child]), plane(self.upper[child])]
    }

    pub fn pack(&self) -> [[u32; 4]; WORDS / 4] {
        let planes = |steps: &[[u8; 3]; WIDTH], axis: usize| u32::from_le_bytes(steps.map(|step| step[axis]));
        let exponent = |axis: usize| self.step[axis].to_bits() >> 23;
        let counts = (0..WIDTH).fold(0, |counts, child| counts | self.leaf_counts[child] << (3 * child));
        let nibble = |at: u32| (counts >> (4 * at) & 15) << 28;
        let word = |at: usize| match at {
            0..3 => self.origin[at].to_bits(),
            3..6 => planes(&self.lower, at - 3),
            6..9 => planes(&self.upper, at - 6),
            9 => exponent(0) | exponent(1) << 8 | exponent(2) << 16 | self.node_count << 24 | nibble(0),
            10 => self.first_node | nibble(1),
            _ => self.first_triangle | nibble(2),
        };
        std::array::from_fn(|texel| std::array::from_fn(|at| word(4 * texel + at)))
    }

    pub fn unpack(texels: &[[u32; 4]]) -> Node {
        let word = |at: usize| texels[at / 4][at % 4];
        let planes = |first: usize| {
            std::array::from_fn(|child| std::array::from_fn(|axis| word(first + axis).to_le_bytes()[child]))
        };
        let counts = word(9) >> 28 | word(10) >> 28 << 4 | word(11) >> 28 << 8;
        let exponents = word(9).to_le_bytes();
        Node {
            origin: Vec3::from_array(std::array::from_fn(|axis| f32::from_bits(word(axis)))),
            step: Vec3::from_array(std::array::from_fn(|axis| f32::from_bits(u32::from(exponents[axis]) << 23))),
            lower: planes(3),
            upper: planes(6),
            node_count: word(9) >> 24 & 15,
            first_node: word(10) & (MAX_INDEX as u32 - 1),
            first_triangle: word(11) & (MAX_INDEX as u32 - 1),
            leaf_counts: std::array::from_fn(|child| counts >> (3 * child) & 7),
        }
    }
}

/// The largest f32 that is not above `value`.
fn f32_below(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) <= value { nearest } else { nearest.next_down() }
}
