//! Images of the file: checked, then decoded in parallel.

use std::collections::HashMap;

use image::ImageFormat;
use rayon::prelude::*;

use super::accessor::Views;
use super::container::{Bytes, Resources};
use super::json::Json;
use super::ktx2::{self, Ktx2};
use super::mip;
use super::notes::Notes;
use super::texture::{ColourSpace, Filter, TextureImage, Wrap};
use crate::input::{MAX_FILE_BYTES, Picture, printable};
use crate::{Error, Result};

/// Maximum side of an image in texels, the common texture limit of graphics devices.
const MAX_SIDE: u32 = 16384;
/// Maximum number of texels of all images together: 1 GiB of RGBA8. If there are more, the largest images are reduced.
const MAX_TEXELS: u64 = 1 << 28;
/// Maximum number of texels of all images before they are reduced. A PNG file of one bit a texel with as many, 1.5 MB,
/// took 42 s on two cores.
const MAX_DECODED_TEXELS: u64 = 1 << 31;

/// A format that can be decoded.
#[derive(Clone, Copy, PartialEq)]
enum Format {
    Picture(ImageFormat),
    Ktx2,
}

impl Format {
    const PNG: Format = Format::Picture(ImageFormat::Png);
    const JPEG: Format = Format::Picture(ImageFormat::Jpeg);
    const WEBP: Format = Format::Picture(ImageFormat::WebP);

    /// The format whose signature the first bytes are.
    fn of(bytes: &[u8]) -> Option<Format> {
        if bytes.starts_with(ktx2::MAGIC) {
            return Some(Format::Ktx2);
        }
        let format = image::guess_format(bytes).ok().map(Format::Picture);
        format.filter(|format| [Format::PNG, Format::JPEG, Format::WEBP].contains(format))
    }

    /// The size in the header, if it is plausible.
    fn size(self, bytes: &[u8]) -> std::result::Result<[u32; 2], String> {
        match self {
            Format::Picture(format) => Ok(Picture::open(bytes, format)?.size),
            Format::Ktx2 => Ok(Ktx2::open(bytes)?.size),
        }
    }

    fn decode(self, bytes: &[u8]) -> std::result::Result<Vec<[u8; 4]>, String> {
        match self {
            Format::Picture(format) => {
                let image = Picture::open(bytes, format)?.decode()?;
                let bytes = image.into_rgba8().into_raw();
                // Without a copy, as a large image takes a gigabyte. Spare room that is no whole texel prevents that.
                Ok(bytemuck::try_cast_vec(bytes).unwrap_or_else(|(_, bytes)| bytes.as_chunks().0.to_vec()))
            }
            Format::Ktx2 => Ktx2::open(bytes)?.decode(),
        }
    }
}

/// The content of an image's bytes.
#[derive(Clone, Copy)]
enum Content {
    /// A format that can be decoded, and the size.
    Known(Format, [u32; 2]),
    /// Another format, which is legal if only an extension uses it.
    Unknown,
    /// Missing or damaged, which a lenient import accepts.
    Broken,
}

/// An image of the file, checked but not yet decoded.
pub(super) struct Encoded<'a> {
    json: Json<'a>,
    name: String,
    bytes: Bytes<'a>,
    content: Content,
    /// Index of the first image with the same bytes, possibly its own.
    pub first: usize,
}

/// The form in which textures use an image.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Form {
    /// The texels as they are stored.
    Stored,
    /// Roughness in G: 1 minus the glossiness in A times a factor, whose bits these are.
    Roughness(u32),
}

impl Form {
    /// The roughness that belongs to a glossiness with `factor`.
    pub fn roughness(factor: f32) -> Form {
        Form::Roughness(factor.to_bits())
    }

    fn apply(self, texels: &mut [[u8; 4]]) {
        let Form::Roughness(bits) = self else { return };
        let factor = f32::from_bits(bits);
        for texel in texels {
            *texel = [255, 255 - (f32::from(texel[3]) * factor).round() as u8, 255, 255];
        }
    }
}

/// An image as textures show it.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Use {
    /// Index of the image in the file.
    pub image: usize,
    /// The form of the texels.
    pub form: Form,
}

/// Where a texture may name its image, and the formats that it may have there. Later entries are preferred to earlier
/// ones.
const SOURCES: [(Option<&str>, &[Format], &str); 3] = [
    (None, &[Format::PNG, Format::JPEG], "neither PNG nor JPEG"),
    (Some(BASIS), &[Format::Ktx2], "not KTX2"),
    (Some(WEBP), &[Format::WEBP], "not WebP"),
];

