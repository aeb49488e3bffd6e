//! Decisions on the surfaces of a scene, and facts about its materials and lights.

use crate::specialisation::features::{Feature, Features};
use glam::Vec3;

use crate::scene::{
    AlphaMode, Anisotropy, Clearcoat, Iridescence, LightKind, Material, NO_LIGHT, Scene, Sheen, Specular, Transmission,
};

use super::decisions::{Specialisation, bytes_text, count};

impl Specialisation {
    pub(super) fn of_surfaces(&mut self, scene: &Scene, m: &Facts) {
        let triangles = scene.triangles.len() as u64;
        let per_triangle = |bytes: u64| format!("{bytes} B per triangle, {} in all", bytes_text(bytes * triangles));
        let materials = |n: usize, what: &str| (n > 0, format!("{} {what}", count(n, "material")));
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
            let cost = match lobe.triangle_bytes {
                0 => lobe.cost.to_owned(),
                bytes => format!("{}; {}", lobe.cost, per_triangle(bytes)),
            };
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
        let (on, why) = (m.needles > 0, format!("{} with inexact hit distances", count(m.needles, "needle")));
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
            format!("{} described by functions", count(objects, "object")),
            "no object is a function",
            "a box test per ray and object, and the functions in every kernel that traces; 128 B per object",
        );
    }
}

/// A lobe that not every scene needs.
struct LobeFeature {
    /// The feature that puts it in the kernels.
    feature: Feature,
    /// Whether a material needs it.
    has: fn(&Material) -> bool,
    /// Number of vectors that it takes in a packed surface.
    vectors: u32,
    /// Description of the materials that need it, which follows their number.
    materials: &'static str,
    /// The reason for leaving it out.
    unneeded: &'static str,
    /// Its cost.
    cost: &'static str,
    /// Its cost in bytes per triangle.
    triangle_bytes: u64,
}

/// All lobes. A packed surface has one more vector, for albedo and normal.
const LOBES: &[LobeFeature] = &[
    LobeFeature {
        feature: Feature::Glossy,
        has: |m| !m.is_lambertian(),
        vectors: Specular::VECTORS,
        materials: "not Lambertian",
        unneeded: "every material is Lambertian",
        cost: "specular terms at every light point; 32 B per point",
        triangle_bytes: 0,
    },
    LobeFeature {
        feature: Feature::Transmission,
        has: |m| !m.unlit && m.transmission.is_present(),
        vectors: Transmission::VECTORS,
        materials: "that may transmit light",
        unneeded: "no material transmits light",
        cost: LOBE_COST,
        triangle_bytes: 0,
    },
    LobeFeature {
        feature: Feature::Clearcoat,
        has: |m| !m.unlit && m.clearcoat.is_present(),
        vectors: Clearcoat::VECTORS,
        materials: "with a clear coat",
        unneeded: "no material has a clear coat",
        cost: LOBE_COST,
        triangle_bytes: 0,
    },
    LobeFeature {
        feature: Feature::CoatNormals,
        has: |m| !m.unlit && m.clearcoat.has_own_normal(m.normal_texture.map(|map| (map, m.normal_scale))),
        vectors: 0,
        materials: "whose clear coat has a normal of its own",
        unneeded: "every clear coat has the normal of its base",
        cost: "a normal at every coat",
        triangle_bytes: 16,
    },
    LobeFeature {
        feature: Feature::Anisotropy,
        has: |m| !m.is_lambertian() && m.anisotropy.is_present(),
        vectors: Anisotropy::VECTORS,
        materials: "with anisotropic reflections",
        unneeded: "every material is isotropic",
        cost: "a tangent at every surface; 16 B per point and per triangle",
        triangle_bytes: 0,
    },
    LobeFeature {
        feature: Feature::Sheen,
        has: |m| !m.unlit && m.sheen.is_present(),
        vectors: Sheen::VECTORS,
        materials: "with a sheen of fibres",
        unneeded: "no material has a sheen",
        cost: "one more lobe at every glossy surface; a table of 31 kB; 16 B per point",
        triangle_bytes: 0,
    },
    LobeFeature {
        feature: Feature::Iridescence,
        has: |m| !m.unlit && m.iridescence.is_present(),
        vectors: Iridescence::VECTORS,
        materials: "with iridescence",
        unneeded: "no material is iridescent",
        cost: "the reflectance of a thin film at every glossy surface; 16 B per point",
        triangle_bytes: 0,
    },
];

/// The cost of most lobes.
const LOBE_COST: &str = "one more lobe at every glossy surface; 16 B per point";

/// Number of vectors of a point's surface: `VisibleSurface` of `shaders/lib/point.wgsl`.
pub fn surface_vectors(features: &Features) -> u32 {
    let lobes: u32 = LOBES.iter().filter(|lobe| features.has(lobe.feature)).map(|lobe| lobe.vectors).sum();
    let chain = u32::from(features.has(Feature::SpecularChains));
    let photons_shown = features.has(Feature::PhotonMap) || features.has(Feature::Caustics);
    let triangle = u32::from(features.has(Feature::SmoothNormals) && photons_shown);
    1 + lobes + chain + triangle
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

/// Whether a material may focus light: it transmits light, or is a smooth metal or a thin film. This is decided by its
/// factors, which textures can only reduce.
fn focuses(m: &Material) -> bool {
    let metal = m.metallic > 0.0 || m.ior == 0.0 || m.ior > 2.6 || m.iridescence.is_present();
    let smooth = m.roughness * m.roughness <= FOCUSING_ALPHA || m.metallic_roughness_texture.is_some();
    !m.unlit && (m.transmission.is_present() || (metal && smooth))
}

/// Maximum roughness factor of surfaces that look like mirrors or clear glass. Its square is the minimum alpha of the
/// kernels.
const CLEAR_ROUGHNESS: f32 = 0.032;

/// Maximum alpha of metals that count as focusing: roughness 0.3. Wider lobes show no caustics.
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
            facts.textured += usize::from(m.visible_textures().next().is_some());
            facts.uv1 += usize::from(m.visible_textures().any(|info| info.uv_set == 1));
            facts.normal_maps += usize::from(m.normal_texture.is_some());
            for (number, lobe) in facts.lobes.iter_mut().zip(LOBES) {
                *number += usize::from((lobe.has)(m));
            }
            facts.focusing += usize::from(focuses(m));
            facts.clear += usize::from(focuses(m) && m.roughness <= CLEAR_ROUGHNESS);
            facts.reflecting += usize::from(!m.is_black());
            facts.alpha += usize::from(m.alpha != AlphaMode::Opaque);
            facts.unlit += usize::from(m.unlit);
        }
        facts.vertex_colours = scene.vertices.iter().any(|v| v.colour != glam::Vec4::ONE);
        facts.smooth_normals = scene.triangles.iter().any(|triangle| !scene.is_flat(triangle));
        facts.needles = (0..scene.triangles.len()).filter(|i| is_needle(scene.triangle_positions(*i))).count();
        for light in &scene.lights {
            match &light.kind {
                LightKind::Mesh { material, .. } => {
                    facts.mesh_lights += 1;
                    let textured = scene.materials[*material as usize].emissive_texture.is_some();
                    facts.textured_lights += usize::from(textured);
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
