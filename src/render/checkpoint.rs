//! Checkpoints: the state that the samples of a render left, in memory or in a file.
//!
//! A checkpoint holds the sums of the film, the means of pixels by which gather rays grow, the photons of audits, the
//! cells that points requested, the fine cells, the visible share of each light, and the counts. Other photons and
//! irradiance records are not in it, because they are computed again from their seed.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::sample_allocation::SampleAllocation;
use crate::fingerprint::digest;
use crate::render::film::{read_file, write_atomically};
use crate::settings::values::SettingValues;
use crate::statistics::totals::Totals;
use crate::{Error, Result};

/// The first bytes of every file; the number rises when the format changes.
const MAGIC: &[u8] = b"penumbra checkpoint 12\n";

/// Bytes of the digest of everything after it.
const DIGEST: usize = 32;

/// The header, as JSON after its length of 8 bytes. Then come the words of the film and of the map.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Header {
    pub version: String,
    /// Fingerprint of scene, camera, settings and version.
    pub fingerprint: String,
    pub samples: u32,
    /// Stages of indirect light (photons and gather rays) after its first one; see `settings/stages.rs`. Records depend
    /// on all of them.
    pub later_stages: Vec<i32>,
    /// `None` before the second batch, and if estimates do not decide the stage.
    pub growth: Option<GrowthHeader>,
    pub blocks: Option<SampleAllocation>,
    pub batches: u32,
    /// How the next batch is shaded.
    pub shade_at_once: bool,
    /// Whether there is a visibility map: not before the trial of its photons, nor after it if they did not pay off.
    pub has_visibility_map: bool,
    /// Whether photons may still be emitted: after the first sample, or when there is more time.
    pub may_have_photons: bool,
    pub samples_without_photons: u32,
    pub totals: Totals,
    /// Number of photons that audits added to the map.
    pub added: usize,
    /// Number of photons that audits found since then; perhaps more than were kept.
    pub left: u32,
    /// In an error they say why the fingerprint differs.
    pub settings: SettingValues,
}

/// [`Growth`](super::growth::Growth) without the values of its pixels, which are words of the checkpoint.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct GrowthHeader {
    pub samples: u32,
    pub has_errors: bool,
}

/// The state that samples left, from which a render continues on any device.
#[derive(Clone)]
pub struct Checkpoint {
    pub(super) header: Header,
    /// The words of the planes, in the order of `Renderer::planes`, followed by the words of the map.
    pub(super) words: Vec<u32>,
    /// The file that it was read from.
    pub(super) file: Option<PathBuf>,
}

impl Header {
    /// The version of Penumbra that writes checkpoints.
    pub fn version() -> String {
        env!("CARGO_PKG_VERSION").to_owned()
    }
}

impl Checkpoint {
    /// Writes it to a file. The old file remains until the new one is complete.
    ///
    /// # Errors
    /// [`Error::Output`] if the file cannot be written.
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
    /// [`Error::Input`] if there is none, and those of [`Checkpoint::from_bytes`].
    pub fn read(path: impl AsRef<Path>) -> Result<Checkpoint> {
        let path = path.as_ref();
        Checkpoint::from_bytes(&read_file(path)?, path)
    }

    /// Reads and checks the bytes of a file; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Input`] if the file is no checkpoint, is damaged, or is of another version.
    pub fn from_bytes(bytes: &[u8], path: impl AsRef<Path>) -> Result<Checkpoint> {
        let refuse = |problem: &str| Error::input(&path, "file", problem);
        let damaged = || refuse("the file is damaged");
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| refuse("the file is not a checkpoint in this format"))?;
        let (stated, followers) = rest.split_first_chunk::<DIGEST>().ok_or_else(damaged)?;
        let (length, rest) = followers.split_first_chunk().ok_or_else(damaged)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| damaged())?;
        let (header, words) = rest.split_at_checked(length).ok_or_else(damaged)?;
        let header: Header = serde_json::from_slice(header).map_err(|_| damaged())?;
        if header.version != env!("CARGO_PKG_VERSION") {
            return Err(refuse(&format!("the checkpoint was written by version {} of Penumbra", header.version)));
        }
        if digest(followers).as_bytes() != stated {
            return Err(damaged());
        }
        // The bytes of the file may not have the alignment of words.
        let words = bytemuck::pod_collect_to_vec(words);
        Ok(Checkpoint { header, words, file: Some(path.as_ref().to_owned()) })
    }

    /// Adds the fingerprint of the renderer that made the checkpoint.
    pub(super) fn with_fingerprint(mut self, fingerprint: String) -> Checkpoint {
        self.header.fingerprint = fingerprint;
        self
    }

    /// Samples per pixel.
    pub fn samples(&self) -> u32 {
        self.header.samples
    }
}
