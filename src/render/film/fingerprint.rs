//! The fingerprint that an image file has of its scene and settings, so that an interrupted sequence can be resumed.

use std::io::Cursor;
use std::path::Path;

use super::formats::read_file;
use super::image::{FINGERPRINT, Image, Metadata};

impl Image {
    /// Adds the fingerprint of what it shows. Files of all formats keep it.
    pub fn set_fingerprint(&mut self, fingerprint: String) {
        self.metadata.insert(FINGERPRINT.to_owned(), Metadata::Text(fingerprint));
    }
}

/// The fingerprint of an image file, set by [`Image::set_fingerprint`]; `None` if the file is missing, damaged or
/// incomplete, or has none.
pub fn fingerprint(path: impl AsRef<Path>) -> Option<String> {
    let path = path.as_ref();
    let bytes = read_file(path).ok()?;
    if let Ok(reader) = png::Decoder::new(Cursor::new(&bytes)).read_info() {
        return of_png(reader);
    }
    match Image::from_bytes(&bytes, path).ok()?.metadata.get(FINGERPRINT) {
        Some(Metadata::Text(fingerprint)) => Some(fingerprint.clone()),
        _ => None,
    }
}

/// Reads all rows, which shows whether the file is complete, and keeps none: a large frame would take gigabytes.
fn of_png(mut reader: png::Reader<Cursor<&Vec<u8>>>) -> Option<String> {
    while reader.next_row().ok()?.is_some() {}
    reader.finish().ok()?;
    let texts = &reader.info().uncompressed_latin1_text;
    texts.iter().find(|text| text.keyword == FINGERPRINT).map(|text| text.text.clone())
}
