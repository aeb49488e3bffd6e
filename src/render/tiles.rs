//! Tiles: whole rows of the image with several samples of each pixel. Each tile has a film.

use std::ops::Range;

use kernel_kit::{Buffer, Frame, Gpu};

use super::picture::Quantity;
use crate::light_transport::direct_light::{DirectLight, max_points};
use crate::light_transport::shared::{TILE_POINTS, TILE_SAMPLES};
use crate::passes::film::{Change, Film, Plane};
use crate::passes::{GuideSamples, Tile, TileBuffers};
use crate::settings::{Aov, ImageSettings, Settings};
use crate::specialisation::features::Features;
use crate::{Error, Result};

/// The size of a tile.
#[derive(Clone, Copy)]
pub(super) struct TileSize {
    pub rows: u32,
    /// Maximum number of samples of a pixel.
    pub samples: u32,
    /// Maximum number of points: of samples, or of pixels that may get an irradiance record.
    pub points: u32,
}

impl TileSize {
    /// A tile of as many rows as fit, and then of as many samples as fit; `lights` is the number of the scene's lights.
    ///
    /// # Errors
    /// [`Error::Usage`] if a row has more pairs of points and lights than fit.
    pub fn new(features: &Features, lights: usize, settings: &Settings) -> Result<TileSize> {
        let most = TILE_POINTS.min(max_points(features, lights, settings));
        let crop = settings.image.crop_window();
        if most < crop.width {
            let problem = format!(
                "with {lights} lights the buffers hold a row of at most {most} pixels, not {}; choose a \
                 narrower `image.crop`, fewer `shadow_rays.samples`, or a `light_sampling.strategy` of a few lights",
                crop.width
            );
            return Err(Error::Usage(problem));
        }
        let rows = (most / crop.width).clamp(1, crop.height);
        let samples = (most / (rows * crop.width)).clamp(1, TILE_SAMPLES.min(settings.image.spp));
        let points = rows * crop.width * samples;
        // A piece has irradiance records for the whole image, of every second pixel at most.
        let ImageSettings { width, height, piece, .. } = settings.image;
        let records = piece.map_or(0, |_| most.min(width.div_ceil(2) * height.div_ceil(2)).max(width));
        Ok(TileSize { rows, samples, points: points.max(records) })
    }
}

/// The guides of denoisers.
pub(super) struct GuidePlanes {
    pub albedo: Plane,
    pub normal: Plane,
    pub position: Plane,
}

/// The planes from which the error of a component of the light is estimated.
pub(super) struct ComponentPlanes {
    /// The sums at the last two powers of two that the number of samples reached; see [`first_half`]. After 2^k
    /// samples, snapshot k modulo 2 is taken.
    pub snapshots: [Plane; 2],
    /// For denoisers.
    pub squares: Option<Plane>,
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
    /// The sums that denoisers need, if these are requested.
    pub guides: Option<GuidePlanes>,
    /// Those of direct and, if there is any, of indirect light, if the error is to be estimated; empty for a single
    /// sample.
    pub components: Vec<ComponentPlanes>,
    /// The classes of each light, if they are requested; see [`DirectLight::class_films`].
    pub classes: Vec<Plane>,
}

/// The number of samples in the first of two halves whose difference estimates the error: the largest power of two that
/// is at most half of all. The first 2^k points of a Sobol sequence are stratified, and so are the next 2^k. `samples`
/// is at least 2.
pub(super) fn first_half(samples: u32) -> u32 {
    1 << (samples.ilog2() - 1)
}

