//! Denoising: filters that remove noise from the image of a render, and the mixture of what they give.

pub mod chance;
pub mod mixture;
#[cfg(feature = "oidn")]
mod oidn;
pub mod statistical;
pub mod stratification;

use std::path::Path;

use kernel_kit::Gpu;

#[cfg(not(feature = "oidn"))]
use crate::Error;
use crate::Result;
use crate::settings::Denoise;

/// Added to the square of a pixel in relMSE, which is the mean of squared errors over squared pixels: otherwise dark
/// pixels alone would decide.
pub const RELMSE_FLOOR: f64 = 0.01;

/// Scene-linear R, G and B.
pub type Colour = [f32; 3];

/// The relMSE of a pixel that looks like `colour`: the mean of the squared errors `square` of R, G and B over their
/// squares.
pub(super) fn relative(colour: &Colour, square: impl Fn(usize) -> f64) -> f64 {
    (0..3).map(|c| square(c) / (f64::from(colour[c]).powi(2) + RELMSE_FLOOR)).sum::<f64>() / 3.0
}

/// A component of the light of a render, direct or indirect: a pixel each, row by row from the top.
pub struct Component {
    /// Means of the samples.
    pub mean: Vec<Colour>,
    /// Variances of these means, computed as for independent samples.
    pub variance: Vec<Colour>,
}

/// The light of some samples of each pixel: the sum of its components.
pub struct Light {
    /// Direct light, and indirect light if there is any.
    pub components: Vec<Component>,
}

impl Light {
    /// The sum of the components.
    pub fn colour(&self) -> Vec<Colour> {
        self.sum(|component| &component.mean)
    }

    /// The sum of the components' variances.
    fn variance(&self) -> Vec<Colour> {
        self.sum(|component| &component.variance)
    }

    fn sum(&self, pick: impl Fn(&Component) -> &Vec<Colour>) -> Vec<Colour> {
        let mut sum = pick(&self.components[0]).clone();
        for component in &self.components[1..] {
            let add = |(sum, more): (&mut Colour, &Colour)| (0..3).for_each(|c| sum[c] += more[c]);
            sum.iter_mut().zip(pick(component)).for_each(add);
        }
        sum
    }
}

/// The surfaces seen through the pixels, in mirrors and through clear glass. If chance decides which of two surfaces a
/// sample shows, this is their mixture ([`chance`]).
pub struct Guides {
    /// Base colour, 0 to 1.
    pub albedo: Vec<Colour>,
    /// Shading normal in world space; shorter at edges, 0 where there is nothing.
    pub normal: Vec<Colour>,
    /// Position on the surface, in normalised space; 0 where there is nothing.
    pub position: Vec<Colour>,
}

/// The input of filters.
pub struct Noisy {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// All samples.
    pub all: Light,
    /// Two halves of the samples, whose noise is nearly independent; `None` for a single sample.
    pub halves: Option<[Light; 2]>,
    /// Number of samples of each half.
    pub half_samples: [u32; 2],
    /// The guides.
    pub guides: Guides,
    /// Whether a pixel needs no filter: its samples show nothing, or the environment alone, which has no noise. Filters
    /// would take stars for fireflies, and spread light into pixels without any.
    pub is_clean: Vec<bool>,
}

/// The output of a filter.
pub struct Filtered {
    /// For all samples.
    pub all: Vec<Colour>,
    /// For each half alone.
    pub halves: Option<[Vec<Colour>; 2]>,
}

/// A filter that removes noise.
trait Filter {
    /// Its name in messages.
    fn name(&self) -> &'static str;

    /// A function that compiles its kernels.
    fn compilation(&self) -> fn(&Gpu) -> Result<()> {
        |_| Ok(())
    }

    fn filter(&self, gpu: &Gpu, noisy: &Noisy) -> Result<Filtered>;

    /// Expected seconds per pixel for `runs` runs: one for all samples, or three if halves are filtered too.
    fn seconds_per_pixel(&self, gpu: &Gpu, runs: u32) -> f64;
}

