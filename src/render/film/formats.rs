//! Reading and writing images. The extension of the path selects the format.

use std::path::Path;

use super::atomic::check_target;
use super::image::Image;
use super::tone_map::View;
use super::{exr, png};
use crate::{Error, Result};

impl Image {
    /// Reads an `.exr`, `.png` or `.hdr` file. PNG and Radiance HDR are decoded to scene-linear Rec.709.
    ///
    /// # Errors
    /// [`Error::Input`] if the file is missing, damaged or in another format.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let decode = decoder(path)?;
        decode(&read_file(path)?, path)
    }

    /// Reads a flat single-part EXR, scan-line or tiled (the largest level): all channels as f32, and its attributes of
    /// the types text, int, float and 4 x 4 matrix. The image is the data window.
    ///
    /// # Errors
    /// [`Error::Input`] if the file is missing, damaged, deep, multi-part, subsampled or compressed with DWA, or if its
    /// header claims more pixels than a file of its length can hold.
    pub fn read_exr(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        exr::decode(&read_file(path)?, path)
    }

    /// [`read`](Self::read) for a file in memory. `path` supplies the extension, and names the file in errors.
    ///
    /// # Errors
    /// The same as [`read`](Self::read).
    pub fn from_bytes(bytes: &[u8], path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        decoder(path)?(bytes, path)
    }

    /// Writes the image: all channels to an `.exr`, or a view of its colour to a `.png`. `exposure_ev` scales the
    /// colour of the view by 2^`exposure_ev`.
    ///
    /// # Errors
    /// Those of [`write_exr`](Self::write_exr), [`write_png`](Self::write_png) and [`check_writable`].
    pub fn write(&self, path: impl AsRef<Path>, view: View, exposure_ev: f32) -> Result<()> {
        let path = path.as_ref();
        match Format::of(path)? {
            Format::Exr => self.write_exr(path),
            Format::Png => self.write_png(path, view, exposure_ev),
        }
    }

    /// As [`write`](Self::write), but a `.png` has the [`shown`](Self::shown) image.
    ///
    /// # Errors
    /// Those of [`write`](Self::write).
    pub fn write_shown(&self, path: impl AsRef<Path>, view: View, exposure_ev: f32) -> Result<()> {
        let path = path.as_ref();
        if is_exr(path) { self.write(path, view, exposure_ev) } else { self.shown().write(path, view, exposure_ev) }
    }
}

/// Whether a path has the extension of OpenEXR.
pub fn is_exr(path: &Path) -> bool {
    extension(path) == "exr"
}

/// Checks that an image can be written to `path`, so that a render does not fail at its end. An existing file is not
/// touched.
///
/// # Errors
/// [`Error::Usage`] if the extension is neither `.exr` nor `.png`, and those of [`check_target`].
pub fn check_writable(path: impl AsRef<Path>) -> Result<()> {
    Format::of(path.as_ref())?;
    check_target(path)
}

/// Output formats.
enum Format {
    Exr,
    Png,
}

impl Format {
    fn of(path: &Path) -> Result<Self> {
        match extension(path).as_str() {
            "exr" => Ok(Format::Exr),
            "png" => Ok(Format::Png),
            _ => Err(Error::Usage(format!("{}: an image is written as .exr or .png", path.display()))),
        }
    }
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// A function that decodes the bytes of an image. The path names the file in errors.
type Decoder = fn(&[u8], &Path) -> Result<Image>;

/// The decoder for the extension of `path`.
fn decoder(path: &Path) -> Result<Decoder> {
    match extension(path).as_str() {
        "exr" => Ok(exr::decode),
        "png" => Ok(|bytes, path| png::decode(bytes, path, image::ImageFormat::Png)),
        "hdr" => Ok(|bytes, path| png::decode(bytes, path, image::ImageFormat::Hdr)),
        _ => Err(Error::input(path, "file", "not a readable image format: must be .exr, .png or .hdr")),
    }
}

/// Maximum size in bytes of a file that Penumbra writes: 4 KiB for each of 2^28 pixels, the largest image. A checkpoint
/// of a denoised image has 352 bytes for a pixel, a piece up to 200 for each level of its tree of samples.
const MAX_BYTES: u64 = 1 << 40;

/// The bytes of a regular file: of an image, a piece or a checkpoint.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>> {
    crate::input::read_up_to(path, MAX_BYTES).map_err(|problem| Error::input(path, "file", problem))
}