impl GuidePlanes {
    /// Empty planes; `None` if there are no guides.
    fn new(buffers: &TileBuffers, plane: &dyn Fn(&Buffer) -> Result<Plane>) -> Result<Option<GuidePlanes>> {
        let Some(GuideSamples { albedo, normal, position, .. }) = &buffers.guides else { return Ok(None) };
        Ok(Some(GuidePlanes { albedo: plane(albedo)?, normal: plane(normal)?, position: plane(position)? }))
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
        let height = settings.image.crop_window().height;
        let first_rows = (0..height).step_by(size.rows as usize);
        first_rows
            .map(|first_row| {
                let rows = size.rows.min(height - first_row);
                TileFilm::new(gpu, film, buffers, direct, [first_row, rows], settings)
            })
            .collect()
    }

    /// Empty films of some rows.
    fn new(
        gpu: &Gpu,
        film: &Film,
        buffers: &TileBuffers,
        direct: Option<&DirectLight>,
        [first_row, rows]: [u32; 2],
        settings: &Settings,
    ) -> Result<TileFilm> {
        let pixels = rows * settings.image.crop_window().width;
        let inputs = buffers.film_inputs();
        let plane = |samples: &Buffer| film.plane(gpu, pixels, samples, inputs);
        let optional = |samples: &Option<Buffer>| samples.as_ref().map(plane).transpose();
        let other = buffers.radiance_indirect.as_ref();
        let squares = settings.image.aovs.contains(&Aov::Variance).then(|| {
            let components = [&buffers.radiance_direct, other.unwrap_or(&buffers.zeros)];
            film.plane_of_squares(gpu, pixels, components, inputs)
        });
        let classes = direct.map(|direct| direct.class_films(gpu, film, pixels, inputs));
        let (direct, indirect) = (plane(&buffers.radiance_direct)?, optional(&buffers.radiance_indirect)?);
        let guides = GuidePlanes::new(buffers, &plane)?;
        let planes = |(sums, samples): (&Plane, &Buffer)| -> Result<ComponentPlanes> {
            let squares =
                guides.is_some().then(|| film.plane_of_squares(gpu, pixels, [samples, &buffers.zeros], inputs));
            Ok(ComponentPlanes {
                snapshots: [film.snapshot(gpu, sums, inputs)?, film.snapshot(gpu, sums, inputs)?],
                squares: squares.transpose()?,
            })
        };
        let components = [Some((&direct, &buffers.radiance_direct)), indirect.as_ref().zip(other)];
        let is_estimated = settings.estimates_error();
        let components =
            components.into_iter().flatten().filter(|_| is_estimated).map(planes).collect::<Result<_>>()?;
        Ok(TileFilm {
            first_row,
            rows,
            direct,
            indirect,
            squares: squares.transpose()?,
            albedo: optional(&buffers.albedo_samples)?,
            normal: optional(&buffers.normal_samples)?,
            position: optional(&buffers.position_samples)?,
            guides,
            components,
            classes: classes.transpose()?.unwrap_or_default(),
        })
    }

    /// All planes except those of classes.
    pub fn planes(&self) -> impl Iterator<Item = &Plane> {
        self.sample_planes().chain(self.components.iter().flat_map(|component| &component.snapshots))
    }

    /// The planes that sum samples, which every technique fills.
    pub fn sample_planes(&self) -> impl Iterator<Item = &Plane> {
        let optional = [&self.indirect, &self.squares, &self.albedo, &self.normal, &self.position];
        let guides = self.guides.iter().flat_map(|guides| [&guides.albedo, &guides.normal, &guides.position]);
        let squares = self.components.iter().filter_map(|component| component.squares.as_ref());
        std::iter::once(&self.direct).chain(optional.into_iter().flatten()).chain(guides).chain(squares)
    }

    /// The plane that sums a quantity.
    pub fn plane(&self, quantity: Quantity) -> Option<&Plane> {
        match quantity {
            Quantity::Direct => Some(&self.direct),
            Quantity::Indirect => self.indirect.as_ref(),
            Quantity::Squares => self.squares.as_ref(),
            Quantity::Albedo => self.albedo.as_ref(),
            Quantity::Normal => self.normal.as_ref(),
            Quantity::Position => self.position.as_ref(),
            Quantity::DirectSquares => self.components.first()?.squares.as_ref(),
            Quantity::IndirectSquares => self.components.get(1)?.squares.as_ref(),
            Quantity::GuideAlbedo => self.guides.as_ref().map(|guides| &guides.albedo),
            Quantity::GuideNormal => self.guides.as_ref().map(|guides| &guides.normal),
            Quantity::GuidePosition => self.guides.as_ref().map(|guides| &guides.position),
        }
    }

