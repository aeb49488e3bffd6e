//! Triangle scenes, cameras and panoramas for tests.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DVec3, Vec2, Vec3, Vec4};
use penumbra::internal::scene::{
    Camera, EmitterTriangle, Light, LightKind, Material, NO_LIGHT, Panorama, Projection, Scene, Specular, Triangle,
    Vertex,
};

pub use penumbra::internal::stress::stage::{Corners, cube, inside_out, square};

/// A Lambertian surface of the given albedo and emitted radiance.
pub fn surface(albedo: f32, emission: f32) -> Material {
    Material {
        base_colour: Vec3::splat(albedo).extend(1.0),
        emissive: Vec3::splat(emission),
        metallic: 0.0,
        // Lambertian, without a specular part.
        specular: Specular::with_factor(0.0),
        ..Material::default()
    }
}

/// A scene of meshes with one material each and of punctual lights. Emissive meshes are lights, too.
pub fn scene(meshes: &[(Vec<Corners>, Material)], punctual: Vec<LightKind>) -> Scene {
    let mut scene = Scene::default();
    for (triangles, material) in meshes {
        let light = if material.emissive == Vec3::ZERO { NO_LIGHT } else { scene.lights.len() as u32 };
        let mut emitters = Vec::new();
        for corners in triangles {
            let first = scene.vertices.len() as u32;
            Arc::make_mut(&mut scene.vertices).extend(corners.map(|c| Vertex {
                position: c.as_vec3(),
                normal: Vec3::ZERO,
                tangent: Vec4::ZERO,
                uv: [Vec2::ZERO; 2],
                colour: Vec4::ONE,
            }));
            emitters.push(EmitterTriangle { triangle: scene.triangles.len() as u32, radiance: material.emissive });
            let vertices = [first, first + 1, first + 2];
            scene.triangles.push(Triangle { vertices, material: scene.materials.len() as u32, light });
        }
        if light != NO_LIGHT {
            let kind = LightKind::Mesh { material: scene.materials.len() as u32, emitters };
            scene.lights.push(Light { name: String::new(), kind });
        }
        scene.materials.push(material.clone());
    }
    scene.lights.extend(punctual.into_iter().map(|kind| Light { name: String::new(), kind }));
    scene
}

/// A sphere of `n` rings with `2 n` segments each; the corners of its triangles are on the sphere.
pub fn sphere(centre: DVec3, radius: f64, n: usize) -> Vec<Corners> {
    let at = |i: usize, j: usize| {
        let (t, p) = (PI * i as f64 / n as f64, TAU * j as f64 / (2 * n) as f64);
        centre + radius * DVec3::new(t.sin() * p.cos(), t.sin() * p.sin(), t.cos())
    };
    let mut triangles = Vec::new();
    for i in 0..n {
        for j in 0..2 * n {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, (j + 1) % (2 * n)), at(i, (j + 1) % (2 * n))];
            if i + 1 < n {
                triangles.push([a, b, c]);
            }
            if i > 0 {
                triangles.push([a, c, d]);
            }
        }
    }
    triangles
}

/// A perspective camera with a vertical field of view in radians.
pub fn camera(position: DVec3, towards: DVec3, yfov: f32) -> Camera {
    let backward = -towards.normalize();
    let up = if backward.y.abs() > 0.9 { DVec3::X } else { DVec3::Y };
    let right = up.cross(backward).normalize();
    let axes = [right, backward.cross(right), backward].map(|a| a.as_vec3());
    let projection = Projection::Perspective { yfov, aspect: None };
    let position = position.as_vec3();
    Camera { name: String::new(), position, axes, projection, near: 1e-3, far: 10.0, lens: None }
}

/// A panorama whose texels have the radiance in the direction of their centres.
pub fn panorama(width: u32, height: u32, radiance: impl Fn(DVec3) -> DVec3) -> Panorama {
    let at = |i: u32| {
        let (x, y) = (f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
        let (azimuth, below) = ((2.0 * x / f64::from(width) - 1.0) * PI, y / f64::from(height) * PI);
        let direction = DVec3::new(below.sin() * azimuth.cos(), below.cos(), below.sin() * azimuth.sin());
        radiance(direction).as_vec3().to_array()
    };
    Panorama { width, height, texels: (0..width * height).map(at).collect() }
}