/// The extension for images that are KTX2.
pub(super) const BASIS: &str = "KHR_texture_basisu";

/// The extension for images that are WebP.
pub(super) const WEBP: &str = "EXT_texture_webp";

/// The image of a texture, if it has any. An image that an extension names is preferred, because it is a better form of
/// the same image.
pub(super) fn source(texture: &Json, images: &[Encoded]) -> Result<Option<usize>> {
    let mut shown = None;
    for (extension, formats, problem) in SOURCES {
        let owner = extension.map_or(Ok(Some(texture.clone())), |name| texture.extension(name))?;
        let Some(source) = owner.map_or(Ok(None), |owner| owner.get("source"))? else { continue };
        let image = source.index(images.len(), "image")?;
        // Of equal images only the first is decoded, and found to be damaged.
        match images[images[image].first].content {
            Content::Known(format, _) if formats.contains(&format) => {}
            // Its other form will do.
            Content::Broken if shown.is_some() => continue,
            Content::Broken => {}
            _ => return Err(source.error(format!("image {image} is {problem}"))),
        }
        shown = Some(image);
    }
    Ok(shown)
}

impl Encoded<'_> {
    /// Whether it is missing or damaged, and a lenient import leaves it out.
    pub fn is_broken(&self) -> bool {
        matches!(self.content, Content::Broken)
    }

    /// Its size in texels, where it can be decoded.
    pub fn size(&self) -> Option<[u32; 2]> {
        match self.content {
            Content::Known(_, size) => Some(size),
            _ => None,
        }
    }

    /// Adds to the error of an image what the user can do.
    pub fn with_remedy(error: Error) -> Error {
        match error {
            Error::Input { file, location, problem } => {
                let problem = format!("{problem}; `lenient` import leaves the image out");
                Error::Input { file, location, problem }
            }
            other => other,
        }
    }

    /// Leaves the image out from now on, because of `error`.
    pub fn leave_out(&mut self, error: &Error, notes: &mut Notes) {
        let problem = match error {
            Error::Input { problem, .. } => problem.clone(),
            other => other.to_string(),
        };
        notes.push(format!(
            "image \"{}\" is left out, and so are the textures that have no other image: {problem}",
            self.name
        ));
        self.content = Content::Broken;
    }

    fn decode(&self, form: Form) -> Result<TextureImage> {
        let Content::Known(format, [width, height]) = self.content else {
            return Err(self.json.error("cannot be decoded"));
        };
        let mut texels = format.decode(&self.bytes).map_err(|e| self.json.error(e))?;
        form.apply(&mut texels);
        Ok(TextureImage { name: self.name.clone(), width, height, texels })
    }
}

/// Resolves every image and reads its header. A lenient import leaves out those that are missing or damaged.
pub(super) fn read_images<'a>(
    root: &Json<'a>,
    views: &Views<'a>,
    resources: &mut Resources,
    lenient: bool,
    notes: &mut Notes,
) -> Result<Vec<Encoded<'a>>> {
    let mut images: Vec<Encoded<'a>> = Vec::new();
    let mut known = HashMap::new();
    let mut total = 0;
    for (i, json) in root.list("images")?.into_iter().enumerate() {
        let uri = json.get("uri")?;
        let bytes = match (&uri, json.get("bufferView")?) {
            (Some(uri), None) => resources.resolve(uri),
            (None, Some(view)) => views.bytes(&view).map(Bytes::Borrowed),
            _ => return Err(json.error("needs either a uri or a buffer view")),
        };
        let file_name = uri.map(|uri| uri.string()).transpose()?.filter(|uri| !uri.starts_with("data:"));
        let name = json.name()?.or(file_name.map(printable)).unwrap_or_else(|| format!("image {i}"));
        let bytes = match bytes {
            Err(error) if lenient => {
                let nothing = Bytes::Borrowed(&[]);
                images.push(Encoded { json, name, bytes: nothing, content: Content::Broken, first: i });
                images[i].leave_out(&error, notes);
                continue;
            }
            bytes => bytes.map_err(Encoded::with_remedy)?,
        };
        let first = *known.entry((bytes.as_ptr(), bytes.len())).or_insert(i);
        let content = if first < i {
            Ok(images[first].content)
        } else {
            total += bytes.len() as u64;
            if total > MAX_FILE_BYTES {
                return Err(
                    json.error(format!("the images have more than {MAX_FILE_BYTES} bytes in total, or overlap"))
                );
            }
            match Format::of(&bytes) {
                Some(format) => format.size(&bytes).map(|size| Content::Known(format, size)).map_err(|e| json.error(e)),
                None if lenient => Err(json.error("neither PNG nor JPEG nor WebP nor KTX2")),
                None => Ok(Content::Unknown),
            }
        };
        let (content, error) = match content {
            Ok(content) => (content, None),
            Err(error) if lenient => (Content::Broken, Some(error)),
            Err(error) => return Err(Encoded::with_remedy(error)),
        };
        images.push(Encoded { json, name, bytes, content, first });
        if let Some(error) = error {
            images[i].leave_out(&error, notes);
        }
    }
    Ok(images)
}

