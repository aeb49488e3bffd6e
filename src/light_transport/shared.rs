//! The inputs that all parts of light transport get from the renderer, and computations that several of them share.

use glam::Vec3;
use kernel_kit::Gpu;
use rayon::prelude::*;

use crate::bvh::Aabb;
use crate::gpu_scene::GpuScene;
use crate::passes::TileBuffers;
use crate::passes::flux::FluxPhotons;
use crate::passes::photons::Traced;
use crate::scene::{Light, Scene};
use crate::statistics::totals::Totals;
use crate::statistics::{Counter, LightPhotons};

/// Maximum number of samples of a pixel in one tile, so that audits repair the visibility map early and a render can
/// stop soon.
pub(crate) const TILE_SAMPLES: u32 = 8;

/// Maximum number of points of a tile: enough to keep a device busy, and few enough for its memory and for the time of
/// a dispatch. With half or a quarter as many, renders of 64 samples took longer (docs/experiments.md, "Smaller
/// tiles").
pub(crate) const TILE_POINTS: u32 = 1 << 19;

/// The device, the scene on both sides, and the buffers of a tile.
#[derive(Clone, Copy)]
pub(crate) struct Shared<'a> {
    pub gpu: &'a Gpu,
    pub scene: &'a Scene,
    pub gpu_scene: &'a GpuScene,
    pub tile: &'a TileBuffers,
}

/// Counts traced visibility photons: their rays, and the photons of each light.
pub(crate) fn count_visibility_photons(scene: &Scene, traced: &Traced, totals: &mut Totals) {
    totals.photon_rays += traced.emitted.iter().map(|n| u64::from(*n)).sum::<u64>();
    totals.photon_overruns += traced.overruns;
    let counts = traced.emitted.iter().zip(&traced.stored);
    let of_light = |(light, (emitted, [illumination, shadow])): (&Light, (&u32, &[u32; 2]))| LightPhotons {
        light: light.name.clone(),
        emitted: u64::from(*emitted),
        illumination: u64::from(*illumination),
        shadow: u64::from(*shadow),
        repaired: 0,
    };
    totals.photons = scene.placed_lights().iter().zip(counts).map(of_light).collect();
}

/// Counts the rays of traced flux photons, and the photons that were lost.
pub(crate) fn count_flux_photons(traced: &FluxPhotons, totals: &mut Totals) {
    totals.photon_rays += traced.rays;
    totals.flux_emitted += u64::from(traced.emitted);
    totals.flux_overruns += traced.overruns;
    totals.count(Counter::NotFiniteFlux, traced.not_finite);
}

/// Bounds and area of the scene's surfaces; procedural objects count as their boxes.
pub(crate) fn extent(scene: &Scene) -> ((Vec3, Vec3), f32) {
    // Sums of a fixed number of triangles, so that the number of threads changes no bit.
    const ADDED: usize = 1 << 16;
    let with = |(bounds, area): (Aabb, f64), [a, b, c]: [Vec3; 3]| {
        let triangle_area = f64::from((b - a).cross(c - a).length()) * 0.5;
        (bounds.union(&Aabb::of([a, b, c])), area + triangle_area)
    };
    let unshared = scene.unshared_triangles();
    let part = |number: usize| {
        let triangles = number * ADDED..unshared.min((number + 1) * ADDED);
        triangles.map(|index| scene.triangle_positions(index)).fold((Aabb::EMPTY, 0.0), with)
    };
    let parts: Vec<_> = (0..unshared.div_ceil(ADDED)).into_par_iter().map(part).collect();
    let of_unshared = parts.iter().fold((Aabb::EMPTY, 0.0), |all, part| (all.0.union(&part.0), all.1 + part.1));
    let (mut bounds, mut area) = scene.instance_triangles().fold(of_unshared, |all, (_, corners)| with(all, corners));
    for object in &scene.procedurals {
        bounds = object.corners().into_iter().fold(bounds, |all, corner| all.extended(corner));
        area += f64::from(object.box_area());
    }
    ((bounds.min, bounds.max), area as f32)
}
