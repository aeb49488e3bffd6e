//! Buffer views compressed by EXT_meshopt_compression or KHR_meshopt_compression.
//!
//! The decoder is our own, written from the appendices of the extension: the crate `meshopt` binds C++, and
//! `meshopt-rs` does not know version 1 of the attributes.

mod bitstream;
mod filter;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

use super::accessor::Buffer;
use super::json::Json;
use crate::Result;
use filter::Filter;

/// The extensions; a view has at most one. They differ in what [`Mode::Attributes`] and filters may be.
pub(super) const EXTENSIONS: [&str; 2] = ["KHR_meshopt_compression", "EXT_meshopt_compression"];

#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

/// A compressed view, whose members have been checked.
struct Compressed<'a> {
    json: Json<'a>,
    bytes: &'a [u8],
    mode: Mode,
    filter: Option<Filter>,
    count: usize,
    stride: usize,
}

/// The decoded bytes of each buffer view; `None` for views that are not compressed.
pub(super) fn decode(root: &Json, buffers: &[Buffer]) -> Result<Vec<Option<Vec<u8>>>> {
    let mut views = Vec::new();
    // Views may share compressed bytes, so the size of the file does not bound what they expand to.
    let mut left: usize = buffers.iter().filter_map(Buffer::bytes).map(<[u8]>::len).sum();
    for view in root.list("bufferViews")? {
        let compressed = compressed(&view, buffers)?;
        if let Some(compressed) = &compressed {
            left = left.checked_sub(compressed.bytes.len()).ok_or_else(|| {
                compressed.json.error("the compressed views overlap: together they have more bytes than the buffers")
            })?;
        }
        views.push(compressed);
    }
    let decoded: Vec<_> = views.par_iter().map(|view| view.as_ref().map(Compressed::decode).transpose()).collect();
    decoded.into_iter().collect()
}

/// The compressed form of a view, if it has one.
fn compressed<'a>(view: &Json<'a>, buffers: &'a [Buffer]) -> Result<Option<Compressed<'a>>> {
    let [khr, ext] = EXTENSIONS.map(|name| view.extension(name));
    let (json, is_khr) = match (khr?, ext?) {
        (Some(json), None) => (json, true),
        (None, Some(json)) => (json, false),
        (None, None) => return Ok(None),
        (Some(_), Some(ext)) => return Err(ext.error(format!("the view has {} as well", EXTENSIONS[0]))),
    };
    let buffer = json.require("buffer")?;
    let bytes = buffers[buffer.index(buffers.len(), "buffer")?].bytes();
    let bytes = bytes.ok_or_else(|| buffer.error("has no data in this file"))?;
    let offset = json.get("byteOffset")?.map_or(Ok(0), |offset| offset.whole())?;
    let length = json.require("byteLength")?.whole()?;
    let bytes = offset.checked_add(length).and_then(|end| bytes.get(offset..end)).ok_or_else(|| {
        json.error(format!("{length} bytes at {offset} do not fit the {} bytes of the buffer", bytes.len()))
    })?;
    let mode = json.require("mode")?;
    let mode = match mode.string()? {
        "ATTRIBUTES" => Mode::Attributes,
        "TRIANGLES" => Mode::Triangles,
        "INDICES" => Mode::Indices,
        other => return Err(mode.error(format!("\"{other}\" is neither ATTRIBUTES nor TRIANGLES nor INDICES"))),
    };
    let stride = json.require("byteStride")?;
    let count = json.require("count")?;
    let (stride, stride_json) = (stride.whole()?, stride);
    let (count, count_json) = (count.whole()?, count);
    let allowed = match mode {
        Mode::Attributes => (4..=256).contains(&stride) && stride % 4 == 0,
        Mode::Triangles | Mode::Indices => stride == 2 || stride == 4,
    };
    if !allowed {
        return Err(stride_json.error(format!("{stride} bytes are not allowed in this mode")));
    }
    let whole = view.require("byteLength")?.whole()?;
    if count == 0 || count.checked_mul(stride) != Some(whole) {
        return Err(count_json.error(format!("{count} elements of {stride} bytes are not the {whole} of the view")));
    }
    if mode == Mode::Triangles && count % 3 != 0 {
        return Err(count_json.error(format!("{count} is not a multiple of 3")));
    }
    let filter = match json.get("filter")? {
        None => None,
        Some(name) => Filter::named(name.string()?, is_khr)
            .map_err(|problem| name.error(problem))?
            .map(|filter| match filter.fits(stride) && mode == Mode::Attributes {
                true => Ok(filter),
                false => Err(name.error(format!("does not go with this mode or with elements of {stride} bytes"))),
            })
            .transpose()?,
    };
    Ok(Some(Compressed { json, bytes, mode, filter, count, stride }))
}

impl Compressed<'_> {
    fn decode(&self) -> Result<Vec<u8>> {
        let decoded = match self.mode {
            Mode::Attributes => bitstream::attributes(self.bytes, self.count, self.stride),
            Mode::Triangles => bitstream::triangles(self.bytes, self.count, self.stride),
            Mode::Indices => bitstream::indices(self.bytes, self.count, self.stride),
        };
        let mut decoded = decoded.map_err(|problem| self.json.error(format!("damaged data: {problem}")))?;
        if let Some(filter) = self.filter {
            filter.apply(&mut decoded, self.stride);
        }
        Ok(decoded)
    }
}
