//! The bounding volume hierarchy: built on the CPU by all threads, read by the kernels of `shaders/lib/bvh.wgsl`.
//!
//! A binary tree by the binned surface-area heuristic, collapsed to four children a node at the least expected
//! cost (Ylitie, Karras and Laine 2017), its boxes rounded outwards to 8 bits a plane.

mod aabb;
mod binary;
mod hierarchy;
mod node;
mod wide;

pub use aabb::Aabb;
pub use hierarchy::Bvh;

#[cfg(test)]
mod tests;
