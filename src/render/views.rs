//! Other views of a scene that is being rendered: cameras that move, images of another size.

use std::mem;
use std::time::Instant;

use super::blocks::Blocks;
use super::photon_benefit::of_first_sample;
use super::renderer::{Kernels, PreparedView, Renderer, ViewOf};
use crate::light_transport::first_pass::MadeMaps;
use crate::light_transport::indirect_light::{IndirectLight, MadeIndirect};
use crate::light_transport::lighting::Lighting;
use crate::scene::Camera;
use crate::specialisation::Specialisation;
use crate::specialisation::features::Feature;
use crate::{Error, Result};

impl Renderer<'_> {
    /// Begins an image of the same scene through another camera, of `width` x `height` pixels. The BVH, the GPU scene
    /// and the photons are kept, so this takes a small part of the time of [`Renderer::new`] if the device keeps its
    /// kernels ([`keep_kernels`](kernel_kit::Gpu::keep_kernels)). The image has the same bits as that of a new renderer
    /// of that size: visibility photons are emitted if a new renderer would emit them.
    ///
    /// # Errors
    /// [`Error::Setting`] for a size out of range and for a piece, [`Error::Usage`] for a lens where the first camera
    /// had none or the reverse, since kernels depend on it, and those of [`Renderer::new`]. After an error of the
    /// device the renderer cannot be used.
    pub fn set_view(&mut self, camera: &Camera, size: [u32; 2]) -> Result<()> {
        self.begin_view(camera, size, false)
    }

    /// As [`Renderer::set_view`], for a preview that is shown briefly while the camera moves. It also uses the
    /// irradiance records of earlier previews, so that few are computed. Records do not depend on the camera, but their
    /// positions depend on the path that the camera took, and so do the bits of the image. No visibility photons are
    /// emitted; those of the last view are used, if there are any.
    ///
    /// # Errors
    /// As [`Renderer::set_view`].
    pub fn preview(&mut self, camera: &Camera, size: [u32; 2]) -> Result<()> {
        self.begin_view(camera, size, true)
    }

    fn begin_view(&mut self, camera: &Camera, [width, height]: [u32; 2], is_preview: bool) -> Result<()> {
        if self.settings.image.piece.is_some() {
            return Err(Error::setting("image.piece", "must not be set: a piece cannot render another view"));
        }
        if camera.lens.is_some() != self.camera.lens.is_some() {
            let problem = "a renderer cannot switch between a pinhole and a lens: make another renderer";
            return Err(Error::Usage(problem.into()));
        }
        let photons = self.lighting.visibility_map.is_some().then(|| self.settings.photons_per_light());
        let settings = self.settings.clone().with(|s| {
            s.visibility_map.photons_per_light = self.requested_photons.or(photons.filter(|_| is_preview));
            (s.image.width, s.image.height) = (width, height);
        });
        settings.check()?;
        if !is_preview {
            let anew = Specialisation::new(&self.scene, Some(camera), &settings);
            let full = anew.with_deferred_of(&self.specialisation);
            (self.specialisation, self.with_photons) = of_first_sample(full, &self.scene, camera, &settings);
        } else {
            self.with_photons = None;
        }
        let (gpu, gpu_scene, specialisation) = (self.gpu, &self.gpu_scene, &self.specialisation);
        gpu_scene.set_camera(gpu, camera, [width, height]);
        let start = Instant::now();
        let kernels = Kernels::new(gpu, specialisation, &gpu_scene.constants(), &settings)?;
        gpu.compile_ahead(gpu_scene)?;
        let time_compile = start.elapsed().as_secs_f64();
        // Data that only the last view needs is released first.
        let Lighting { visibility_map, indirect, .. } = mem::take(&mut self.lighting);
        self.tiles.clear();
        let has_map = self.specialisation.features.has(Feature::VisibilityMap);
        let visibility_map = visibility_map.filter(|_| has_map && photons == Some(settings.photons_per_light()));
        // Other stages have other photons.
        let MadeIndirect { map, records } = indirect.map(IndirectLight::into_made).unwrap_or_default();
        let map = map.filter(|_| self.stage == self.first_stage()).or(self.first_map.take());
        if mem::replace(&mut self.is_preview, is_preview) {
            self.kept_records = records;
        }
        let records = if is_preview { self.kept_records.take() } else { None };
        let made = MadeMaps { visibility_map, indirect: MadeIndirect { map, records } };
        let mut totals = self.totals.of_another_view();
        totals.time_compile += time_compile;
        if made.visibility_map.is_none() {
            (totals.photons, totals.photon_bytes) = (Vec::new(), 0);
        }
        let features = &specialisation.features;
        let view = ViewOf { gpu, scene: &self.scene, gpu_scene, features, camera, settings: &settings };
        let PreparedView { primary, film, lighting, indirect_kernels, buffers, tiles, tile_size, stage } =
            view.prepare(kernels, made, &mut totals)?;
        self.blocks = Blocks::of(&settings.image);
        (self.primary, self.film) = (primary, film);
        (self.lighting, self.indirect_kernels) = (lighting, indirect_kernels);
        (self.buffers, self.tiles, self.tile_size) = (buffers, tiles, tile_size);
        (self.camera, self.settings, self.totals) = (camera.clone(), settings, totals);
        (self.stage, self.samples, self.batches, self.shade_at_once) = (stage, 0, 0, false);
        (self.growth, self.errors) = (None, None);
        (self.seconds_per_sample, self.seconds_to_allocate) = (None, None);
        self.has_other_views = true;
        Ok(())
    }
}
