//! The bounding volume hierarchy (BVH), built on the CPU by all threads and traversed by `shaders/lib/bvh.wgsl`.
//!
//! A binary tree is built with the binned surface-area heuristic (SAH) and collapsed to four children per node at the
//! minimum expected cost (Ylitie, Karras and Laine 2017). The planes of its boxes are rounded outwards to 8 bits.
//! Meshes that are stored once have trees of their own, below one over their instances.

mod aabb;
mod binary;
mod box_tree;
mod hierarchy;
mod instance_table;
mod instanced;
mod node;
mod packet;
mod wide;

pub use aabb::Aabb;
pub use box_tree::BoxTree;
pub use hierarchy::Bvh;
pub(crate) use hierarchy::{INDEX_MASK, NODE_INDEX_MASK, NODE_TEXELS, STACK_SIZE, TRIANGLE_TEXELS};
pub(crate) use instance_table::INSTANCE_TEXELS;
pub use instance_table::InstanceTable;
pub(crate) use packet::PACKET_LANES;

#[cfg(test)]
mod tests;
