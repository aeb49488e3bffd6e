//! The surface at a pixel: the first one that the ray through its centre hits.

use glam::DVec3;

use crate::gpu_scene::CameraUniform;
use crate::scene::{Camera, Nearest, Scene, SurfaceSearch};

/// A surface at a pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Hit {
    /// Name of its material.
    pub material: String,
    /// Position in the file's world space.
    pub position: DVec3,
    /// Unit normal of the triangle, towards the camera; `None` for a procedural object.
    pub normal: Option<DVec3>,
    /// Depth along the direction of view, in the units of the file.
    pub depth: f64,
}

/// The nearest surface at a point of the image, from 0 to 1 each way from the top left. Materials and textures that let
/// light pass count as opaque, and procedural objects as their boxes.
pub fn pick(scene: &Scene, camera: &Camera, [width, height]: [u32; 2], [x, y]: [f32; 2]) -> Option<Hit> {
    let (origin, direction) = CameraUniform::new(camera, width, height).ray([x, y].map(f64::from));
    // Multiples of the direction are depths.
    let range = f64::from(camera.near)..=f64::from(camera.far);
    let scale = scene.normalisation.scale();
    let Nearest { depth, material, normal } = SurfaceSearch::new(scene).nearest(origin, direction, &range)?;
    Some(Hit {
        material: scene.materials[material as usize].name.clone(),
        position: scene.normalisation.undo_f64(origin + depth * direction),
        normal: normal.map(|n| if n.dot(direction) > 0.0 { -n } else { n }),
        depth: depth / scale,
    })
}
