//! Decisions on the lights of a scene, and on how shading points sample them.

use glam::Vec3;

use super::bsdf_rays::{Sphere, boxes_by_material};
use super::decisions::Specialisation;
use super::surfaces::Facts;
use crate::count::count;
use crate::kernels::MAX_LIGHTS;
use crate::kernels::light_texels::{FEW_EMITTERS, NEAR_LIGHT};
use crate::scene::{Light, LightKind, Scene};
use crate::settings::technique::ConsideredLights;
use crate::settings::{Aov, LightSampling, Settings};
use crate::specialisation::features::Feature;

impl Specialisation {
    pub(super) fn decide_on_lights(&mut self, scene: &Scene, m: &Facts) {
        let some_lights = |n: usize| (n > 0, count(n, "light", "lights"));
        for (feature, number) in [
            (Feature::MeshLights, m.mesh_lights),
            (Feature::PointLights, m.point_lights),
            (Feature::SpotLights, m.spot_lights),
            (Feature::DirectionalLights, m.directional_lights),
        ] {
            let (on, why) = some_lights(number);
            self.decide(feature, on, why, "the scene has none", "a branch at every light point and photon");
        }
        let panorama = scene.environment();
        let why = panorama
            .map_or(String::new(), |p| format!("a panorama of {} x {} texels surrounds the scene", p.width, p.height));
        let unneeded = "the scene has no environment";
        let cost = "look-ups where rays leave the scene and at every light point; 16 B per texel";
        self.decide(Feature::Environment, panorama.is_some(), why, unneeded, cost);
        let (on, why) = some_lights(m.textured_lights);
        self.decide(
            Feature::EmissiveTextures,
            on,
            why,
            "no emission is textured",
            "texture lookups at every light point",
        );
        let (on, why) = some_lights(m.transparent_lights);
        let unneeded = "no mesh light is transparent in parts";
        self.decide(Feature::EmissiveAlpha, on, why, unneeded, "the alpha test at every light point");
        let (on, why) = some_lights(m.lights_of_volumes);
        let on = on && self.features.has(Feature::Transmission);
        let unneeded = "no mesh light emits into a volume of its own";
        self.decide(Feature::EmissiveVolumes, on, why, unneeded, "the volume behind every light point");

        self.decide(
            Feature::DarkPoints,
            !scene.placed_lights().is_empty(),
            "points that face away from a light need no ray".into(),
            "no point can face away from a light",
            "a test at every point and light",
        );
        let many = |light: &&Light| has_many_emitters(light);
        let (on, why) = some_lights(scene.lights.iter().filter(many).count());
        let unneeded = "every light has so few triangles that points evaluate all of them";
        self.decide(Feature::ManyEmitters, on, why, unneeded, "a search at every light point");
        let closed = |light: &&Light| is_closed(scene, light);
        let (on, why) = some_lights(scene.lights.iter().filter(many).filter(closed).count());
        self.decide(
            Feature::EmitterPairs,
            on,
            why,
            "no light of many triangles is a closed mesh",
            "two table look-ups at every light point; 1 to 9 kB per triangle",
        );
    }

    pub(super) fn decide_on_light_sampling(&mut self, scene: &Scene, settings: &Settings) {
        let (sampling, why) = light_sampling(scene, settings);
        let few = !matches!(sampling, LightSampling::All) && !settings.technique.is_path_tracing();
        let cost = format!("pass sample_lights; {} B per point", 8 * settings.light_sampling.sampled_lights);
        self.decide(Feature::LightSampling, few, why.clone(), &why, &cost);
        let uniform = sampling == LightSampling::Uniform;
        self.decide(
            Feature::UniformLightSampling,
            uniform,
            "requested".into(),
            "not requested",
            "much noise where lights differ",
        );
        self.decide(
            Feature::ContributionSampling,
            sampling == LightSampling::Contribution,
            "requested".into(),
            "not requested",
            "two potentials of each light at every point",
        );
        let zones = sampling == LightSampling::Zones;
        let cost = "passes photons, grid, zones before the first sample; 256 B a zone, of 32,768 at most, and 64 \
                    potentials a point";
        self.decide(Feature::Zones, zones, why.clone(), &why, cost);
    }
}

/// The facts of a packed light that decide on features.
pub(crate) struct LightFacts {
    /// It has a closed form.
    pub closed_form: bool,
    /// It has tables of the triangles that are seen from each direction.
    pub viewed: bool,
    /// Its bounding sphere.
    pub bounds: Sphere,
}

