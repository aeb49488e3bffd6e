//! Writing PNG, and reading PNG and Radiance HDR.

use std::path::Path;

use rayon::prelude::*;

use super::atomic::{Problem, write_atomically};
use super::image::{FINGERPRINT, Image, Metadata};
use super::tone_map::View;
use crate::input::Picture;
use crate::scene::linear_from_srgb;
use crate::settings::Settings;
use crate::{Error, Result, memory};

/// Maximum number of pixels: those of the largest image that Penumbra renders, and of the largest panorama.
const MAX_PIXELS: u64 = Settings::MAX_SIDE as u64 * Settings::MAX_SIDE as u64;

/// Bytes of a pixel while it is decoded: up to 16 as the file has it, 16 as RGBA, and 16 in the image.
const PIXEL_BYTES: u64 = 3 * 16;

impl Image {
    /// Writes the colour as an 8-bit PNG, scaled by 2^`exposure_ev` and tone-mapped by `view`: over black, without
    /// alpha, as Blender and pbrt do, or with its alpha channel if it is [`transparent`](Self::transparent).
    ///
    /// # Errors
    /// [`Error::Output`] if `R`, `G` or `B` is missing or the file cannot be written. The old file is then unchanged.
    pub fn write_png(&self, path: impl AsRef<Path>, view: View, exposure_ev: f32) -> Result<()> {
        write_atomically(path, |file| self.encode_png(file, view, exposure_ev))
    }

    /// The file that [`write_png`](Self::write_png) writes.
    ///
    /// # Errors
    /// [`Error::Output`] if `R`, `G` or `B` is missing.
    pub fn to_png(&self, view: View, exposure_ev: f32) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.encode_png(&mut bytes, view, exposure_ev).map_err(|problem| Error::output("PNG", problem))?;
        Ok(bytes)
    }

    /// [`write_png`](Self::write_png) to any writer.
    pub(crate) fn encode_png(
        &self,
        to: impl std::io::Write,
        view: View,
        exposure_ev: f32,
    ) -> std::result::Result<(), Problem> {
        let missing = |name| format!("there is no channel {name}");
        let (bytes, colour) = match self.transparent {
            true => (self.display_with_alpha(view, exposure_ev).map_err(missing)?, png::ColorType::Rgba),
            false => (self.display(view, exposure_ev).map_err(missing)?, png::ColorType::Rgb),
        };
        let mut encoder = png::Encoder::new(to, self.width, self.height);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_color(colour);
        if view != View::Raw {
            encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
        }
        if let Some(Metadata::Text(fingerprint)) = self.metadata.get(FINGERPRINT) {
            encoder.add_text_chunk(FINGERPRINT.to_owned(), fingerprint.clone())?;
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&bytes)?;
        Ok(writer.finish()?)
    }

    /// The pixels as 8-bit RGB, row by row from the top. The error is the name of a missing channel.
    pub(crate) fn display(&self, view: View, exposure_ev: f32) -> std::result::Result<Vec<u8>, &'static str> {
        let [r, g, b] = self.rgb()?;
        let gain = exposure_ev.exp2();
        let mut bytes = vec![0; self.pixels() * 3];
        bytes.par_chunks_exact_mut(3).enumerate().for_each(|(i, out)| {
            let colour = view.apply([r[i] * gain, g[i] * gain, b[i] * gain]);
            for (out, x) in out.iter_mut().zip(colour) {
                *out = (x * 255.0).round() as u8;
            }
        });
        Ok(bytes)
    }

    /// As [`display`](Self::display), as RGBA. The colour of a PNG is not multiplied by its alpha.
    fn display_with_alpha(&self, view: View, exposure_ev: f32) -> std::result::Result<Vec<u8>, &'static str> {
        let [r, g, b] = self.rgb()?;
        let alpha = self.channel("A").ok_or("A")?;
        let gain = exposure_ev.exp2();
        let pixel = |i: usize| {
            let share = alpha[i].clamp(0.0, 1.0);
            let own = if share > 0.0 { gain / share } else { 0.0 };
            let [r, g, b] = view.apply([r[i] * own, g[i] * own, b[i] * own]);
            [r, g, b, share].map(|x| (x * 255.0).round() as u8)
        };
        Ok((0..self.pixels()).into_par_iter().flat_map_iter(pixel).collect())
    }
}

/// Writes 8-bit RGB, row by row from the top, as a PNG.
///
/// # Errors
/// [`Error::Output`] if the file cannot be written. The old file is then unchanged.
pub fn write_colours(path: &Path, size: [u32; 2], colours: &[u8]) -> Result<()> {
    write_atomically(path, |file| Ok(encode_colours(file, size, colours)?))
}

/// [`write_colours`] to any writer.
///
/// # Errors
/// Those of the writer.
pub fn encode_colours(
    to: impl std::io::Write,
    [width, height]: [u32; 2],
    colours: &[u8],
) -> std::result::Result<(), png::EncodingError> {
    let mut encoder = png::Encoder::new(to, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(colours)?;
    writer.finish()
}

/// Decodes a PNG or Radiance file to the channels `R`, `G`, `B` and, if it has alpha, `A`. sRGB values become
/// scene-linear.
pub(super) fn decode(bytes: &[u8], path: &Path, format: image::ImageFormat) -> Result<Image> {
    let input = |problem: String| Error::input(path, "file", problem);
    let picture = Picture::open(bytes, format).map_err(input)?;
    let [width, height] = picture.size;
    let pixels = u64::from(width) * u64::from(height);
    if pixels > MAX_PIXELS {
        return Err(input(format!("{width} x {height} pixels: the maximum is {MAX_PIXELS} pixels")));
    }
    // A small file can have many pixels of one colour.
    if memory::available_with_swap().is_some_and(|available| pixels * PIXEL_BYTES > available) {
        return Err(input(format!("{width} x {height} pixels do not fit in memory")));
    }
    let decoded = picture.decode().map_err(input)?;
    let coded = format == image::ImageFormat::Png;
    let has_alpha = decoded.color().has_alpha();
    let pixels = decoded.into_rgba32f();

    let mut image = Image::new(pixels.width(), pixels.height());
    for (c, name) in ["R", "G", "B", "A"].into_iter().enumerate().take(if has_alpha { 4 } else { 3 }) {
        let sample = |pixel: &image::Rgba<f32>| {
            let alpha = if has_alpha { pixel[3] } else { 1.0 };
            match c {
                3 => alpha,
                _ if coded => linear_from_srgb(pixel[c]) * alpha,
                _ => pixel[c],
            }
        };
        image.add_channel(name, pixels.pixels().map(sample).collect());
    }
    Ok(image)
}
