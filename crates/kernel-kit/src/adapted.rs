//! Kernels as the device takes them. A kernel is written for a device that has all that kernels use; for a device that
//! lacks some of it, the kernel is adapted.

use std::borrow::Cow;
use std::collections::BTreeMap;

use crate::compose::Composed;
use crate::error::Result;
use crate::uniforms::{FIRST_GROUP_BINDING, GROUP, PARAMETER_BINDING};

/// Features that kernels must avoid on a device.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Device {
    /// It has no immediates: kernels take their parameters from a uniform buffer.
    pub(crate) without_immediates: bool,
    /// Long dispatches are sliced: `group_index` adds the first workgroup of the slice, from a uniform buffer.
    pub(crate) sliced: bool,
    /// Storage textures of an entry point: kernels with more read the others as sampled textures, which devices allow
    /// more of.
    pub(crate) max_storage_textures: u32,
}

impl Device {
    /// The kernel as this device takes it.
    ///
    /// # Errors
    /// [`crate::Error::Kernel`] if what the adapted kernel takes is not valid in a uniform buffer.
    pub(crate) fn adapt<'c>(&self, composed: &'c Composed) -> Result<Cow<'c, Composed>> {
        let mut wgsl = Cow::Borrowed(composed.wgsl.as_str());
        if self.without_immediates {
            let uniform = format!("@group({GROUP}) @binding({PARAMETER_BINDING}) var<uniform>");
            wgsl = replaced(wgsl, "var<immediate>", &uniform);
        }
        if self.sliced {
            let uniform = format!("@group({GROUP}) @binding({FIRST_GROUP_BINDING}) var<uniform> FIRST_GROUP: u32");
            wgsl = replaced(wgsl, "const FIRST_GROUP = 0u", &uniform);
        }
        if composed.taken().iter().any(|taken| taken.storage_textures > self.max_storage_textures) {
            wgsl = Cow::Owned(with_sampled_textures(&wgsl, self.max_storage_textures as usize));
        }
        match wgsl {
            Cow::Borrowed(_) => Ok(Cow::Borrowed(composed)),
            Cow::Owned(wgsl) => Composed::new(&composed.kernel, wgsl).map(Cow::Owned),
        }
    }
}

impl Composed {
    /// The kernel as devices without immediates take it: with its parameters in a uniform buffer.
    ///
    /// # Errors
    /// [`crate::Error::Kernel`] if these are not valid there: a struct, and what follows it, must be aligned to 16
    /// bytes.
    pub fn without_immediates(&self) -> Result<Composed> {
        let device = Device { without_immediates: true, sliced: false, max_storage_textures: u32::MAX };
        device.adapt(self).map(Cow::into_owned)
    }
}

fn replaced<'t>(text: Cow<'t, str>, from: &str, to: &str) -> Cow<'t, str> {
    if text.contains(from) { Cow::Owned(text.replace(from, to)) } else { text }
}

/// Storage textures that are read, and the sampled textures of the same texels.
const READ_TEXTURES: [(&str, &str); 4] = [
    ("texture_storage_2d<rgba32float, read>", "texture_2d<f32>"),
    ("texture_storage_2d<rgba32uint, read>", "texture_2d<u32>"),
    ("texture_storage_2d_array<rgba32float, read>", "texture_2d_array<f32>"),
    ("texture_storage_2d_array<rgba32uint, read>", "texture_2d_array<u32>"),
];

/// The kernel with sampled textures, whose loads name a level, in place of all storage textures but the first `kept`.
fn with_sampled_textures(wgsl: &str, kept: usize) -> String {
    let declared = READ_TEXTURES.iter().flat_map(|(storage, sampled)| {
        wgsl.match_indices(storage).map(move |(at, _)| {
            let name = wgsl[..at].trim_end().trim_end_matches(':').trim_end();
            (at, (name.rsplit(char::is_whitespace).next().unwrap_or_default(), (*storage, *sampled)))
        })
    });
    let declared: BTreeMap<_, _> = declared.collect();
    let names: BTreeMap<&str, (&str, &str)> = declared.into_values().skip(kept).collect();
    let loads = wgsl.match_indices("textureLoad(").filter_map(|(at, call)| {
        let arguments = at + call.len();
        let name = wgsl[arguments..].split(',').next()?.trim();
        names.contains_key(name).then(|| end_of_arguments(wgsl, arguments))
    });
    let mut ends: Vec<usize> = loads.collect();
    // Loads within the arguments of others end earlier.
    ends.sort_unstable();
    let mut text = String::new();
    let mut begin = 0;
    for end in ends {
        text += &wgsl[begin..end];
        text += ", 0";
        begin = end;
    }
    text += &wgsl[begin..];
    names.iter().fold(text, |text, (name, (storage, sampled))| {
        text.replace(&format!(" {name}: {storage}"), &format!(" {name}: {sampled}"))
    })
}

/// Position of the parenthesis that closes the one just before `begin`.
fn end_of_arguments(wgsl: &str, begin: usize) -> usize {
    let mut open = 1;
    for (at, c) in wgsl[begin..].char_indices() {
        match c {
            '(' => open += 1,
            ')' => open -= 1,
            _ => {}
        }
        if open == 0 {
            return begin + at;
        }
    }
    wgsl.len()
}
