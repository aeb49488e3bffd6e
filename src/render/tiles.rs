//! Tiles: whole rows of the image with several samples of each pixel. Each tile has a film.

use kernel_kit::{Buffer, Frame, Gpu};

use crate::Result;
use crate::light_transport::direct_light::{DirectLight, max_points};
use crate::light_transport::shared::TILE_SAMPLES;
use crate::passes::film::{Film, Plane};
use crate::passes::{Tile, TileBuffers};
use crate::settings::{Aov, Settings};
use crate::specialisation::features::Features;

/// Maximum number of points of a tile: enough to keep a device busy, and few enough for its memory and for the time of
/// a dispatch.
const TILE_POINTS: u32 = 1 << 19;

/// The size of a tile.
#[derive(Clone, Copy)]
pub(super) struct TileSize {
    pub rows: u32,
    /// Maximum number of samples of a pixel.
    pub layers: u32,
    /// Maximum number of points.
    pub points: u32,
}

impl TileSize {
    /// As many rows as fit, then as many samples as fit; `lights` is the number of the scene's lights.
    pub fn new(features: &Features, lights: usize, settings: &Settings) -> TileSize {
        let most = TILE_POINTS.min(max_points(features, lights, settings));
        let rows = (most / settings.image.width).clamp(1, settings.image.height);
        let layers = (most / (rows * settings.image.width)).clamp(1, TILE_SAMPLES.min(settings.image.spp));
        TileSize { rows, layers, points: rows * settings.image.width * layers }
    }
}

/// What denoisers need beside the image.
pub(super) struct DenoisingPlanes {
    pub albedo: Plane,
    pub normal: Plane,
    pub position: Plane,
    /// Of direct and, if there is any, indirect light; none for a single sample.
    pub parts: Vec<PartPlanes>,
}

/// What tells the error of a part of the light.
pub(super) struct PartPlanes {
    /// The sums when the number of samples was a power of two last, and the time before; see [`first_half`].
    snapshots: [Plane; 2],
    pub squares: Plane,
}

/// The film of some rows.
pub(super) struct TileFilm {
    first_row: u32,
    rows: u32,
    pub direct: Plane,
    pub indirect: Option<Plane>,
    pub squares: Option<Plane>,
    pub albedo: Option<Plane>,
    pub normal: Option<Plane>,
    pub position: Option<Plane>,
    /// What denoisers need, if they are requested.
    pub denoising: Option<DenoisingPlanes>,
    /// The classes of each light, if they are requested; see [`DirectLight::class_films`].
    pub classes: Vec<Plane>,
}

impl PartPlanes {
    /// The sums of the first half of `samples` samples; see [`first_half`].
    pub fn first_half(&self, samples: u32) -> &Plane {
        self.snapshot(first_half(samples))
    }

    /// The snapshot after a number of samples that is a power of two.
    fn snapshot(&self, samples: u32) -> &Plane {
        &self.snapshots[samples.ilog2() as usize % 2]
    }
}

/// The number of samples of the first of two halves whose errors are compared: the largest power of two up to half of
/// them. That many points of a Sobol sequence, from its first one on, are stratified, and so are the next ones.
/// `samples` is at least 2.
pub(super) fn first_half(samples: u32) -> u32 {
    1 << (samples.ilog2() - 1)
}

impl DenoisingPlanes {
    /// Empty planes of `pixels` pixels; none if there are no guides.
    fn new(
        gpu: &Gpu,
        film: &Film,
        buffers: &TileBuffers,
        pixels: u32,
        settings: &Settings,
    ) -> Result<Option<DenoisingPlanes>> {
        let guides = [&buffers.guide_albedo_samples, &buffers.guide_normal_samples, &buffers.guide_position_samples];
        let [Some(albedo), Some(normal), Some(position)] = guides else { return Ok(None) };
        let counters = &buffers.counters;
        let parts = [Some(&buffers.radiance_direct), buffers.radiance_indirect.as_ref()].into_iter().flatten();
        let part = |samples: &Buffer| -> Result<PartPlanes> {
            Ok(PartPlanes {
                snapshots: [film.plane(gpu, pixels, samples, counters)?, film.plane(gpu, pixels, samples, counters)?],
                squares: film.plane_of_squares(gpu, pixels, [samples, &buffers.zeros], counters)?,
            })
        };
        Ok(Some(DenoisingPlanes {
            albedo: film.plane(gpu, pixels, albedo, counters)?,
            normal: film.plane(gpu, pixels, normal, counters)?,
            position: film.plane(gpu, pixels, position, counters)?,
            parts: parts.filter(|_| settings.image.spp > 1).map(part).collect::<Result<_>>()?,
        }))
    }
}

