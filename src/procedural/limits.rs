//! Constants of procedural objects.

/// Maximum number of objects in a scene. Each ray tests the box of every object.
pub const MAX_OBJECTS: usize = 64;

/// The bit of a hit's primitive index that is set for procedural objects.
pub(crate) const PROCEDURAL: u32 = 1 << 31;

/// Bits of a hit's primitive index that hold the index of a procedural object.
pub(crate) const INDEX_MASK: u32 = 0xff;
const _: () = assert!(MAX_OBJECTS <= INDEX_MASK as usize);

/// Maximum number of iterations until the next crossing, in all loops of a function and in the search along the ray
/// together. This is 16 times what a fractal at a grazing angle needs, and a sixteenth of the limit of software devices
/// for all rays of an invocation.
pub(crate) const ITERATIONS: u32 = 4096;

/// Maximum number of iterations of a ray in all objects together. It then ignores further objects. The lanes of a
/// software device wait for each other, so that its loops may run several times as many iterations.
pub(crate) const RAY_ITERATIONS: u32 = 2 * ITERATIONS;
