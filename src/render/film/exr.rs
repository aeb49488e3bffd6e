//! OpenEXR files with one flat part and any channels.

use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::io::{self, BufWriter, Cursor, Read, Seek, Write};
use std::path::Path;

use ::exr::block::lines::LineRefMut;
use ::exr::image::read::image::ReadLayers;
use ::exr::image::read::layers::ReadChannels;
use ::exr::image::write::samples::{SamplesWriter, WritableSamples};
use ::exr::image::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer, read::read, write::WritableImage,
};
use ::exr::math::{RoundingMode, Vec2};
use ::exr::meta::MetaData;
use ::exr::meta::attribute::{AttributeValue, Chromaticities, IntegerBounds, LevelMode, SampleType, Text};
use ::exr::meta::header::{Header, ImageAttributes, LayerAttributes};

use super::atomic::write_atomically;
use super::image::{Channel, Image, Metadata, Window};
use crate::{Error, Result};

/// Rec.709 primaries and D65.
const REC709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

/// Length of the longest name of a channel or attribute: the limit of the format.
pub(in crate::render) const MAX_NAME_BYTES: usize = 255;

/// Attributes with a type of [`Metadata`] that describe the file, not the image.
const TECHNICAL: [&str; 5] = ["name", "chunkCount", "pixelAspectRatio", "screenWindowWidth", "dwaCompressionLevel"];

/// Attribute of an image whose PNG has an alpha channel.
const TRANSPARENT: &str = "penumbra:transparent";

impl Image {
    /// Writes all channels and metadata to a single-part scan-line EXR of f32 samples. The compression is lossless (ZIP
    /// of 16 lines), channels are sorted by name, chromaticities are those of Rec.709.
    ///
    /// # Errors
    /// [`Error::Output`] if the format cannot represent a channel or attribute, or if the file cannot be written. The
    /// old file is then unchanged.
    pub fn write_exr(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let image = self.to_exr().map_err(|problem| Error::output(path, problem))?;
        write_atomically(path, |file| {
            image.write().to_buffered(&mut *file)?;
            Ok(sort_attributes(file)?)
        })
    }

    fn to_exr(&self) -> std::result::Result<ExrImage<Layer<AnyChannels<Borrowed<'_>>>>, String> {
        if self.width == 0 || self.height == 0 || self.channels.is_empty() {
            return Err("an image without pixels or channels".into());
        }
        let mut names = HashSet::new();
        let mut channels = Vec::with_capacity(self.channels.len());
        for Channel { name, samples } in &self.channels {
            if !names.insert(name) {
                return Err(format!("two channels are called {name}"));
            }
            if samples.len() != self.pixels() {
                return Err(format!("channel {name}: {} samples for {} pixels", samples.len(), self.pixels()));
            }
            channels.push(AnyChannel::new(text(name)?, Borrowed { samples, width: self.width as usize }));
        }

        let mut attributes = LayerAttributes::default();
        for (name, value) in &self.metadata {
            match (name.as_str(), value) {
                ("worldToCamera", Metadata::Matrix(matrix)) => attributes.world_to_camera = Some(*matrix),
                ("worldToNDC", Metadata::Matrix(matrix)) => attributes.world_to_normalized_device = Some(*matrix),
                ("comments", Metadata::Text(value)) => attributes.comments = Some(value_text(value)),
                ("owner", Metadata::Text(value)) => attributes.owner = Some(value_text(value)),
                ("software", Metadata::Text(value)) => attributes.software_name = Some(value_text(value)),
                (name, value) => {
                    let value = match value {
                        Metadata::Text(value) => AttributeValue::Text(value_text(value)),
                        Metadata::Int(value) => AttributeValue::I32(*value),
                        Metadata::Float(value) => AttributeValue::F32(*value),
                        Metadata::Matrix(value) => AttributeValue::Matrix4x4(*value),
                    };
                    attributes.other.insert(text(name)?, value);
                }
            }
        }
        if self.transparent {
            attributes.other.insert(text(TRANSPARENT)?, AttributeValue::I32(1));
        }

