//! The volume behind a surface (KHR_materials_volume).

use glam::Vec3;

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::TextureInfo;

/// The medium inside a closed surface (KHR_materials_volume).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Volume {
    /// World length after which white light has the attenuation colour; infinite where nothing is absorbed.
    pub attenuation_distance: f32,
    /// See [`Volume::attenuation_distance`]; each 0 to 1.
    pub attenuation_colour: Vec3,
}

/// Minimum difference of a relative index of refraction from 1. Nearer to 1, the half vector of refraction is a
/// difference of almost equal vectors with too few digits, so light passes straight.
pub(super) const MIN_BENDING: f32 = 1e-3;

impl Volume {
    /// Absorption by normalised length: over the attenuation distance, light becomes the attenuation colour (Beer and
    /// Lambert).
    pub(in crate::scene::material) fn absorption(&self, scale: f64) -> [f32; 3] {
        let distance = f64::from(self.attenuation_distance) * scale;
        // A colour of 0 would have an infinite logarithm. e^-80 is less than any radiance that shows.
        self.attenuation_colour.to_array().map(|c| (-f64::from(c).ln().max(-80.0) / distance) as f32)
    }

    fn read(json: &Json) -> Result<Option<Volume>> {
        // How thick it is follows from the mesh; 0 stands for a thin wall.
        if json.number_in("thicknessFactor", 0.0, 0.0..)? <= 0.0 {
            return Ok(None);
        }
        let volume = Volume {
            attenuation_distance: match json.get("attenuationDistance")? {
                Some(_) => json.number_in("attenuationDistance", 1.0, 0.0..)?,
                None => f32::INFINITY,
            },
            attenuation_colour: json.numbers_in::<3>("attenuationColor", 1.0, 0.0..=1.0)?.into(),
        };
        if let Some(distance) = json.get("attenuationDistance")?
            && volume.attenuation_distance == 0.0
        {
            return Err(distance.error("attenuationDistance is 0: it must be more"));
        }
        Ok(Some(volume))
    }
}

impl Lobe for Option<Volume> {
    const EXTENSION: &'static str = "KHR_materials_volume";
    const LAYOUT: Layout =
        Layout { texel: "VOLUME_TEXEL", texels: 1, mask: "VOLUME_TEXTURES", textures: &[], constants: &[] };

    fn read(material: &Json, _: &mut dyn ReadTexture) -> Result<Self> {
        material.extension(Self::EXTENSION)?.map_or(Ok(None), |json| Volume::read(&json))
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        Vec::new()
    }

    fn without_textures(self) -> Self {
        self
    }

    /// Absorption, and the index of refraction by which light that passes is bent, relative to that around: 1 for a
    /// thin wall.
    fn texels(&self, context: &LobeContext) -> Vec<[f32; 4]> {
        let ior = context.ior / context.outside;
        let own = self.filter(|_| context.encloses_volume);
        let bends = own.is_some() && (ior - 1.0).abs() >= MIN_BENDING;
        // An index of 0 stands for an infinite one, which reflects all.
        let refraction = if bends && ior > 0.0 { ior } else { 1.0 };
        // A surface without a volume of its own has the same medium on both sides.
        let absorption = own.map(|volume| volume.absorption(context.scale));
        let [red, green, blue] = absorption.unwrap_or(context.absorption);
        vec![[red, green, blue, refraction]]
    }
}
