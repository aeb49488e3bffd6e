//! A thin film on the specular lobe: KHR_materials_iridescence.

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::{ColourSpace, TextureInfo};

/// KHR_materials_iridescence: a thin film, whose colours change with the angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iridescence {
    /// Factor, 0 to 1: how much of the reflectance is that of the film.
    pub factor: f32,
    /// Index of refraction of the film, at least 1.
    pub ior: f32,
    /// Thickness in nanometres where the texture is 0.
    pub thickness_minimum: f32,
    /// Thickness in nanometres where the texture is 1, and where there is none.
    pub thickness_maximum: f32,
    /// Factor in R.
    pub texture: Option<TextureInfo>,
    /// Thickness in G, from the minimum to the maximum.
    pub thickness_texture: Option<TextureInfo>,
}

impl Default for Iridescence {
    fn default() -> Self {
        Iridescence {
            factor: 0.0,
            ior: 1.3,
            thickness_minimum: 100.0,
            thickness_maximum: 400.0,
            texture: None,
            thickness_texture: None,
        }
    }
}

impl Iridescence {
    /// One of that factor, index of refraction and thickness in nanometres, without textures.
    pub const fn new(factor: f32, ior: f32, thickness: f32) -> Iridescence {
        let (thickness_minimum, thickness_maximum) = (thickness, thickness);
        Iridescence { factor, ior, thickness_minimum, thickness_maximum, texture: None, thickness_texture: None }
    }

    /// Whether there is a film of some thickness.
    pub fn is_present(&self) -> bool {
        let thinnest_counts = self.thickness_texture.is_some();
        self.factor > 0.0 && (self.thickness_maximum > 0.0 || thinnest_counts && self.thickness_minimum > 0.0)
    }
}

impl Lobe for Iridescence {
    const EXTENSION: &'static str = "KHR_materials_iridescence";
    const LAYOUT: Layout = Layout {
        texel: "IRIDESCENCE_TEXEL",
        texels: 1,
        mask: "IRIDESCENCE_TEXTURES",
        textures: &["IRIDESCENCE_TEXTURE", "IRIDESCENCE_THICKNESS_TEXTURE"],
        constants: &[],
    };

    fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Self> {
        let Some(json) = material.extension(Self::EXTENSION)? else { return Ok(Self::default()) };
        Ok(Iridescence {
            factor: json.number_in("iridescenceFactor", 0.0, 0.0..=1.0)?,
            ior: json.number_in("iridescenceIor", 1.3, 1.0..)?,
            thickness_minimum: json.number_in("iridescenceThicknessMinimum", 100.0, 0.0..)?,
            thickness_maximum: json.number_in("iridescenceThicknessMaximum", 400.0, 0.0..)?,
            texture: textures.texture(&json, "iridescenceTexture", ColourSpace::Linear)?,
            thickness_texture: textures.texture(&json, "iridescenceThicknessTexture", ColourSpace::Linear)?,
        })
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        vec![&self.texture, &self.thickness_texture]
    }

    fn without_textures(self) -> Self {
        Iridescence { texture: None, thickness_texture: None, ..self }
    }

    /// A film that is not there has the factor 0.
    fn texels(&self, _: &LobeContext) -> Vec<[f32; 4]> {
        let factor = if self.is_present() { self.factor } else { 0.0 };
        vec![[factor, self.ior, self.thickness_minimum, self.thickness_maximum]]
    }

    fn reflects(&self) -> bool {
        self.is_present()
    }
}