        let size = Vec2(self.width as usize, self.height as usize);
        let [x, y] = self.crop.map_or([0; 2], |window| window.at);
        attributes.layer_position = Vec2(x as i32, y as i32);
        let channels = AnyChannels::sort(channels.into_iter().collect());
        let layer = Layer::new(size, attributes, Encoding::SMALL_LOSSLESS, channels);
        let mut shared = match self.crop {
            Some(Window { of: [width, height], .. }) => ImageAttributes::with_size((width as usize, height as usize)),
            None => ImageAttributes::with_size(size),
        };
        shared.chromaticities = Some(REC709);
        Ok(ExrImage::new(shared, layer))
    }
}

/// The samples of a channel. The crate's own samples would be copies.
#[derive(Clone, Copy)]
struct Borrowed<'a> {
    samples: &'a [f32],
    width: usize,
}

impl<'s> WritableSamples<'s> for Borrowed<'_> {
    type Writer = Self;

    fn sample_type(&self) -> SampleType {
        SampleType::F32
    }

    fn infer_level_modes(&self) -> (LevelMode, RoundingMode) {
        (LevelMode::Singular, RoundingMode::Down)
    }

    fn create_samples_writer(&'s self, _: &Header) -> Self {
        *self
    }
}

impl SamplesWriter for Borrowed<'_> {
    fn extract_line(&self, line: LineRefMut<'_>) {
        let Vec2(x, y) = line.location.position;
        let samples = &self.samples[y * self.width + x..][..line.location.sample_count];
        // The line is in memory and has this length.
        let _ = line.write_samples_from_slice(samples);
    }
}

/// Sorts the attributes of a file's header by name. The crate writes them in the order of a hash table, which differs
/// from file to file. Their lengths stay, and so do the offsets of the pixels.
fn sort_attributes(file: &mut BufWriter<File>) -> io::Result<()> {
    file.flush()?;
    let file = file.get_mut();
    // Headers are of a few kilobytes, but AOVs of many lights have many channels.
    let (mut header, mut length) = (Vec::new(), 1 << 16);
    loop {
        file.rewind()?;
        header.clear();
        Read::take(&mut *file, length).read_to_end(&mut header)?;
        if sort_header(&mut header) || (header.len() as u64) < length {
            break;
        }
        length *= 2;
    }
    file.rewind()?;
    file.write_all(&header)
}

/// [`sort_attributes`] of the first bytes of a file. Returns false, and sorts nothing, if the header is longer.
fn sort_header(bytes: &mut [u8]) -> bool {
    // The magic number and the version.
    const FIRST: usize = 8;
    let mut rest = Bytes(&bytes[FIRST..]);
    let mut attributes = Vec::new();
    let mut end = FIRST;
    loop {
        let before = rest.0.len();
        let name = match next_attribute(&mut rest) {
            Ok(Some((name, _))) => name,
            Ok(None) => break,
            Err(_) => return false,
        };
        let length = before - rest.0.len();
        attributes.push((name.to_vec(), bytes[end..end + length].to_vec()));
        end += length;
    }
    attributes.sort();
    let sorted: Vec<u8> = attributes.into_iter().flat_map(|(_, attribute)| attribute).collect();
    bytes[FIRST..end].copy_from_slice(&sorted);
    true
}

/// The metadata of [`Image::read_exr`] alone, for a file in memory: no pixels are decoded.
pub(in crate::render) fn decode_metadata(bytes: &[u8], path: &Path) -> Result<BTreeMap<String, Metadata>> {
    Ok(metadata(&header(bytes, path)?))
}

/// The checked header of a file.
fn header(bytes: &[u8], path: &Path) -> Result<Header> {
    check_header(bytes).map_err(|(location, problem)| Error::input(path, location, problem))?;
    let damaged = |problem| Error::input(path, "file", format!("damaged EXR: {problem}"));
    Ok(MetaData::read_from_buffered(bytes, false).map_err(damaged)?.headers.swap_remove(0))
}

