//! The fingerprint of a scene, which identifies the checkpoints and references of a render.

use std::fmt::{Debug, Write};

use super::description::Scene;
use super::panorama::Panorama;
use super::texture::TextureImage;
use crate::fingerprint::Fingerprint;

impl Scene {
    /// The fingerprint of the scene, of Penumbra's version and of `settings`, which are all else that decides the
    /// image: 32 hexadecimal digits.
    pub fn fingerprint(&self, settings: &impl Debug) -> String {
        let mut fingerprint = Fingerprint::default();
        // Naming every field makes the compiler report one that is forgotten.
        let Scene {
            vertices,
            triangles,
            shared_meshes,
            instances,
            materials,
            textures,
            images,
            procedurals,
            functions,
            lights,
            cameras,
            normalisation,
            notes: _,
            files: _,
            variants: _,
            animation_end: _,
        } = self;
        // The debug form of a float has all of its bits, except those of a NaN.
        let parts = (
            vertices,
            triangles,
            materials,
            textures,
            lights,
            cameras,
            normalisation,
            procedurals,
            functions,
            settings,
        );
        // Writing to a fingerprint never fails.
        let _ = write!(fingerprint, "{} {parts:?}", env!("CARGO_PKG_VERSION"));
        // Scenes without instances keep the fingerprints that they had before there were any.
        if !instances.is_empty() {
            let _ = write!(fingerprint, "{shared_meshes:?} {instances:?}");
        }
        // The debug form of millions of texels is slow, so their bytes are hashed.
        for TextureImage { name, width, height, texels } in images.iter() {
            let _ = write!(fingerprint, "{name:?} {width} {height}");
            fingerprint.write_bytes(texels.as_flattened());
        }
        // The debug form of a panorama is only its size.
        if let Some(Panorama { width, height, texels }) = self.environment() {
            let _ = write!(fingerprint, "{width} {height}");
            fingerprint.write_bytes(bytemuck::cast_slice(texels));
        }
        fingerprint.finish()
    }
}
