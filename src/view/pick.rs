//! What is at a pixel: the surface that the ray through its centre meets first.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::gpu_scene::CameraUniform;
use crate::scene::{Camera, Scene};

/// A surface at a pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Hit {
    /// Name of its material.
    pub material: String,
    /// Position in the file's world space.
    pub position: DVec3,
    /// Unit normal of the triangle, towards the camera; none of an object that is a function.
    pub normal: Option<DVec3>,
    /// Depth along the direction of view, in the units of the file.
    pub depth: f64,
}

/// The nearest surface at a point of the image, from 0 to 1 each way from the top left. Pixels of textures that let
/// rays pass do so here, too, only if the whole material does; objects that are functions are met at their boxes.
pub fn pick(scene: &Scene, camera: &Camera, [width, height]: [u32; 2], [x, y]: [f32; 2]) -> Option<Hit> {
    let uniform = CameraUniform::new(camera, width, height);
    let vector = |v: [f32; 3]| Vec3::from(v).as_dvec3();
    let across = f64::from(2.0 * x - 1.0) * vector(uniform.right) + f64::from(1.0 - 2.0 * y) * vector(uniform.up);
    let (position, ahead) = (vector(uniform.position), -vector(uniform.backward));
    let (origin, way) = if uniform.orthographic == 1 { (position + across, ahead) } else { (position, ahead + across) };
    // The way has a length of 1 along the direction of view, so that its multiples are depths.
    let range = f64::from(camera.near)..=f64::from(camera.far);
    let triangles = (0..scene.triangles.len()).into_par_iter().filter_map(|index| {
        let corners = scene.triangle_positions(index).map(Vec3::as_dvec3);
        let depth = triangle_depth(corners, origin, way)?;
        range.contains(&depth).then_some((depth, index))
    });
    let nearest = triangles.min_by(|a, b| a.0.total_cmp(&b.0));
    let boxes = scene.procedurals.iter().filter_map(|object| {
        let corners = object.corners();
        let lower = corners.iter().copied().reduce(Vec3::min)?.as_dvec3() - origin;
        let upper = corners.iter().copied().reduce(Vec3::max)?.as_dvec3() - origin;
        let (a, b) = (lower / way, upper / way);
        let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
        (enter <= leave && range.contains(&enter)).then_some((enter, object.material))
    });
    let object = boxes.min_by(|a, b| a.0.total_cmp(&b.0));
    let scale = scene.normalisation.scale();
    let hit = |depth: f64, material: u32, normal: Option<DVec3>| Hit {
        material: scene.materials[material as usize].name.clone(),
        position: scene.normalisation.undo_f64(origin + depth * way),
        normal: normal.map(|n| if n.dot(way) > 0.0 { -n } else { n }),
        depth: depth / scale,
    };
    match (nearest, object) {
        (Some((depth, index)), object) if object.is_none_or(|(enter, _)| depth <= enter) => {
            let [a, b, c] = scene.triangle_positions(index).map(Vec3::as_dvec3);
            Some(hit(depth, scene.triangles[index].material, (b - a).cross(c - a).try_normalize()))
        }
        (_, Some((enter, material))) => Some(hit(enter, material, None)),
        _ => None,
    }
}

/// The multiple of `way` at which a ray meets a triangle, from either side.
fn triangle_depth([a, b, c]: [DVec3; 3], origin: DVec3, way: DVec3) -> Option<f64> {
    let (a, b, c) = (a - origin, b - origin, c - origin);
    let normal = (b - a).cross(c - a);
    let depth = a.dot(normal) / way.dot(normal);
    let at = depth * way;
    let inside = |p: DVec3, q: DVec3| (q - p).cross(at - p).dot(normal) >= 0.0;
    (depth.is_finite() && inside(a, b) && inside(b, c) && inside(c, a)).then_some(depth)
}