/// The attributes that images have.
fn metadata(header: &Header) -> BTreeMap<String, Metadata> {
    let mut metadata = BTreeMap::new();
    for (name, value) in header.all_named_attributes() {
        let name = String::from_utf8_lossy(name).into_owned();
        let value = match value {
            _ if TECHNICAL.contains(&name.as_str()) => continue,
            AttributeValue::Text(value) => Metadata::Text(string(&value)),
            AttributeValue::I32(value) => Metadata::Int(value),
            AttributeValue::F32(value) => Metadata::Float(value),
            AttributeValue::Matrix4x4(value) => Metadata::Matrix(value),
            _ => continue,
        };
        metadata.insert(name, value);
    }
    metadata
}

/// [`Image::read_exr`] for a file in memory.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Image> {
    let input = |location: &str, problem: String| Error::input(path, location, problem);
    let header = header(bytes, path)?;
    let damaged = |problem: ::exr::error::Error| input("file", format!("damaged EXR: {problem}"));
    let file = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(damaged)?;

    let layer = file.layer_data;
    let mut image = Image::new(layer.size.width() as u32, layer.size.height() as u32);
    image.crop = window(&file.attributes.display_window, layer.attributes.layer_position, layer.size);
    let mut names = HashSet::new();
    for channel in layer.channel_data.list {
        let samples = match channel.sample_data {
            FlatSamples::F32(samples) => samples,
            samples => samples.values_as_f32().collect(),
        };
        let name = string(&channel.name);
        if !names.insert(name.clone()) {
            return Err(input(&name, "two channels have this name".into()));
        }
        image.channels.push(Channel { name, samples });
    }
    image.metadata = metadata(&header);
    // Another program may have dropped the alpha channel, and kept the attribute.
    let is_transparent = image.metadata.remove(TRANSPARENT) == Some(Metadata::Int(1));
    image.transparent = is_transparent && image.channel("A").is_some();
    Ok(image)
}

/// Where the pixels lie in the display window, if they are a part of it; `None` for other windows, which Penumbra does
/// not write.
fn window(display: &IntegerBounds, at: Vec2<i32>, size: Vec2<usize>) -> Option<Window> {
    let side = |at: i32, size: usize, first: i32, of: usize| {
        let at = usize::try_from(i64::from(at) - i64::from(first)).ok()?;
        (at.checked_add(size)? <= of).then_some([u32::try_from(at).ok()?, u32::try_from(of).ok()?])
    };
    let [x, width] = side(at.0, size.0, display.position.0, display.size.0)?;
    let [y, height] = side(at.1, size.1, display.position.1, display.size.1)?;
    (display.size != size).then_some(Window { at: [x, y], of: [width, height] })
}

/// The name of a channel or attribute, as UTF-8.
fn text(name: &str) -> std::result::Result<Text, String> {
    // A zero byte would end the name.
    if name.is_empty() || name.len() > MAX_NAME_BYTES || name.contains('\0') {
        return Err(format!("a channel or attribute cannot be called {name:?}"));
    }
    Ok(value_text(name))
}

/// Text as UTF-8. The crate's own conversion refuses text that is not Latin-1.
fn value_text(value: &str) -> Text {
    Text::from_slice_unchecked(value.as_bytes())
}

fn string(text: &Text) -> String {
    String::from_utf8_lossy(text.as_slice()).into_owned()
}

/// Refuses headers that the `exr` crate would believe. The crate allocates what a header claims before it reads a
/// pixel, and a failed allocation ends the process. The error is a location and a problem.
fn check_header(bytes: &[u8]) -> Checked<()> {
    let mut rest = Bytes(bytes);
    if rest.take(4) != Some(&::exr::meta::magic_number::BYTES) {
        return Err(in_file(if bytes.is_empty() { "the file is empty" } else { "this is not an OpenEXR file" }));
    }
    let flags = rest.int().ok_or_else(truncated)?;
    if flags & 0x800 != 0 {
        return Err(in_file("the file holds deep data, which is not supported"));
    }
    if flags & 0x1000 != 0 {
        return Err(in_file("the file holds several parts, which is not supported"));
    }

    let (mut pixels, mut channels) = (0u64, 0u64);
    while let Some((name, value)) = next_attribute(&mut rest)? {
        match name {
            // If there are several data windows, the crate may use any of them.
            b"dataWindow" => pixels = pixels.max(pixels_of_window(name, value)?),
            b"displayWindow" => _ = pixels_of_window(name, value)?,
            b"channels" => channels += count_channels(name, value)?,
            b"compression" => check_compression(name, value)?,
            _ => {}
        }
    }

    // Deflate is the densest coding, with at most 1032 bytes per byte. Samples of 16 bits count as 32 here, which is a
    // factor of two, and another factor of two is for safety.
    let limit = (bytes.len() as u64).saturating_mul(4096);
    let claimed = u128::from(pixels) * u128::from(channels) * 4;
    if claimed > u128::from(limit) {
        return Err(("dataWindow".into(), format!("claims {claimed} bytes of pixels in a file of {}", bytes.len())));
    }
    Ok(())
}

