//! The nodes for packet traversal (`shaders/lib/packet.wgsl`): eight texels, 128 bytes, so that one load in which each
//! lane of a subgroup has its own texel fetches a node.
//!
//! | texel | x y z | w |
//! | --- | --- | --- |
//! | 0 to 3 | lower planes of a child, f32 | the child's entry, as `shaders/lib/bvh.wgsl` has them |
//! | 4 to 7 | upper planes of the same children | texel 4 of the root: the largest magnitude of a coordinate |

use glam::Vec3;

use super::aabb::Aabb;
use super::hierarchy::{Bvh, MAX_COORDINATE, NODE_TEXELS, TRIANGLE_TEXELS};
use super::node::{Node, WIDTH};

/// Texels of a node, and lanes of the subgroups that trace packets.
pub(crate) const PACKET_LANES: u32 = 2 * WIDTH as u32;

/// Bits of an entry that hold the index of a node or a triangle; above them is a leaf's number of triangles,
/// at most four, which takes three bits.
const ENTRY_INDEX_BITS: u32 = 29;

/// The box of a missing child. Its planes are swapped: every ray that can be traced leaves it before it enters it.
const NOWHERE: Aabb = Aabb { min: Vec3::splat(MAX_COORDINATE), max: Vec3::splat(-MAX_COORDINATE) };

impl Bvh {
    /// Number of texels of [`packet_nodes`](Self::packet_nodes).
    pub(crate) fn packet_texels(&self) -> u64 {
        (self.nodes.len() / NODE_TEXELS as usize) as u64 * u64::from(PACKET_LANES)
    }

    /// The nodes as packets read them, with the same indices as in [`nodes`](Self::nodes). Boxes are exact: those that
    /// the corners of their triangles span.
    pub fn packet_nodes(&self) -> Vec<[f32; 4]> {
        let nodes = self.nodes.chunks_exact(NODE_TEXELS as usize);
        let mut texels = vec![[0.0; 4]; PACKET_LANES as usize * nodes.len()];
        let mut bounds = vec![Aabb::EMPTY; nodes.len()];
        // Children follow their parents, so the reverse order visits them first.
        for (index, packed) in nodes.enumerate().rev() {
            let node = Node::unpack(packed);
            let texels = &mut texels[PACKET_LANES as usize * index..][..PACKET_LANES as usize];
            let mut primitive = node.first_triangle;
            for child in 0..WIDTH {
                let count = node.leaf_counts[child];
                let (child_bounds, entry) = match () {
                    () if child < node.node_count as usize => {
                        let at = node.first_node + child as u32;
                        (bounds[at as usize], at)
                    }
                    () if count > 0 => (self.leaf_bounds(primitive, count), count << ENTRY_INDEX_BITS | primitive),
                    () => (NOWHERE, 0),
                };
                primitive += count;
                texels[child] = child_bounds.min.extend(f32::from_bits(entry)).to_array();
                texels[WIDTH + child] = child_bounds.max.extend(0.0).to_array();
                if child_bounds != NOWHERE {
                    bounds[index] = bounds[index].union(&child_bounds);
                }
            }
        }
        let largest = bounds[0].min.abs().max(bounds[0].max.abs()).max_element();
        texels[WIDTH][3] = if largest.is_finite() { largest } else { 0.0 };
        texels
    }

    fn leaf_bounds(&self, first: u32, count: u32) -> Aabb {
        let [first, end] = [first, first + count].map(|at| (TRIANGLE_TEXELS * at) as usize);
        let corners = self.triangles[first..end].iter().map(|texel| Vec3::from_slice(&texel[..3]));
        corners.fold(Aabb::EMPTY, |all, corner| all.extended(corner))
    }
}
