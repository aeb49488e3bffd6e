//! What tells a shading point whether it sees a light: photons, cells, shadow rays, audits.

use super::decisions::{Item, Specialisation, bytes_text, is_lit};
use crate::kernels::{GridShape, MAX_LIGHTS};
use crate::scene::Scene;
use crate::settings::Settings;
use crate::settings::technique::Visibility;
use crate::specialisation::features::Feature;

/// Why the environment has no visibility photons.
const NO_PHOTONS: &str = "nearly every point sees a part of it, so that photons would find boundaries everywhere";

/// The visibility map is left out if more points than this share are boundary or unknown after the first sample of each
/// pixel: photons are then too sparse for what the scene hides, and queries cost more than the rays that they save.
/// Measured on the still life (0.57): 42 s with the map, 17 s without.
const PILOT_SHARE: f64 = 0.5;

impl Specialisation {
    pub(super) fn of_visibility(&mut self, scene: &Scene, settings: &Settings) {
        let mapped = self.of_visibility_map(scene, settings);
        let estimated = mapped && settings.technique.requirements().visibility == Visibility::PhotonsAlone;
        self.of_guessed_visibility(scene, settings, estimated);
        self.of_audits(settings, mapped, estimated);
    }

    /// Decides on the visibility map and how its photons are counted; whether there is one.
    fn of_visibility_map(&mut self, scene: &Scene, settings: &Settings) -> bool {
        let map = settings.technique.uses_visibility_map();
        let placed = scene.placed_lights().len();
        let photons = u64::from(settings.visibility_map.photons_per_light) * placed as u64;
        let many = placed > MAX_LIGHTS as usize;
        let few_sampled = self.features.has(Feature::LightSampling);
        let unneeded = if few_sampled {
            // Of 64 lights of scenes/lamps.glb it left half of the candidates to shadow rays.
            "points sample few of many lights: it costs more than it saves".to_owned()
        } else if many {
            format!("a photon's word has room for {MAX_LIGHTS} lights")
        } else if !map {
            format!("the technique {} does not use it", settings.technique)
        } else if placed == 0 && scene.environment().is_some() {
            format!("the environment is the only light: {NO_PHOTONS}")
        } else if scene.lights.is_empty() {
            "there is no light".to_owned()
        } else {
            "there is nothing to be lit".to_owned()
        };
        let wanted = map && !many && !few_sampled && placed > 0 && !scene.is_empty();
        let mut why = format!("{photons} photons tell lit and shadowed points apart");
        if scene.environment().is_some() {
            why += &format!("; none are of the environment: {NO_PHOTONS}");
        }
        let cost = format!("passes photons, grid, classify; about {}", bytes_text(photons * 24));
        self.decide(Feature::VisibilityMap, wanted, why, &unneeded, &cost);
        self.decide(
            Feature::LightTags,
            wanted && placed > 1,
            format!("{placed} lights"),
            "there is one light at most",
            "a key and a comparison a photon",
        );
        self.decide(
            Feature::PaperCounting,
            wanted && settings.visibility_map.paper_counting,
            "asked for".into(),
            "photons are counted by their normals",
            "false shadows beside objects",
        );
        wanted
    }

