//! The memory of the machine that a render takes. Without enough of it the system would end the process without a
//! word.

use glam::DVec4;
use kernel_kit::Gpu;

use super::denoise::Colour;
use super::tiles::TileFilm;
use crate::passes::film::{Plane, Sum};
use crate::settings::stages::grows;
use crate::settings::{Aov, Denoise, Settings};
use crate::{Error, Result, memory};

/// Bytes of a sample of a channel, and of a colour that denoisers take.
const CHANNEL: u64 = size_of::<f32>() as u64;
const COLOUR: u64 = size_of::<Colour>() as u64;

/// Bytes of a pixel while the input of denoisers is made, without what each part of the light has: the means of three
/// guides in both precisions, the sums of one part of the light, and the coverage.
const INPUT: u64 = 3 * (size_of::<DVec4>() as u64 + COLOUR) + size_of::<Sum>() as u64 + size_of::<f64>() as u64;

/// Refuses an image that has no room in the memory that is available. `row` is a row of its film, on `gpu`.
///
/// What counts is the minimum, so that no render is refused that would succeed: sums of samples where they are in
/// the machine's memory, and what the image and its denoisers take at the end. Renders of `scenes/box.glb` with `path`
/// and 2,048 x 2,048 pixels on lavapipe had peaks of 145 bytes per pixel, or 586 with a denoiser and a single sample,
/// apart from what small images take. Less the copy of the state, which is made only where it has room, these are 81
/// and 426. Here they count as 80 and 404.
///
/// # Errors
/// [`Error::Memory`].
pub(super) fn check(gpu: &Gpu, row: &TileFilm, settings: &Settings) -> Result<()> {
    let part = settings.image.part();
    let pixels = u64::from(part.width) * u64::from(part.height);
    let sums = u64::from(part.height) * bytes_of_sums(gpu, row, settings);
    let needed = sums + pixels * bytes_of_image(settings, row.indirect.is_some());
    match memory::available_with_swap() {
        Some(available) if needed > available => {
            Err(Error::Memory { size: [part.width, part.height], needed, available, remedy: remedy(settings) })
        }
        _ => Ok(()),
    }
}

/// Whether `bytes` more have room beside what the image will take.
pub(super) fn has_room(bytes: u64, settings: &Settings, has_indirect: bool) -> bool {
    let part = settings.image.part();
    let image = u64::from(part.width) * u64::from(part.height) * bytes_of_image(settings, has_indirect);
    memory::available().is_none_or(|available| bytes + image <= available)
}

/// Bytes of a row's sums in the machine's memory. That is where software devices have their buffers, and all devices
/// the sums of a piece.
fn bytes_of_sums(gpu: &Gpu, row: &TileFilm, settings: &Settings) -> u64 {
    if settings.image.piece.is_none() && !gpu.info.is_software() {
        return 0;
    }
    // The second is not filled by a single sample, which a render that is to end in time may have.
    let snapshots = row.parts.iter().map(|part| &part.snapshots[0]);
    row.sample_planes().chain(snapshots).map(Plane::bytes).sum()
}

/// Bytes of a pixel's channels, and of what denoisers take.
fn bytes_of_image(settings: &Settings, has_indirect: bool) -> u64 {
    let channels: u64 = settings.image.aovs.iter().map(|aov| channels_of(*aov)).sum();
    // R, G, B and A; and means from which the growth of indirect light is decided, if there is a second sample.
    let has_means = grows(settings) && has_indirect && (2..Settings::UNLIMITED_SPP).contains(&settings.image.spp);
    let raw = CHANNEL * (4 + channels + u64::from(has_means));
    if settings.image.denoise == Denoise::None || settings.image.piece.is_some() {
        return raw;
    }
    // Mean and variance of each part of the light. Halves of the samples are not there after a single one.
    raw + INPUT + 2 * COLOUR * (1 + u64::from(has_indirect))
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
    format!("choose {}, or a part of the image with `image.crop`", remedies.join(", "))
}