impl Specialisation {
    /// Decides what depends on the packed lights, which are those of the scene.
    pub(crate) fn decide_on_packed_lights(&mut self, scene: &Scene, lights: &[LightFacts]) {
        self.features.set(Feature::ClosedForms, lights.iter().any(|light| light.closed_form));
        self.features.set(Feature::SampledForms, lights.iter().any(|light| !light.closed_form));
        let boxes = boxes_by_material(scene);
        let reflecting = || scene.materials.iter().zip(&boxes).filter(|(m, _)| !m.is_black()).filter_map(|(_, b)| *b);
        let is_far = |light: &LightFacts| {
            let far = NEAR_LIGHT * light.bounds.radius;
            light.viewed && reflecting().all(|bounds| light.bounds.distance_to(&bounds) > far)
        };
        let mut many = lights.iter().zip(&scene.lights).filter(|(_, light)| has_many_emitters(light));
        let far = self.features.has(Feature::EmitterPairs) && many.all(|(facts, _)| is_far(facts));
        self.features.set(Feature::FarEmitters, far);
    }
}

/// How shading points sample lights, and why.
fn light_sampling(scene: &Scene, settings: &Settings) -> (LightSampling, String) {
    let (lights, placed) = (scene.lights.len(), scene.placed_lights().len());
    let sampled = settings.light_sampling.sampled_lights as usize;
    let technique = settings.technique;
    let all = |why: String| (LightSampling::All, why);
    if technique.is_path_tracing() {
        let sampling = settings.light_sampling.strategy.unwrap_or(LightSampling::Power);
        return (sampling, "paths sample one light at each vertex".into());
    }
    let few_enough = || {
        all(match lights {
            1 => "there is one light".to_owned(),
            _ => format!("{lights} lights are few enough to evaluate all of them"),
        })
    };
    if lights <= sampled || scene.is_empty() {
        return few_enough();
    }
    if settings.image.aovs.contains(&Aov::Shadow) {
        return all("the AOV shadow covers all lights".into());
    }
    let evaluates_all = || all(format!("the technique {technique} evaluates all lights"));
    if !technique.samples_lights() {
        return evaluates_all();
    }
    let requested = |sampling: LightSampling| {
        (sampling, format!("points sample {sampled} of {lights} lights: `light_sampling.strategy` is {sampling}"))
    };
    match settings.light_sampling.strategy {
        Some(LightSampling::Uniform) => requested(LightSampling::Uniform),
        Some(LightSampling::Power) => requested(LightSampling::Power),
        Some(LightSampling::Contribution) if lights <= MAX_LIGHTS as usize => requested(LightSampling::Contribution),
        Some(LightSampling::Contribution) => (
            LightSampling::Power,
            format!("points sample {sampled} of {lights} lights by power: too many to weigh each"),
        ),
        Some(LightSampling::All) => all("`light_sampling.strategy` is all".into()),
        None if technique.requirements().lights == ConsideredLights::AllOrSampled => evaluates_all(),
        None if lights <= Settings::MANY_LIGHTS as usize => few_enough(),
        _ if placed > 0 && placed <= MAX_LIGHTS as usize => {
            let why = format!("points sample {sampled} of {lights} lights, by the light that reaches their zone");
            (LightSampling::Zones, why)
        }
        _ => {
            let why = format!(
                "points sample {sampled} of {lights} lights by power: a photon's word has room for {MAX_LIGHTS}"
            );
            (LightSampling::Power, why)
        }
    }
}

/// Whether a light has too many triangles to evaluate the contribution of each, so that points sample one by power.
pub fn has_many_emitters(light: &Light) -> bool {
    matches!(&light.kind, LightKind::Mesh { emitters, .. } if emitters.len() > FEW_EMITTERS as usize)
}

/// Whether a light is a closed mesh that emits outwards, so that half of its triangles face away from any point:
/// its area vectors sum to 0.
pub fn is_closed(scene: &Scene, light: &Light) -> bool {
    let LightKind::Mesh { material, emitters } = &light.kind else { return false };
    let triangles: Vec<_> = emitters.iter().map(|e| scene.triangle_positions(e.triangle as usize)).collect();
    is_closed_mesh(&triangles, scene.materials[*material as usize].double_sided)
}

/// As [`is_closed`], for triangles.
pub(crate) fn is_closed_mesh(triangles: &[[Vec3; 3]], two_sided: bool) -> bool {
    let mut sum = Vec3::ZERO;
    let mut area = 0.0;
    for [a, b, c] in triangles {
        let across = (*b - *a).cross(*c - *a);
        sum += across;
        area += across.length();
    }
    // The tolerance of a hundredth lets a mesh with a small hole for a socket count as closed.
    !two_sided && sum.length() < 0.01 * area
}
