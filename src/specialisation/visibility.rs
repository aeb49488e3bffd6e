//! Decisions on visibility: photons, cells, shadow rays, audits.

use super::decisions::{Specialisation, bytes_text, is_lit};
use crate::count::count;
use crate::kernels::{GridShape, MAX_LIGHTS};
use crate::scene::{Camera, Scene};
use crate::settings::technique::Visibility;
use crate::settings::{Aov, Settings};
use crate::specialisation::features::Feature;

/// The reason why the environment has no visibility photons.
const NO_PHOTONS: &str = "nearly every point sees a part of it, so photons would find boundaries everywhere";

/// Number of shadow rays, over all points that face a light, above which photons and cells save time. Render time over
/// that of `two-pass` in `scenes/{box,sphere,crowd,procedural,materials}.glb`: 0.53 to 1.01 with 2 to 4 million shadow
/// rays (256 x 256 pixels, 16 samples), 0.6 to 0.91 with 5 to 8 million, 0.5 to 0.72 with 9 to 16 million
/// (docs/decisions.md, "The first sample shows whether photons pay off").
pub(crate) const SHADOW_RAYS_OF_MAP: f64 = 2_097_152.0;

/// Minimum samples per pixel for photons and cells to save time: with fewer, fine cells learn too little. With 4
/// million shadow rays `scenes/crowd.glb` took 1.17 times as long as with `two-pass` at 4 samples of 512 x 512 pixels,
/// and 0.9 times at 16 samples of 256 x 256.
pub(crate) const SAMPLES_OF_MAP: u32 = 8;

/// Whether photons and cells may save more time than they take, or are requested.
fn photons_pay(scene: &Scene, camera: Option<&Camera>, settings: &Settings) -> bool {
    if settings.visibility_map.photons_per_light.is_some() || settings.image_depends_on_photons() {
        return true;
    }
    let rays = settings.shadow_rays_to_a_light() as f64;
    if rays < SHADOW_RAYS_OF_MAP || settings.image.spp < SAMPLES_OF_MAP {
        return false;
    }
    let aspect = settings.image.width as f32 / settings.image.height as f32;
    let covered = camera.map_or(1.0, |camera| scene.covered_share(camera, aspect));
    covered * rays >= SHADOW_RAYS_OF_MAP
}

impl Specialisation {
    pub(super) fn decide_on_visibility(&mut self, scene: &Scene, camera: Option<&Camera>, settings: &Settings) {
        let mapped = self.decide_on_visibility_map(scene, camera, settings);
        let estimated = mapped && settings.technique.requirements().visibility == Visibility::PhotonsAlone;
        self.decide_on_estimated_visibility(scene, settings, estimated);
        self.decide_on_audits(settings, mapped, estimated);
        self.decide_on_shading();
    }

    /// Decides on the visibility map, and on how its photons are counted. Returns whether there is a map.
    fn decide_on_visibility_map(&mut self, scene: &Scene, camera: Option<&Camera>, settings: &Settings) -> bool {
        let obstacle = self.obstacle_to_map(scene, camera, settings);
        let placed = scene.placed_lights().len();
        let photons = u64::from(settings.photons_of_light(placed)) * placed as u64;
        let mut why =
            format!("{} lit from shadowed points", count(photons, "photon distinguishes", "photons distinguish"));
        if settings.tries_photons() {
            why += ", if the first sample finds few of them in penumbrae";
        }
        if scene.environment().is_some() {
            why += &format!("; none are of the environment: {NO_PHOTONS}");
        }
        let cost = format!("passes photons, grid, classify; about {}", bytes_text(photons * 24));
        let (mapped, unneeded) = (obstacle.is_none(), obstacle.unwrap_or_default());
        self.decide(Feature::VisibilityMap, mapped, why, &unneeded, &cost);
        self.decide_on_counting(settings, mapped, placed);
        mapped
    }

    /// The reason why there is no visibility map, if there is one.
    fn obstacle_to_map(&self, scene: &Scene, camera: Option<&Camera>, settings: &Settings) -> Option<String> {
        let placed = scene.placed_lights().len();
        Some(if self.features.has(Feature::LightSampling) {
            // With 64 lights of scenes/lamps.glb the map left half of the candidates to shadow rays.
            "points sample a few of many lights: the map costs more than it saves".to_owned()
        } else if placed > MAX_LIGHTS as usize {
            format!("a photon's word has room for {MAX_LIGHTS} lights")
        } else if !settings.technique.uses_visibility_map() {
            format!("the technique {} does not use it", settings.technique)
        } else if !photons_pay(scene, camera, settings) {
            "the image has so few shadow rays that photons take longer".to_owned()
        } else if placed == 0 && scene.environment().is_some() {
            format!("the environment is the only light: {NO_PHOTONS}")
        } else if placed == 0 {
            "there is no light".to_owned()
        } else if scene.is_empty() {
            "there is no surface".to_owned()
        } else {
            return None;
        })
    }

