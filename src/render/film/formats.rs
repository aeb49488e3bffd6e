//! Reading and writing images by the extension of their path.

use std::path::Path;

use super::atomic::check_target;
use super::image::Image;
use super::tone_map::View;
use super::{exr, png};
use crate::{Error, Result};

impl Image {
    /// Reads an image by its extension: `.exr`, or `.png` and `.hdr` (decoded to scene-linear Rec.709).
    ///
    /// # Errors
    /// [`Error::Input`] where the file is missing, damaged, or none of these.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let decode = decoder(path)?;
        decode(&read_file(path)?, path)
    }

    /// Reads all channels of a flat single-part EXR, scan-line or tiled (the largest level), as f32, and its text,
    /// int, float and 4 x 4 attributes. The image is the data window.
    ///
    /// # Errors
    /// [`Error::Input`] where the file is missing, damaged, deep, of several parts, subsampled or compressed by DWA, or
    /// where its header claims more than a file of its length can hold.
    pub fn read_exr(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        exr::decode(&read_file(path)?, path)
    }

    /// As [`read`](Self::read), of a file that is in memory: `path` has the extension, and names it in errors.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn from_bytes(bytes: &[u8], path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        decoder(path)?(bytes, path)
    }

    /// Writes the image by the extension of `path`: all of it to `.exr`, a view of its colour to `.png`.
    ///
    /// # Errors
    /// As [`write_exr`](Self::write_exr), [`write_png`](Self::write_png) and [`check_writable`].
    pub fn write(&self, path: impl AsRef<Path>, view: View, exposure_ev: f32) -> Result<()> {
        let path = path.as_ref();
        match Format::of(path)? {
            Format::Exr => self.write_exr(path),
            Format::Png => self.write_png(path, view, exposure_ev),
        }
    }
}

/// Says early, before anything is rendered, whether an image can be written to `path`. An existing file is not touched.
///
/// # Errors
/// [`Error::Usage`] where the extension is neither `.exr` nor `.png`, [`Error::Output`] as [`check_target`].
pub fn check_writable(path: impl AsRef<Path>) -> Result<()> {
    Format::of(path.as_ref())?;
    check_target(path)
}

/// The formats that are written.
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

/// Reads the bytes of an image; the path names it in errors.
type Decoder = fn(&[u8], &Path) -> Result<Image>;

/// What reads images of that extension.
fn decoder(path: &Path) -> Result<Decoder> {
    match extension(path).as_str() {
        "exr" => Ok(exr::decode),
        "png" => Ok(|bytes, path| png::decode(bytes, path, image::ImageFormat::Png)),
        "hdr" => Ok(|bytes, path| png::decode(bytes, path, image::ImageFormat::Hdr)),
        _ => Err(Error::input(path, "file", "not an image that can be read: .exr, .png or .hdr is needed")),
    }
}

/// The bytes of a regular file.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>> {
    crate::input::read_file(path).map_err(|problem| Error::input(path, "file", problem))
}