/// Decodes the images that are `used` in parallel. The inner errors are those of single images.
pub(super) fn decode(images: &[Encoded], used: &[Use]) -> Result<Vec<Result<TextureImage>>> {
    check_texels(images, used.iter(), MAX_TEXELS)?;
    Ok(used.par_iter().map(|shown| images[shown.image].decode(shown.form)).collect())
}

/// Like [`decode`], for images of textures: if they have too many texels together, the largest are reduced, in their
/// colour spaces.
pub(super) fn decode_textures(
    images: &[Encoded],
    used: &[(Use, ColourSpace)],
    notes: &mut Notes,
) -> Result<Vec<Result<TextureImage>>> {
    let total = check_texels(images, used.iter().map(|(shown, _)| shown), MAX_DECODED_TEXELS)?;
    let sizes: Vec<_> = used.iter().map(|(shown, _)| images[shown.image].size().unwrap_or([1, 1])).collect();
    let levels = mip::levels(&sizes, MAX_TEXELS);
    let decode = |((shown, space), level): (&(Use, ColourSpace), &u32)| {
        images[shown.image].decode(shown.form).map(|image| image.at_level(*level, *space))
    };
    let decoded: Vec<Result<_>> = used.par_iter().zip(&levels).map(decode).collect();
    let reduced = levels.iter().filter(|level| **level > 0).count();
    // If an image is damaged, import fails, or starts again without the image and adds the note then.
    if reduced > 0 && decoded.iter().all(Result::is_ok) {
        let are = if reduced == 1 { "is" } else { "are" };
        let smallest = 1u64 << levels.iter().max().expect("some are reduced");
        notes.push(format!(
            "the images of textures have {total} texels in total, more than {MAX_TEXELS}: {reduced} of {} {are} \
             reduced, by a factor of up to {smallest} in width and height",
            used.len()
        ));
    }
    Ok(decoded)
}

/// The number of texels of the images that are `used`, each of which must have a side that devices take.
fn check_texels<'u>(images: &[Encoded], used: impl Iterator<Item = &'u Use>, max: u64) -> Result<u64> {
    let mut total = 0;
    for image in used.map(|shown| &images[shown.image]) {
        let Some([width, height]) = image.size() else { continue };
        total += u64::from(width) * u64::from(height);
        if width.max(height) > MAX_SIDE || total > max {
            return Err(image.json.error(format!(
                "{width} x {height} texels: the maximum is {MAX_SIDE} per side and {max} in all images"
            )));
        }
    }
    Ok(total)
}

/// Wrap modes and filter of a sampler. The default is to repeat with a linear filter.
pub(super) fn sampler(json: Option<&Json>) -> Result<([Wrap; 2], Filter)> {
    let Some(json) = json else { return Ok(Default::default()) };
    let wrap = |key: &str| match json.get(key)? {
        None => Ok(Wrap::Repeat),
        Some(code) => match code.whole()? {
            10497 => Ok(Wrap::Repeat),
            33648 => Ok(Wrap::Mirror),
            33071 => Ok(Wrap::Clamp),
            n => Err(code.error(format!("unknown wrap mode {n}"))),
        },
    };
    let filter = match json.get("magFilter")? {
        None => Filter::Linear,
        Some(code) => match code.whole()? {
            9728 => Filter::Nearest,
            9729 => Filter::Linear,
            n => return Err(code.error(format!("unknown filter {n}"))),
        },
    };
    Ok(([wrap("wrapS")?, wrap("wrapT")?], filter))
}
