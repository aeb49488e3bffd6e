//! The steps of a technique's first pass, which makes the photon maps ("In the first pass the photon map is created").
//! It runs once, before the first sample. Only the steps of visibility photons may run later: if the first sample must
//! show whether such photons pay off, they are emitted after it. A step does nothing if the specialisation left its
//! kernels out.

use std::mem;

use super::adaptive_testing::AdaptiveTesting;
use super::cell_visibility::CellVisibility;
use super::fine_cells::FineCellMap;
use super::indirect_light::{IndirectLight, IndirectSetup, MadeIndirect};
use super::kernels::{DirectKernels, IndirectKernels};
use super::light_sampler::LightSampler;
use super::lighting::Lighting;
use super::shared::Shared;
use super::visibility_map::VisibilityMap;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::gpu_scene::light_buffer::LightBuffers;
use crate::passes::primary::BoundPrimary;
use crate::scene::Camera;
use crate::settings::Settings;
use crate::statistics::totals::Totals;

/// Maps of another view of the same scene that do not depend on the camera. If a map is `None`, it is made.
#[derive(Default)]
pub(crate) struct MadeMaps {
    pub visibility_map: Option<VisibilityMap>,
    pub indirect: MadeIndirect,
}

/// A first pass under way.
pub(crate) struct FirstPass<'a> {
    pub shared: Shared<'a>,
    pub direct_kernels: DirectKernels,
    pub indirect_kernels: &'a IndirectKernels,
    pub primary: &'a BoundPrimary,
    pub camera: &'a Camera,
    /// The camera as kernels read it.
    pub camera_uniform: &'a CameraUniform,
    pub settings: &'a Settings,
    /// The settings with the numbers of photons and gather rays that the first sample has (`settings/stages.rs`).
    pub indirect_settings: &'a Settings,
    /// Maximum number of points of a tile.
    pub points: u32,
    pub totals: &'a mut Totals,
    pub made: MadeMaps,
    /// The parts made so far.
    pub lighting: Lighting,
}

impl FirstPass<'_> {
    /// Makes the sampler that gives each point a few of many lights. With zones it traces photons of every light, sorts
    /// them by zone, and lists the lights that reach each zone (passes `photons`, `grid`, `zones`).
    pub fn make_light_sampler(&mut self) -> Result<()> {
        if let Some(kernels) = self.direct_kernels.light_sampler.take() {
            let sampler = LightSampler::new(&self.shared, kernels, self.points, self.settings, self.totals)?;
            self.lighting.light_sampler = Some(sampler);
        }
        Ok(())
    }

    /// Traces illumination and shadow photons of every light (figure 1 of the paper), sorts them into a grid, and
    /// classifies its cells (passes `photons`, `grid`).
    pub fn make_visibility_map(&mut self) -> Result<()> {
        if let Some(kernels) = self.direct_kernels.visibility_map.take() {
            self.lighting.visibility_map = Some(match self.made.visibility_map.take() {
                Some(map) => map.renewed(self.shared.gpu)?,
                None => VisibilityMap::new(&self.shared, kernels, self.settings, self.totals)?,
            });
        }
        Ok(())
    }

    /// Makes an empty table of fine cells, which the shadow rays of the first samples fill.
    pub fn make_fine_cells(&mut self) -> Result<()> {
        if let Some(kernel) = self.direct_kernels.fine_cells.take() {
            let image = &self.settings.image;
            let covered = self.shared.scene.covered_share(self.camera, image.width as f32 / image.height as f32);
            let pixels = (covered * f64::from(image.width) * f64::from(image.height)) as u64;
            let cells = FineCellMap::new(&self.shared, &kernel, self.camera_uniform, image.height, pixels)?;
            self.lighting.fine_cells = Some(cells);
        }
        Ok(())
    }

    /// Prepares direct light: passes `classify`, `shadow` and `shade`, bound to the parts that earlier steps made.
    pub fn make_direct_light(&mut self) -> Result<()> {
        let Some(kernels) = self.direct_kernels.direct_light.take() else { return Ok(()) };
        self.lighting.make_direct_light(&self.shared, kernels, self.points, self.settings)
    }

    /// Traces rays from every cell of a grid to every light (pass `cells`). Direct light must be ready.
    pub fn trace_cell_rays(&mut self) -> Result<()> {
        if let (Some(kernel), Some(direct)) = (self.direct_kernels.cells.take(), &self.lighting.direct) {
            let cells = CellVisibility::new(&self.shared, &kernel, direct, self.settings, self.totals)?;
            self.lighting.cells = Some(cells);
        }
        Ok(())
    }

    /// Lists the surfaces around each light that may hide it (pass `light_buffer`). Direct light must be ready.
    pub fn make_light_buffers(&mut self) -> Result<()> {
        if let (Some(pass), Some(direct)) = (self.direct_kernels.light_buffer.take(), &self.lighting.direct) {
            let Shared { gpu, scene, gpu_scene, tile } = self.shared;
            let buffers = LightBuffers::new(scene, &gpu_scene.lights.lights, self.settings.light_buffer.resolution);
            self.totals.photon_bytes += buffers.bytes();
            let classes = &direct.classify_buffers().classes;
            self.lighting.light_buffers = Some(pass.bind(gpu, tile, &buffers, classes, gpu_scene)?);
        }
        Ok(())
    }

    /// Makes the buffers for the order of each point's lights (pass `ward`). Direct light must be ready.
    pub fn make_adaptive_testing(&mut self) -> Result<()> {
        if let (Some(kernel), Some(direct)) = (self.direct_kernels.ward.take(), &self.lighting.direct) {
            let testing = AdaptiveTesting::new(&self.shared, &kernel, direct, self.points, self.settings)?;
            self.lighting.adaptive_testing = Some(testing);
        }
        Ok(())
    }

    /// Traces photons that carry flux into the global map, and precomputes irradiance at the positions of further
    /// photons (passes `flux`, `grid`, `irradiance`). Then places irradiance records all over the view, from coarse to
    /// fine, each with a final gather that ends in the map (passes `cache`, `gather`).
    pub fn make_indirect_light(&mut self) -> Result<()> {
        let FirstPass { shared, indirect_kernels: kernels, primary, indirect_settings: settings, .. } = *self;
        let setup = IndirectSetup { shared, kernels, primary, camera: self.camera_uniform, settings };
        let made = mem::take(&mut self.made.indirect);
        self.lighting.indirect = Some(IndirectLight::new(&setup, made, self.totals)?);
        Ok(())
    }
}
