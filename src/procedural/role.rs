//! The roles of functions.

/// What a function is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// `fn(origin: vec3f, direction: vec3f, nearest: f32, parameters: vec4f) -> vec4f`: normal, and length to the first
    /// crossing beyond `nearest`.
    Intersection,
    /// `fn(position: vec3f, parameters: vec4f) -> f32`: distance to the surface, negative within.
    Distance,
    /// `fn(base: vec3f, position: vec3f, parameters: vec4f) -> vec3f`: base colour at a point of the surface.
    Colour,
}
