//! The clear coat: KHR_materials_clearcoat.

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::{ColourSpace, TextureInfo};

/// KHR_materials_clearcoat.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearcoat {
    /// Factor, 0 to 1.
    pub factor: f32,
    /// Roughness, 0 to 1.
    pub roughness: f32,
    /// Scale of the normal texture's x and y.
    pub normal_scale: f32,
    /// Factor in R.
    pub texture: Option<TextureInfo>,
    /// Roughness in G.
    pub roughness_texture: Option<TextureInfo>,
    /// Tangent-space normal of the coat, which is smooth where there is none, whatever its base is.
    pub normal_texture: Option<TextureInfo>,
}

impl Default for Clearcoat {
    fn default() -> Self {
        Clearcoat::with_factor(0.0)
    }
}

impl Clearcoat {
    /// A smooth one of that factor, without textures.
    pub const fn with_factor(factor: f32) -> Clearcoat {
        let (roughness, normal_scale) = (0.0, 1.0);
        Clearcoat { factor, roughness, normal_scale, texture: None, roughness_texture: None, normal_texture: None }
    }

    /// Whether there is a coat.
    pub fn is_present(&self) -> bool {
        self.factor > 0.0
    }

    /// Whether the coat has another normal than a base of that normal texture and scale: each has its own map, or only
    /// one of them has one.
    pub fn has_own_normal(&self, base: Option<(TextureInfo, f32)>) -> bool {
        self.is_present() && base != self.normal_texture.map(|map| (map, self.normal_scale))
    }
}

impl Lobe for Clearcoat {
    const EXTENSION: &'static str = "KHR_materials_clearcoat";
    const LAYOUT: Layout = Layout {
        texel: "CLEARCOAT_TEXEL",
        texels: 1,
        mask: "CLEARCOAT_TEXTURES",
        textures: &["CLEARCOAT_TEXTURE", "CLEARCOAT_ROUGHNESS_TEXTURE", "CLEARCOAT_NORMAL_TEXTURE"],
        constants: &[],
    };

    fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Self> {
        let Some(json) = material.extension(Self::EXTENSION)? else { return Ok(Self::default()) };
        let normal = json.get("clearcoatNormalTexture")?;
        Ok(Clearcoat {
            factor: json.number_in("clearcoatFactor", 0.0, 0.0..=1.0)?,
            roughness: json.number_in("clearcoatRoughnessFactor", 0.0, 0.0..=1.0)?,
            texture: textures.texture(&json, "clearcoatTexture", ColourSpace::Linear)?,
            roughness_texture: textures.texture(&json, "clearcoatRoughnessTexture", ColourSpace::Linear)?,
            normal_texture: textures.texture(&json, "clearcoatNormalTexture", ColourSpace::Linear)?,
            normal_scale: normal.map_or(Ok(1.0), |normal| normal.number_in("scale", 1.0, ..))?,
        })
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        vec![&self.texture, &self.roughness_texture, &self.normal_texture]
    }

    fn without_textures(self) -> Self {
        Clearcoat { texture: None, roughness_texture: None, normal_texture: None, ..self }
    }

    fn tangent_texture(&self) -> Option<TextureInfo> {
        self.normal_texture
    }

    fn texels(&self, _: &LobeContext) -> Vec<[f32; 4]> {
        vec![[self.factor, self.roughness, self.normal_scale, 0.0]]
    }

    fn min_roughness(&self) -> f32 {
        match (self.is_present(), self.roughness_texture) {
            (true, None) => self.roughness,
            (true, Some(_)) => 0.0,
            (false, _) => 1.0,
        }
    }

    fn reflects(&self) -> bool {
        self.is_present()
    }
}
