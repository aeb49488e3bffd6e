//! What a scene needs: the one place that decides which modules and branches the kernels are composed of, which
//! buffers exist and which passes run.

use glam::Vec3;
use serde::Serialize;

use crate::bvh::Bvh;
use crate::gpu::Features;
use crate::gpu_scene::lights;
use crate::passes::cells;
use crate::passes::grid::MAX_LIGHTS;
use crate::scene::{AlphaMode, Light, LightKind, Material, NO_LIGHT, Scene};
use crate::settings::{Aov, LightSampling, Settings, Technique};

/// What was decided for a scene and its settings.
#[derive(Clone, Debug, Serialize)]
pub struct Specialisation {
    /// What the kernels are composed with.
    #[serde(skip)]
    pub features: Features,
    /// What is there, and why.
    pub kept: Vec<Item>,
    /// What was left out, and why.
    pub left_out: Vec<Item>,
}

/// Something that a render can have or do without.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Item {
    /// What it is.
    pub name: &'static str,
    /// Why it is kept or left out.
    pub reason: String,
    /// What it costs, or would.
    pub cost: String,
}

impl Specialisation {
    /// Decides what `scene` rendered with `settings` needs.
    pub fn new(scene: &Scene, settings: &Settings) -> Specialisation {
        let mut specialisation =
            Specialisation { features: Features::default(), kept: Vec::new(), left_out: Vec::new() };
        let facts = Facts::new(scene);
        specialisation.of_surfaces(scene, &facts);
        specialisation.of_lights(scene, &facts);
        specialisation.of_light_sampling(scene, settings);
        specialisation.of_visibility(scene, settings);
        specialisation.of_indirect_light(scene, settings, &facts);
        specialisation.of_channels(settings);
        specialisation
    }

