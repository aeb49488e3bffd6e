//! Roles of functions.

/// The role of a function, which determines its signature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// `fn(origin: vec3f, direction: vec3f, nearest: f32, parameters: vec4f) -> vec4f`: the normal at the first
    /// crossing beyond `nearest`, and the distance to it.
    Intersection,
    /// `fn(position: vec3f, parameters: vec4f) -> f32`: signed distance to the surface, negative inside.
    Distance,
    /// `fn(base: vec3f, position: vec3f, parameters: vec4f) -> vec3f`: the base colour at a point of
    /// the surface.
    Colour,
}
