//! Renders that are written to a file and taken up again, bit for bit as if they had never stopped.
//!
//! Photons and irradiance records are made anew, as their seed says; what the file holds is what samples have left: the sums
//! of the film, the photons that audits added, the cells that points asked about, what was seen of each light, and the counts.

use std::io::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::film::{read_file, write_atomically};
use crate::fingerprint::{digest, fingerprint};
use crate::{Error, Result};

use super::totals::Totals;
use super::visibility_map::MapState;
use super::{Renderer, direct};

/// How every file begins; the number rises with the form.
const MAGIC: &[u8] = b"penumbra checkpoint 1\n";

/// What follows, as JSON, after its length of 8 bytes; then come the words of the film and of the map.
#[derive(Serialize, Deserialize)]
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
    /// Of the words that follow.
    digest: String,
}

impl Renderer<'_> {
    /// Writes what [`Renderer::resume`] needs. The old file stays until the new one is whole.
    ///
    /// # Errors
    /// [`Error::Output`] where the file cannot be written, and those of [`crate::gpu::Gpu::read`].
    pub fn save_checkpoint(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let mut words = Vec::new();
        for plane in self.planes() {
            words.extend(plane.state(self.gpu)?);
        }
        let map = self.direct.as_ref().map_or(Ok(MapState::default()), |direct| direct.map_state(self.gpu))?;
        words.extend(map.words());
        let left_out = self.needs.left_out.iter().find(|item| item.name == "visibility_map");
        let header = Header {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            fingerprint: self.fingerprint(),
            samples: self.samples,
            batches: self.batches,
            totals: self.totals.clone(),
            map_left_out: left_out.map(|item| item.reason.clone()),
            added: map.added.len(),
            left: map.left,
            digest: digest(bytemuck::cast_slice(&words)),
        };
        write_atomically(path, |file| {
            let header = serde_json::to_vec(&header)?;
            file.write_all(MAGIC)?;
            file.write_all(&(header.len() as u64).to_le_bytes())?;
            file.write_all(&header)?;
            Ok(file.write_all(bytemuck::cast_slice(&words))?)
        })
    }

    /// Goes on where the render that wrote the file stood. To be called before the first sample.
    ///
    /// # Errors
    /// [`Error::Input`] where the file is none of [`Renderer::save_checkpoint`], is damaged, or is of another scene,
    /// camera, version or other settings, the seed and the number of samples among them.
    pub fn resume(&mut self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let refuse = |problem: &str| Error::input(path, "file", problem);
        let bytes = read_file(path)?;
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| refuse("is no checkpoint of this form"))?;
        let damaged = || refuse("is damaged");
        let (length, rest) = rest.split_first_chunk().ok_or_else(damaged)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| damaged())?;
        let (header, words) = rest.split_at_checked(length).ok_or_else(damaged)?;
        let header: Header = serde_json::from_slice(header).map_err(|_| damaged())?;
        if header.version != env!("CARGO_PKG_VERSION") {
            return Err(refuse(&format!("was written by version {} of Penumbra", header.version)));
        }
        if header.fingerprint != self.fingerprint() {
            return Err(refuse(
                "is of another scene or camera, or of other settings, such as --seed, --spp or the size",
            ));
        }
        if header.digest != digest(words) {
            return Err(damaged());
        }
        // The file's bytes lie as they come, words want to be aligned.
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(words);

        if let Some(reason) = header.map_left_out.filter(|_| self.needs.features.has("visibility_map")) {
            self.leave_map_out(&reason)?;
        }
        let mut rest = words.as_slice();
        for plane in self.planes() {
            let (state, others) = rest.split_at_checked(plane.state_words()).ok_or_else(damaged)?;
            plane.restore(self.gpu, state);
            rest = others;
        }
        let map = MapState::from_words(rest, header.added, header.left).ok_or_else(damaged)?;
        if let Some(direct) = &mut self.direct {
            let (gpu, scene, tables, tile) = (self.gpu, &self.scene, &self.tables, &self.buffers);
            if !direct.restore(&direct::Shared { gpu, scene, tables, tile }, &map, &mut self.totals)? {
                return Err(damaged());
            }
        }
        self.refine_for(header.samples)?;
        self.samples = header.samples;
        self.batches = header.batches;
        self.totals = header.totals.after(&self.totals);
        Ok(())
    }

    fn fingerprint(&self) -> String {
        fingerprint(&self.scene, &(&self.camera, &self.settings))
    }
}