    /// Keeps the sums of the tile's pixels if `samples`, their number of samples, is a power of two.
    pub fn take_snapshot(&self, frame: &mut Frame<'_>, tile: &Tile, samples: u32) {
        if samples.is_power_of_two() {
            self.components
                .iter()
                .for_each(|component| component.snapshots[samples.ilog2() as usize % 2].record(frame, tile));
        }
    }

    /// Adds a change of the indirect light to all samples so far of the tile's pixels.
    pub fn correct(&self, gpu: &Gpu, film: &Film, frame: &mut Frame<'_>, change: Change<'_>) -> Result<()> {
        let Some(indirect) = &self.indirect else { return Ok(()) };
        if let Some(squares) = &self.squares {
            film.correct_squares(gpu, frame, squares, &[&self.direct, indirect], &change)?;
        }
        let component = self.components.get(1);
        if let Some(squares) = component.and_then(|component| component.squares.as_ref()) {
            film.correct_squares(gpu, frame, squares, &[indirect], &change)?;
        }
        film.correct(gpu, frame, indirect, &change)?;
        let last = change.earlier_samples.ilog2();
        let snapshots =
            component.into_iter().flat_map(|component| [last, last.saturating_sub(1)].map(|k| (k, component)));
        for (k, component) in snapshots.take(last.min(1) as usize + 1) {
            let of_snapshot = Change { earlier_samples: 1 << k, ..change };
            film.correct(gpu, frame, &component.snapshots[k as usize % 2], &of_snapshot)?;
        }
        Ok(())
    }

    /// The rows of the crop window that are in the tile.
    pub fn rows(&self) -> Range<u32> {
        self.first_row..self.first_row + self.rows
    }

    /// The tile for `samples_per_pixel` samples of each of `pixel_count` pixels. The first sample of a pixel is number
    /// `first_sample`.
    pub fn tile(&self, settings: &Settings, pixel_count: u32, first_sample: u32, samples_per_pixel: u32) -> Tile {
        let image = &settings.image;
        let crop = image.crop_window();
        Tile {
            width: image.width,
            height: image.height,
            first_column: crop.x,
            first_row: crop.y + self.first_row,
            columns: crop.width,
            rows: self.rows,
            pixel_count,
            point_count: pixel_count * samples_per_pixel,
            samples_per_pixel,
            first_sample,
            seed: image.seed,
            centred: f32::from(image.spp == 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Crop, Technique};

    /// A row whose points and lights would overflow a counter is refused; a part of it that fits is accepted.
    #[test]
    fn rows_of_too_many_light_points_are_refused() {
        let size = |technique: Technique, width: u32| {
            let settings =
                Settings::builder().technique(technique).size(4096, 16).shadow_samples(1024).build().unwrap();
            let settings = settings.with(|s| s.image.crop = Some(Crop { x: 0, y: 0, width, height: 16 }));
            TileSize::new(&Features::default(), 2048, &settings)
        };
        // With 2^21 light points per point, 2,047 points have fewer than 2^32.
        assert_eq!(size(Technique::TWO_PASS, 2047).unwrap().rows, 1);
        let problem = size(Technique::TWO_PASS, 2048).err().unwrap().to_string();
        let told = ["2048 lights", "at most 2047", "`image.crop`", "`shadow_rays.samples`"];
        assert!(told.iter().all(|words| problem.contains(words)), "{problem}");
        assert_eq!(size(Technique::PATH, 4096).unwrap().rows, 16, "paths count no light points");
    }
}
