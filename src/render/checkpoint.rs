//! Checkpoints: what samples of a render have left, in memory or in a file.
//!
//! Photons and irradiance records are not in it: their seed makes them anew. It holds the sums of the film, the photons
//! that audits added, the cells that points requested, what was seen of each light, and the counts.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::fingerprint::digest;
use crate::render::film::{read_file, write_atomically};
use crate::statistics::totals::Totals;
use crate::{Error, Result};

/// How every file begins; the number rises when the format changes.
const MAGIC: &[u8] = b"penumbra checkpoint 3\n";

/// Bytes of the digest of all that follows it.
const DIGEST: usize = 32;

/// What follows as JSON, after its length of 8 bytes. The words of the film and of the map end the file.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Header {
    pub version: String,
    /// Of scene, camera, settings and version.
    pub fingerprint: String,
    pub samples: u32,
    pub batches: u32,
    pub totals: Totals,
    /// Why there is no visibility map, where there is none.
    pub map_left_out: Option<String>,
    /// Photons that audits added to the map.
    pub added: usize,
    /// Those that they have left since, of which there may have been too many to keep.
    pub left: u32,
}

/// What samples have left: enough to go on from, on any device.
#[derive(Clone)]
pub struct Checkpoint {
    pub(super) header: Header,
    /// The words of the planes, in the order of `Renderer::planes`, and then those of the map.
    pub(super) words: Vec<u32>,
    /// Where it was read from.
    pub(super) file: Option<PathBuf>,
}

impl Header {
    /// The version of Penumbra that writes checkpoints.
    pub fn version() -> String {
        env!("CARGO_PKG_VERSION").to_owned()
    }
}

impl Checkpoint {
    /// Writes it to a file. The old file stays until the new one is whole.
    ///
    /// # Errors
    /// [`Error::Output`] where the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        write_atomically(path, |file| {
            let header = serde_json::to_vec(&self.header)?;
            let length = (header.len() as u64).to_le_bytes();
            let rest = [&length, header.as_slice(), bytemuck::cast_slice(&self.words)].concat();
            file.write_all(MAGIC)?;
            file.write_all(digest(&rest).as_bytes())?;
            Ok(file.write_all(&rest)?)
        })
    }

    /// Reads a file of [`Checkpoint::write`].
    ///
    /// # Errors
    /// [`Error::Input`] where there is none, and those of [`Checkpoint::from_bytes`].
    pub fn read(path: impl AsRef<Path>) -> Result<Checkpoint> {
        let path = path.as_ref();
        Checkpoint::from_bytes(&read_file(path)?, path)
    }

    /// Checks what was read; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Input`] where the file is no checkpoint, is damaged, or is of another version.
    pub fn from_bytes(bytes: &[u8], path: impl AsRef<Path>) -> Result<Checkpoint> {
        let refuse = |problem: &str| Error::input(&path, "file", problem);
        let damaged = || refuse("is damaged");
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| refuse("is no checkpoint of this form"))?;
        let (stated, followers) = rest.split_first_chunk::<DIGEST>().ok_or_else(damaged)?;
        let (length, rest) = followers.split_first_chunk().ok_or_else(damaged)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| damaged())?;
        let (header, words) = rest.split_at_checked(length).ok_or_else(damaged)?;
        let header: Header = serde_json::from_slice(header).map_err(|_| damaged())?;
        if header.version != env!("CARGO_PKG_VERSION") {
            return Err(refuse(&format!("was written by version {} of Penumbra", header.version)));
        }
        if digest(followers).as_bytes() != stated {
            return Err(damaged());
        }
        // The file's bytes may not be aligned as words must be.
        let words = bytemuck::pod_collect_to_vec(words);
        Ok(Checkpoint { header, words, file: Some(path.as_ref().to_owned()) })
    }

    /// With the fingerprint of the renderer that left it.
    pub(super) fn signed(mut self, fingerprint: String) -> Checkpoint {
        self.header.fingerprint = fingerprint;
        self
    }

    /// Samples a pixel.
    pub fn samples(&self) -> u32 {
        self.header.samples
    }
}
