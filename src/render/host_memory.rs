//! The memory of the machine that a render takes. Without enough of it the system would end the process without a
//! word.

use glam::DVec4;
use serde::Serialize;

use super::denoise::Colour;
use super::pieces::sums::{Total, half_of, max_nodes};
use crate::light_transport::shared::{TILE_POINTS, TILE_SAMPLES};
use crate::passes::film::{Plane, Sum};
use crate::settings::stages::grows;
use crate::settings::{Aov, Denoise, Settings};
use crate::specialisation::Specialisation;
use crate::specialisation::features::{Feature, Features};
use crate::{Error, Result, memory};

/// Bytes of a sample of a channel, of a colour that denoisers take, and of a number in a mean over a region.
const CHANNEL: u64 = size_of::<f32>() as u64;
const COLOUR: u64 = size_of::<Colour>() as u64;
const NUMBER: u64 = size_of::<f64>() as u64;

/// Bytes of a pixel while the input of denoisers is made, without what each component of the light has: the means of
/// three guides in both precisions, the sums of one component of the light, and the coverage.
const INPUT: u64 = 3 * (size_of::<DVec4>() as u64 + COLOUR) + size_of::<Sum>() as u64 + NUMBER;

/// Bytes of a pixel while the errors of a mixture are estimated, without the components of the light: the guides; the
/// raw image and its halves; those of one filter; the variance; the mixture and its halves; weights of the squares (3)
/// and of the filter (1), means of noise (4), distributions (6); the ratio of the noise, and whether the pixel is
/// clean.
const MIXTURE: u64 = (3 + 3 + 3 + 1 + 3) * COLOUR + (3 + 1 + 4 + 6) * NUMBER + CHANNEL + 1;

/// Bytes of a pixel while adaptive sampling estimates its error: the colours of all samples and of two halves, those by
/// which noise is measured, and their medians (5), the error, and the number of samples.
const ERRORS: u64 = 5 * COLOUR + NUMBER + CHANNEL;

/// Bytes that an image takes at least, so that no render is refused that would succeed.
///
/// Renders of `scenes/box.glb` with `path` on lavapipe had peaks per pixel, apart from what small images take, of 145
/// bytes, or 586 with the statistical denoiser and a single sample, or 1,151 with two. Less the copy of the state,
/// which is made only where it has room, these are 81, 426 and 799. Here they count as 80, 404 and 785. What Open Image
/// Denoise takes for itself is left out: it may do with less.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ImageMemory {
    /// In the machine's memory: the channels, and what denoisers take at the end.
    pub host: u64,
    /// On the device: the sums of samples. Those of a piece, and the buffers of a software device, are in the machine's
    /// memory.
    pub film: u64,
}

impl ImageMemory {
    /// What the image of such settings takes, by what a scene and these need.
    pub fn new(specialisation: &Specialisation, settings: &Settings) -> ImageMemory {
        ImageMemory::of(&specialisation.features, specialisation.has_indirect_light(), settings)
    }

    /// [`ImageMemory::new`] by its features.
    pub(super) fn of(features: &Features, has_indirect: bool, settings: &Settings) -> ImageMemory {
        let pixels = settings.image.crop_window().pixels();
        ImageMemory {
            host: pixels * bytes_of_image(settings, has_indirect),
            film: pixels * bytes_of_sums(features, has_indirect, settings),
        }
    }

    /// Refuses an image that has no room in the memory that is available. The film of `last` is released before it is
    /// rendered.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub(super) fn check(self, last: Option<ImageMemory>, is_software: bool, settings: &Settings) -> Result<()> {
        let crop = settings.image.crop_window();
        let on_host = |film: u64| if is_software || settings.image.piece.is_some() { film } else { 0 };
        let released = last.map_or(0, |last| on_host(last.film));
        let needed = self.host + on_host(self.film);
        refuse_unless([crop.width, crop.height], needed, released, || remedy(settings))
    }
}

/// Refuses an image of `size` that needs more bytes than are available.
///
/// # Errors
/// [`Error::Memory`].
pub(super) fn refuse_without_room(size: [u32; 2], needed: u64, remedy: impl Fn() -> String) -> Result<()> {
    refuse_unless(size, needed, 0, remedy)
}

/// [`refuse_without_room`], where as many bytes as `released` become available before.
fn refuse_unless(size: [u32; 2], needed: u64, released: u64, remedy: impl Fn() -> String) -> Result<()> {
    match memory::available_with_swap().map(|available| available.saturating_add(released)) {
        Some(available) if needed > available => Err(Error::Memory { size, needed, available, remedy: remedy() }),
        _ => Ok(()),
    }
}

/// Whether `bytes` more have room beside what the image will take.
pub(super) fn has_room(bytes: u64, settings: &Settings, has_indirect: bool) -> bool {
    let image = settings.image.crop_window().pixels() * bytes_of_image(settings, has_indirect);
    memory::available().is_none_or(|available| bytes + image <= available)
}

/// Whether there is a second sample. A render that ends in time may have a single one, but not one that ends by noise,
/// which a single sample does not show.
fn has_second_sample(settings: &Settings) -> bool {
    let image = &settings.image;
    image.spp > 1 && (image.spp < Settings::UNLIMITED_SPP || image.noise.is_some())
}

