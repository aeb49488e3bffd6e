//! Files that may be anything: read whole or not at all, and believed only as far as their length bears them out.
//!
//! What a file may cost is bounded by its *honest size*: its own bytes, and what its coding can expand them to.

use std::fs::{self, File};
use std::io::{Cursor, Read};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

/// Refused above this: no file that a renderer can hold in memory is larger, and .glb itself ends at 4 GiB.
pub(crate) const MAX_FILE_BYTES: u64 = 1 << 32;

/// The bytes of a regular file: a pipe or a device could block or never end.
pub(crate) fn read_file(path: &Path) -> std::result::Result<Vec<u8>, String> {
    let metadata = fs::metadata(path).map_err(|e| e.to_string())?;
    if metadata.is_dir() {
        return Err("is a folder".into());
    }
    if !metadata.is_file() {
        return Err("is not a regular file".into());
    }
    if metadata.len() > MAX_FILE_BYTES {
        return Err(format!("has {} bytes, at most {MAX_FILE_BYTES} are read", metadata.len()));
    }
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    File::open(path).and_then(|file| file.take(MAX_FILE_BYTES).read_to_end(&mut bytes)).map_err(|e| e.to_string())?;
    Ok(bytes)
}

/// Most bytes of a file's own words that are repeated: names in files mean something to people well below this.
const MAX_WORDS: usize = 512;

/// Words of a file, fit to be shown on one line of a terminal: without control characters, and no longer than a line
/// that anybody reads.
pub(crate) fn printable(text: &str) -> String {
    let end = text.floor_char_boundary(MAX_WORDS);
    let mut line: String = text[..end].chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    if end < text.len() {
        line.push('…');
    }
    line
}

/// A PNG, JPEG or Radiance file whose header has been read and can be true.
pub(crate) struct Picture<'a> {
    decoder: Box<dyn ImageDecoder + 'a>,
    /// Width and height, both at least 1.
    pub size: [u32; 2],
}

impl<'a> Picture<'a> {
    /// Reads the header; refuses one that claims more than a file of this length can hold.
    pub fn open(bytes: &'a [u8], format: ImageFormat) -> std::result::Result<Self, String> {
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        let mut limits = Limits::no_limits();
        // What the PNG reader holds beside the pixels: a few rows, here of half a million texels of 64 bits, and chunks
        // for colour profiles, which may be packed.
        limits.max_alloc = Some(4 * bytes.len() as u64 + (4 << 20));
        reader.limits(limits);
        let decoder = reader.into_decoder().map_err(|e| e.to_string())?;
        let (width, height) = decoder.dimensions();
        let texels = u64::from(width) * u64::from(height);
        // Texels that a byte stands for at most.
        let densest = match format {
            // A block of 64 takes a bit at least; components of which each is reduced along another axis take half as many.
            ImageFormat::Jpeg => 8 * 64 * 2,
            // Deflate expands a byte to 1032 at most.
            ImageFormat::Png => 1032 * 8 / png_texel_bits(bytes)?,
            // Radiance's old form has runs of 255 texels in four bytes. What repeats these could go beyond; its programs do not.
            _ => 64,
        };
        if texels == 0 || texels > densest * bytes.len() as u64 {
            return Err(format!("claims {width} x {height} texels in {} bytes", bytes.len()));
        }
        Ok(Picture { decoder: Box::new(decoder), size: [width, height] })
    }

    /// Bytes of its pixels before they are converted to anything.
    pub fn decoded_bytes(&self) -> u64 {
        self.decoder.total_bytes()
    }

    /// Its pixels.
    pub fn decode(self) -> std::result::Result<DynamicImage, String> {
        DynamicImage::from_decoder(self.decoder).map_err(|e| e.to_string())
    }
}

/// Bits of a texel of a PNG, of which a decoder of pictures tells only what it expands them to.
fn png_texel_bits(bytes: &[u8]) -> std::result::Result<u64, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    Ok(decoder.read_header_info().map_err(|e| e.to_string())?.bits_per_pixel() as u64)
}
