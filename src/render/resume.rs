//! Renders that continue from a checkpoint, in another process or on another device, with the same bits as without the
//! interruption.

use std::path::Path;

use super::checkpoint::{Checkpoint, GrowthHeader, Header};
use super::growth::Growth;
use super::renderer::Renderer;
use crate::light_transport::shared::Shared;
use crate::light_transport::visibility_map::MapState;
use crate::settings::stages::LAST_STAGE;
use crate::settings::values::difference;
use crate::{Error, Result};

impl Renderer<'_> {
    /// The state that samples left so far.
    ///
    /// # Errors
    /// Those of [`kernel_kit::Gpu::read`].
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        Ok(self.checkpoint_without_fingerprint()?.with_fingerprint(self.fingerprint()))
    }

    /// Writes the file for [`Renderer::resume`]. The old file remains until the new one is complete.
    ///
    /// # Errors
    /// Those of [`Renderer::checkpoint`] and [`Checkpoint::write`].
    pub fn save_checkpoint(&self, path: impl AsRef<Path>) -> Result<()> {
        self.checkpoint()?.write(path)
    }

    /// Like [`Renderer::checkpoint`], for a renderer of the same scene and settings: it has no fingerprint, because
    /// computing that takes longer than everything else.
    pub(super) fn checkpoint_without_fingerprint(&self) -> Result<Checkpoint> {
        let mut words = Vec::new();
        match &self.piece_sums {
            Some(sums) => words.extend(sums.words()),
            None => {
                for plane in self.planes() {
                    words.extend(plane.state(self.gpu)?);
                }
            }
        }
        if let Some(Growth { means, errors, .. }) = &self.sampling.growth {
            words.extend(means.iter().chain(errors.iter().flatten()).map(|value| value.to_bits()));
        }
        let map = self.view.lighting.map_state(self.gpu)?;
        words.extend(map.words());
        let header = Header {
            version: Header::version(),
            fingerprint: String::new(),
            samples: self.sampling.samples,
            later_stages: self.view.later_stages.clone(),
            growth: self
                .sampling
                .growth
                .as_ref()
                .map(|Growth { samples, errors, .. }| GrowthHeader { samples: *samples, has_errors: errors.is_some() }),
            blocks: self.sampling.allocation.clone(),
            batches: self.sampling.batches,
            shade_at_once: self.sampling.shade_at_once,
            has_visibility_map: self.view.lighting.visibility_map.is_some(),
            may_have_photons: self.with_photons.is_some(),
            samples_without_photons: self.sampling.samples_without_photons,
            totals: self.totals.clone(),
            added: map.added.len(),
            left: map.left,
            settings: self.settings.values(),
        };
        Ok(Checkpoint { header, words, file: None })
    }

    /// Like [`Renderer::resume_from`], from a file.
    ///
    /// # Errors
    /// Those of [`Checkpoint::read`] and [`Renderer::resume_from`].
    pub fn resume(&mut self, path: impl AsRef<Path>) -> Result<()> {
        self.resume_from(&Checkpoint::read(path)?)
    }

    /// Continues the render that wrote the checkpoint, with the same bits as without the interruption. Call it before
    /// the first sample.
    ///
    /// # Errors
    /// [`Error::Input`] if the checkpoint belongs to another scene, another camera or other settings, which it names.
    pub fn resume_from(&mut self, from: &Checkpoint) -> Result<()> {
        let Checkpoint { header, words, file } = from;
        let refuse = |problem: &str| Error::input(file.as_deref().unwrap_or("checkpoint".as_ref()), "file", problem);
        let damaged = || refuse("the checkpoint is damaged");
        let unsigned = file.is_none() && header.fingerprint.is_empty();
        if !unsigned && header.fingerprint != self.fingerprint() {
            return Err(refuse(&match difference(&header.settings, &self.settings.values()) {
                Some(difference) => format!("the checkpoint is of other settings: {difference}"),
                None => "the checkpoint is of another scene or camera".to_owned(),
            }));
        }
        self.restore_trial(header)?;
        if !self.fits(header) {
            return Err(damaged());
        }
        let mut rest = words.as_slice();
        if let Some(sums) = &self.piece_sums {
            self.piece_sums = Some(sums.restored(header.samples, &mut rest).ok_or_else(damaged)?);
        }
        for plane in self.planes().filter(|_| self.piece_sums.is_none()) {
            let (state, others) = rest.split_at_checked(plane.state_words()).ok_or_else(damaged)?;
            plane.restore(self.gpu, state);
            rest = others;
        }
        let growth = match &header.growth {
            Some(growth) => Some(self.growth_from(growth, &mut rest).ok_or_else(damaged)?),
            None => None,
        };
        let map = MapState::from_words(rest, header.added, header.left).ok_or_else(damaged)?;
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.view.buffers);
        if !self.view.lighting.restore(&Shared { gpu, scene, gpu_scene, tile }, &map, &mut self.totals)? {
            return Err(damaged());
        }
        self.restore_stages(&header.later_stages)?;
        self.sampling.samples = header.samples;
        self.sampling.samples_without_photons = header.samples_without_photons;
        self.sampling.growth = growth;
        self.sampling.allocation.clone_from(&header.blocks);
        self.sampling.batches = header.batches;
        self.sampling.shade_at_once = header.shade_at_once;
        self.totals = header.totals.clone().after(&self.totals);
        Ok(())
    }

    /// Whether a checkpoint with this header can be one of this render, whose trial of photons is restored.
    fn fits(&self, header: &Header) -> bool {
        let image = &self.settings.image;
        let has_map = self.view.lighting.visibility_map.is_some();
        header.has_visibility_map == has_map
            // Counts are by light.
            && (!has_map || header.totals.photons.len() == self.totals.photons.len())
            // Other renders may have more samples than were requested.
            && (image.piece.is_none() || header.samples <= image.range().count())
            && self.fits_stages(&header.later_stages)
            && header.blocks.is_some() == self.sampling.allocation.is_some()
            && header.blocks.as_ref().is_none_or(|allocation| allocation.fits(image))
    }

    /// Whether indirect light can have these stages after its first one.
    fn fits_stages(&self, stages: &[i32]) -> bool {
        let all = [&[self.view.stage], stages].concat();
        all.is_sorted_by(|a, b| a < b) && all.last().is_some_and(|last| *last <= LAST_STAGE)
    }

    /// The growth of indirect light, whose pixels are the first of the words in `rest`; these are taken off. `None` if
    /// there are too few.
    fn growth_from(&self, header: &GrowthHeader, rest: &mut &[u32]) -> Option<Growth> {
        let GrowthHeader { samples, has_errors } = *header;
        let pixels = self.settings.image.crop_window().pixels();
        let mut values = || {
            let (values, others) = rest.split_at_checked(pixels as usize)?;
            *rest = others;
            Some(values.iter().copied().map(f32::from_bits).collect::<Vec<f32>>())
        };
        let means = values()?;
        let errors = if has_errors { Some(values()?) } else { None };
        Some(Growth { samples, means, errors })
    }

    /// Fingerprint of scene, camera, settings and version.
    pub(super) fn fingerprint(&self) -> String {
        self.scene.fingerprint(&(&self.camera, &self.settings))
    }
}
