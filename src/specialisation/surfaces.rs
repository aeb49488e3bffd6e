//! Decisions on the surfaces of a scene, and facts about its materials and lights.

use glam::Vec3;
use rayon::prelude::*;

use super::decisions::{Specialisation, bytes_text};
use super::lobes::{LOBES, LobeRole, has_lobe};
use crate::bvh::INSTANCE_TEXELS;
use crate::count::count;
use crate::scene::{AlphaMode, LightKind, Material, NO_LIGHT, Scene};
use crate::settings::Settings;
use crate::specialisation::features::Feature;

impl Specialisation {
    pub(super) fn decide_on_surfaces(&mut self, scene: &Scene, m: &Facts) {
        let triangles = scene.triangles.len() as u64;
        let per_triangle = |bytes: u64| format!("{bytes} B per triangle, {} in all", bytes_text(bytes * triangles));
        let materials = |n: usize, what: &str| (n > 0, format!("{} {what}", count(n, "material", "materials")));
        let (on, why) = materials(m.textured, "with textures");
        self.decide(
            Feature::Textures,
            on,
            why,
            "no material has a texture",
            "texture lookups in every surface; texels",
        );
        let (on, why) = materials(m.uv1, "with a second set of texture coordinates");
        self.decide(Feature::Uv1, on, why, "no texture uses the second set of coordinates", &per_triangle(16));
        let (on, why) = materials(m.normal_maps, "with normal maps");
        self.decide(Feature::NormalMaps, on, why, "no material has a normal map", &per_triangle(16));
        for (lobe, number) in LOBES.iter().zip(m.lobes) {
            let (on, why) = materials(number, lobe.materials);
            let tangents = if lobe.tangents { format!("; {}", per_triangle(16)) } else { String::new() };
            let cost = format!("{}{tangents}", lobe.cost);
            self.decide(lobe.feature, on, why, lobe.unneeded, &cost);
        }
        let (on, why) = materials(m.alpha, "with alpha mask or blending");
        self.decide(
            Feature::AlphaTest,
            on,
            why,
            "every surface is opaque",
            "a test at every alpha triangle that a ray hits",
        );
        let (on, why) = materials(m.unlit, "unlit");
        self.decide(Feature::Unlit, on, why, "no material is unlit", "a branch in every surface");
        let vertices = |on: bool| (on, "some vertices have them".to_owned());
        let (on, why) = vertices(m.vertex_colours);
        self.decide(Feature::VertexColours, on, why, "every vertex is white", &per_triangle(32));
        let (on, why) =
            (m.needles > 0, format!("{} with inexact hit distances", count(m.needles, "needle", "needles")));
        let unneeded = "no triangle is much longer than wide";
        self.decide(Feature::Needles, on, why, unneeded, "a plane for every ray and triangle test");
        let (on, why) = vertices(m.smooth_normals);
        self.decide(
            Feature::SmoothNormals,
            on,
            why,
            "every triangle is flat",
            "normals interpolated, and points moved to the smooth surface, at every hit",
        );

        let objects = scene.procedurals.len();
        self.features = std::mem::take(&mut self.features).with_functions(scene.functions.clone());
        self.decide(
            Feature::Procedurals,
            objects > 0,
            format!("{} described by functions", count(objects, "object", "objects")),
            "no object is a function",
            "a box test per ray and object, and the functions in every kernel that traces; 128 B per object",
        );
    }
}

/// A needle: a triangle so long and thin that rounding displaces hit points by more than the offset of ray origins, so
/// that it stops rays that leave it. The displacement along the triangle is up to 0.13 ULP times its aspect ratio times
/// its length (`tests/kernels/precision.rs`); origins are at least 8 ULP above the surface (`offset_origin` in
/// `shaders/lib/ray.wgsl`). On floors of needles as long as the scene, the first rays are stopped at an aspect ratio
/// between 100 and 1000.
fn is_needle([a, b, c]: [Vec3; 3]) -> bool {
    const LONG: f32 = 100.0;
    let longest2 = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    let height = (b - a).cross(c - a).length() / longest2.sqrt();
    longest2 > LONG * height
}

/// Whether a material may focus light: it refracts light, or is smooth and reflects much light, as metals, thin films
/// and dense dielectrics do (an index of 2.6 reflects a fifth head-on, and an index of 0 stands for infinity). This is
/// decided by its factors, which textures can only reduce.
fn focuses(m: &Material) -> bool {
    let dense = m.specular.factor > 0.0 && (m.ior == 0.0 || m.ior > 2.6);
    let metal = m.metallic > 0.0 || dense || has_lobe(m, LobeRole::Film);
    let smooth = m.roughness * m.roughness <= FOCUSING_ALPHA || m.metallic_roughness_texture.is_some();
    !m.unlit && (m.transmission.is_present() || (metal && smooth))
}