    /// Decides on the techniques whose visibility may be a guess: equation 1, cells, and adaptive shadow testing.
    fn of_guessed_visibility(&mut self, scene: &Scene, settings: &Settings, estimated: bool) {
        let visibility = settings.technique.requirements().visibility;
        let lit = is_lit(scene);
        let many = scene.lights.len() > MAX_LIGHTS as usize;
        let adaptive = visibility == Visibility::Adaptive;
        let ward = lit && !many && scene.lights.len() > 1 && adaptive;
        let why = match ward {
            true => "lights that are not tested are guessed",
            false => "the photons' own visibility is shown (equation 1)",
        };
        let unneeded = "shadow rays decide at boundaries";
        self.decide(Feature::VisibilityEstimate, estimated || ward, why.to_owned(), unneeded, "blurred shadows");

        let unused = format!("the technique {} does not use it", settings.technique);
        let cells = lit && settings.technique.uses_cells();
        let why = format!("{} rays a cell and light tell what its points see", settings.cells.rays_per_light);
        let grid = u64::from(GridShape::over_scene(scene, settings.cells.resolution).cells());
        // A count and a class word for each cell and light.
        let cost = format!("pass cells; about {}", bytes_text(8 * scene.lights.len() as u64 * grid));
        self.decide(Feature::Cells, cells, why, &unused, &cost);
        let tags = cells && visibility == Visibility::Voxels;
        let why = "voxels that agree with their neighbours need no shadow ray".to_owned();
        self.decide(Feature::VoxelTags, tags, why, &unused, "a look at 26 neighbours a cell");

        let buffered = lit && !many && settings.technique.uses_light_buffers();
        let too_many = format!("beyond {MAX_LIGHTS} lights their cells would be too large to tell anything");
        let unneeded = if many && settings.technique.uses_light_buffers() { &too_many } else { &unused };
        let why = "lists of the surfaces around each light tell what may hide it".to_owned();
        let cost = "pass light_buffer; before the first sample a look at each light and triangle";
        self.decide(Feature::LightBuffer, buffered, why, unneeded, cost);

        let why = format!("lights are tested until the rest is below {} of a point's light", settings.ward.tolerance);
        let too_many = format!("its keys have room for {MAX_LIGHTS} lights: all are tested");
        let unneeded = match (adaptive, many) {
            (true, true) => too_many.as_str(),
            (true, false) => "there is one light at most, which is always tested",
            (false, _) => &unused,
        };
        self.decide(Feature::Ward, ward, why, unneeded, "pass ward: a round of tests a light; 4 B a point and light");
    }

    fn of_audits(&mut self, settings: &Settings, mapped: bool, estimated: bool) {
        let unneeded = match (mapped, estimated) {
            (true, true) => "the technique traces no shadow rays",
            (true, false) => "`visibility_map.audit` is 0: the result may be biased",
            (false, _) => "nothing is decided by photons",
        };
        let why = format!("{:.3} of the decided points trace a shadow ray all the same", settings.visibility_map.audit);
        let audited = mapped && !estimated && settings.visibility_map.audit > 0.0;
        self.decide(Feature::Audit, audited, why, unneeded, "a shadow ray for each audited point");
    }

    /// Decides what depends on the light tables: where photons decide, every light has a closed form and no surface is
    /// glossy, most points need no light point. (Light points tell all that glossy surfaces reflect.)
    pub(crate) fn of_closed_forms(&mut self, all_lights_have_one: bool) {
        let decided = self.features.has(Feature::VisibilityMap) && !self.features.has(Feature::LightSampling);
        self.features.set(Feature::FewSampled, decided && !self.features.has(Feature::Glossy) && all_lights_have_one);
    }

    /// Why the pilot samples, with this share of boundary and unknown points, say that the visibility map does not pay;
    /// none where it pays, or must stay because the settings ask for what it alone tells.
    pub(crate) fn of_pilot(&self, settings: &Settings, boundary_share: f64) -> Option<String> {
        let shown = settings.technique.requirements().visibility == Visibility::PhotonsAlone
            || self.features.has(Feature::AovShadow);
        let pays = boundary_share <= PILOT_SHARE;
        (self.features.has(Feature::VisibilityMap) && !shown && !pays).then(|| {
            let percent = 100.0 * boundary_share;
            format!("it does not pay: {percent:.0} % of the first points were boundary or unknown")
        })
    }

    /// Leaves out the visibility map, and what exists for it alone.
    pub(crate) fn leave_map_out(&mut self, reason: &str) {
        for feature in [Feature::VisibilityMap, Feature::LightTags, Feature::PaperCounting, Feature::Audit] {
            if let Some(at) = self.kept.iter().position(|item| item.feature == feature) {
                let item = self.kept.remove(at);
                self.left_out.push(Item { reason: reason.to_owned(), ..item });
                self.features.set(feature, false);
            }
        }
        self.features.set(Feature::FewSampled, false);
    }
}