impl TileFilm {
    /// Empty films of all tiles, in the order of their rows.
    pub fn of_all_tiles(
        gpu: &Gpu,
        film: &Film,
        buffers: &TileBuffers,
        direct: Option<&DirectLight>,
        size: TileSize,
        settings: &Settings,
    ) -> Result<Vec<TileFilm>> {
        let first_rows = (0..settings.image.height).step_by(size.rows as usize);
        first_rows
            .map(|first_row| {
                let rows = size.rows.min(settings.image.height - first_row);
                TileFilm::new(gpu, film, buffers, direct, [first_row, rows], settings)
            })
            .collect()
    }

    fn new(
        gpu: &Gpu,
        film: &Film,
        buffers: &TileBuffers,
        direct: Option<&DirectLight>,
        [first_row, rows]: [u32; 2],
        settings: &Settings,
    ) -> Result<TileFilm> {
        let pixels = rows * settings.image.width;
        let plane = |samples: &Buffer| film.plane(gpu, pixels, samples, &buffers.counters);
        let optional = |samples: &Option<Buffer>| samples.as_ref().map(plane).transpose();
        let other = buffers.radiance_indirect.as_ref();
        let squares = settings.image.aovs.contains(&Aov::Variance).then(|| {
            let parts = [&buffers.radiance_direct, other.unwrap_or(&buffers.zeros)];
            film.plane_of_squares(gpu, pixels, parts, &buffers.counters)
        });
        let classes = direct.map(|direct| direct.class_films(gpu, film, pixels, &buffers.counters));
        Ok(TileFilm {
            first_row,
            rows,
            direct: plane(&buffers.radiance_direct)?,
            indirect: optional(&buffers.radiance_indirect)?,
            squares: squares.transpose()?,
            albedo: optional(&buffers.albedo_samples)?,
            normal: optional(&buffers.normal_samples)?,
            position: optional(&buffers.position_samples)?,
            denoising: DenoisingPlanes::new(gpu, film, buffers, pixels, settings)?,
            classes: classes.transpose()?.unwrap_or_default(),
        })
    }

    /// All planes but those of classes.
    pub fn planes(&self) -> impl Iterator<Item = &Plane> {
        let parts = self.denoising.iter().flat_map(|planes| &planes.parts);
        self.sample_planes().chain(parts.flat_map(|part| &part.snapshots))
    }

    /// The planes that sum samples, which every technique fills.
    pub fn sample_planes(&self) -> impl Iterator<Item = &Plane> {
        let optional = [&self.indirect, &self.squares, &self.albedo, &self.normal, &self.position];
        let denoising = self.denoising.iter().flat_map(|planes| {
            let parts = planes.parts.iter().map(|part| &part.squares);
            [&planes.albedo, &planes.normal, &planes.position].into_iter().chain(parts)
        });
        std::iter::once(&self.direct).chain(optional.into_iter().flatten()).chain(denoising)
    }

    /// Keeps the sums of all samples so far, whose number is a power of two, for denoisers.
    pub fn take_snapshot(&self, frame: &mut Frame<'_>, samples: u32) {
        let Some(denoising) = &self.denoising else { return };
        for (part, sums) in
            denoising.parts.iter().zip([Some(&self.direct), self.indirect.as_ref()].into_iter().flatten())
        {
            part.snapshot(samples).copy_from(frame, sums);
        }
    }

    /// The tile for `layers` samples of each pixel, the first of which is number `first_sample`.
    pub fn tile(&self, settings: &Settings, first_sample: u32, layers: u32) -> Tile {
        let (width, height, seed, spp) =
            (settings.image.width, settings.image.height, settings.image.seed, settings.image.spp);
        let pixel_count = self.rows * width;
        Tile {
            width,
            height,
            first_row: self.first_row,
            pixel_count,
            point_count: pixel_count * layers,
            first_sample,
            seed,
            centred: u32::from(spp == 1),
        }
    }
}
