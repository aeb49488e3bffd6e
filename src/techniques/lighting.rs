//! How a technique lights the points that the camera sees.

use crate::Result;
use crate::gpu::{Buffer, Features, Frame, Gpu};
use crate::passes::film::Film;
use crate::passes::path::{BoundPath, Path, PathParameters};
use crate::passes::{Tile, TileBuffers};
use crate::scene::Scene;
use crate::settings::{Settings, Technique};
use crate::tables::SceneTables;

use super::direct::{self, Direct, ShadowFilm};
use super::totals::Totals;

pub(super) enum Kernels {
    Direct(direct::Kernels),
    Path(Path),
}

impl Kernels {
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)], settings: &Settings) -> Result<Kernels> {
        Ok(match settings.technique {
            Technique::Path => Kernels::Path(Path::new(gpu, features, constants)?),
            _ => Kernels::Direct(direct::Kernels::new(gpu, features, constants, settings)?),
        })
    }
}

pub(super) enum Lighting {
    /// Direct light, light by light, by the photons' classes and shadow rays.
    Direct(Box<Direct>),
    /// A path from each point, direct and indirect light alike.
    Path { path: BoundPath, max_bounces: u32, light_scale: f32 },
}

impl Lighting {
    #[allow(clippy::too_many_arguments)]
    pub fn new(
        gpu: &Gpu,
        kernels: Kernels,
        scene: &Scene,
        tables: &SceneTables,
        tile: &TileBuffers,
        points: u32,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<Lighting> {
        Ok(match kernels {
            Kernels::Direct(kernels) => {
                Lighting::Direct(Box::new(Direct::new(gpu, kernels, scene, tables, tile, points, settings, totals)?))
            }
            Kernels::Path(path) => Lighting::Path {
                path: path.bind(gpu, tile, tables)?,
                max_bounces: settings.max_bounces,
                light_scale: settings.light_scale,
            },
        })
    }

    /// Adds the light of the tile's points to its radiance.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile, films: &[ShadowFilm]) {
        match self {
            Lighting::Direct(direct) => direct.record(frame, tile, films),
            Lighting::Path { path, max_bounces, light_scale } => {
                let parameters = PathParameters { tile: *tile, max_bounces: *max_bounces, light_scale: *light_scale };
                path.record(frame, &parameters);
            }
        }
    }

    /// Films of the lights' classes for a tile of `pixels` pixels; none where there are no classes.
    pub fn films(&self, gpu: &Gpu, film: &Film, pixels: u32, counters: &Buffer) -> Result<Vec<ShadowFilm>> {
        match self {
            Lighting::Direct(direct) => direct.films(gpu, film, pixels, counters),
            Lighting::Path { .. } => Ok(Vec::new()),
        }
    }

    /// Learns from the sample: photons that audits left go into the map.
    pub fn heal(&mut self, gpu: &Gpu, tables: &SceneTables, tile: &TileBuffers, totals: &mut Totals) -> Result<()> {
        match self {
            Lighting::Direct(direct) => direct.heal(gpu, tables, tile, totals),
            Lighting::Path { .. } => Ok(()),
        }
    }

    /// Bytes of the buffers of the frame.
    pub fn frame_bytes(&self) -> u64 {
        match self {
            Lighting::Direct(direct) => direct.frame_bytes(),
            Lighting::Path { .. } => 0,
        }
    }
}
