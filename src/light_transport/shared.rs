//! What all parts of light transport get from the renderer, and computations that several of them share.

use glam::Vec3;
use kernel_kit::Gpu;

use crate::gpu_scene::GpuScene;
use crate::passes::TileBuffers;
use crate::passes::photons::Traced;
use crate::scene::{Light, Scene};
use crate::statistics::LightPhotons;

/// Maximum number of samples of a pixel in one tile, so that audits repair the visibility map early and a render can
/// stop soon.
pub(crate) const TILE_SAMPLES: u32 = 8;

/// Maximum number of points of a tile: enough to keep a device busy, and few enough for its memory and for the time of
/// a dispatch.
pub(crate) const TILE_POINTS: u32 = 1 << 19;

/// The device, the scene on both sides, and the buffers of a tile.
#[derive(Clone, Copy)]
pub(crate) struct Shared<'a> {
    pub gpu: &'a Gpu,
    pub scene: &'a Scene,
    pub gpu_scene: &'a GpuScene,
    pub tile: &'a TileBuffers,
}

/// The visibility photons of each light.
pub(crate) fn photons_by_light(scene: &Scene, traced: &Traced) -> Vec<LightPhotons> {
    let counts = traced.emitted.iter().zip(&traced.stored);
    let of_light = |(light, (emitted, [illumination, shadow])): (&Light, (&u32, &[u32; 2]))| LightPhotons {
        light: light.name.clone(),
        emitted: u64::from(*emitted),
        illumination: u64::from(*illumination),
        shadow: u64::from(*shadow),
        repaired: 0,
    };
    scene.placed_lights().iter().zip(counts).map(of_light).collect()
}

/// Bounds and area of the scene's surfaces; procedural objects count as their boxes.
pub(crate) fn extent(scene: &Scene) -> ((Vec3, Vec3), f32) {
    let mut bounds = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let mut area = 0.0f64;
    for (_, [a, b, c]) in scene.placed_triangles() {
        bounds = (bounds.0.min(a).min(b).min(c), bounds.1.max(a).max(b).max(c));
        area += f64::from((b - a).cross(c - a).length()) * 0.5;
    }
    for object in &scene.procedurals {
        bounds = object.corners().iter().fold(bounds, |(low, high), p| (low.min(*p), high.max(*p)));
        area += f64::from(object.box_area());
    }
    (bounds, area as f32)
}
