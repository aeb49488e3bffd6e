//! The kernels of light transport, composed and compiled in parallel. A kernel that a render does not need is `None`.

use kernel_kit::Gpu;

use super::direct_light::DirectLightKernels;
use super::global_map::GlobalMapKernels;
use super::irradiance_cache::CacheKernels;
use super::light_sampler::LightSamplerKernels;
use super::visibility_map::MapKernels;
use crate::Result;
use crate::passes::cells::Cells;
use crate::passes::fine_cells::FineCells;
use crate::passes::light_buffer::LightBufferPass;
use crate::passes::path::Path;
use crate::passes::ward::Ward;
use crate::settings::Settings;
use crate::specialisation::Specialisation;
use crate::specialisation::features::{Feature, Features};

/// The kernels of separate direct light. The first pass takes them.
#[derive(Default)]
pub(crate) struct DirectKernels {
    pub light_sampler: Option<LightSamplerKernels>,
    pub visibility_map: Option<MapKernels>,
    pub cells: Option<Cells>,
    pub light_buffer: Option<LightBufferPass>,
    pub ward: Option<Ward>,
    pub fine_cells: Option<FineCells>,
    pub direct_light: Option<DirectLightKernels>,
}

impl DirectKernels {
    /// The kernels that the features require.
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        settings: &Settings,
    ) -> Result<DirectKernels> {
        if !settings.technique.is_two_pass() {
            return Ok(DirectKernels::default());
        }
        let map = || MapKernels::new(gpu, features, constants, settings);
        let light_sampler = || LightSamplerKernels::new(gpu, features, constants, settings);
        let has = |name| features.has(name);
        let light_buffer = || LightBufferPass::new(gpu, features, constants);
        let nearest = settings.visibility_map.nearest;
        let ((direct_light, visibility_map), ((cells, light_buffer, ward, fine_cells), light_sampler)) = rayon::join(
            || {
                rayon::join(
                    || DirectLightKernels::new(gpu, features, constants, settings),
                    || has(Feature::VisibilityMap).then(map).transpose(),
                )
            },
            || {
                rayon::join(
                    || {
                        let cells = has(Feature::Cells).then(|| Cells::new(gpu, features, constants)).transpose();
                        let light_buffer = has(Feature::LightBuffer).then(light_buffer).transpose();
                        let ward = has(Feature::Ward).then(|| Ward::new(gpu, features, constants)).transpose();
                        let fine = has(Feature::FineCells).then(|| FineCells::new(gpu, features, nearest)).transpose();
                        (cells, light_buffer, ward, fine)
                    },
                    || has(Feature::LightSampling).then(light_sampler).transpose(),
                )
            },
        );
        Ok(DirectKernels {
            light_sampler: light_sampler?,
            visibility_map: visibility_map?,
            cells: cells?,
            light_buffer: light_buffer?,
            ward: ward?,
            fine_cells: fine_cells?,
            direct_light: Some(direct_light?),
        })
    }
}

/// The kernels of indirect light, or of all light in techniques in which paths or the shown map carry it. The render
/// uses them again when it makes new photons and records.
pub(crate) struct IndirectKernels {
    pub global_map: Option<GlobalMapKernels>,
    pub cache: Option<CacheKernels>,
    pub path: Option<Path>,
    pub features: Features,
    /// See [`Specialisation::has_indirect_light`].
    pub has_light: bool,
}

impl IndirectKernels {
    /// The kernels that the specialisation requires.
    pub fn new(gpu: &Gpu, specialisation: &Specialisation, constants: &[(&str, f64)]) -> Result<IndirectKernels> {
        let features = &specialisation.features;
        let has = |name| features.has(name);
        let (map, (cache, path)) = rayon::join(
            || has(Feature::GlobalMap).then(|| GlobalMapKernels::new(gpu, features, constants)).transpose(),
            || {
                rayon::join(
                    || has(Feature::IrradianceCache).then(|| CacheKernels::new(gpu, features, constants)).transpose(),
                    || specialisation.traces_paths.then(|| Path::new(gpu, features, constants)).transpose(),
                )
            },
        );
        Ok(IndirectKernels {
            global_map: map?,
            cache: cache?,
            path: path?,
            features: features.clone(),
            has_light: specialisation.has_indirect_light(),
        })
    }
}
