//! The steps of a technique's second pass, the paper's visualisation step: a frame, which adds one or more samples to
//! every pixel of a tile. A step records its dispatches. It does nothing if the first pass did not make its part.

use kernel_kit::Frame;

use super::adaptive_testing::AdaptiveTesting;
use super::direct_light::DirectLight;
use super::lighting::Lighting;
use crate::passes::Tile;
use crate::passes::classify::Chunk;
use crate::passes::film::Plane;
use crate::passes::path::PathParameters;
use crate::passes::primary::BoundPrimary;
use crate::settings::Settings;

/// A second pass under way.
pub(crate) struct SecondPass<'a, 'g> {
    pub frame: &'a mut Frame<'g>,
    pub tile: &'a Tile,
    pub primary: &'a BoundPrimary,
    pub lighting: &'a Lighting,
    pub settings: &'a Settings,
    /// The film's planes for the tile.
    pub planes: Vec<&'a Plane>,
    /// See [`crate::passes::shade::ShadeParameters::at_once`]. It is set if classes decide few points.
    pub shade_at_once: bool,
    /// The films of the lights' classes, if the AOV `shadow` is requested.
    pub class_films: &'a [Plane],
}

impl SecondPass<'_, '_> {
    /// Traces a camera ray for each sample, also over mirrors and through clear glass, to the shading point (pass
    /// `primary`).
    pub fn trace_camera_rays(&mut self) {
        self.primary.record(self.frame, self.tile);
    }

    /// Samples a few of many lights for each point (pass `sample_lights`).
    pub fn sample_lights(&mut self) {
        if let Some(sampler) = &self.lighting.light_sampler {
            sampler.sample(self.frame, self.tile);
        }
    }

    /// The lights that points consider, in chunks that fit in the buffers.
    pub fn light_chunks(&self) -> impl Iterator<Item = Chunk> + use<> {
        self.lighting.direct.as_ref().map(DirectLight::chunks).into_iter().flatten()
    }

    /// Gives each point the class of its fine cell for each light, if the cell has one, and queues it by its class for
    /// shadow rays or an audit. If there are neither fine cells nor a map, every point is unknown unless it faces away
    /// from the light (pass `classify`).
    pub fn classify(&mut self, lights: &Chunk) {
        self.direct(|direct, frame, tile| direct.classify(frame, tile, lights));
    }

    /// Gives the undecided points the classes of the visibility map's cells, and requests those that are missing (pass
    /// `classify`).
    pub fn look_up_map_cells(&mut self, lights: &Chunk) {
        self.direct(|direct, frame, tile| direct.look_up_map_cells(frame, tile, lights));
    }

    /// Classifies the cells that were requested for the first time (pass `grid`). Pieces do not: the class of such a
    /// cell holds for the surface of the points that request it first, and these may belong to another piece.
    pub fn classify_requested_cells(&mut self) {
        if self.settings.image.piece.is_some() {
            return;
        }
        self.direct(|direct, frame, _| direct.classify_requested_cells(frame));
    }

    /// Classifies the undecided points by the requested cells; if n_i and n_s are shown, by their k nearest photons.
    /// Queues them, and those that the map's cells classified, as [`Self::classify`] does (pass `classify`).
    pub fn query_photons(&mut self, lights: &Chunk) {
        self.direct(|direct, frame, tile| direct.query(frame, tile, lights));
    }

    /// Makes the pixels next to a boundary boundaries too (pass `classify`).
    pub fn dilate_boundaries(&mut self, lights: &Chunk) {
        self.direct(|direct, frame, tile| direct.dilate(frame, tile, lights));
    }

    /// For the earlier methods, whose classes another pass gives: counts the classes, and queues boundary and unknown
    /// points for shadow rays (pass `classify`).
    pub fn queue_shadow_rays(&mut self, lights: &Chunk) {
        self.direct(|direct, frame, tile| direct.compact(frame, tile, lights));
    }

    /// Traces the queued shadow rays (pass `shadow`).
    pub fn trace_shadow_rays(&mut self, lights: &Chunk) {
        self.direct(|direct, frame, tile| direct.trace_shadow_rays(frame, tile, lights));
    }

    /// Traces the queued audits. Each that contradicts a class stores a photon that will repair the map (pass
    /// `shadow`).
    pub fn audit(&mut self, lights: &Chunk) {
        self.direct(|direct, frame, tile| direct.audit(frame, tile, lights));
    }

    /// Adds the lights' direct light to each point by its class (pass `shade`).
    pub fn shade(&mut self, lights: &Chunk) {
        let at_once = self.shade_at_once;
        self.direct(|direct, frame, tile| direct.shade(frame, tile, lights, at_once));
    }

