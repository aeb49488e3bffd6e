//! Images: named channels of scene-linear f32, written to EXR and tone-mapped to PNG.
//!
//! The colour of an image is its root channels `R`, `G` and `B` (Rec.709 primaries, scene-linear), with `A` where it
//! has alpha (colour is then premultiplied, as OpenEXR has it). Everything else is a channel of its own name. An EXR
//! keeps all of it, bit for bit; a PNG is one [`View`] of the colour. Files are replaced whole or not at all.

mod atomic;
mod camera;
mod exr;
mod png;
mod tone_map;

use std::path::Path;

use crate::{Error, Result};

pub use atomic::{abandon_writes, check_target, write_atomically};
pub use tone_map::View;

/// An image: channels of one size, rows top to bottom.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Channels by their EXR names: `R`, `G`, `B`, `A`, `direct.R`, `N.X`, `Z`, `shadow.lamp.class`.
    pub channels: Vec<Channel>,
    /// EXR attributes (camera, counts, seed, technique, device, version), in order of name.
    pub metadata: std::collections::BTreeMap<String, Metadata>,
}

/// A channel of an [`Image`].
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// EXR name.
    pub name: String,
    /// `width * height` samples.
    pub samples: Vec<f32>,
}

/// A value of an EXR attribute.
#[derive(Clone, Debug, PartialEq)]
pub enum Metadata {
    /// Text.
    Text(String),
    /// A whole number.
    Int(i32),
    /// A number.
    Float(f32),
    /// A 4 x 4 matrix, row-major, applied to row vectors as OpenEXR does.
    Matrix([f32; 16]),
}

impl Image {
    /// An image of that size without channels.
    pub fn new(width: u32, height: u32) -> Self {
        Image { width, height, ..Default::default() }
    }

    /// Pixels: `width * height`.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The samples of the channel of that name, row by row from the top.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|channel| channel.name == name).map(|channel| channel.samples.as_slice())
    }

    /// The root channels `R`, `G` and `B`; the name of the first that is missing as the error.
    pub fn rgb(&self) -> std::result::Result<[&[f32]; 3], &'static str> {
        let find = |name| self.channel(name).ok_or(name);
        Ok([find("R")?, find("G")?, find("B")?])
    }

    /// Adds a channel of `width * height` samples, or replaces the one of that name.
    ///
    /// # Panics
    /// If the number of samples is not that of the pixels: a defect of the caller, never of a file.
    pub fn add_channel(&mut self, name: impl Into<String>, samples: Vec<f32>) {
        let name = name.into();
        assert_eq!(samples.len(), self.pixels(), "channel {name} does not fit the image");
        match self.channels.iter_mut().find(|channel| channel.name == name) {
            Some(channel) => channel.samples = samples,
            None => self.channels.push(Channel { name, samples }),
        }
    }

    /// Reads an image by its extension: `.exr`, or `.png` and `.hdr` (decoded to scene-linear Rec.709).
    ///
    /// # Errors
    /// [`Error::Input`] where the file is missing, damaged, or none of these.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let decode = decoder(path)?;
        decode(&read_file(path)?, path)
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
