//! Images without noise: what denoisers take from the film, and the channels of what they give.

use glam::DVec4;

use super::denoise::{Colour, Denoiser, Guides, Light, Noisy, Part};
use super::output::Film;
use super::picture::colour_of;
use super::renderer::Renderer;
use super::tiles::{GuidePlanes, TileFilm, first_half};
use crate::passes::film::{Plane, Sum, variance_of_mean};
use crate::settings::{Crop, Denoise};
use crate::{Error, Image, Result};

/// A choice of a tile's planes.
type Pick<'a> = &'a dyn Fn(&TileFilm) -> Option<&Plane>;

impl Renderer<'_> {
    /// As [`Renderer::image`], with the channels `denoised.R`, `denoised.G` and `denoised.B` of the image without
    /// noise, and `error`, their estimated standard error: the root of the mean square over the three. There is no
    /// `error` after a single sample. Without denoisers it is the same as [`Renderer::image`].
    ///
    /// # Errors
    /// As [`Renderer::image`]; [`Error::Setting`] if the render keeps nothing for denoisers, because
    /// [`ImageSettings::denoise`](crate::settings::ImageSettings::denoise) is [`Denoise::None`]; [`Error::Input`] with
    /// the library of a denoiser that fails.
    pub fn denoised_image(&self, denoiser: &Denoiser) -> Result<Image> {
        let mut image = self.image()?;
        self.add_denoised(&mut image, denoiser)?;
        Ok(image)
    }

    /// Adds the channels of [`Renderer::denoised_image`] to an image of this render.
    ///
    /// # Errors
    /// As [`Renderer::denoised_image`].
    pub fn add_denoised(&self, image: &mut Image, denoiser: &Denoiser) -> Result<()> {
        if denoiser.choice() == Denoise::None {
            return Ok(());
        }
        if self.settings.image.denoise == Denoise::None {
            return Err(Error::setting("image.denoise", "is none: the film keeps nothing for denoisers"));
        }
        let Some(denoised) = denoiser.denoise(self.gpu, &self.noisy()?)? else { return Ok(()) };
        let mut colours = denoised.colour;
        if let Some(background) = colour_of(self.settings.image.background) {
            let means = Film::of(self).means(&|f| Some(&f.direct))?.unwrap_or_default();
            for (colour, mean) in colours.iter_mut().zip(&means) {
                let behind = background * (1.0 - mean.w);
                *colour = [0, 1, 2].map(|c| colour[c] + behind[c] as f32);
            }
        }
        for (c, name) in ["denoised.R", "denoised.G", "denoised.B"].into_iter().enumerate() {
            image.add_channel(name, colours.iter().map(|colour| colour[c]).collect());
        }
        if let Some(error) = denoised.error {
            image.add_channel("error", error);
        }
        Ok(())
    }

    /// What denoisers take. Without denoisers there are no guides, and the variances are 0.
    pub(super) fn noisy(&self) -> Result<Noisy> {
        let film = Film::of(self);
        let guide = |pick: &dyn Fn(&GuidePlanes) -> &Plane| -> Result<Vec<Colour>> {
            Ok(film.means(&|f| f.guides.as_ref().map(pick))?.unwrap_or_default().iter().map(colour).collect())
        };
        let mut albedo = guide(&|planes| &planes.albedo)?;
        albedo.iter_mut().flatten().for_each(|x| *x = x.clamp(0.0, 1.0));
        let normal = guide(&|planes| &planes.normal)?;
        // Without what passes by: w is the share of samples that met a surface.
        let met = |p: &DVec4| if p.w > 0.0 { colour(&(*p / p.w)) } else { [0.0; 3] };
        let positions = film.means(&|f| f.guides.as_ref().map(|planes| &planes.position))?.unwrap_or_default();
        let position = positions.iter().map(met).collect();

        let samples = |pixel: usize| self.samples_of(pixel);
        let (mut all, mut halves) = (Vec::new(), [Vec::new(), Vec::new()]);
        let parts: [Pick; 2] = [&|f| Some(&f.direct), &|f| f.indirect.as_ref()];
        for (index, part) in parts.into_iter().enumerate() {
            let Some(whole) = film.plane_sums(part, &samples)? else { continue };
            let squares = film.plane_sums(&|f| f.parts.get(index)?.squares.as_ref(), &samples)?;
            if let Some(first) = self.first_halves(&film, index)? {
                // A pixel without samples of a half tells nothing of the error: it counts as exact.
                let mean = |part: Sum, whole: &Sum| if part.kept > 0.0 { part.mean() } else { whole.mean() };
                let both = first.iter().zip(&whole);
                let second = both.clone().map(|(part, whole)| colour(&mean(whole.without(part), whole)));
                halves[1].push(second.collect());
                halves[0].push(both.map(|(part, whole)| colour(&mean(*part, whole))).collect());
            }
            let variance =
                |(squares, sum): (&Sum, &Sum)| colour(&variance_of_mean(sum.mean(), squares.mean(), sum.kept));
            let variance = squares.map(|squares| squares.iter().zip(&whole).map(variance).collect());
            let mean = whole.iter().map(|sum| colour(&sum.mean())).collect();
            all.push(Part { mean, variance: variance.unwrap_or_else(|| vec![[0.0; 3]; whole.len()]) });
        }
        let Crop { width, height, .. } = self.settings.image.part();
        // Filters take one number: with adaptive sampling that of the pixels which know least.
        let fewest = (0..width as usize * height as usize).map(samples).min().unwrap_or(0);
        let in_half = if fewest > 1 { first_half(fewest) } else { fewest };
        let half_samples = [in_half, fewest - in_half];
        let factor = |of: usize, pixel: usize| {
            let first = f64::from(first_half(samples(pixel))) / f64::from(samples(pixel));
            (1.0 / if of == 0 { first } else { 1.0 - first }) as f32
        };
        let half =
            |of: usize, means: Vec<Vec<Colour>>| Light { parts: half_parts(means, &all, &|pixel| factor(of, pixel)) };
        let [first, second] = halves;
        let halves = (!first.is_empty()).then(|| [half(0, first), half(1, second)]);
        let guides = Guides { albedo, normal, position };
        Ok(Noisy { size: [width, height], all: Light { parts: all }, halves, half_samples, guides })
    }

    /// The sums of the first half of each pixel's samples, of a part of the light; none of a single sample.
    fn first_halves(&self, film: &Film<'_>, part: usize) -> Result<Option<Vec<Sum>>> {
        if self.samples < 2 {
            return Ok(None);
        }
        let half = |pixel: usize| first_half(self.samples_of(pixel));
        let snapshot = |k: usize| film.plane_sums(&|f| Some(&f.parts.get(part)?.snapshots[k]), &half);
        let (Some(even), Some(odd)) = (snapshot(0)?, snapshot(1)?) else { return Ok(None) };
        let pick = |(pixel, sums): (usize, [Sum; 2])| sums[half(pixel).ilog2() as usize % 2];
        Ok(Some(even.into_iter().zip(odd).map(<[Sum; 2]>::from).enumerate().map(pick).collect()))
    }
}

/// The parts of one half of the samples. The variances of their means are those of all samples times `factor`.
fn half_parts(means: Vec<Vec<Colour>>, all: &[Part], factor: &dyn Fn(usize) -> f32) -> Vec<Part> {
    let variance = |(pixel, variance): (usize, &Colour)| variance.map(|x| x * factor(pixel));
    let part = |(mean, all): (Vec<Colour>, &Part)| Part {
        mean,
        variance: all.variance.iter().enumerate().map(variance).collect(),
    };
    means.into_iter().zip(all).map(part).collect()
}

fn colour(value: &DVec4) -> Colour {
    value.truncate().as_vec3().to_array()
}
