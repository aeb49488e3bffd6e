//! Indices of refraction that depend on the wavelength: KHR_materials_dispersion.

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::TextureInfo;

use super::volume::MIN_BENDING;

/// KHR_materials_dispersion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Dispersion {
    /// 20 over the Abbe number; 0 for an index of refraction that is the same for all wavelengths.
    pub strength: f32,
}

impl Dispersion {
    /// One of that strength.
    pub const fn new(strength: f32) -> Dispersion {
        Dispersion { strength }
    }
}

impl Lobe for Dispersion {
    const EXTENSION: &'static str = "KHR_materials_dispersion";
    const LAYOUT: Layout =
        Layout { texel: "DISPERSION_TEXEL", texels: 1, mask: "DISPERSION_TEXTURES", textures: &[], constants: &[] };

    fn read(material: &Json, _: &mut dyn ReadTexture) -> Result<Self> {
        let Some(json) = material.extension(Self::EXTENSION)? else { return Ok(Self::default()) };
        Ok(Dispersion { strength: json.number_in("dispersion", 0.0, 0.0..)? })
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        Vec::new()
    }

    fn without_textures(self) -> Self {
        self
    }

    /// The index of refraction of green light minus that of red light, which is also that of blue minus that of green.
    /// The colours stand for the lines d, C and F.
    fn texels(&self, context: &LobeContext) -> Vec<[f32; 4]> {
        let above_one = context.ior - 1.0;
        // The extension's strength is 20 over the Abbe number (n - 1) / (n_F - n_C), and this is half of n_F - n_C. The
        // index for red stays above 1.
        let spread = (above_one * 0.025 * self.strength).min(above_one - MIN_BENDING).max(0.0);
        vec![[spread / context.outside, 0.0, 0.0, 0.0]]
    }
}
