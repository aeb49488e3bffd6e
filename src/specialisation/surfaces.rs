//! What the surfaces of a scene need, and the facts about its materials and lights.

use crate::specialisation::features::{Feature, Features};
use glam::Vec3;

use crate::scene::{
    AlphaMode, Anisotropy, Clearcoat, Iridescence, LightKind, Material, NO_LIGHT, Scene, Sheen, Specular, Transmission,
};

use super::decisions::{Specialisation, bytes_text, count};

impl Specialisation {
    pub(super) fn of_surfaces(&mut self, scene: &Scene, m: &Facts) {
        let triangles = scene.triangles.len() as u64;
        let per_triangle = |bytes: u64| format!("{bytes} B a triangle, {} in all", bytes_text(bytes * triangles));
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
            "a test at every alpha triangle that a ray meets",
        );
        let (on, why) = materials(m.unlit, "unlit");
        self.decide(Feature::Unlit, on, why, "no material is unlit", "a branch in every surface");
        let vertices = |on: bool| (on, "some vertices have them".to_owned());
        let (on, why) = vertices(m.vertex_colours);
        self.decide(Feature::VertexColours, on, why, "every vertex is white", &per_triangle(32));
        let (on, why) = (m.needles > 0, format!("{}, the distance along which rounds", count(m.needles, "needle")));
        let unneeded = "no triangle is much longer than wide";
        self.decide(Feature::Needles, on, why, unneeded, "a plane at every triangle that a ray is tested with");
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
            "a box test a ray and object, and the functions in every kernel that traces; 128 B an object",
        );
    }
}

/// A lobe of surfaces that not every scene needs.
struct LobeFeature {
    /// What the kernels have it by.
    feature: Feature,
    /// Whether a material needs it.
    has: fn(&Material) -> bool,
    /// Vectors that it takes in a packed surface.
    vectors: u32,
    /// What the materials are that need it, after their number.
    materials: &'static str,
    /// Why it is left out.
    unneeded: &'static str,
    /// What it costs.
    cost: &'static str,
    /// What it costs beside, in bytes a triangle.
    triangle_bytes: u64,
}

/// All of them. A packed surface has a vector more, its albedo and normal.
const LOBES: &[LobeFeature] = &[
    LobeFeature {
        feature: Feature::Glossy,
        has: |m| !m.is_lambertian(),
        vectors: Specular::VECTORS,
        materials: "not Lambertian",
        unneeded: "every material is Lambertian",
        cost: "specular terms at every light point; 32 B a point",
        triangle_bytes: 0,
    },
    LobeFeature {
        feature: Feature::Transmission,
        has: |m| !m.unlit && m.transmission.is_present(),
        vectors: Transmission::VECTORS,
        materials: "that light passes through",
        unneeded: "no light passes through any material",
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
        unneeded: "every material reflects alike along and across",
        cost: "a tangent at every surface; 16 B a point and a triangle",
        triangle_bytes: 0,
    },
    LobeFeature {
        feature: Feature::Sheen,
        has: |m| !m.unlit && m.sheen.is_present(),
        vectors: Sheen::VECTORS,
        materials: "with a sheen of fibres",
        unneeded: "no material has a sheen",
        cost: "a lobe more at every glossy surface; a table of 31 kB; 16 B a point",
        triangle_bytes: 0,
    },
    LobeFeature {
        feature: Feature::Iridescence,
        has: |m| !m.unlit && m.iridescence.is_present(),
        vectors: Iridescence::VECTORS,
        materials: "with iridescence",
        unneeded: "no material is iridescent",
        cost: "the reflectance of a thin film at every glossy surface; 16 B a point",
        triangle_bytes: 0,
    },
];

/// What most lobes cost.
const LOBE_COST: &str = "a lobe more at every glossy surface; 16 B a point";

/// Vectors that a point's surface takes with those features: `VisibleSurface` of `shaders/lib/point.wgsl`.
pub fn surface_vectors(features: &Features) -> u32 {
    let lobes: u32 = LOBES.iter().filter(|lobe| features.has(lobe.feature)).map(|lobe| lobe.vectors).sum();
    let chain = u32::from(features.has(Feature::SpecularChains));
    let photons_shown = features.has(Feature::PhotonMap) || features.has(Feature::Caustics);
    let triangle = u32::from(features.has(Feature::SmoothNormals) && photons_shown);
    1 + lobes + chain + triangle
}

/// A triangle that is so much longer than wide that rounding moves the point where a ray meets it farther along it
/// than rays are kept clear of surfaces: by up to 0.13 units of f32 for each time that it is as long as wide, times
/// its length (`tests/kernels/precision.rs`), where rays begin 8 units or more off (`offset_origin` in
/// `shaders/lib/ray.wgsl`). Of floors of needles as long as the scene the first ray is stopped between aspects of 100
/// and 1000.
fn is_needle([a, b, c]: [Vec3; 3]) -> bool {
    const LONG: f32 = 100.0;
    let longest2 = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    let height = (b - a).cross(c - a).length() / longest2.sqrt();
    longest2 > LONG * height
}

/// A material some part of which light passes through, or is reflected by as by a metal that is not rough, or as by a
/// thin film: its factors leave room for it, as textures multiply them.
fn focuses(m: &Material) -> bool {
    let metal = m.metallic > 0.0 || m.ior == 0.0 || m.ior > 2.6 || m.iridescence.is_present();
    let smooth = m.roughness * m.roughness <= FOCUSING_ALPHA || m.metallic_roughness_texture.is_some();
    !m.unlit && (m.transmission.is_present() || (metal && smooth))
}

/// Roughness factor of surfaces that are mirrors or clear glass to the eye: its square is the least alpha of the
/// kernels.
const CLEAR_ROUGHNESS: f32 = 0.032;

/// Widest lobes of metals that count as focusing, as alpha: roughness 0.3. Wider ones show no caustics.
pub(crate) const FOCUSING_ALPHA: f32 = 0.09;

/// Numbers of materials and lights that have some property, counting only materials that a triangle or an object uses.
#[derive(Default)]
pub(super) struct Facts {
    pub(super) textured: usize,
    pub(super) uv1: usize,
    pub(super) normal_maps: usize,
    /// Materials with each lobe of [`LOBES`].
    lobes: [usize; LOBES.len()],
    pub(super) focusing: usize,
    pub(super) clear: usize,
    /// All but black ones.
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
