//! What all lobes of a material have in common: reading their glTF extension, their textures, their part of the tables.

use crate::Result;
use crate::scene::images::Form;
use crate::scene::json::Json;
use crate::scene::texture::{ColourSpace, TextureInfo};

/// Reads texture infos, and remembers which textures and images of the file are used.
pub(in crate::scene) trait ReadTexture {
    /// The texture info `key` of `owner`; `None` if there is none, or if its texture cannot be shown.
    ///
    /// # Errors
    /// [`crate::Error`] with the place in the file where the info is malformed.
    fn texture(&mut self, owner: &Json, key: &str, space: ColourSpace) -> Result<Option<TextureInfo>> {
        self.texture_of_form(owner, key, space, Form::Stored)
    }

    /// Like [`ReadTexture::texture`], for an image that is derived from the stored one.
    ///
    /// # Errors
    /// As [`ReadTexture::texture`].
    fn texture_of_form(
        &mut self,
        owner: &Json,
        key: &str,
        space: ColourSpace,
        form: Form,
    ) -> Result<Option<TextureInfo>>;
}

/// What a lobe's texels depend on besides its own parameters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LobeContext {
    /// Factor from world lengths to normalised ones.
    pub scale: f64,
    /// The material's index of refraction, or 0.
    pub ior: f32,
    /// Index of refraction of the volume around the surface; 1 for air.
    pub outside: f32,
    /// Absorption of that volume per normalised length.
    pub absorption: [f32; 3],
    /// Light enters the material's own volume.
    pub encloses_volume: bool,
}

/// How kernels find a lobe: the names of constants of `package::lib::constants`, and their values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layout {
    /// Name of the constant for the offset of its texels within a material's.
    pub texel: &'static str,
    /// Number of its texels.
    pub texels: usize,
    /// Name of the constant that has a bit for each of its textures.
    pub mask: &'static str,
    /// Names of the constants for its textures, in the order of [`Lobe::textures`].
    pub textures: &'static [&'static str],
    /// Other numbers that its kernels use.
    pub constants: &'static [(&'static str, u32)],
}

/// A part of a material that reflects light or lets it pass: one of the extensions of glTF's metallic-roughness model.
pub(in crate::scene) trait Lobe: Sized + Default {
    /// The glTF extension that it is read from.
    const EXTENSION: &'static str;
    /// How kernels find it.
    const LAYOUT: Layout;

    /// Reads it from a material; the default where the material has no such extension.
    ///
    /// # Errors
    /// [`crate::Error`] where the extension is malformed.
    fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Self>;

    /// Its textures, in the order of [`Layout::textures`].
    fn textures(&self) -> Vec<&Option<TextureInfo>>;

    /// The same lobe without any texture.
    fn without_textures(self) -> Self;

    /// Its texels in the table of materials: [`Layout::texels`] of them.
    fn texels(&self, context: &LobeContext) -> Vec<[f32; 4]>;

    /// The texture whose coordinates define tangents for triangles that have none, if the lobe needs tangents.
    fn tangent_texture(&self) -> Option<TextureInfo> {
        None
    }

    /// Reflects light whatever the base and the specular factor are: such a material is not Lambertian.
    fn reflects(&self) -> bool {
        false
    }

    /// Lets light pass: such a material is not Lambertian.
    fn transmits(&self) -> bool {
        false
    }

    /// Takes all light from the diffuse base, wherever it is on the surface.
    fn replaces_base(&self) -> bool {
        false
    }

    /// Lower bound of the roughness of its own microfacets; 1 if it has none, 0 if a texture may make them smooth.
    fn min_roughness(&self) -> f32 {
        1.0
    }
}
