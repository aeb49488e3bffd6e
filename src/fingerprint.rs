//! What a render starts from, as one number: files that belong to one scene and version are told from others by it.

use std::fmt::{self, Debug, Write};
use std::hash::Hasher;

use siphasher::sip128::{Hasher128, SipHasher24};

use crate::Scene;
use crate::scene::{Panorama, TextureImage};

/// 128 bits, as 32 hexadecimal digits, of the scene, of whatever else decides the image, and of Penumbra's version. Two
/// inputs that differ have the same digits with a probability of 2^-128; the digits are not proof against an attacker.
pub fn fingerprint(scene: &Scene, rest: &impl Debug) -> String {
    let mut digest = Digest(SipHasher24::new());
    // Names every field, so that none is forgotten. The debug form of a float says all of its bits but a NaN's.
    let Scene {
        vertices,
        triangles,
        materials,
        textures,
        images,
        procedurals,
        functions,
        lights,
        cameras,
        normalisation,
        notes: _,
    } = scene;
    let parts =
        (vertices, triangles, materials, textures, lights, cameras, normalisation, procedurals, functions, rest);
    // The digest takes whatever is written.
    let _ = write!(digest, "{} {parts:?}", env!("CARGO_PKG_VERSION"));
    // Texels as they are: their debug form is slow where there are many.
    for TextureImage { name, width, height, texels } in images {
        let _ = write!(digest, "{name:?} {width} {height}");
        digest.0.write(texels.as_flattened());
    }
    // Its debug form says only how large it is.
    if let Some(Panorama { width, height, texels }) = scene.environment() {
        let _ = write!(digest, "{width} {height}");
        digest.0.write(bytemuck::cast_slice(texels));
    }
    hexadecimal(&digest.0)
}

/// The same of bytes, to tell whether they are whole.
pub fn digest(bytes: &[u8]) -> String {
    let mut digest = SipHasher24::new();
    digest.write(bytes);
    hexadecimal(&digest)
}

fn hexadecimal(digest: &SipHasher24) -> String {
    format!("{:032x}", digest.finish128().as_u128())
}

struct Digest(SipHasher24);

impl Write for Digest {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}
