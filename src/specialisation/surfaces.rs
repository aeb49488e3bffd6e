//! What the surfaces of a scene need, and the facts about its materials and lights.

use glam::Vec3;

use crate::scene::{AlphaMode, LightKind, Material, NO_LIGHT, Scene};

use super::decisions::{Specialisation, bytes_text, count};

impl Specialisation {
    pub(super) fn of_surfaces(&mut self, scene: &Scene, m: &Facts) {
        let triangles = scene.triangles.len() as u64;
        let per_triangle = |bytes: u64| format!("{bytes} B a triangle, {} in all", bytes_text(bytes * triangles));
        let materials = |n: usize, what: &str| (n > 0, format!("{} {what}", count(n, "material")));
        let (on, why) = materials(m.textured, "with textures");
        self.decide("textures", on, why, "no material has a texture", "texture lookups in every surface; texels");
        let (on, why) = materials(m.uv1, "with a second set of texture coordinates");
        self.decide("uv1", on, why, "no texture uses the second set of coordinates", &per_triangle(16));
        let (on, why) = materials(m.normal_maps, "with normal maps");
        self.decide("normal_maps", on, why, "no material has a normal map", &per_triangle(16));
        let (on, why) = materials(m.glossy, "not Lambertian");
        self.decide(
            "glossy",
            on,
            why,
            "every material is Lambertian",
            "specular terms at every light point; 32 B a point",
        );
        let (on, why) = materials(m.transmission, "that light passes through");
        let cost = "a lobe more at every glossy surface; 16 B a point";
        self.decide("transmission", on, why, "no light passes through any material", cost);
        let (on, why) = materials(m.clearcoat, "with a clear coat");
        self.decide("clearcoat", on, why, "no material has a clear coat", cost);
        let (on, why) = materials(m.coat_normals, "whose clear coat has a normal of its own");
        let unneeded = "every clear coat has the normal of its base";
        self.decide("coat_normals", on, why, unneeded, &format!("a normal at every coat; {}", per_triangle(16)));
        let (on, why) = materials(m.anisotropy, "with anisotropic reflections");
        let cost = "a tangent at every surface; 16 B a point and a triangle";
        self.decide("anisotropy", on, why, "every material reflects alike along and across", cost);
        let (on, why) = materials(m.sheen, "with a sheen of fibres");
        let cost = "a lobe more at every glossy surface; a table of 31 kB; 16 B a point";
        self.decide("sheen", on, why, "no material has a sheen", cost);
        let (on, why) = materials(m.alpha, "with alpha mask or blending");
        self.decide(
            "alpha_test",
            on,
            why,
            "every surface is opaque",
            "a test at every alpha triangle that a ray meets",
        );
        let (on, why) = materials(m.unlit, "unlit");
        self.decide("unlit", on, why, "no material is unlit", "a branch in every surface");
        let vertices = |on: bool| (on, "some vertices have them".to_owned());
        let (on, why) = vertices(m.vertex_colours);
        self.decide("vertex_colours", on, why, "every vertex is white", &per_triangle(32));
        let (on, why) = (m.needles > 0, format!("{}, the distance along which rounds", count(m.needles, "needle")));
        let unneeded = "no triangle is much longer than wide";
        self.decide("needles", on, why, unneeded, "a plane at every triangle that a ray is tested with");
        let (on, why) = vertices(m.smooth_normals);
        self.decide(
            "smooth_normals",
            on,
            why,
            "every triangle is flat",
            "normals interpolated, and points moved to the smooth surface, at every hit",
        );

        let objects = scene.procedurals.len();
        self.features = std::mem::take(&mut self.features).with_functions(scene.functions.clone());
        self.decide(
            "procedurals",
            objects > 0,
            format!("{} described by functions", count(objects, "object")),
            "no object is a function",
            "a box test a ray and object, and the functions in every kernel that traces; 128 B an object",
        );
    }
}