/// Errors are estimated, and filters mixed, if denoising then takes at most this share of the time left for it. It
/// takes three times as long as a filter alone, and gains less: if time is short, more samples gain more.
const MIXED_SHARE: f64 = 2.0 / 3.0;

/// Seconds of one processor core, on all cores.
fn on_all_cores(seconds: f64) -> f64 {
    seconds / std::thread::available_parallelism().map_or(1, usize::from) as f64
}

/// Denoisers that are ready for use.
///
/// ```no_run
/// use penumbra::settings::Denoise;
/// # use penumbra::{Camera, Device, Scene, Settings};
/// use penumbra::{Denoiser, Renderer};
/// # fn show(device: &Device, scene: Scene, camera: &Camera) -> penumbra::Result<()> {
///
/// let denoiser = Denoiser::new(Denoise::Auto, None)?;
/// let settings = Settings::builder().denoise(denoiser.choice()).build()?;
/// let mut renderer = Renderer::new(device, scene, camera, &settings)?;
/// while renderer.samples() < settings.image.spp {
///     renderer.render_batch()?;
/// }
/// // R, G and B are raw; denoised.R and so on are beside them.
/// let image = renderer.denoised_image(&denoiser)?;
/// # Ok(())
/// # }
/// ```
#[derive(Default)]
pub struct Denoiser {
    choice: Denoise,
    filters: Vec<Box<dyn Filter>>,
    /// Only the image of all samples is filtered, not those of its halves, and errors are not estimated.
    pub(super) is_quick: bool,
}

/// A denoised image.
pub(super) struct Denoised {
    pub colour: Vec<Colour>,
    /// The estimated standard errors of each pixel; `None` for a single sample, whose error is unknown.
    pub error: Option<Vec<Colour>>,
}

impl Denoiser {
    /// Prepares the denoisers of `choice`. `oidn_library` is the library of Open Image Denoise; if it names no folder,
    /// or is not given, the loader searches for it.
    ///
    /// # Errors
    /// [`crate::Error::Input`] with the library of Open Image Denoise if it cannot be used, unless the choice is
    /// [`Denoise::Auto`] and no library is given: then the statistical denoiser is the only one.
    pub fn new(choice: Denoise, oidn_library: Option<&Path>) -> Result<Denoiser> {
        let mut filters: Vec<Box<dyn Filter>> = Vec::new();
        match choice {
            Denoise::None => {}
            Denoise::Statistical => filters.push(Box::new(statistical::Statistical)),
            Denoise::Oidn => filters.push(oidn(oidn_library)?),
            Denoise::Auto => {
                match oidn(oidn_library) {
                    Ok(filter) => filters.push(filter),
                    Err(error) if oidn_library.is_some() => return Err(error),
                    Err(_) => {}
                }
                filters.push(Box::new(statistical::Statistical));
            }
        }
        Ok(Denoiser { choice, filters, is_quick: false })
    }

    /// The value for [`ImageSettings::denoise`](crate::settings::ImageSettings::denoise) of a render that this denoiser
    /// filters.
    pub fn choice(&self) -> Denoise {
        self.choice
    }

