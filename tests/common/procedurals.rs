//! Procedural objects in scenes for tests.

use glam::{DAffine3, Vec3};
use penumbra::Scene;
use penumbra::internal::procedural::{Builder, Procedural, Role};
use penumbra::internal::scene::Material;

/// The sphere of `scenes/`, an intersection function; its first parameter is the radius.
pub const SPHERE: &str = include_str!("../../scenes/procedural/sphere.wgsl");

/// A sphere as a distance function; its first parameter is the radius.
pub const BALL: &str = "fn ball(position: vec3f, parameters: vec4f) -> f32 { return length(position) - parameters.x; }";

/// An object: source, name and role of its function, its first parameter, its world matrix and its material.
pub struct Object<'a> {
    pub source: &'a str,
    pub function: &'a str,
    pub role: Role,
    pub parameter: f32,
    pub world: DAffine3,
    pub material: Material,
}

/// Adds objects to a scene whose normalised space is world space. Their bounds are cubes of edge 2 around their
/// origins.
pub fn place(scene: &mut Scene, objects: &[Object]) {
    let mut builder = Builder::default();
    for object in objects {
        let function = builder.function(object.source, object.function, object.role).unwrap();
        scene.materials.push(object.material.clone());
        scene.procedurals.push(Procedural {
            name: object.function.to_owned(),
            to_own: object.world.inverse(),
            bounds: [Vec3::NEG_ONE, Vec3::ONE],
            function,
            parameters: [object.parameter, 0.0, 0.0, 0.0],
            colour: None,
            material: scene.materials.len() as u32 - 1,
        });
    }
    scene.functions = builder.finish().unwrap();
}

/// A sphere of radius 1, as an intersection or a distance function.
pub fn sphere(role: Role, world: DAffine3, material: Material) -> Object<'static> {
    let (source, function) = if role == Role::Distance { (BALL, "ball") } else { (SPHERE, "sphere") };
    Object { source, function, role, parameter: 1.0, world, material }
}
