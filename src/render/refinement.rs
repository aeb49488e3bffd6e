//! How indirect light improves as samples are added: in stages, by a new global map and more rays of the irradiance
//! records, and by a new caustic map for every 8 samples. So the first image comes early, and in a long render the
//! errors of the maps vanish.

use std::time::Instant;

use glam::{DVec3, DVec4};

use super::growth::{Growth, VARIANCE_RATIO, errors_of_rays, mean_error, wants_rays};
use super::renderer::Renderer;
use super::sample_allocation::SampleAllocation;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::light_transport::caustic_map::CausticMap;
use crate::light_transport::indirect_light::{IndirectLight, IndirectSetup};
use crate::light_transport::kernels::IndirectKernels;
use crate::light_transport::shared::Shared;
use crate::passes::cache::BoundCache;
use crate::passes::film::{Change, Plane};
use crate::settings::stages::{LAST_STAGE, grows, settings_of_stage, stage};
use crate::specialisation::features::Feature;
use crate::statistics::Rays;

/// A step of indirect light to another stage.
#[derive(Clone, Copy)]
pub(super) struct Step {
    /// The stage that it leads to.
    pub stage: i32,
    /// Whether the error due to gather rays is expected to remain larger than the error due to samples.
    pub leaves_more_error: bool,
}