    /// The names of the denoisers, for messages.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.filters.iter().map(|filter| filter.name())
    }

    /// A function that compiles the filters' kernels for a device that keeps them
    /// ([`keep_kernels`](Gpu::keep_kernels)). Called while [`Renderer::new`](crate::Renderer::new) compiles its own
    /// kernels, it saves a wait at the end of the render. Its errors are those of [`kernel_kit::Kernel::new`].
    pub fn compilation(&self) -> impl Fn(&Gpu) -> Result<()> + Send + use<> {
        let of_filters: Vec<_> = self.filters.iter().map(|filter| filter.compilation()).collect();
        move |gpu| of_filters.iter().try_for_each(|compile| compile(gpu))
    }

    /// Expected seconds for an image of `pixels` pixels.
    pub fn seconds(&self, gpu: &Gpu, pixels: u64) -> f64 {
        let runs = if self.is_quick { 1 } else { 3 };
        self.filters.iter().map(|filter| filter.seconds_per_pixel(gpu, runs)).sum::<f64>() * pixels as f64
    }

    /// Leaves out steps that would take too much of `seconds` for an image of `pixels` pixels: first the estimation of
    /// errors, which mixing filters needs, then filters. Returns whether anything was left out.
    pub fn fit(&mut self, gpu: &Gpu, pixels: u64, seconds: f64) -> bool {
        if self.seconds(gpu, pixels) <= MIXED_SHARE * seconds {
            return false;
        }
        self.is_quick = true;
        self.filters.retain(|filter| filter.seconds_per_pixel(gpu, 1) * pixels as f64 <= seconds);
        self.filters.truncate(1);
        true
    }

    /// Removes the noise; `None` if there are no denoisers.
    pub(super) fn denoise(&self, gpu: &Gpu, noisy: &Noisy) -> Result<Option<Denoised>> {
        let raw = noisy.all.colour();
        let mut filtered = self.filters.iter().map(|filter| filter.filter(gpu, noisy)).collect::<Result<Vec<_>>>()?;
        let halves = noisy.halves.as_ref().map(|halves| halves.each_ref().map(Light::colour));
        for Filtered { all, halves: filtered } in &mut filtered {
            repair(all, &raw, &noisy.is_clean);
            for (image, raw) in filtered.iter_mut().flatten().zip(halves.iter().flatten()) {
                repair(image, raw, &noisy.is_clean);
            }
        }
        let Some(Filtered { all, .. }) = filtered.first() else { return Ok(None) };
        let (Some(halves), Some(filtered)) = (&halves, mixture::filtered_images(&filtered)) else {
            // Without halves, errors cannot be estimated.
            return Ok(Some(Denoised { colour: all.clone(), error: None }));
        };
        let halves = halves.each_ref().map(Vec::as_slice);
        let (size, half_samples) = (noisy.size, noisy.half_samples);
        let variance = noisy.all.variance();
        let ratios = stratification::ratios(size, &variance, halves, half_samples);
        let raw = mixture::Raw { size, all: &raw, halves, half_samples, ratios: &ratios };
        let mut mixed = if self.choice == Denoise::Auto {
            mixture::mix(&raw, &filtered)
        } else {
            mixture::alone(&raw, &filtered[0])
        };
        // Clean pixels were not filtered: their error is that of their own samples, not that of their region.
        for (i, error) in mixed.error.iter_mut().enumerate().filter(|(i, _)| noisy.is_clean[*i]) {
            *error = variance[i].map(f32::sqrt);
        }
        Ok(Some(Denoised { colour: mixed.colour, error: Some(mixed.error) }))
    }
}

/// Open Image Denoise.
#[cfg(feature = "oidn")]
fn oidn(library: Option<&Path>) -> Result<Box<dyn Filter>> {
    Ok(Box::new(oidn::OpenImageDenoise::load(library)?))
}

/// The error that this build has no Open Image Denoise.
#[cfg(not(feature = "oidn"))]
fn oidn(library: Option<&Path>) -> Result<Box<dyn Filter>> {
    let library = library.unwrap_or(Path::new("Open Image Denoise"));
    Err(Error::input(library, "library", "cannot be used: Penumbra was built without its Cargo feature `oidn`"))
}

/// Puts the raw pixel in place of a clean one, or of one that is not finite: filters may overflow where the image is
/// very bright.
fn repair(image: &mut [Colour], raw: &[Colour], is_clean: &[bool]) {
    for ((pixel, raw), is_clean) in image.iter_mut().zip(raw).zip(is_clean) {
        if *is_clean || !pixel.iter().all(|x| x.is_finite()) {
            *pixel = *raw;
        }
    }
}
