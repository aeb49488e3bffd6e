//! Reading untrusted files.
//!
//! A file is read whole or not at all. Its headers are believed only as far as its length allows: the memory that a
//! file may cost is bounded by its *honest size*, which is its own bytes and what its coding can expand them to.

use std::fs::{self, File};
use std::io::{Cursor, Read};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

/// Maximum size of a file of a scene. A larger scene does not fit in memory, and the .glb format itself ends at 4 GiB.
pub(crate) const MAX_FILE_BYTES: u64 = 1 << 32;

/// The bytes of a file of a scene; see [`read_up_to`].
pub(crate) fn read_file(path: &Path) -> std::result::Result<Vec<u8>, String> {
    read_up_to(path, MAX_FILE_BYTES)
}

/// The bytes of a regular file of at most `max_bytes`. Pipes and devices are refused because they could block or never
/// end.
pub(crate) fn read_up_to(path: &Path, max_bytes: u64) -> std::result::Result<Vec<u8>, String> {
    let metadata = fs::metadata(path).map_err(|e| e.to_string())?;
    if metadata.is_dir() {
        return Err("it is a folder".into());
    }
    if !metadata.is_file() {
        return Err("it is not a regular file".into());
    }
    if metadata.len() > max_bytes {
        return Err(format!("it has {} bytes, and the maximum is {max_bytes}", metadata.len()));
    }
    let mut bytes = Vec::new();
    let reserved = usize::try_from(metadata.len()).ok().and_then(|length| bytes.try_reserve_exact(length).ok());
    if reserved.is_none() {
        return Err(format!("its {} bytes do not fit in memory", metadata.len()));
    }
    File::open(path).and_then(|file| file.take(max_bytes).read_to_end(&mut bytes)).map_err(|e| e.to_string())?;
    Ok(bytes)
}

/// Maximum length in bytes of a text from a file that is repeated to the user: enough to recognise it, in a few lines
/// of a terminal.
const MAX_PRINTABLE: usize = 512;

/// Text from a file, made safe for one line of a terminal: control characters are replaced, and the text is cut to
/// [`MAX_PRINTABLE`] bytes.
pub(crate) fn printable(text: &str) -> String {
    let end = text.floor_char_boundary(MAX_PRINTABLE);
    let mut line: String = text[..end].chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    if end < text.len() {
        line.push('…');
    }
    line
}

/// A PNG, JPEG, WebP or Radiance file whose header has been read and is plausible for the length of the file.
pub(crate) struct Picture<'a> {
    decoder: Box<dyn ImageDecoder + 'a>,
    /// Width and height, both at least 1.
    pub size: [u32; 2],
}

impl<'a> Picture<'a> {
    /// Reads the header. Refuses it if it claims more texels than a file of this length can hold.
    pub fn open(bytes: &'a [u8], format: ImageFormat) -> std::result::Result<Self, String> {
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        let mut limits = Limits::no_limits();
        // Beside the pixels the PNG reader holds a few rows (4 MiB is a row of half a million texels of 64 bits) and
        // colour profiles, which may be compressed.
        limits.max_alloc = Some(4 * bytes.len() as u64 + (4 << 20));
        reader.limits(limits);
        let decoder = reader.into_decoder().map_err(|e| e.to_string())?;
        let (width, height) = decoder.dimensions();
        let texels = u64::from(width) * u64::from(height);
        // Maximum number of texels that one byte can encode.
        let densest = match format {
            // A block of 64 values takes at least one bit. It covers 128 texels where each component is subsampled
            // along another axis.
            ImageFormat::Jpeg => 8 * 64 * 2,
            // Deflate expands a byte to at most 1032.
            ImageFormat::Png => 1032 * 8 / png_texel_bits(bytes)?,
            ImageFormat::WebP => webp_densest(bytes, [width, height])?,
            // Radiance's old run-length form has runs of 255 texels in four bytes. Repeated run markers could encode
            // more, but no known program writes them.
            _ => 64,
        };
        if texels == 0 || texels > densest * bytes.len() as u64 {
            return Err(format!("it claims {width} x {height} texels in {} bytes", bytes.len()));
        }
        Ok(Picture { decoder: Box::new(decoder), size: [width, height] })
    }

    /// Decodes the pixels.
    pub fn decode(self) -> std::result::Result<DynamicImage, String> {
        DynamicImage::from_decoder(self.decoder).map_err(|e| e.to_string())
    }
}

/// Texels that every WebP may have: 2048 x 2048. A lossless one of a single colour needs no bit for any of them.
const WEBP_FREE: u64 = 1 << 22;
/// Texels per byte of a longer file. libwebp writes 16383 x 16383 texels of one colour as 10308 bytes: 26038 in each.
const WEBP_DENSEST: u64 = 1 << 15;

/// Maximum number of texels that one byte of the WebP can encode. Refuses animations, and images whose frame does not
/// have the `size` of the header: the `image` crate allocates memory for the frame before it compares the two.
fn webp_densest(bytes: &[u8], size: [u32; 2]) -> std::result::Result<u64, String> {
    let mut rest = bytes.get(12..).unwrap_or(&[]);
    while let Some((head, tail)) = rest.split_first_chunk::<8>() {
        let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        let bits = |at: usize| tail.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let frame = match &head[..4] {
            b"ANMF" | b"ANIM" => return Err("it is an animation, which a texture cannot be".into()),
            // The size follows a tag of three bytes and a signature of three. Upper bits are scales for display.
            b"VP8 " => bits(6).map(|bits| [bits & 0x3fff, bits >> 16 & 0x3fff]),
            // After a signature of one byte.
            b"VP8L" => bits(1).map(|bits| [bits & 0x3fff, bits >> 14 & 0x3fff].map(|less| less + 1)),
            _ => Some(size),
        };
        if frame != Some(size) {
            return Err("it is damaged: header and frame differ in size".into());
        }
        rest = tail.get(length.saturating_add(length % 2)..).unwrap_or(&[]);
    }
    Ok(WEBP_DENSEST.max(WEBP_FREE / bytes.len() as u64))
}

/// Bits per texel as stored in the PNG. The `image` crate only reports the format after expansion.
fn png_texel_bits(bytes: &[u8]) -> std::result::Result<u64, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    Ok(decoder.read_header_info().map_err(|e| e.to_string())?.bits_per_pixel() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checkpoints of large images exceed 4 GiB, which is the limit of scenes: each caller has its own.
    #[test]
    fn files_are_read_up_to_the_callers_limit() -> std::io::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("file");
        fs::write(&path, [7; 100])?;
        assert_eq!(read_up_to(&path, 100), Ok(vec![7; 100]));
        assert_eq!(read_up_to(&path, 99), Err("it has 100 bytes, and the maximum is 99".to_owned()));
        Ok(())
    }
}
