//! The bytes of a glTF scene: the JSON and binary chunks of a .glb, and the resources that URIs refer to.

use std::collections::HashMap;
use std::ops::Deref;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use super::json::Json;
use crate::input::read_file;
use crate::{Error, Result};

/// Bytes of the file itself or of a resource.
pub(super) enum Bytes<'a> {
    /// Bytes of the file.
    Borrowed(&'a [u8]),
    /// Bytes of a data URI or of another file, to which several URIs may refer.
    Shared(Arc<Vec<u8>>),
}

impl Deref for Bytes<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Bytes::Borrowed(bytes) => bytes,
            Bytes::Shared(bytes) => bytes,
        }
    }
}

/// The JSON text and the binary chunk of a .glb or .gltf. The first bytes distinguish the two formats.
pub(super) fn chunks<'a>(bytes: &'a [u8], file: &Path) -> Result<(&'a [u8], Option<&'a [u8]>)> {
    if bytes.is_empty() {
        return Err(Error::input(file, "file", "the file is empty"));
    }
    if !bytes.starts_with(b"glTF") {
        let is_glb = file.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb"));
        return if is_glb {
            Err(Error::input(file, "byte 0", "not a .glb: the magic number is missing"))
        } else {
            Ok((bytes, None))
        };
    }
    let at = |offset: usize, problem: String| Error::input(file, format!("byte {offset}"), problem);
    let word = |offset: usize, what: &str| -> Result<u32> {
        let word =
            bytes.get(offset..offset + 4).ok_or_else(|| at(offset, format!("the file ends within its {what}")))?;
        Ok(u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
    };
    let version = word(4, "header")?;
    if version != 2 {
        return Err(at(4, format!("binary glTF version {version}, only 2 is supported")));
    }
    let length = word(8, "header")? as usize;
    if length > bytes.len() {
        return Err(at(
            8,
            format!("the file is truncated: {length} bytes are declared, but there are {}", bytes.len()),
        ));
    }
    const JSON: u32 = u32::from_le_bytes(*b"JSON");
    const BIN: u32 = u32::from_le_bytes(*b"BIN\0");
    let (mut json, mut bin) = (None, None);
    let mut offset = 12;
    while offset < length {
        let size = word(offset, "chunk header")? as usize;
        let kind = word(offset + 4, "chunk header")?;
        let start = offset + 8;
        let chunk = bytes[..length]
            .get(start..start.saturating_add(size))
            .ok_or_else(|| at(offset, format!("chunk of {size} bytes does not fit the {length} bytes of the file")))?;
        match kind {
            JSON if json.is_none() && offset == 12 => json = Some(chunk),
            JSON => return Err(at(offset, "second JSON chunk".into())),
            _ if json.is_none() => return Err(at(offset, "the first chunk is not JSON".into())),
            BIN if bin.is_none() => bin = Some(chunk),
            BIN => return Err(at(offset, "second binary chunk".into())),
            // Other chunks belong to extensions. glTF 4.4.3 requires that they are ignored.
            _ => {}
        }
        offset = start + size;
    }
    let json = json.ok_or_else(|| at(12, "no JSON chunk".into()))?;
    Ok((json, bin))
}

/// Resources that URIs refer to. Each file is read once, because a thousand buffers may refer to the same one.
#[derive(Default)]
pub(super) struct Resources {
    /// `None` for a file that could not be read.
    files: HashMap<PathBuf, Option<Arc<Vec<u8>>>>,
}

impl Resources {
    /// The files that were to be read in addition to `file`, the scene, sorted.
    pub fn files(&self, file: &Path) -> Vec<PathBuf> {
        let folder = file.parent().unwrap_or(Path::new(""));
        let mut files: Vec<PathBuf> = self.files.keys().map(|path| folder.join(path)).collect();
        files.sort();
        files
    }

    /// The bytes that a `uri` property refers to: a data URI, or a file below the scene's folder.
    pub fn resolve(&mut self, uri: &Json) -> Result<Bytes<'static>> {
        let text = uri.string()?;
        if let Some(data) = text.strip_prefix("data:") {
            return decode_data(data).map(|bytes| Bytes::Shared(Arc::new(bytes))).map_err(|problem| uri.error(problem));
        }
        let path = local_path(text).map_err(|problem| uri.error(problem))?;
        if let Some(Some(bytes)) = self.files.get(&path) {
            return Ok(Bytes::Shared(bytes.clone()));
        }
        let folder = uri.file().parent().unwrap_or(Path::new(""));
        let read = read_file(&folder.join(&path)).map(Arc::new);
        self.files.insert(path.clone(), read.as_ref().ok().cloned());
        read.map(Bytes::Shared).map_err(|e| uri.error(format!("{}: {e}", path.display())))
    }
}

/// Decodes a data URI (RFC 2397) without its leading `data:`.
fn decode_data(data: &str) -> std::result::Result<Vec<u8>, &'static str> {
    let (header, payload) = data.split_once(',').ok_or("data URI without a comma")?;
    let (header, is_base64) = match header.strip_suffix(";base64") {
        Some(header) => (header, true),
        None => (header, false),
    };
    if header.split(';').skip(1).any(|parameter| !parameter.contains('=')) {
        return Err("data URI with a parameter that has no value");
    }
    if is_base64 {
        BASE64.decode(payload).map_err(|_| "invalid base64")
    } else {
        percent_decode(payload).ok_or("invalid percent-encoding")
    }
}

/// Base64 as found in real files: padding is optional, and the bits after the last byte are ignored.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// Decodes percent-encoding (RFC 3986, section 2.1).
fn percent_decode(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let mut digit = || rest.next().and_then(|c| (c as char).to_digit(16));
            bytes.push((digit()? * 16 + digit()?) as u8);
        } else {
            bytes.push(byte);
        }
    }
    Some(bytes)
}

/// Checks that `uri` is a relative path that stays below the scene's folder.
fn local_path(uri: &str) -> std::result::Result<PathBuf, String> {
    // A colon before the first slash ends a scheme (RFC 3986, section 3.1).
    if uri.split('/').next().is_some_and(|first| first.contains(':')) {
        return Err("only data URIs and relative paths are supported".into());
    }
    let decoded =
        percent_decode(uri).and_then(|bytes| String::from_utf8(bytes).ok()).ok_or("invalid percent-encoding")?;
    let mut path = PathBuf::new();
    for component in Path::new(&decoded).components() {
        let inside = match component {
            Component::Normal(name) => {
                path.push(name);
                true
            }
            Component::CurDir => true,
            Component::ParentDir => path.pop(),
            Component::RootDir | Component::Prefix(_) => false,
        };
        if !inside {
            return Err(format!("{decoded}: leaves the scene's folder"));
        }
    }
    if path.as_os_str().is_empty() { Err("empty path".into()) } else { Ok(path) }
}