impl Renderer<'_> {
    /// The stage that the next sample needs, whatever the estimates of errors are.
    pub(super) fn due_stage(&self) -> i32 {
        let has_map = self.view.lighting.indirect.as_ref().is_some_and(IndirectLight::has_map);
        let samples = self.settings.image.range().first + self.sampling.samples;
        if has_map { stage(&self.settings, samples, self.estimates_growth()) } else { self.view.stage }
    }

    /// Whether estimates of errors decide when gather rays are added.
    fn estimates_growth(&self) -> bool {
        let has_records = self.view.lighting.indirect.as_ref().is_some_and(IndirectLight::has_records);
        has_records && grows(&self.settings)
    }

    /// Advances indirect light to the stage that the next sample needs, and further while estimates favour gather rays,
    /// as long as `fits` allows the step.
    pub(super) fn refine(&mut self, fits: &mut dyn FnMut(&Self, Step) -> bool) -> Result<()> {
        let start = Instant::now();
        let due = self.due_stage();
        while self.view.stage < due && fits(self, Step { stage: self.view.stage + 1, leaves_more_error: false }) {
            self.advance_to(self.view.stage + 1)?;
        }
        if self.estimates_growth() && self.sampling.samples > 0 {
            self.grow(fits)?;
        }
        self.totals.time_render += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Whether the next sample may need another stage.
    pub(super) fn may_refine(&self) -> bool {
        let grows = || self.sampling.growth.as_ref().is_some_and(|growth| growth.is_due(self.sampling.samples));
        self.view.stage < self.due_stage() || (self.estimates_growth() && self.view.stage < LAST_STAGE && grows())
    }

    /// Advances through `stages`. Summed samples are not corrected.
    pub(super) fn restore_stages(&mut self, stages: &[i32]) -> Result<()> {
        stages.iter().try_for_each(|stage| self.add_rays(*stage).map(|_| ()))
    }

    /// The next stage. Once there is an estimate, stages are taken two at a time, as each has a fixed cost besides its
    /// rays: a map, filtering, and new positions of records.
    pub(super) fn next_stage(&self) -> i32 {
        let is_known = self.estimates_growth() && self.view.stage > self.first_stage();
        (self.view.stage + if is_known { 2 } else { 1 }).min(LAST_STAGE)
    }

    /// The next stage if it fits, else the one before it if that one fits. `error` and `noise` are the relMSE due to
    /// gather rays and to samples. Without `error` it is unknown which is larger.
    fn next_that_fits(&self, fits: &mut dyn FnMut(&Self, Step) -> bool, error: Option<f64>, noise: f64) -> Option<i32> {
        let fits = |stage: &i32| {
            let leaves_more_error = error.is_some_and(|error| error > noise * self.factor_to(*stage));
            fits(self, Step { stage: *stage, leaves_more_error })
        };
        (self.view.stage + 1..=self.next_stage()).rev().find(fits)
    }

    /// The factor by which `stage` multiplies the present number of gather rays.
    fn factor_to(&self, stage: i32) -> f64 {
        f64::from(stage - self.view.stage).exp2()
    }

    /// Adds gather rays while they are estimated to reduce the error by more than samples would.
    fn grow(&mut self, fits: &mut dyn FnMut(&Self, Step) -> bool) -> Result<()> {
        let is_early = self.sampling.growth.as_ref().is_some_and(|growth| !growth.is_due(self.sampling.samples));
        // If nothing fits even without noise, the decision waits: later there may be more time.
        let fits_if_no_noise = |growth: &Growth| self.next_that_fits(fits, growth.error(), 0.0).is_some();
        if self.view.stage == LAST_STAGE || is_early || !self.sampling.growth.as_ref().is_none_or(fits_if_no_noise) {
            return Ok(());
        }
        let mut means = self.pixel_means()?;
        let (mut errors, first) = (None, self.view.stage);
        if let Some(growth) = self.sampling.growth.take() {
            let noise = match self.noise_of_samples()? {
                Some(noise) => VARIANCE_RATIO * noise,
                None => growth.noise(&means, self.sampling.samples),
            };
            errors = growth.errors;
            loop {
                let error = errors.as_deref().map(mean_error);
                let Some(stage) = self.next_that_fits(fits, error, noise) else { break };
                let factor = self.factor_to(stage);
                // Only rays of samples count: the photons may have been traced for another view.
                let Rays { gather, camera, shadow, audit, bounce, .. } = self.totals.rays();
                let others = camera + shadow + audit + bounce;
                if error.is_some_and(|error| !wants_rays(error, noise, gather, others, factor)) {
                    break;
                }
                let changes = self.advance_to(stage)?;
                errors = Some(errors_of_rays(&changes, &means, factor));
            }
        }
        if self.view.stage > first {
            means = self.pixel_means()?;
        }
        self.sampling.growth = Some(Growth { samples: self.sampling.samples, means, errors });
        Ok(())
    }

    /// Mean light of each pixel so far, and of its channels.
    fn pixel_means(&self) -> Result<Vec<f32>> {
        let mut means = Vec::new();
        for film in &self.view.tiles {
            let first = means.len();
            let means_of = |plane: &Plane| plane.means(self.gpu, &|pixel| self.samples_of(first + pixel));
            let direct = means_of(&film.direct)?;
            let indirect = film.indirect.as_ref().map(means_of).transpose()?;
            let mean = |(i, direct): (usize, &DVec4)| {
                let all = *direct + indirect.as_ref().map_or(DVec4::ZERO, |indirect| indirect[i]);
                mean_of_channels(all.truncate())
            };
            means.extend(direct.iter().enumerate().map(mean));
        }
        Ok(means)
    }

    /// Advances indirect light to a stage, and corrects the samples so far: they then have its indirect light too.
    /// Returns the change of each pixel, the mean of its channels; nothing if no sample changes.
    fn advance_to(&mut self, stage: i32) -> Result<Vec<f32>> {
        match self.add_rays(stage)? {
            Some(before) if self.sampling.samples > 0 && self.piece_sums.is_none() => self.correct_samples(&before),
            _ => Ok(Vec::new()),
        }
    }

    /// Advances indirect light to a stage. Returns the irradiance cache of the previous one.
    fn add_rays(&mut self, stage: i32) -> Result<Option<BoundCache>> {
        let is_first = self.view.stage == self.first_stage();
        let Some(indirect) = &mut self.view.lighting.indirect else { return Ok(None) };
        if self.has_other_views && is_first {
            self.first_map = indirect.take_map();
        }
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.view.buffers);
        // Records are for the whole view.
        tile.sampled_pixels.iter().for_each(|sampled| sampled.set_all(gpu));
        let earlier = settings_of_stage(&self.settings, self.view.stage).gather_rays();
        let setup = IndirectSetup {
            shared: Shared { gpu, scene, gpu_scene, tile },
            kernels: &self.view.indirect_kernels,
            primary: &self.view.primary,
            camera: &CameraUniform::new(&self.camera, self.settings.image.width, self.settings.image.height),
            settings: &settings_of_stage(&self.settings, stage),
        };
        let before = indirect.add_rays(&setup, earlier, &mut self.totals)?;
        self.view.stage = stage;
        self.view.later_stages.push(stage);
        Ok(before)
    }

    /// Adds the change of the irradiance records since `before` to all samples so far. Otherwise the samples with fewer
    /// gather rays would stay in the image for good. The change hardly varies within a pixel, so it is computed for one
    /// sample of each. Returns the mean of its channels for each pixel.
    fn correct_samples(&mut self, before: &BoundCache) -> Result<Vec<f32>> {
        let mut changes = Vec::new();
        let (Some(indirect), Some(change)) = (&self.view.lighting.indirect, &self.view.buffers.radiance_indirect)
        else {
            return Ok(changes);
        };
        for film in &self.view.tiles {
            let first_pixel = changes.len();
            changes.resize(first_pixel + film.rows().len() * self.settings.image.crop_window().width as usize, 0.0);
            let of_film = &mut changes[first_pixel..];
            let by_samples = |allocation: &SampleAllocation| allocation.by_samples().map(Some).collect();
            for blocks in self.sampling.allocation.as_ref().map_or(vec![None], by_samples) {
                let samples = blocks.as_ref().map_or(self.sampling.samples, |blocks| blocks.first_sample);
                let (pixels, pixel_count) = self.list_pixels(film, blocks.as_ref());
                if pixel_count == 0 || samples == 0 {
                    continue;
                }
                let tile = film.tile(&self.settings, pixel_count, samples, 1);
                let mut frame = self.gpu.frame("correction");
                frame.clear(&self.view.buffers.counters);
                self.view.primary.record(&mut frame, &tile);
                indirect.change(&mut frame, before, &tile);
                let inputs = self.view.buffers.film_inputs();
                let correction = Change { change, pixel_count, earlier_samples: samples, inputs };
                film.correct(self.gpu, &self.view.film, &mut frame, correction)?;
                frame.submit()?;
                let differences: Vec<[f32; 4]> = self.gpu.read(change, pixel_count as usize)?;
                for (i, [r, g, b, _]) in differences.into_iter().enumerate() {
                    let pixel = pixels.as_ref().map_or(i, |pixels| pixels[i] as usize);
                    of_film[pixel] = mean_of_channels(DVec3::from([r, g, b].map(f64::from)));
                }
                self.totals.gather_rays += u64::from(pixel_count);
            }
        }
        Ok(changes)
    }

    /// The stage of the first sample.
    pub(super) fn first_stage(&self) -> i32 {
        stage(&self.settings, 0, grows(&self.settings))
    }

    /// Makes the caustic map of the samples from `first_sample` on, unless they share the last one.
    pub(super) fn trace_caustics(&mut self, first_sample: u32) -> Result<()> {
        let number = CausticMap::number_at(first_sample);
        let IndirectKernels { global_map, features, .. } = &self.view.indirect_kernels;
        let Some(kernels) = global_map.as_ref().filter(|_| features.has(Feature::Caustics)) else { return Ok(()) };
        if self.view.lighting.caustics.as_ref().is_none_or(|caustics| caustics.number() != number) {
            let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.view.buffers);
            let shared = Shared { gpu, scene, gpu_scene, tile };
            let traced = CausticMap::new(&shared, kernels, &self.settings, number, &mut self.totals)?;
            self.view.lighting.caustics = Some(traced);
        }
        Ok(())
    }
}

fn mean_of_channels(light: DVec3) -> f32 {
    (light.element_sum() / 3.0) as f32
}