/// Bytes of a pixel's sums of samples. Those of classes are left out, as in [`channels`].
fn bytes_of_sums(features: &Features, has_indirect: bool, settings: &Settings) -> u64 {
    let has = |feature| u64::from(features.has(feature));
    let components = 1 + u64::from(has_indirect);
    let aovs = [Feature::AovAlbedo, Feature::AovNormal, Feature::AovPosition].map(has).iter().sum::<u64>();
    let variance = u64::from(settings.image.aovs.contains(&Aov::Variance));
    let sums = components + aovs + variance + 3 * has(Feature::Guides);
    let image = &settings.image;
    if let Some(range) = image.piece {
        let half = half_of(image);
        let squares = components * u64::from(half.is_some());
        return (sums + squares) * max_nodes(range, half, batch_of_piece(settings)) * size_of::<Total>() as u64;
    }
    // The second snapshot is not filled by a single sample.
    let snapshots = 1 + u64::from(has_second_sample(settings));
    let of_errors = if settings.estimates_error() { components * (snapshots + has(Feature::Guides)) } else { 0 };
    (sums + of_errors) * Plane::PIXEL_BYTES
}

/// The most samples per pixel that a batch of a piece may have: one if no tile holds two samples of all pixels.
fn batch_of_piece(settings: &Settings) -> u32 {
    if settings.image.crop_window().pixels() > u64::from(TILE_POINTS / 2) { 1 } else { TILE_SAMPLES }
}

/// Bytes of a pixel's channels, and of what denoisers take.
fn bytes_of_image(settings: &Settings, has_indirect: bool) -> u64 {
    // Means from which the growth of indirect light is decided, if there is a second sample.
    let has_means = grows(settings) && has_indirect && has_second_sample(settings);
    let raw = channels(&settings.image.aovs) + CHANNEL * u64::from(has_means);
    if settings.image.piece.is_some() {
        return raw;
    }
    if settings.image.denoise != Denoise::None {
        return raw + denoisers(has_indirect, has_second_sample(settings));
    }
    // Errors are estimated before the channels are made.
    if settings.estimates_error() && has_second_sample(settings) { raw.max(ERRORS) } else { raw }
}

/// Bytes of a pixel that denoisers take. Halves of the samples are there after the second one.
pub(super) fn denoisers(has_indirect: bool, has_halves: bool) -> u64 {
    let components = 1 + u64::from(has_indirect);
    // Mean and variance of each component of the light, and of its halves.
    if has_halves { MIXTURE + 3 * 2 * COLOUR * components } else { INPUT + 2 * COLOUR * components }
}

/// Bytes of a pixel's channels: R, G, B and A, and those of AOVs.
pub(super) fn channels(aovs: &[Aov]) -> u64 {
    CHANNEL * (4 + aovs.iter().map(|aov| channels_of(*aov)).sum::<u64>())
}

/// Number of channels of an AOV. Those of `shadow` are left out: few images with them are large.
fn channels_of(aov: Aov) -> u64 {
    match aov {
        Aov::Direct | Aov::Indirect | Aov::Albedo | Aov::Normal | Aov::Position | Aov::Variance => 3,
        Aov::Depth | Aov::Samples => 1,
        Aov::Shadow => 0,
    }
}

fn remedy(settings: &Settings) -> String {
    let image = &settings.image;
    let mut remedies = vec!["a smaller `image.width` or `image.height`"];
    if !image.aovs.is_empty() {
        remedies.push("fewer `image.aovs`");
    }
    if image.denoise != Denoise::None {
        remedies.push("`image.denoise` none");
    }
    if image.piece.is_some() {
        remedies.push("fewer samples in `image.piece`");
    }
    format!("choose {}, or a part of the image with `image.crop`", remedies.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{SampleRange, Sampling};

    /// A piece of an image larger than a tile adds samples one by one. Before the last of 256 there are the sums of
    /// 128, 64, 32, 16, 8, 4, 2 and 1 samples, and that of the last one. Denoisers need squares of the light and three
    /// guides.
    #[test]
    fn pieces_count_all_sums_that_they_hold() {
        let bytes = |denoise: Denoise, [width, height]: [u32; 2], [first, end]: [u32; 2]| {
            let settings = Settings::builder().size(width, height).spp(256).build().unwrap();
            let settings = settings.with(|s| {
                s.image.denoise = denoise;
                s.image.piece = Some(SampleRange { first, end });
            });
            let features = Features::default().with(Feature::Guides, denoise != Denoise::None);
            ImageMemory::of(&features, true, &settings).film
        };
        let pixels = 4096 * 2160;
        assert_eq!(bytes(Denoise::None, [4096, 2160], [0, 256]), pixels * 9 * 2 * 32);
        assert_eq!(bytes(Denoise::None, [4096, 2160], [0, 1]), pixels * 2 * 32);
        assert_eq!(bytes(Denoise::Statistical, [4096, 2160], [0, 256]), pixels * 9 * (2 + 2 + 3) * 32);
        // Eight samples at a time: before the last batch, sums of 128, 64, 32, 16 and 8.
        assert_eq!(bytes(Denoise::None, [64, 32], [0, 256]), 64 * 32 * 6 * 2 * 32);
    }

    /// Adaptive sampling has colours of the image, of its halves, and medians, whether it ends by noise or by a budget.
    #[test]
    fn adaptive_sampling_counts_its_estimates() {
        let host = |change: &dyn Fn(&mut Settings)| {
            let settings = Settings::builder().size(100, 50).spp(4).build().unwrap().with(|s| change(s));
            ImageMemory::of(&Features::default(), false, &settings).host / 5000
        };
        let noise = |s: &mut Settings| (s.image.noise, s.image.spp) = (Some(0.01), Settings::UNLIMITED_SPP);
        assert_eq!(host(&|_| ()), 4 * 4);
        assert_eq!(host(&noise), 5 * 12 + 8 + 4);
        assert_eq!(host(&|s| s.image.sampling = Sampling::Adaptive), 5 * 12 + 8 + 4);
        // Denoisers of the halves take more.
        let denoised = |s: &mut Settings| s.image.denoise = Denoise::Statistical;
        assert_eq!(
            host(&|s| {
                noise(s);
                denoised(s);
            }),
            host(&denoised)
        );
    }
}
