//! The parts that the first pass of a technique makes for its second pass.

use kernel_kit::Gpu;

use super::adaptive_testing::AdaptiveTesting;
use super::audits::Precautions;
use super::caustic_map::CausticMap;
use super::cell_visibility::CellVisibility;
use super::direct_light::{DirectInputs, DirectLight, DirectLightKernels};
use super::fine_cells::FineCellMap;
use super::indirect_light::IndirectLight;
use super::light_sampler::LightSampler;
use super::shared::Shared;
use super::visibility_map::{MapState, VisibilityMap};
use crate::Result;
use crate::passes::classify::BoundShowCells;
use crate::passes::light_buffer::BoundLightBuffer;
use crate::settings::Settings;
use crate::specialisation::features::Features;
use crate::statistics::totals::Totals;

/// The parts that light a tile's points. A part that the technique or the scene does not need is `None`.
#[derive(Default)]
pub(crate) struct Lighting {
    /// Gives each point a few of many lights.
    pub light_sampler: Option<LightSampler>,
    pub visibility_map: Option<VisibilityMap>,
    /// Visibility of lights from the cells of a grid.
    pub cells: Option<CellVisibility>,
    /// The surfaces around each light.
    pub light_buffers: Option<BoundLightBuffer>,
    /// Where the map does not decide: the shadow rays of earlier samples as photons.
    pub fine_cells: Option<FineCellMap>,
    pub adaptive_testing: Option<AdaptiveTesting>,
    /// Direct light, if the technique computes it separately.
    pub direct: Option<DirectLight>,
    pub indirect: Option<IndirectLight>,
    /// The caustic map of the current samples, if surfaces focus light.
    pub caustics: Option<CausticMap>,
}

impl Lighting {
    fn inputs(&self) -> DirectInputs<'_> {
        DirectInputs {
            visibility_map: self.visibility_map.as_ref(),
            light_sampler: self.light_sampler.as_ref(),
            fine_cells: self.fine_cells.as_ref(),
        }
    }

    /// Makes direct light for tiles of `points` points, guided by the visibility map and the light sampler.
    pub fn make_direct_light(
        &mut self,
        shared: &Shared<'_>,
        kernels: DirectLightKernels,
        points: u32,
        settings: &Settings,
    ) -> Result<()> {
        self.direct = Some(DirectLight::new(shared, kernels, points, settings, self.inputs())?);
        Ok(())
    }

    fn bind_direct_light(&mut self, shared: &Shared<'_>) -> Result<()> {
        // Taken out, because its inputs are borrowed from `self` meanwhile.
        let Some(mut direct) = self.direct.take() else { return Ok(()) };
        let bound = direct.bind(shared, self.inputs());
        self.direct = Some(direct);
        bound
    }

    /// Adds the photons of audits to the visibility map and sorts it again, if that is `due` or their buffer is nearly
    /// full. Fine cells take the photons themselves, at once.
    pub fn repair_map(&mut self, shared: &Shared<'_>, due: bool, totals: &mut Totals) -> Result<()> {
        let Some(map) = self.visibility_map.as_mut().filter(|_| self.fine_cells.is_none()) else { return Ok(()) };
        if map.take_repairs(shared.gpu, due, totals)? {
            unbind(&mut self.direct);
            map.sort(shared.gpu)?;
        }
        self.bind_direct_light(shared)
    }

    /// See [`DirectLight::bind_shown_cells`]; `None` also without direct light.
    pub fn bind_shown_cells(
        &self,
        shared: &Shared<'_>,
        features: &Features,
        nearest: u32,
    ) -> Result<Option<BoundShowCells>> {
        let bind = |direct: &DirectLight| direct.bind_shown_cells(shared, features, nearest, self.inputs());
        self.direct.as_ref().map_or(Ok(None), bind)
    }

    /// See [`DirectLight::set_precautions`].
    pub fn set_precautions(&mut self, precautions: Precautions) {
        if let Some(direct) = &mut self.direct {
            direct.set_precautions(precautions);
        }
    }

    /// See [`FineCellMap::classify`].
    pub fn classify_fine_cells(&mut self, gpu: &Gpu, samples: u32) -> Result<()> {
        self.fine_cells.as_mut().map_or(Ok(()), |cells| cells.classify(gpu, samples))
    }

    /// The state that samples left in the visibility map, or in adaptive shadow testing.
    pub fn map_state(&self, gpu: &Gpu) -> Result<MapState> {
        let state = match (&self.visibility_map, &self.adaptive_testing) {
            (Some(map), _) => map.state(gpu)?,
            (None, Some(testing)) => MapState { rest: testing.state(gpu)?, ..MapState::default() },
            (None, None) => MapState::default(),
        };
        let fine_cells = self.fine_cells.as_ref().map_or(Ok(Vec::new()), |cells| cells.state(gpu))?;
        Ok(MapState { fine_cells, ..state })
    }

    /// Restores that state before the first sample; false if it belongs to another render.
    pub fn restore(&mut self, shared: &Shared<'_>, state: &MapState, totals: &mut Totals) -> Result<bool> {
        let fits = match (&mut self.visibility_map, &self.adaptive_testing) {
            (Some(map), _) => {
                unbind(&mut self.direct);
                map.restore(shared.gpu, state, totals)?
            }
            (None, Some(testing)) => testing.restore(shared.gpu, &state.rest),
            (None, None) => state.rest.is_empty(),
        };
        let fits = fits
            && match &mut self.fine_cells {
                Some(cells) => cells.restore(shared.gpu, &state.fine_cells)?,
                None => state.fine_cells.is_empty(),
            };
        self.bind_direct_light(shared)?;
        Ok(fits)
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        self.direct.as_ref().map_or(0, DirectLight::frame_bytes)
            + self.adaptive_testing.as_ref().map_or(0, AdaptiveTesting::frame_bytes)
            + self.light_sampler.as_ref().map_or(0, LightSampler::frame_bytes)
            + self.fine_cells.as_ref().map_or(0, FineCellMap::bytes)
            + self.indirect.as_ref().map_or(0, IndirectLight::frame_bytes)
    }
}

/// Direct light must release the map's tables before they are made again.
fn unbind(direct: &mut Option<DirectLight>) {
    if let Some(direct) = direct {
        direct.unbind();
    }
}