    fn of_surfaces(&mut self, scene: &Scene, m: &Facts) {
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

    fn of_lights(&mut self, scene: &Scene, m: &Facts) {
        let some_lights = |n: usize| (n > 0, count(n, "light"));
        for (feature, number) in [
            ("mesh_lights", m.mesh_lights),
            ("point_lights", m.point_lights),
            ("spot_lights", m.spot_lights),
            ("directional_lights", m.directional_lights),
        ] {
            let (on, why) = some_lights(number);
            self.decide(feature, on, why, "the scene has none", "a branch at every light point and photon");
        }
        let panorama = scene.environment();
        let why = panorama
            .map_or(String::new(), |p| format!("a panorama of {} x {} texels is all around", p.width, p.height));
        let unneeded = "the scene has no environment";
        let cost = "look-ups where rays leave the scene and at every light point; 16 B a texel";
        self.decide("environment", panorama.is_some(), why, unneeded, cost);
        let (on, why) = some_lights(m.textured_lights);
        self.decide("emissive_textures", on, why, "no emission is textured", "texture lookups at every light point");

        self.decide(
            "dark_points",
            !scene.placed_lights().is_empty(),
            "points that face away from a light need no ray".into(),
            "there is no light that a point could face away from",
            "a test at every point and light",
        );
        let many = |light: &&Light| lights::has_many_emitters(light);
        let (on, why) = some_lights(scene.lights.iter().filter(many).count());
        let unneeded = "points ask all triangles of every light what they send";
        self.decide("many_emitters", on, why, unneeded, "a search at every light point");
        let closed = |light: &&Light| lights::is_closed(scene, light);
        let (on, why) = some_lights(scene.lights.iter().filter(many).filter(closed).count());
        self.decide(
            "emitter_pairs",
            on,
            why,
            "no light of many triangles is a closed mesh",
            "two records at every light point; 1 kB a triangle",
        );
    }

    fn of_light_sampling(&mut self, scene: &Scene, settings: &Settings) {
        let (choice, why) = light_sampling(scene, settings);
        let few = !matches!(choice, LightSampling::All) && settings.technique != Technique::Path;
        let cost = format!("pass choose; {} B a point", 8 * settings.light_sampling.sampled_lights);
        self.decide("light_sampling", few, why.clone(), &why, &cost);
        let uniform = choice == LightSampling::Uniform;
        self.decide(
            "uniform_light_sampling",
            uniform,
            "asked for".into(),
            "not asked for",
            "much noise where lights differ",
        );
        let zones = choice == LightSampling::Zones;
        let cost = "passes photons, grid, zones before the first sample; 256 B a zone, of 32,768 at most, and 64 potentials a point";
        self.decide("zones", zones, why.clone(), &why, cost);
    }

    /// What tells whether points see lights: photons, cells, audits.
    fn of_visibility(&mut self, scene: &Scene, settings: &Settings) {
        let map = settings.technique.uses_visibility_map();
        let placed = scene.placed_lights().len();
        let photons = u64::from(settings.visibility_map.photons_per_light) * placed as u64;
        let unneeded = if !map {
            format!("the technique {} does not ask it", settings.technique)
        } else if placed == 0 && scene.environment().is_some() {
            format!("the environment is the only light: {NO_PHOTONS}")
        } else if scene.lights.is_empty() {
            "there is no light".to_owned()
        } else {
            "there is nothing to be lit".to_owned()
        };
        let many = placed > MAX_LIGHTS as usize;
        let unneeded = if many { format!("a photon's word has room for {MAX_LIGHTS} lights") } else { unneeded };
        let few = self.features.has("light_sampling");
        // Of 64 lights of scenes/lamps.glb it left half of what was asked to shadow rays.
        let unneeded =
            if few { "points ask few of many lights: it costs more than it saves".to_owned() } else { unneeded };
        let wanted = map && !many && !few && placed > 0 && !scene.is_empty();
        let mut why = format!("{photons} photons tell lit and shadowed points apart");
        if scene.environment().is_some() {
            why += &format!("; none are of the environment: {NO_PHOTONS}");
        }
        let cost = format!("passes photons, grid, classify; about {}", bytes_text(photons * 24));
        self.decide("visibility_map", wanted, why, &unneeded, &cost);
        let several = placed > 1;
        let why = format!("{placed} lights");
        self.decide(
            "light_tags",
            wanted && several,
            why,
            "there is one light at most",
            "a key and a comparison a photon",
        );
        self.decide(
            "paper_counting",
            wanted && settings.visibility_map.paper_counting,
            "asked for".into(),
            "photons are counted by their normals",
            "false shadows beside objects",
        );
        let estimate = settings.technique == Technique::VisibilityEstimate;
        let why = "the photons' own visibility is shown (equation 1)".to_owned();
        let lit = is_lit(scene);
        let many = scene.lights.len() > MAX_LIGHTS as usize;
        let ward = lit && !many && scene.lights.len() > 1 && settings.technique == Technique::WardAdaptive;
        let why = if ward { "lights that are not tested are guessed".to_owned() } else { why };
        self.decide(
            "visibility_estimate",
            (wanted && estimate) || ward,
            why,
            "shadow rays decide at boundaries",
            "blurred shadows",
        );
        let other = format!("the technique {} does not ask it", settings.technique);
        let cells = lit && settings.technique.uses_cells();
        let why = format!("{} rays a cell and light tell what its points see", settings.cells.rays_per_light);
        let cost = format!("pass cells; about {}", bytes_text(grid_bytes(scene, settings)));
        self.decide("cells", cells, why, &other, &cost);
        let tags = cells && settings.technique == Technique::VoxelTags;
        let why = "voxels that agree with their neighbours need no shadow ray".to_owned();
        self.decide("voxel_tags", tags, why, &other, "a look at 26 neighbours a cell");
        let why = format!("lights are tested until the rest is below {} of a point's light", settings.ward.tolerance);
        let too_many = format!("its keys have room for {MAX_LIGHTS} lights: all are tested");
        let unneeded = match settings.technique {
            Technique::WardAdaptive if many => too_many.as_str(),
            Technique::WardAdaptive => "there is one light at most, which is always tested",
            _ => &other,
        };
        self.decide("ward", ward, why, unneeded, "pass ward: a round of tests a light; 4 B a point and light");
        let audited = wanted && !estimate && settings.visibility_map.audit > 0.0;
        let why = format!("{:.3} of the decided points trace a shadow ray all the same", settings.visibility_map.audit);
        let reason =
            if wanted && estimate { "the technique traces no shadow rays" } else { "nothing is decided by photons" };
        let reason = if wanted && !estimate { "`visibility_map.audit` is 0: the result may be biased" } else { reason };
        self.decide("audit", audited, why, reason, "a shadow ray for each audited point");
    }

    fn of_indirect_light(&mut self, scene: &Scene, settings: &Settings, m: &Facts) {
        let lit = is_lit(scene);
        let shaded = settings.technique.is_two_pass() && lit;
        // Without bounces a path's first ray is left, for the highlights of lights that rays can meet.
        let highlights = m.glossy > 0 && (m.mesh_lights > 0 || scene.environment().is_some());
        let why = match settings.indirect.max_bounces {
            0 => "highlights of lights that rays can meet".to_owned(),
            bounces => format!("up to {bounces} bounces"),
        };
        let unneeded = match settings.technique {
            Technique::Path => "paths bring all light",
            _ if settings.technique.shows_map() => "the map brings all light",
            _ if settings.indirect.max_bounces == 0 => "`indirect.max_bounces` is 0",
            _ if lit => "every surface is black",
            _ => "there is nothing to be lit",
        };
        let reflected = settings.indirect.max_bounces > 0 && m.reflecting > 0;
        let on = shaded && (reflected || highlights);
        self.decide(
            "indirect",
            on,
            why,
            unneeded,
            "pass path: a path from every glossy point, and where no record is; 16 B a point",
        );

        let shown = lit && settings.technique.shows_map();
        self.decide(
            "photon_map",
            shown,
            "the technique shows it".into(),
            "its light is gathered, not shown",
            "a search and 32 short rays a point",
        );
        let negative = shown && settings.technique == Technique::NegativePhotons;
        let why = "shadow photons take the energy of the light that they lack".to_owned();
        self.decide("negative_photons", negative, why, "no point is taken as lit", "a ray on from every first hit");
        let bounces = on && reflected;
        let why = format!("{} rays leave photons that tell irradiance", settings.indirect.photons);
        let unneeded = "no light of more bounces is asked for";
        let cost = format!("passes flux, irradiance; about {}", bytes_text(u64::from(settings.indirect.photons) * 48));
        self.decide("global_map", shown || bounces, why, unneeded, &cost);
        let why = format!("{} that is a mirror or clear glass", count(m.clear, "material"));
        let absent = match settings.technique {
            Technique::Path => "paths go on there",
            _ if settings.indirect.max_bounces == 0 => "`indirect.max_bounces` is 0",
            _ => "no material is a mirror or clear glass",
        };
        let traced = settings.technique != Technique::Path && settings.indirect.max_bounces > 0;
        let cost = "rays on from such surfaces, to where photons are; 16 B a point";
        self.decide("chains", traced && lit && m.clear > 0, why, absent, cost);
        let why = format!("{} that light is focused by", count(m.focusing, "material"));
        let unneeded = if bounces { "no material focuses light" } else { unneeded };
        let cost = "a map for every 8 samples: four times the rays of the global map, a search a point";
        self.decide("caustics", bounces && m.focusing > 0, why, unneeded, cost);
        let unneeded = if bounces {
            "`indirect.irradiance_cache.enabled` is false"
        } else {
            "no light of more bounces is asked for"
        };
        let why = format!(
            "records of {} rays hold the diffuse part of the indirect light",
            settings.indirect.irradiance_cache.gather_rays
        );
        let cost = "passes gather, cache; about 100 B a record";
        self.decide("irradiance_cache", bounces && settings.indirect.irradiance_cache.enabled, why, unneeded, cost);
    }

    fn of_channels(&mut self, settings: &Settings) {
        let pixels = u64::from(settings.image.width) * u64::from(settings.image.height);
        let aov = |aov: Aov| settings.image.aovs.contains(&aov);
        for (feature, on) in [
            ("aov_albedo", aov(Aov::Albedo)),
            ("aov_normal", aov(Aov::Normal)),
            ("aov_position", aov(Aov::Position) || aov(Aov::Depth)),
            ("aov_shadow", aov(Aov::Shadow)),
        ] {
            let cost = format!("{} of film", bytes_text(pixels * 32));
            self.decide(feature, on, "asked for".into(), "not asked for", &cost);
        }
    }

    /// What is decided once there is a hierarchy, which a plan does without.
    pub(crate) fn of_hierarchy(&mut self, bvh: &Bvh) {
        self.features = std::mem::take(&mut self.features).with("shallow_bvh", bvh.is_shallow());
    }

    /// Leaves the visibility map out, and what there is for it, once a render has found that it does not pay.
    pub(crate) fn leave_map_out(&mut self, reason: &str) {
        for name in ["visibility_map", "light_tags", "paper_counting", "audit"] {
            if let Some(at) = self.kept.iter().position(|item| item.name == name) {
                let item = self.kept.remove(at);
                self.left_out.push(Item { reason: reason.to_owned(), ..item });
                self.features = std::mem::take(&mut self.features).with(name, false);
            }
        }
    }

    fn decide(&mut self, name: &'static str, on: bool, kept_for: String, left_out_for: &str, cost: &str) {
        self.features = std::mem::take(&mut self.features).with(name, on);
        let reason = if on { kept_for } else { left_out_for.to_owned() };
        let list = if on { &mut self.kept } else { &mut self.left_out };
        list.push(Item { name, reason, cost: cost.to_owned() });
    }
}

/// So many of something.
fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Whether there is something to be lit, and a light.
fn is_lit(scene: &Scene) -> bool {
    !scene.lights.is_empty() && !scene.is_empty()
}

/// Which lights points ask, and why.
fn light_sampling(scene: &Scene, settings: &Settings) -> (LightSampling, String) {
    let (lights, placed) = (scene.lights.len(), scene.placed_lights().len());
    let chosen = settings.light_sampling.sampled_lights as usize;
    let photons = placed > 0 && placed <= MAX_LIGHTS as usize;
    if settings.technique == Technique::Path {
        let choice = settings.light_sampling.strategy.unwrap_or(LightSampling::Power);
        return (choice, "paths ask one light at each vertex".into());
    }
    let all = |why: String| (LightSampling::All, why);
    let technique = settings.technique;
    if lights <= chosen || scene.is_empty() {
        return all(format!("{lights} lights are few enough to ask all of them"));
    }
    if settings.image.aovs.contains(&Aov::Shadow) {
        return all("the AOV shadow is of all lights".into());
    }
    if !technique.samples_lights() {
        return all(format!("the technique {technique} asks all lights"));
    }
    let asked = |choice: LightSampling| {
        (choice, format!("points ask {chosen} of {lights} lights: `light_sampling.strategy` is {choice}"))
    };
    match settings.light_sampling.strategy {
        Some(LightSampling::Uniform) => asked(LightSampling::Uniform),
        Some(LightSampling::Power) => asked(LightSampling::Power),
        Some(LightSampling::All) => all("`light_sampling.strategy` is all".into()),
        None if technique == Technique::TwoPass => all(format!("the technique {technique} asks all lights")),
        None if lights <= Settings::MANY_LIGHTS as usize => {
            all(format!("{lights} lights are few enough to ask all of them"))
        }
        _ if photons => {
            (LightSampling::Zones, format!("points ask {chosen} of {lights} lights, by what reaches their zone"))
        }
        _ => {
            let why =
                format!("points ask {chosen} of {lights} lights by power: a photon's word has room for {MAX_LIGHTS}");
            (LightSampling::Power, why)
        }
    }
}

/// Bytes of the grid that cells are judged by: a count and a class word for each cell and light.
fn grid_bytes(scene: &Scene, settings: &Settings) -> u64 {
    8 * scene.lights.len() as u64 * u64::from(cells::grid_of(scene, settings.cells.resolution).cells())
}

/// Why the environment has no visibility photons.
const NO_PHOTONS: &str = "nearly every point sees a part of it, so that photons would find boundaries everywhere";

/// A number of bytes as people read it.
pub fn bytes_text(bytes: u64) -> String {
    match bytes {
        0..10_000 => format!("{bytes} B"),
        10_000..10_000_000 => format!("{} kB", bytes / 1000),
        _ => format!("{} MB", bytes / 1_000_000),
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
struct Facts {
    textured: usize,
    uv1: usize,
    normal_maps: usize,
    glossy: usize,
    transmission: usize,
    clearcoat: usize,
    coat_normals: usize,
    focusing: usize,
    clear: usize,
    anisotropy: usize,
    sheen: usize,
    /// All but black ones.
    reflecting: usize,
    alpha: usize,
    unlit: usize,
    vertex_colours: bool,
    smooth_normals: bool,
    needles: usize,
    mesh_lights: usize,
    point_lights: usize,
    spot_lights: usize,
    directional_lights: usize,
    textured_lights: usize,
}

impl Facts {
    fn new(scene: &Scene) -> Facts {
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
