//! Denoised images of a render.

use super::denoise::{Denoiser, Noisy};
use super::noisy::{add_denoised, noisy};
use super::output::Film;
use super::renderer::Renderer;
use crate::settings::{Crop, Denoise};
use crate::{Error, Image, Result};

impl Renderer<'_> {
    /// As [`Renderer::image`], with the channels `denoised.R`, `denoised.G` and `denoised.B` of the denoised image;
    /// `error`, their estimated standard error (the root of the mean square over the three); and `relative_error`, the
    /// root of the estimated relMSE. There are no errors after a single sample. Without denoisers it is the same as
    /// [`Renderer::image`].
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
        if self.settings.image.piece.is_some() {
            let problem = "is for merged pieces: a single piece lacks the samples of the others";
            return Err(Error::setting("image.denoise", problem));
        }
        let Crop { width, height, .. } = self.settings.image.crop_window();
        let background = self.settings.image.background;
        add_denoised(image, denoiser, self.gpu, &Film::of(self), [width, height], background)
    }

    /// The input of denoisers. Without denoisers there are no guides, and the variances are 0.
    pub(super) fn noisy(&self) -> Result<Noisy> {
        let Crop { width, height, .. } = self.settings.image.crop_window();
        noisy(&Film::of(self), [width, height])
    }
}