/// A material with a sheen: one of a colour other than black.
fn has_sheen(m: &Material) -> bool {
    !m.unlit && m.sheen_colour != Vec3::ZERO
}

/// A material with a clear coat that has another normal than the base: each has its own map, or only one of them has one.
fn has_coat_normal(m: &Material) -> bool {
    let base = m.normal_texture.map(|map| (map, m.normal_scale));
    let coat = m.clearcoat_normal_texture.map(|map| (map, m.clearcoat_normal_scale));
    !m.unlit && m.clearcoat > 0.0 && base != coat
}

/// A triangle that is so much longer than wide that rounding moves the point where a ray meets it farther along it than rays
/// are kept clear of surfaces: by up to 0.13 units of f32 for each time that it is as long as wide, times its length
/// (`tests/kernels/precision.rs`), where rays begin 8 units or more off (`offset_origin` in `shaders/lib/ray.wgsl`). Of
/// floors of needles as long as the scene the first ray is stopped between aspects of 100 and 1000.
fn is_needle([a, b, c]: [Vec3; 3]) -> bool {
    const LONG: f32 = 100.0;
    let longest2 = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    let height = (b - a).cross(c - a).length() / longest2.sqrt();
    longest2 > LONG * height
}

/// A material that reflects only as a Lambertian: no metal, and no dielectric layer.
fn is_lambertian(m: &Material) -> bool {
    m.unlit || (m.metallic == 0.0 && m.specular == 0.0 && m.transmission == 0.0 && m.clearcoat == 0.0 && !has_sheen(m))
}

/// A material some part of which light passes through, or is reflected by as by a metal that is not rough: its factors leave
/// room for it, as textures multiply them.
fn focuses(m: &Material) -> bool {
    let metal = m.metallic > 0.0 || m.ior == 0.0 || m.ior > 2.6;
    let smooth = m.roughness * m.roughness <= FOCUSING_ALPHA || m.metallic_roughness_texture.is_some();
    !m.unlit && (m.transmission > 0.0 || (metal && smooth))
}

/// Roughness factor of surfaces that are mirrors or clear glass to the eye: its square is the least alpha of the kernels.
const CLEAR_ROUGHNESS: f32 = 0.032;

/// Widest lobes of metals that count as focusing, as alpha: roughness 0.3. Wider ones show no caustics.
pub(crate) const FOCUSING_ALPHA: f32 = 0.09;

/// Numbers of materials and lights that have some property, counting only materials that a triangle or an object uses.
#[derive(Default)]
pub(super) struct Facts {
    pub(super) textured: usize,
    pub(super) uv1: usize,
    pub(super) normal_maps: usize,
    pub(super) glossy: usize,
    pub(super) transmission: usize,
    pub(super) clearcoat: usize,
    pub(super) coat_normals: usize,
    pub(super) focusing: usize,
    pub(super) clear: usize,
    pub(super) anisotropy: usize,
    pub(super) sheen: usize,
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
            facts.textured += usize::from(m.shown_slots().next().is_some());
            facts.uv1 += usize::from(m.shown_slots().any(|s| s.uv_set == 1));
            facts.normal_maps += usize::from(m.normal_texture.is_some());
            facts.glossy += usize::from(!is_lambertian(m));
            facts.transmission += usize::from(!m.unlit && m.transmission > 0.0);
            facts.focusing += usize::from(focuses(m));
            facts.clear += usize::from(focuses(m) && m.roughness <= CLEAR_ROUGHNESS);
            facts.clearcoat += usize::from(!m.unlit && m.clearcoat > 0.0);
            facts.coat_normals += usize::from(has_coat_normal(m));
            facts.anisotropy += usize::from(!is_lambertian(m) && m.anisotropy > 0.0);
            facts.sheen += usize::from(has_sheen(m));
            let black = m.unlit || (is_lambertian(m) && m.base_colour.truncate() == Vec3::ZERO);
            facts.reflecting += usize::from(!black);
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