    /// Adds the classes to their films (pass `film`), if the AOV `shadow` is requested.
    pub fn add_classes_to_film(&mut self, lights: &Chunk) {
        let films = self.class_films;
        self.direct(|direct, frame, tile| direct.add_classes_to_film(frame, tile, lights, films));
    }

    /// Gives each point the class of its cell for each light (pass `cells`), and empties the queues.
    pub fn look_up_cells(&mut self, lights: &Chunk) {
        if let Some(cells) = &self.lighting.cells {
            cells.classify(self.frame, self.tile, lights);
        }
        self.direct(|direct, frame, _| direct.clear_queues(frame));
    }

    /// Classifies each point by the surfaces that are listed between it and each light (pass `light_buffer`), and
    /// empties the queues.
    pub fn look_up_light_buffers(&mut self, lights: &Chunk) {
        if let Some(buffers) = &self.lighting.light_buffers {
            buffers.record(self.frame, self.tile, lights);
        }
        self.direct(|direct, frame, _| direct.clear_queues(frame));
    }

    /// Sorts the lights of each point by their potential contributions (pass `ward`).
    pub fn order_lights(&mut self, lights: &Chunk) {
        self.testing(|testing, _, frame, tile| testing.order(frame, tile, lights));
    }

    /// Queues the next light of each point whose untested lights could still contribute enough (pass `ward`).
    pub fn queue_next_light(&mut self, lights: &Chunk) {
        self.testing(|testing, direct, frame, tile| testing.next(frame, direct.classify_buffers(), tile, lights));
    }

    /// Estimates the visibility of the lights that were not tested (pass `ward`).
    pub fn estimate_untested_lights(&mut self, lights: &Chunk) {
        self.testing(|testing, _, frame, tile| testing.estimate(frame, tile, lights));
    }

    /// Adds the visibility of the tested lights to the statistics for later estimates (pass `ward`), and empties the
    /// queues.
    pub fn learn_visibility(&mut self, lights: &Chunk) {
        self.testing(|testing, direct, frame, tile| {
            testing.learn(frame, tile, lights);
            direct.clear_queues(frame);
        });
    }

    /// Shows the global map at each point: density estimation (pass `irradiance`).
    pub fn show_global_map(&mut self) {
        if let Some(indirect) = &self.lighting.indirect {
            indirect.show_map(self.frame, self.tile);
        }
    }

    /// Lights each point by the irradiance records around it, and queues the points that no record covers (pass
    /// `cache`).
    pub fn interpolate_irradiance(&mut self) {
        if let Some(indirect) = &self.lighting.indirect {
            indirect.interpolate_irradiance(self.frame, self.tile);
        }
    }

    /// Traces paths (pass `path`): with irradiance records from glossy points and from points that no record covers,
    /// else from every point.
    pub fn trace_paths(&mut self) {
        let parameters = PathParameters {
            tile: *self.tile,
            max_bounces: self.settings.indirect.max_bounces,
            light_samples: self.settings.shadow_rays.samples,
            max_indirect: self.settings.indirect.clamp.unwrap_or(f32::MAX),
            from_hits: 0,
            paths_per_point: 1,
            path_number: 0,
        };
        if let Some(indirect) = &self.lighting.indirect {
            indirect.trace_paths(self.frame, &parameters);
        }
    }

    /// Shows the caustic map at each point (pass `irradiance`).
    pub fn show_caustics(&mut self) {
        if let Some(caustics) = &self.lighting.caustics {
            caustics.show(self.frame, self.tile);
        }
    }

    /// Adds the samples to the film's sums (pass `film`).
    pub fn add_to_film(&mut self) {
        for plane in &self.planes {
            plane.record(self.frame, self.tile);
        }
    }

    /// Whether adaptive shadow testing orders the lights. It does not if there is one light or too many, or if nothing
    /// is to be lit: the technique is then the same as `two-pass`.
    pub fn has_adaptive_testing(&self) -> bool {
        self.lighting.adaptive_testing.is_some()
    }

    /// Whether there are cells with classes. If nothing is to be lit, there are no cells.
    pub fn has_cells(&self) -> bool {
        self.lighting.cells.is_some()
    }

    /// Whether there are lists of the surfaces around each light. There are none if nothing is to be lit, or if there
    /// are too many lights.
    pub fn has_light_buffers(&self) -> bool {
        self.lighting.light_buffers.is_some()
    }

    fn direct(&mut self, step: impl FnOnce(&DirectLight, &mut Frame<'_>, &Tile)) {
        if let Some(direct) = &self.lighting.direct {
            step(direct, self.frame, self.tile);
        }
    }

    fn testing(&mut self, step: impl FnOnce(&AdaptiveTesting, &DirectLight, &mut Frame<'_>, &Tile)) {
        if let (Some(testing), Some(direct)) = (&self.lighting.adaptive_testing, &self.lighting.direct) {
            step(testing, direct, self.frame, self.tile);
        }
    }
}
