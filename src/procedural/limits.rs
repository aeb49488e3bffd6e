//! Limits of procedural objects.

/// Most objects of a scene: each ray looks at the box of each of them.
pub const MAX_OBJECTS: usize = 64;

/// Bit of a hit's primitive that tells an object from a triangle.
pub(crate) const PROCEDURAL: u32 = 1 << 31;

/// Turns of all loops of a function and of the search along a ray, until the next crossing: 16 times what a fractal at a
/// grazing angle takes, and a sixteenth of what software devices grant all rays of an invocation together.
pub(crate) const TURNS: u32 = 4096;

/// Turns of a ray in all objects together, after which it looks for no more. Lanes of a software device wait for each other, so
/// that its loops may take several times as many.
pub(crate) const RAY_TURNS: u32 = 2 * TURNS;
