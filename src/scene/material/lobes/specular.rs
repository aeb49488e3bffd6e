//! The specular lobe's extension, KHR_materials_specular. Every material that is not Lambertian has the lobe.

use glam::Vec3;

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::{ColourSpace, TextureInfo};

/// KHR_materials_specular.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Specular {
    /// Specular factor, 0 to 1; 1 where absent. 0 leaves a material without metal Lambertian.
    pub factor: f32,
    /// Specular colour factor, at least 0; one where absent.
    pub colour: Vec3,
    /// Specular factor in A.
    pub texture: Option<TextureInfo>,
    /// Specular colour (sRGB).
    pub colour_texture: Option<TextureInfo>,
}

impl Default for Specular {
    fn default() -> Self {
        Specular::with_factor(1.0)
    }
}

impl Specular {
    /// A white one of that factor, without textures.
    pub const fn with_factor(factor: f32) -> Specular {
        Specular { factor, colour: Vec3::ONE, texture: None, colour_texture: None }
    }
}

impl Lobe for Specular {
    const EXTENSION: &'static str = "KHR_materials_specular";
    const LAYOUT: Layout = Layout {
        texel: "SPECULAR_TEXEL",
        texels: 1,
        mask: "SPECULAR_TEXTURES",
        textures: &["SPECULAR_TEXTURE", "SPECULAR_COLOUR_TEXTURE"],
        constants: &[],
    };

    fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Self> {
        let Some(json) = material.extension(Self::EXTENSION)? else { return Ok(Specular::default()) };
        Ok(Specular {
            factor: json.number_in("specularFactor", 1.0, 0.0..=1.0)?,
            colour: json.numbers_in::<3>("specularColorFactor", 1.0, 0.0..)?.into(),
            texture: textures.texture(&json, "specularTexture", ColourSpace::Linear)?,
            colour_texture: textures.texture(&json, "specularColorTexture", ColourSpace::Srgb)?,
        })
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        vec![&self.texture, &self.colour_texture]
    }

    fn without_textures(self) -> Self {
        Specular { texture: None, colour_texture: None, ..self }
    }

    fn texels(&self, _: &LobeContext) -> Vec<[f32; 4]> {
        vec![self.colour.extend(self.factor).to_array()]
    }
}