/// A result whose error is a location in the file and a problem.
type Checked<T> = std::result::Result<T, (String, String)>;

fn in_file(problem: &str) -> (String, String) {
    ("file".to_owned(), problem.to_owned())
}

fn truncated() -> (String, String) {
    in_file("the file ends within its header")
}

fn in_attribute(name: &[u8], problem: impl Into<String>) -> (String, String) {
    (String::from_utf8_lossy(name).into_owned(), problem.into())
}

/// The name and value of the next attribute of the header. `None` at its end.
fn next_attribute<'a>(rest: &mut Bytes<'a>) -> Checked<Option<(&'a [u8], Bytes<'a>)>> {
    let name = rest.name().ok_or_else(truncated)?;
    if name.is_empty() {
        return Ok(None);
    }
    // The crate always takes the first byte of a type as a part of it. If that is the terminating zero, the crate finds
    // other attributes from there on.
    if rest.name().ok_or_else(truncated)?.is_empty() {
        return Err(in_attribute(name, "attribute without a type"));
    }
    let size = rest.int().ok_or_else(truncated)?;
    let value = rest.take(usize::try_from(size).unwrap_or(usize::MAX)).ok_or_else(truncated)?;
    Ok(Some((name, Bytes(value))))
}

/// The number of pixels of a data or display window.
fn pixels_of_window(name: &[u8], mut value: Bytes) -> Checked<u64> {
    let bounds = value.window().ok_or_else(|| in_attribute(name, "damaged attribute"))?;
    // The crate adds positions and sizes in i32.
    let limit = i64::from(i32::MAX / 2);
    let [x, y] = [bounds[2] - bounds[0] + 1, bounds[3] - bounds[1] + 1];
    if x < 1 || y < 1 || x > limit || y > limit || bounds.iter().any(|b| b.abs() > limit) {
        return Err(in_attribute(name, format!("{x} x {y} pixels")));
    }
    Ok(x as u64 * y as u64)
}

/// The number of channels of a channel list.
fn count_channels(name: &[u8], mut value: Bytes) -> Checked<u64> {
    let damaged = || in_attribute(name, "damaged attribute");
    let mut count = 0;
    loop {
        let channel = value.name().ok_or_else(damaged)?;
        if channel.is_empty() {
            return Ok(count);
        }
        // The type of the samples, a flag, and three reserved bytes.
        value.take(8).ok_or_else(damaged)?;
        if [value.int(), value.int()] != [Some(1), Some(1)] {
            return Err(in_attribute(channel, "subsampled channel"));
        }
        count += 1;
    }
}

/// Refuses DWA, because the crate's decoder allocates what a damaged block claims.
fn check_compression(name: &[u8], mut value: Bytes) -> Checked<()> {
    match value.take(1) {
        Some([8 | 9]) => Err(in_attribute(name, "DWAA and DWAB are not supported; save it with ZIP")),
        _ => Ok(()),
    }
}

/// The bytes that are left to read.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn int(&mut self) -> Option<i32> {
        self.take(4).and_then(|bytes| bytes.try_into().ok()).map(i32::from_le_bytes)
    }

    /// Takes the bytes up to a zero byte, and the zero byte.
    fn name(&mut self) -> Option<&'a [u8]> {
        let length = self.0.iter().position(|&byte| byte == 0)?;
        let name = self.take(length);
        self.take(1);
        name
    }

    fn window(&mut self) -> Option<[i64; 4]> {
        let mut next = || self.int().map(i64::from);
        Some([next()?, next()?, next()?, next()?])
    }
}