/// Maximum roughness factor of surfaces that look like mirrors or clear glass. Its square, 1.02e-3, is just above the
/// minimum alpha of the kernels (`MIN_ALPHA` in `shaders/lib/bsdf/microfacet.wgsl`).
const CLEAR_ROUGHNESS: f32 = 0.032;

/// Maximum alpha of metals that count as focusing: roughness 0.3. Wider lobes show no caustics. Other
/// widths were not compared.
pub(crate) const FOCUSING_ALPHA: f32 = 0.09;

/// Numbers of materials and lights with certain properties. Only materials that a triangle or an object uses count.
#[derive(Default)]
pub(super) struct Facts {
    pub(super) textured: usize,
    pub(super) uv1: usize,
    pub(super) normal_maps: usize,
    /// Materials with each lobe of [`LOBES`].
    lobes: [usize; LOBES.len()],
    pub(super) focusing: usize,
    pub(super) clear: usize,
    /// Materials that are not black.
    pub(super) reflecting: usize,
    /// Materials with a lobe that lets light pass.
    pub(super) transmitting: usize,
    pub(super) alpha: usize,
    pub(super) unlit: usize,
    pub(super) vertex_colours: bool,
    pub(super) smooth_normals: bool,
    pub(super) needles: usize,
    pub(super) mesh_lights: usize,
    pub(super) point_lights: usize,
    pub(super) spot_lights: usize,
    pub(super) directional_lights: usize,
    pub(super) textured_lights: usize,
    pub(super) transparent_lights: usize,
    /// Mesh lights that emit into volumes behind their surfaces.
    pub(super) lights_of_volumes: usize,
}

impl Specialisation {
    /// The import decides which meshes are stored once, because their copies may not fit the host's memory.
    pub(super) fn decide_on_instances(&mut self, scene: &Scene, settings: &Settings) {
        let instances = scene.instances.len();
        let on = instances > 0 && Self::traces_instances(settings);
        let why = format!("{} of meshes that are stored once", count(instances, "instance", "instances"));
        let unneeded = "each triangle is in the scene by itself";
        let bytes = bytes_text(16 * u64::from(INSTANCE_TEXELS) * instances as u64);
        let cost = format!("{bytes}; rays one by one, with a change of space at every copy that they may meet");
        self.decide(Feature::Instances, on, why, unneeded, &cost);
    }
}

impl Facts {
    pub(super) fn new(scene: &Scene) -> Facts {
        let mut facts = Facts::default();
        let mut used = vec![false; scene.materials.len()];
        for triangle in &scene.triangles {
            used[triangle.material as usize] = true;
        }
        for object in &scene.procedurals {
            used[object.material as usize] = true;
        }
        for (m, _) in scene.materials.iter().zip(used).filter(|(_, used)| *used) {
            facts.textured += usize::from(m.texture_infos().next().is_some());
            facts.uv1 += usize::from(m.texture_infos().any(|info| info.uv_set == 1));
            facts.normal_maps += usize::from(m.normal_texture.is_some());
            for (number, lobe) in facts.lobes.iter_mut().zip(LOBES) {
                *number += usize::from((lobe.has)(m));
            }
            facts.focusing += usize::from(focuses(m));
            facts.clear += usize::from(focuses(m) && m.roughness <= CLEAR_ROUGHNESS);
            facts.reflecting += usize::from(!m.is_black());
            facts.transmitting += usize::from(m.lets_light_pass());
            facts.alpha += usize::from(m.alpha != AlphaMode::Opaque);
            facts.unlit += usize::from(m.unlit);
        }
        facts.vertex_colours = scene.vertices.par_iter().any(|v| v.colour != glam::Vec4::ONE);
        facts.smooth_normals = scene.triangles.par_iter().any(|triangle| !scene.is_flat(triangle));
        let triangles = (0..scene.triangles.len()).into_par_iter();
        facts.needles = triangles.filter(|i| is_needle(scene.triangle_positions(*i))).count();
        for light in &scene.lights {
            match &light.kind {
                LightKind::Mesh { material, .. } => {
                    facts.mesh_lights += 1;
                    let material = &scene.materials[*material as usize];
                    facts.textured_lights += usize::from(material.emissive_texture.is_some());
                    facts.transparent_lights += usize::from(material.alpha != AlphaMode::Opaque);
                    facts.lights_of_volumes += usize::from(material.emits_into_volume());
                }
                LightKind::Point { .. } => facts.point_lights += 1,
                LightKind::Spot { .. } => facts.spot_lights += 1,
                LightKind::Directional { .. } => facts.directional_lights += 1,
                LightKind::Environment { .. } => {}
            }
        }
        debug_assert!(scene.triangles.iter().all(|t| t.light == NO_LIGHT || (t.light as usize) < scene.lights.len()));
        facts
    }
}
