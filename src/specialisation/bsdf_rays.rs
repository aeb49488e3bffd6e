//! Whether rays sampled from the BSDF of visible points find light that light points would sample badly.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use crate::scene::{LightKind, Material, Scene, SharedMesh};

/// Rays sampled from the BSDF complement light points where the upper bound of their probability of hitting a light is
/// at least this; see `shaders/lib/bsdf_rays.wgsl`. The measurements are in docs/experiments.md, "BSDF rays that may
/// hit a light".
pub(crate) const MIN_HIT_PROBABILITY: f64 = 1.0;

/// Upper bound, over all surfaces and lights, of the probability that a ray sampled from the BSDF of a surface hits a
/// light. Infinite if factors alone cannot bound it.
pub(super) fn max_hit_probability(scene: &Scene) -> f64 {
    if scene.environment().is_some() {
        return f64::INFINITY;
    }
    let boxes = boxes_by_material(scene);
    let lights: Vec<Sphere> = scene.lights.iter().filter_map(|light| light_bounds(scene, &light.kind)).collect();
    let mut max = 0.0f64;
    for (material, bounds) in scene.materials.iter().zip(&boxes) {
        let density = max_density(material);
        if let Some(bounds) = bounds.filter(|_| density > 0.0) {
            max = lights.iter().fold(max, |max, light| max.max(density * max_solid_angle(&bounds, light)));
        }
    }
    max
}

/// Lower and upper corner.
type Box3 = [DVec3; 2];

/// A bounding sphere.
pub(crate) struct Sphere {
    pub centre: DVec3,
    pub radius: f64,
}

impl Sphere {
    /// Distance from its centre to a box; 0 within.
    pub(super) fn distance_to(&self, [low, high]: &Box3) -> f64 {
        (self.centre.clamp(*low, *high) - self.centre).length()
    }
}

fn extended(bounds: Option<Box3>, point: DVec3) -> Option<Box3> {
    Some(bounds.map_or([point; 2], |[low, high]| [low.min(point), high.max(point)]))
}

/// The bounds of the surfaces of each material, if it has any.
pub(super) fn boxes_by_material(scene: &Scene) -> Vec<Option<Box3>> {
    let mut boxes = vec![None; scene.materials.len()];
    let mut extend = |material: u32, points: &[Vec3]| {
        let bounds = &mut boxes[material as usize];
        *bounds = points.iter().fold(*bounds, |bounds, point| extended(bounds, point.as_dvec3()));
    };
    for (i, triangle) in scene.triangles[..scene.unshared_triangles()].iter().enumerate() {
        extend(triangle.material, &scene.triangle_positions(i));
    }
    let of_meshes: Vec<_> = scene.shared_meshes.iter().map(|mesh| shared_boxes(scene, mesh)).collect();
    for instance in &scene.instances {
        for (material, corners) in &of_meshes[instance.mesh] {
            extend(*material, &corners.map(|corner| instance.apply(corner)));
        }
    }
    for object in &scene.procedurals {
        extend(object.material, &object.corners());
    }
    boxes
}

/// The corners of the bounds of each material's surfaces in a shared mesh.
fn shared_boxes(scene: &Scene, mesh: &SharedMesh) -> Vec<(u32, [Vec3; 8])> {
    let mut boxes: BTreeMap<u32, [Vec3; 2]> = BTreeMap::new();
    for i in mesh.triangles.clone() {
        let bounds = boxes.entry(scene.triangles[i].material).or_insert([Vec3::INFINITY, Vec3::NEG_INFINITY]);
        let extended = |[low, high]: [Vec3; 2], p: Vec3| [low.min(p), high.max(p)];
        *bounds = scene.triangle_positions(i).into_iter().fold(*bounds, extended);
    }
    let corner = |bounds: &[Vec3; 2], i: usize| Vec3::from_array([0, 1, 2].map(|axis| bounds[i >> axis & 1][axis]));
    boxes.iter().map(|(material, bounds)| (*material, std::array::from_fn(|i| corner(bounds, i)))).collect()
}

/// The bounds of a light that rays can hit.
fn light_bounds(scene: &Scene, light: &LightKind) -> Option<Sphere> {
    let LightKind::Mesh { emitters, .. } = light else { return None };
    let corners = || emitters.iter().flat_map(|emitter| scene.triangle_positions(emitter.triangle as usize));
    let [low, high] = corners().fold(None, |bounds, corner| extended(bounds, corner.as_dvec3()))?;
    let centre = 0.5 * (low + high);
    let radius = corners().map(|corner| (corner.as_dvec3() - centre).length()).fold(0.0, f64::max);
    Some(Sphere { centre, radius })
}

/// Upper bound of the solid angle of a light's bounds, seen from anywhere in `surfaces`.
fn max_solid_angle(surfaces: &Box3, light: &Sphere) -> f64 {
    let squared_sine = (light.radius / light.distance_to(surfaces)).powi(2);
    if squared_sine.is_nan() || squared_sine >= 1.0 {
        return 4.0 * PI;
    }
    2.0 * PI * squared_sine / (1.0 + (1.0 - squared_sine).sqrt())
}

/// Upper bound of `bsdf_max_density` (`shaders/lib/bsdf.wgsl`) over all views; 0 for Lambertian materials. Infinite for
/// materials that transmit light, and where a texture may make a lobe narrower than its factor.
fn max_density(m: &Material) -> f64 {
    if m.is_lambertian() {
        return 0.0;
    }
    let narrow = m.min_roughness();
    if narrow == 0.0 || m.has_transmitting_lobe() {
        return f64::INFINITY;
    }
    // At grazing views Smith's root is the width: 1 / (2 pi alpha^3).
    let lobes = 0.5 / (PI * f64::from(narrow).powi(6));
    lobes.max(1.0 / PI)
}
