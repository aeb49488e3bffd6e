//! Decisions on indirect light: paths, the global map, caustics, the irradiance cache.

use super::bsdf_rays::{MIN_HIT_PROBABILITY, max_hit_probability};
use super::decisions::{Specialisation, bytes_text, is_lit};
use super::surfaces::Facts;
use crate::count::count;
use crate::scene::Scene;
use crate::settings::Settings;
use crate::settings::stages::{grows, settings_of_stages};
use crate::specialisation::features::Feature;

impl Specialisation {
    pub(super) fn decide_on_indirect_light(&mut self, scene: &Scene, settings: &Settings, m: &Facts) {
        let lit = is_lit(scene);
        let technique = settings.technique;
        // Without bounces, only a path's first vertex remains: for the highlights of lights that its ray can hit, and
        // for light that comes through the surface, which pass `shade` leaves to paths.
        let rays = self.decide_on_bsdf_rays(scene, settings, m);
        let reflected = settings.indirect.max_bounces > 0 && m.reflecting > 0;
        let on = technique.is_two_pass() && lit && (reflected || rays || m.transmitting > 0);
        let why = match settings.indirect.max_bounces {
            0 if rays => "highlights of lights that rays can hit".to_owned(),
            0 => "light that comes through surfaces".to_owned(),
            bounces => format!("up to {bounces} bounces"),
        };
        let unneeded = match settings.indirect.max_bounces {
            _ if technique.is_path_tracing() => "paths carry all light",
            _ if technique.shows_map() => "the map holds all light",
            0 if lit => {
                "no light that rays can hit is large beside a glossy lobe, no surface lets light pass, and \
                `indirect.max_bounces` is 0"
            }
            0 => "`indirect.max_bounces` is 0",
            _ if lit => "every surface is black",
            _ => "there is no surface or no light",
        };
        let cost = "pass path: a path from every glossy point, and where no irradiance record is valid; 16 B per point";
        self.decide(Feature::Indirect, on, why, unneeded, cost);
        let bounces = on && reflected;
        let why = "points where a ray may hit a light, or light comes through the surface".to_owned();
        let unneeded = if on { "paths carry indirect light too" } else { "nothing is traced" };
        let cost = "a test of every point and light, and a queue of points";
        self.decide(Feature::Highlights, on && !reflected, why, unneeded, cost);
        let cached = bounces && settings.indirect.irradiance_cache.enabled;
        let stages = settings_of_stages(settings, cached && grows(settings));
        self.decide_on_global_map(settings, &stages, lit, bounces);
        self.decide_on_caustics(settings, m, lit, bounces);
        let unneeded =
            if bounces { "`indirect.irradiance_cache.enabled` is false" } else { "no bounces are requested" };
        let rays = span(stages.each_ref().map(Settings::gather_rays), |rays| rays.to_string());
        let why = format!("records of {rays} rays hold the diffuse part of the indirect light");
        let cost = "passes gather, cache; about 100 B per record";
        self.decide(Feature::IrradianceCache, cached, why, unneeded, cost);
        // The shown map holds all light that Lambertian surfaces reflect, and nothing else.
        let rest = self.features.has(Feature::PhotonMap) && self.features.has(Feature::Glossy);
        self.traces_paths = technique.is_path_tracing() || on || rest;
    }

    /// Decides whether rays sampled from the BSDF of visible points add to light points.
    fn decide_on_bsdf_rays(&mut self, scene: &Scene, settings: &Settings, m: &Facts) -> bool {
        let separate = settings.technique.is_two_pass();
        let met = m.mesh_lights > 0 || scene.environment().is_some();
        let glossy = self.features.has(Feature::Glossy);
        let chance = if separate && glossy && met { max_hit_probability(scene) } else { 0.0 };
        let unneeded = match (separate, glossy, met) {
            (false, ..) => "paths carry all light",
            (_, false, _) => "every material is Lambertian",
            (.., false) => "no ray can hit a light",
            _ => "all lights are small beside the lobes of all glossy surfaces",
        };
        let why = "some light is wider than a narrow lobe of some surface".to_owned();
        let cost = "the density of the BSDF at every light point, and a ray from points with such lobes";
        self.decide(Feature::BsdfRays, chance >= MIN_HIT_PROBABILITY, why, unneeded, cost);
        chance >= MIN_HIT_PROBABILITY
    }

    /// `stages` are the settings of the first and of the last map; `bounces`: whether gathers and paths end in the map.
    fn decide_on_global_map(&mut self, settings: &Settings, stages: &[Settings; 2], lit: bool, bounces: bool) {
        let shown = lit && settings.technique.shows_map();
        self.decide(
            Feature::PhotonMap,
            shown,
            "the technique shows it".into(),
            "the technique does not show the map directly",
            "a search and 32 short rays per point",
        );
        let negative = settings.technique.has_negative_photons();
        let why = "shadow photons subtract the energy of occluded light".to_owned();
        let cost = "a ray onwards from every first hit";
        self.decide(Feature::NegativePhotons, shown && negative, why, "the technique does not subtract light", cost);
        let photons = stages.each_ref().map(Settings::flux_photons);
        let why = format!("{} rays store photons that estimate irradiance", span(photons, |rays| rays.to_string()));
        let bytes = span(photons, |photons| bytes_text(u64::from(photons) * 48));
        let cost = format!("passes flux, irradiance; about {bytes}");
        self.decide(Feature::GlobalMap, shown || bounces, why, "no bounces are requested", &cost);
    }

    fn decide_on_caustics(&mut self, settings: &Settings, m: &Facts, lit: bool, bounces: bool) {
        let paths = settings.technique.is_path_tracing();
        let why = format!("{} like a mirror or clear glass", count(m.clear, "material", "materials"));
        let unneeded = match settings.indirect.max_bounces {
            _ if paths => "paths continue there",
            0 => "`indirect.max_bounces` is 0",
            _ => "no material is a mirror or clear glass",
        };
        // Paths carry light alone, which unlit surfaces are not.
        let shown = (lit && !paths) || m.unlit > 0;
        let continued = settings.indirect.max_bounces > 0 && shown && m.clear > 0;
        let cost = "rays onwards from such surfaces to surfaces with photons; 16 B per point";
        self.decide(Feature::SpecularChains, continued, why, unneeded, cost);
        let why = format!("{} that may focus light", count(m.focusing, "material", "materials"));
        let unneeded = if bounces { "no material focuses light" } else { "no bounces are requested" };
        let cost = "a map for every 8 samples: four times the rays of the global map, a search per point";
        let caustics = bounces && m.focusing > 0;
        self.decide(Feature::Caustics, caustics, why, unneeded, cost);
        let subtracted = self.features.has(Feature::NegativePhotons);
        let why = "paths and gather rays would meet focused light by chance".to_owned();
        let unneeded = if caustics { "photons subtract light" } else { unneeded };
        let cost = "16 B per irradiance point";
        self.decide(Feature::CausticIrradiance, caustics && !subtracted, why, unneeded, cost);
    }
}

/// A number that grows from the first stage to the last one: "16 to 4096".
fn span([first, last]: [u32; 2], text: impl Fn(u32) -> String) -> String {
    if first == last { text(first) } else { format!("{} to {}", text(first), text(last)) }
}
