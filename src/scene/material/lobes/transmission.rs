//! Light that passes through the surface: KHR_materials_transmission.

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::{ColourSpace, TextureInfo};

/// KHR_materials_transmission.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Transmission {
    /// The part of the base that lets light pass, 0 to 1.
    pub factor: f32,
    /// Transmission in R.
    pub texture: Option<TextureInfo>,
}

impl Transmission {
    /// One of that factor, without a texture.
    pub const fn with_factor(factor: f32) -> Transmission {
        Transmission { factor, texture: None }
    }

    /// Whether some light may pass.
    pub fn is_present(&self) -> bool {
        self.factor > 0.0
    }
}

impl Lobe for Transmission {
    const EXTENSION: &'static str = "KHR_materials_transmission";
    const LAYOUT: Layout = Layout {
        texel: "TRANSMISSION_TEXEL",
        texels: 1,
        mask: "TRANSMISSION_TEXTURES",
        textures: &["TRANSMISSION_TEXTURE"],
        constants: &[],
    };

    fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Self> {
        let Some(json) = material.extension(Self::EXTENSION)? else { return Ok(Self::default()) };
        Ok(Transmission {
            factor: json.number_in("transmissionFactor", 0.0, 0.0..=1.0)?,
            texture: textures.texture(&json, "transmissionTexture", ColourSpace::Linear)?,
        })
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        vec![&self.texture]
    }

    fn without_textures(self) -> Self {
        Transmission { texture: None, ..self }
    }

    fn texels(&self, _: &LobeContext) -> Vec<[f32; 4]> {
        vec![[self.factor, 0.0, 0.0, 0.0]]
    }

    fn transmits(&self) -> bool {
        self.is_present()
    }

    fn replaces_base(&self) -> bool {
        self.factor >= 1.0 && self.texture.is_none()
    }
}
