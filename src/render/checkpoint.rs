//! Renders that are kept and taken up again, in another process or on another device, bit for bit as if they had never stopped.
//!
//! Photons and irradiance records are made anew, as their seed says; what a checkpoint holds is what samples have left: the sums
//! of the film, the photons that audits added, the cells that points asked about, what was seen of each light, and the counts.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::fingerprint::{digest, fingerprint};
use crate::render::film::{read_file, write_atomically};
use crate::{Error, Result};

use super::Renderer;
use crate::light_transport::direct_light;
use crate::light_transport::visibility_map::MapState;
use crate::statistics::totals::Totals;

/// How every file begins; the number rises with the form.
const MAGIC: &[u8] = b"penumbra checkpoint 3\n";

/// Bytes of the digest of all that follows it.
const DIGEST: usize = 32;

/// What comes then, as JSON, after its length of 8 bytes; the words of the film and of the map end the file.
#[derive(Clone, Serialize, Deserialize)]
struct Header {
    version: String,
    /// Of scene, camera, settings and version.
    fingerprint: String,
    samples: u32,
    batches: u32,
    totals: Totals,
    /// Why there is no visibility map, where there is none.
    map_left_out: Option<String>,
    /// Photons that audits added to the map.
    added: usize,
    /// Those that they have left since, of which there may have been too many to keep.
    left: u32,
}

/// What samples have left, in memory or in a file: enough to go on from, on any device.
#[derive(Clone)]
pub struct Checkpoint {
    header: Header,
    words: Vec<u32>,
    /// Where it was read from.
    file: Option<PathBuf>,
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
    /// [`Error::Input`] where the file is none of [`Checkpoint::write`], is damaged, or is of another version.
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
        // The file's bytes lie as they come, words want to be aligned.
        let words = bytemuck::pod_collect_to_vec(words);
        Ok(Checkpoint { header, words, file: Some(path.as_ref().to_owned()) })
    }

    /// With the fingerprint of the renderer that left it.
    pub(super) fn signed(mut self, renderer: &Renderer<'_>) -> Checkpoint {
        self.header.fingerprint = renderer.fingerprint();
        self
    }

    /// Samples a pixel.
    pub fn samples(&self) -> u32 {
        self.header.samples
    }

    /// The words of the planes, in the order of [`Renderer::planes`], and what follows them.
    pub(super) fn words(&self) -> &[u32] {
        &self.words
    }

    pub(super) fn totals(&self) -> &Totals {
        &self.header.totals
    }
}

impl Renderer<'_> {
    /// What samples have left so far.
    ///
    /// # Errors
    /// Those of [`crate::gpu::Gpu::read`].
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        Ok(self.unsigned_checkpoint()?.signed(self))
    }

    /// Writes what [`Renderer::resume`] needs. The old file stays until the new one is whole.
    ///
    /// # Errors
    /// Those of [`Renderer::checkpoint`] and [`Checkpoint::write`].
    pub fn save_checkpoint(&self, path: impl AsRef<Path>) -> Result<()> {
        self.checkpoint()?.write(path)
    }

    /// As [`Renderer::checkpoint`], for a renderer of the same scene and settings: without its fingerprint, which takes
    /// longer than all the rest.
    pub(super) fn unsigned_checkpoint(&self) -> Result<Checkpoint> {
        let mut words = Vec::new();
        for plane in self.planes() {
            words.extend(plane.state(self.gpu)?);
        }
        let map = self.direct.as_ref().map_or(Ok(MapState::default()), |direct| direct.map_state(self.gpu))?;
        words.extend(map.words());
        let left_out = self.specialisation.left_out.iter().find(|item| item.name == "visibility_map");
        let header = Header {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            fingerprint: String::new(),
            samples: self.samples,
            batches: self.batches,
            totals: self.totals.clone(),
            map_left_out: left_out.map(|item| item.reason.clone()),
            added: map.added.len(),
            left: map.left,
        };
        Ok(Checkpoint { header, words, file: None })
    }

    /// As [`Renderer::resume_from`], of a file.
    ///
    /// # Errors
    /// Those of [`Checkpoint::read`] and [`Renderer::resume_from`].
    pub fn resume(&mut self, path: impl AsRef<Path>) -> Result<()> {
        self.resume_from(&Checkpoint::read(path)?)
    }

    /// Goes on where the render stood that left the checkpoint, bit for bit as if it had not stopped. To be called before the
    /// first sample.
    ///
    /// # Errors
    /// [`Error::Input`] where the checkpoint is of another scene, camera, or other settings, the seed and the number of
    /// samples among them.
    pub fn resume_from(&mut self, from: &Checkpoint) -> Result<()> {
        let Checkpoint { header, words, file } = from;
        let refuse = |problem: &str| Error::input(file.as_deref().unwrap_or("checkpoint".as_ref()), "file", problem);
        let damaged = || refuse("is damaged");
        let unsigned = file.is_none() && header.fingerprint.is_empty();
        if !unsigned && header.fingerprint != self.fingerprint() {
            return Err(refuse(
                "is of another scene or camera, or of other settings, such as `image.seed`, `image.spp` or the size",
            ));
        }
        // Counts are by light; and a render that has all of its samples takes no more.
        if header.totals.photons.len() != self.totals.photons.len() || header.samples > self.settings.image.spp {
            return Err(damaged());
        }
        let left_out = header.map_left_out.as_ref();
        if let Some(reason) = left_out.filter(|_| self.specialisation.features.has("visibility_map")) {
            self.leave_map_out(reason)?;
        }
        let mut rest = words.as_slice();
        for plane in self.planes() {
            let (state, others) = rest.split_at_checked(plane.state_words()).ok_or_else(damaged)?;
            plane.restore(self.gpu, state);
            rest = others;
        }
        let map = MapState::from_words(rest, header.added, header.left).ok_or_else(damaged)?;
        if let Some(direct) = &mut self.direct {
            let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.buffers);
            if !direct.restore(&direct_light::Shared { gpu, scene, gpu_scene, tile }, &map, &mut self.totals)? {
                return Err(damaged());
            }
        }
        self.refine_for(header.samples)?;
        self.samples = header.samples;
        self.batches = header.batches;
        self.totals = header.totals.clone().after(&self.totals);
        Ok(())
    }

    fn fingerprint(&self) -> String {
        fingerprint(&self.scene, &(&self.camera, &self.settings))
    }
}
