//! Other views of a scene that is being rendered: cameras that move, images of another size.

use std::mem;

use super::host_memory::ImageMemory;
use super::photon_benefit::postpone_photons;
use super::prepared_view::{Kernels, ViewOf};
use super::renderer::Renderer;
use super::sampling_state::SamplingState;
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
    /// had none or the reverse, since kernels depend on it, and those of [`Renderer::new`]. The first two and
    /// [`Error::Memory`] leave the renderer as it was. After any other error it cannot be used.
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

    /// Checks what the kernels and the sums of this renderer allow.
    fn check_view(&self, camera: &Camera) -> Result<()> {
        if self.settings.image.piece.is_some() {
            return Err(Error::setting("image.piece", "must not be set: a piece cannot render another view"));
        }
        if camera.lens.is_some() != self.camera.lens.is_some() {
            let problem = "a renderer cannot switch between a pinhole and a lens: make another renderer";
            return Err(Error::Usage(problem.into()));
        }
        Ok(())
    }

    fn begin_view(&mut self, camera: &Camera, [width, height]: [u32; 2], is_preview: bool) -> Result<()> {
        self.check_view(camera)?;
        let photons = self.view.lighting.visibility_map.is_some().then(|| self.settings.photons_per_light());
        let settings = self.settings.clone().with(|s| {
            s.visibility_map.photons_per_light = self.requested_photons.or(photons.filter(|_| is_preview));
            (s.image.width, s.image.height) = (width, height);
        });
        settings.check()?;
        let (specialisation, with_photons) = if is_preview {
            (self.specialisation.clone(), None)
        } else {
            let anew = Specialisation::new(&self.scene, Some(camera), &settings);
            postpone_photons(anew.with_deferred_of(&self.specialisation), &self.scene, camera, &settings)
        };
        let (kernels, time_compile) = Kernels::compile(self.gpu, &specialisation, &self.gpu_scene, &settings)?;
        let last = ImageMemory::new(&self.specialisation, &self.settings);
        let tile_size = kernels.fit(self.gpu, &self.scene, &specialisation.features, &settings, Some(last))?;
        // From here on the last view is given up.
        (self.specialisation, self.with_photons) = (specialisation, with_photons);
        self.gpu_scene.set_camera(self.gpu, camera, [width, height]);
        let made = self.take_maps(photons == Some(settings.photons_per_light()), is_preview);
        let mut totals = self.totals.of_another_view();
        totals.time_compile += time_compile;
        if made.visibility_map.is_none() {
            (totals.photons, totals.photon_bytes) = (Vec::new(), 0);
        }
        let inputs = ViewOf {
            gpu: self.gpu,
            scene: &self.scene,
            gpu_scene: &self.gpu_scene,
            features: &self.specialisation.features,
            camera,
            settings: &settings,
        };
        self.view = inputs.prepare(kernels, tile_size, made, &mut totals)?;
        self.sampling = SamplingState::new(&settings.image, false);
        (self.camera, self.settings, self.totals) = (camera.clone(), settings, totals);
        self.has_other_views = true;
        Ok(())
    }

    /// Takes the maps that the next view can use; whatever else belongs to the last view is released, before the next
    /// one needs memory. `is_as_many`: the next view has as many visibility photons.
    fn take_maps(&mut self, is_as_many: bool, is_preview: bool) -> MadeMaps {
        let Lighting { visibility_map, indirect, .. } = mem::take(&mut self.view.lighting);
        self.view.tiles.clear();
        let has_map = self.specialisation.features.has(Feature::VisibilityMap);
        let visibility_map = visibility_map.filter(|_| has_map && is_as_many);
        // Other stages have other photons.
        let MadeIndirect { map, records } = indirect.map(IndirectLight::into_made).unwrap_or_default();
        let map = map.filter(|_| self.view.stage == self.first_stage()).or(self.first_map.take());
        if mem::replace(&mut self.is_preview, is_preview) {
            self.kept_records = records;
        }
        let records = if is_preview { self.kept_records.take() } else { None };
        MadeMaps { visibility_map, indirect: MadeIndirect { map, records } }
    }
}
