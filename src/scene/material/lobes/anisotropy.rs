//! Reflections that are spread along a tangent: KHR_materials_anisotropy.

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::{ColourSpace, TextureInfo};

/// KHR_materials_anisotropy.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Anisotropy {
    /// Strength, 0 to 1.
    pub strength: f32,
    /// Rotation from the tangent, counter-clockwise, in radians.
    pub rotation: f32,
    /// Direction in R and G, strength in B.
    pub texture: Option<TextureInfo>,
}

impl Anisotropy {
    /// One of that strength along the tangent, without a texture.
    pub const fn with_strength(strength: f32) -> Anisotropy {
        Anisotropy { strength, rotation: 0.0, texture: None }
    }

    /// Whether reflections along the tangent differ from those across.
    pub fn is_present(&self) -> bool {
        self.strength > 0.0
    }
}

impl Lobe for Anisotropy {
    const EXTENSION: &'static str = "KHR_materials_anisotropy";
    const LAYOUT: Layout = Layout {
        texel: "ANISOTROPY_TEXEL",
        texels: 1,
        mask: "ANISOTROPY_TEXTURES",
        textures: &["ANISOTROPY_TEXTURE"],
        constants: &[],
    };

    fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Self> {
        let Some(json) = material.extension(Self::EXTENSION)? else { return Ok(Self::default()) };
        Ok(Anisotropy {
            strength: json.number_in("anisotropyStrength", 0.0, 0.0..=1.0)?,
            rotation: json.number_in("anisotropyRotation", 0.0, ..)?,
            texture: textures.texture(&json, "anisotropyTexture", ColourSpace::Linear)?,
        })
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        vec![&self.texture]
    }

    fn without_textures(self) -> Self {
        Anisotropy { texture: None, ..self }
    }

    fn tangent_texture(&self) -> Option<TextureInfo> {
        self.texture
    }

    fn texels(&self, _: &LobeContext) -> Vec<[f32; 4]> {
        vec![[self.strength, self.rotation.cos(), self.rotation.sin(), 0.0]]
    }
}