    /// Decides on how the photons of the map are counted, and on fine cells. `mapped`: there is a visibility map.
    fn decide_on_counting(&mut self, settings: &Settings, mapped: bool, placed_lights: usize) {
        self.decide(
            Feature::LightTags,
            mapped && placed_lights > 1,
            format!("{placed_lights} lights"),
            "there is at most one light",
            "a key and a comparison per photon",
        );
        self.decide(
            Feature::PaperCounting,
            mapped && settings.visibility_map.paper_counting,
            "requested".into(),
            "photons are counted by their normals",
            "false shadows beside objects",
        );
        let shown = settings.image.aovs.contains(&Aov::Shadow)
            || settings.technique.requirements().visibility == Visibility::PhotonsAlone;
        self.decide(
            Feature::ExactCounts,
            mapped && shown,
            "n_i and n_s are shown".into(),
            "cells decide: no point searches for its nearest photons",
            "a search for each boundary point",
        );
        self.decide_on_fine_cells(settings, mapped, shown);
    }

    /// Decides on fine cells. `mapped`: there is a visibility map; `shown`: the image shows the classes by photons.
    fn decide_on_fine_cells(&mut self, settings: &Settings, mapped: bool, shown: bool) {
        let unneeded = if !mapped {
            "photons classify no points"
        } else if shown {
            "what the photons tell is shown"
        } else if settings.visibility_map.audit == 0.0 || settings.visibility_map.paper_counting {
            "the method of the paper alone is requested"
        } else if !settings.visibility_map.fine_cells {
            "photons alone must decide"
        } else if settings.image.piece.is_some() {
            "the samples of a piece learn nothing from other samples"
        } else {
            "there is one sample per pixel, and none to learn from"
        };
        self.decide(
            Feature::FineCells,
            mapped && settings.learns_from_shadow_rays(),
            "the shadow rays of earlier samples are photons where the map does not decide".to_owned(),
            unneeded,
            "pass fine_cells; 160 to 320 B per pixel and light, of at most four lights; 168 MB at most",
        );
    }

    /// Decides on the techniques that may estimate visibility without shadow rays: equation 1, cells, and adaptive
    /// shadow testing.
    fn decide_on_estimated_visibility(&mut self, scene: &Scene, settings: &Settings, estimated: bool) {
        let visibility = settings.technique.requirements().visibility;
        let lit = is_lit(scene);
        let many = scene.lights.len() > MAX_LIGHTS as usize;
        let adaptive = visibility == Visibility::Adaptive;
        let ward = lit && !many && scene.lights.len() > 1 && adaptive;
        let why = match ward {
            true => "the visibility of lights that are not tested is estimated",
            false => "visibility is estimated from the photons (equation 1)",
        };
        let unneeded = "shadow rays decide at boundaries";
        self.decide(Feature::VisibilityEstimate, estimated || ward, why.to_owned(), unneeded, "blurred shadows");

        let unused = format!("the technique {} does not use it", settings.technique);
        let cells = lit && settings.technique.uses_cells();
        let rays = count(settings.cells.rays_per_light, "ray", "rays");
        let why = format!("visibility is that of {rays} per cell and light");
        let grid = u64::from(GridShape::over_scene(scene, settings.cells.resolution).cells());
        // A count and a class word for each cell and light.
        let cost = format!("pass cells; about {}", bytes_text(8 * scene.lights.len() as u64 * grid));
        self.decide(Feature::Cells, cells, why, &unused, &cost);
        let tags = cells && visibility == Visibility::Voxels;
        let why = "voxels that agree with their neighbours need no shadow rays".to_owned();
        self.decide(Feature::VoxelTags, tags, why, &unused, "26 neighbours per cell");

        let buffered = lit && !many && settings.technique.uses_light_buffers();
        let too_many = format!("beyond {MAX_LIGHTS} lights their cells would be too large to tell anything");
        let unneeded = if many && settings.technique.uses_light_buffers() { &too_many } else { &unused };
        let why = "lists of the surfaces around each light tell what may hide it".to_owned();
        let cost = "pass light_buffer; a test of each light and triangle before the first sample";
        self.decide(Feature::LightBuffer, buffered, why, unneeded, cost);

        let why = format!("lights are tested until the rest is below {} of a point's light", settings.ward.tolerance);
        let too_many = format!("its keys have room for {MAX_LIGHTS} lights: all are tested");
        let unneeded = match (adaptive, many) {
            (true, true) => too_many.as_str(),
            (true, false) => "there is at most one light, which is always tested",
            (false, _) => &unused,
        };
        self.decide(Feature::Ward, ward, why, unneeded, "pass ward: a round per light; 4 B per point and light");
    }

    fn decide_on_audits(&mut self, settings: &Settings, mapped: bool, estimated: bool) {
        let unneeded = match (mapped, estimated) {
            (true, true) => "the technique traces no shadow rays",
            (true, false) => "`visibility_map.audit` is 0: the result may be biased",
            (false, _) => "photons classify no points",
        };
        let why = format!("{:.3} of lit and shadowed points still trace a shadow ray", settings.visibility_map.audit);
        let audited = mapped && !estimated && settings.visibility_map.audit > 0.0;
        self.decide(Feature::Audit, audited, why, unneeded, "a shadow ray for each audited point");
    }

    /// Decides how points that photons or cells classify are shaded.
    fn decide_on_shading(&mut self) {
        let decided = [Feature::VisibilityMap, Feature::Cells, Feature::LightBuffer].map(|f| self.features.has(f));
        let few = decided.contains(&true) && !self.features.has(Feature::LightSampling);
        let why = "most points are lit or shadowed: the others are queued".to_owned();
        let unneeded = "every point traces shadow rays";
        self.decide(Feature::FewSampled, few, why, unneeded, "a queue, and the surfaces of its points read again");
    }
}
