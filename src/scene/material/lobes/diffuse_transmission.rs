//! Light that leaves the other side of the surface in all directions: KHR_materials_diffuse_transmission.

use glam::Vec3;

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::{ColourSpace, TextureInfo};

/// KHR_materials_diffuse_transmission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiffuseTransmission {
    /// The part of the diffuse base that lets light pass, 0 to 1.
    pub factor: f32,
    /// Colour of the light that passes; each 0 to 1.
    pub colour: Vec3,
    /// Factor in A.
    pub texture: Option<TextureInfo>,
    /// Colour (sRGB).
    pub colour_texture: Option<TextureInfo>,
}

impl Default for DiffuseTransmission {
    fn default() -> Self {
        DiffuseTransmission::new(0.0, Vec3::ONE)
    }
}

impl DiffuseTransmission {
    /// One of that factor and colour, without textures.
    pub const fn new(factor: f32, colour: Vec3) -> DiffuseTransmission {
        DiffuseTransmission { factor, colour, texture: None, colour_texture: None }
    }

    /// Whether some light may pass.
    pub fn is_present(&self) -> bool {
        self.factor > 0.0 && self.colour != Vec3::ZERO
    }
}

impl Lobe for DiffuseTransmission {
    const EXTENSION: &'static str = "KHR_materials_diffuse_transmission";
    const LAYOUT: Layout = Layout {
        texel: "DIFFUSE_TRANSMISSION_TEXEL",
        texels: 1,
        mask: "DIFFUSE_TRANSMISSION_TEXTURES",
        textures: &["DIFFUSE_TRANSMISSION_TEXTURE", "DIFFUSE_TRANSMISSION_COLOUR_TEXTURE"],
        constants: &[],
    };

    fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Self> {
        let Some(json) = material.extension(Self::EXTENSION)? else { return Ok(Self::default()) };
        Ok(DiffuseTransmission {
            factor: json.number_in("diffuseTransmissionFactor", 0.0, 0.0..=1.0)?,
            colour: json.numbers_in::<3>("diffuseTransmissionColorFactor", 1.0, 0.0..=1.0)?.into(),
            texture: textures.texture(&json, "diffuseTransmissionTexture", ColourSpace::Linear)?,
            colour_texture: textures.texture(&json, "diffuseTransmissionColorTexture", ColourSpace::Srgb)?,
        })
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        vec![&self.texture, &self.colour_texture]
    }

    fn without_textures(self) -> Self {
        DiffuseTransmission { texture: None, colour_texture: None, ..self }
    }

    fn texels(&self, _: &LobeContext) -> Vec<[f32; 4]> {
        vec![self.colour.extend(self.factor).to_array()]
    }

    fn transmits(&self) -> bool {
        self.is_present()
    }

    fn replaces_base(&self) -> bool {
        self.factor >= 1.0 && self.texture.is_none()
    }
}
