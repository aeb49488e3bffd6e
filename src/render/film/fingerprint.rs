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
    let image = Image::from_bytes(&bytes, path).ok()?;
    if let Some(Metadata::Text(fingerprint)) = image.metadata.get(FINGERPRINT) {
        return Some(fingerprint.clone());
    }
    let reader = png::Decoder::new(Cursor::new(&bytes)).read_info().ok()?;
    let texts = &reader.info().uncompressed_latin1_text;
    texts.iter().find(|text| text.keyword == FINGERPRINT).map(|text| text.text.clone())
}
