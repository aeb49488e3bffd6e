//! Images of the file: checked, then decoded in parallel.

use std::collections::HashMap;

use image::ImageFormat;
use rayon::prelude::*;

use super::accessor::Views;
use super::container::{Bytes, Resources};
use super::json::Json;
use super::texture::{Filter, TextureImage, Wrap};
use crate::Result;
use crate::input::{MAX_FILE_BYTES, Picture, printable};

/// Maximum side of an image in texels, the common texture limit of graphics devices.
const MAX_SIDE: u32 = 16384;
/// Maximum number of texels of all images together: 1 GiB of RGBA8.
const MAX_TEXELS: u64 = 1 << 28;

/// An image of the file, checked but not yet decoded.
pub(super) struct Encoded<'a> {
    json: Json<'a>,
    name: String,
    bytes: Bytes<'a>,
    /// None if it is neither PNG nor JPEG, which is legal if only an extension uses it.
    format: Option<(ImageFormat, [u32; 2])>,
    /// Index of the first image with the same bytes, possibly its own.
    pub first: usize,
}

impl Encoded<'_> {
    /// Whether the format can be decoded.
    pub fn is_known(&self) -> bool {
        self.format.is_some()
    }

    fn decode(&self) -> Result<TextureImage> {
        let (format, [width, height]) = self.format.ok_or_else(|| self.json.error("neither PNG nor JPEG"))?;
        let image = Picture::open(&self.bytes, format).and_then(Picture::decode).map_err(|e| self.json.error(e))?;
        let texels = image.into_rgba8().as_raw().as_chunks::<4>().0.to_vec();
        Ok(TextureImage { name: self.name.clone(), width, height, texels })
    }
}

/// Resolves every image and reads its header.
pub(super) fn read_images<'a>(
    root: &Json<'a>,
    views: &Views<'a>,
    resources: &mut Resources,
) -> Result<Vec<Encoded<'a>>> {
    let mut images: Vec<Encoded<'a>> = Vec::new();
    let mut known = HashMap::new();
    let mut total = 0;
    for (i, json) in root.list("images")?.into_iter().enumerate() {
        let uri = json.get("uri")?;
        let bytes = match (&uri, json.get("bufferView")?) {
            (Some(uri), None) => resources.resolve(uri)?,
            (None, Some(view)) => Bytes::Borrowed(views.bytes(&view)?),
            _ => return Err(json.error("needs either a uri or a buffer view")),
        };
        let file_name = uri.map(|uri| uri.string()).transpose()?.filter(|uri| !uri.starts_with("data:"));
        let name = json.name()?.or(file_name.map(printable)).unwrap_or_else(|| format!("image {i}"));
        let first = *known.entry((bytes.as_ptr(), bytes.len())).or_insert(i);
        let format = if first < i {
            images[first].format
        } else {
            total += bytes.len() as u64;
            if total > MAX_FILE_BYTES {
                return Err(
                    json.error(format!("the images have more than {MAX_FILE_BYTES} bytes in total, or overlap"))
                );
            }
            match image::guess_format(&bytes) {
                Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => {
                    Some((format, Picture::open(&bytes, format).map_err(|e| json.error(e))?.size))
                }
                _ => None,
            }
        };
        images.push(Encoded { json, name, bytes, format, first });
    }
    Ok(images)
}

/// Decodes the images with the indices `used` in parallel.
pub(super) fn decode(images: &[Encoded], used: &[usize]) -> Result<Vec<TextureImage>> {
    let mut total = 0;
    for image in used.iter().map(|&i| &images[i]) {
        let [width, height] = image.format.map_or([0, 0], |(_, size)| size);
        total += u64::from(width) * u64::from(height);
        if width.max(height) > MAX_SIDE || total > MAX_TEXELS {
            return Err(image.json.error(format!(
                "{width} x {height} texels: the maximum is {MAX_SIDE} per side and {MAX_TEXELS} in all images"
            )));
        }
    }
    used.par_iter().map(|&i| images[i].decode()).collect()
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
