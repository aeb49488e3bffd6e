//! The extension KHR_materials_pbrSpecularGlossiness, as a metallic-roughness material with a specular lobe.
//!
//! A dielectric whose index of refraction is infinite reflects its specular colour at normal incidence, and its
//! specular factor of 1 at grazing angles: the Fresnel term of the extension. Its base colour is what the extension
//! calls the diffuse colour, diffuse (1 - max(specular)), and its roughness is 1 - glossiness. The conversion is exact
//! but for textures of specular and glossiness: their glossiness becomes a texture of roughness, rounded to 1/255, and
//! the factor 1 - max(specular) is left out, because it differs from texel to texel. That is 4 % for the usual
//! dielectric.

use glam::{Vec3, Vec4};

use super::lobe::ReadTexture;
use super::lobes::Specular;
use crate::Result;
use crate::scene::images::Form;
use crate::scene::json::Json;
use crate::scene::texture::{ColourSpace, TextureInfo};

/// Name of the extension.
pub(in crate::scene) const EXTENSION: &str = "KHR_materials_pbrSpecularGlossiness";

/// The index of refraction that stands for infinity; its reflectance at normal incidence is 1.
pub(super) const INFINITE_IOR: f32 = 0.0;

/// The parts of a metallic-roughness material that the extension replaces. It has no metal.
pub(super) struct Converted {
    pub base_colour: Vec4,
    pub base_colour_texture: Option<TextureInfo>,
    pub roughness: f32,
    pub roughness_texture: Option<TextureInfo>,
    pub specular: Specular,
}

/// Reads the extension of a material, if it has it.
pub(super) fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Option<Converted>> {
    let Some(json) = material.extension(EXTENSION)? else { return Ok(None) };
    const TEXTURE: &str = "specularGlossinessTexture";
    let diffuse: Vec4 = json.numbers_in::<4>("diffuseFactor", 1.0, 0.0..=1.0)?.into();
    let colour: Vec3 = json.numbers_in::<3>("specularFactor", 1.0, 0.0..=1.0)?.into();
    let glossiness = json.number_in("glossinessFactor", 1.0, 0.0..=1.0)?;
    let base_colour_texture = textures.texture(&json, "diffuseTexture", ColourSpace::Srgb)?;
    let colour_texture = textures.texture(&json, TEXTURE, ColourSpace::Srgb)?;
    let form = Form::roughness(glossiness);
    let roughness_texture = textures.texture_of_form(&json, TEXTURE, ColourSpace::Linear, form)?;
    let reflected = if colour_texture.is_some() { 0.0 } else { colour.max_element() };
    Ok(Some(Converted {
        base_colour: (diffuse.truncate() * (1.0 - reflected)).extend(diffuse.w),
        base_colour_texture,
        roughness: if roughness_texture.is_some() { 1.0 } else { 1.0 - glossiness },
        roughness_texture,
        specular: Specular { factor: 1.0, colour, texture: None, colour_texture },
    }))
}
