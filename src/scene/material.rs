//! Materials, and the textures they use.

use std::collections::HashMap;

use glam::{Mat2, Vec2, Vec3, Vec4};

use super::images::{self, Encoded};
use super::json::Json;
use super::notes::Notes;
use super::texture::{ColourSpace, Texture, TextureInfo};
use crate::Result;

/// How the alpha of the base colour is used (glTF 3.9.4).
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// A texel with alpha below the cutoff is a hole.
    Mask {
        /// The cutoff.
        cutoff: f32,
    },
    /// Alpha is the probability that a ray is stopped (stochastic transparency).
    Blend,
}

/// glTF metallic-roughness material with the extensions that Penumbra renders.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name in the file, or `material N`.
    pub name: String,
    /// Linear RGBA factor.
    pub base_colour: Vec4,
    /// Metallic factor, 0 to 1.
    pub metallic: f32,
    /// Roughness factor, 0 to 1; GGX alpha is its square.
    pub roughness: f32,
    /// Emitted radiance: emissive factor times KHR_materials_emissive_strength (for an unlit
    /// material zero: it is [`Material::unlit`]).
    pub emissive: Vec3,
    /// KHR_materials_ior; 1.5 where absent.
    pub ior: f32,
    /// KHR_materials_specular factor; 1 where absent.
    pub specular: f32,
    /// KHR_materials_specular colour factor; one where absent.
    pub specular_colour: Vec3,
    /// KHR_materials_transmission factor, 0 to 1: the part of the base that lets light pass.
    pub transmission: f32,
    /// KHR_materials_volume, where its thickness is not 0: the surface bounds a volume and bends light. None: a thin wall.
    pub volume: Option<Volume>,
    /// KHR_materials_clearcoat factor, 0 to 1.
    pub clearcoat: f32,
    /// KHR_materials_clearcoat roughness, 0 to 1.
    pub clearcoat_roughness: f32,
    /// Scale of the clear coat's normal texture's x and y.
    pub clearcoat_normal_scale: f32,
    /// KHR_materials_anisotropy strength, 0 to 1.
    pub anisotropy: f32,
    /// KHR_materials_anisotropy rotation from the tangent, counter-clockwise, in radians.
    pub anisotropy_rotation: f32,
    /// KHR_materials_sheen colour, each 0 to 1.
    pub sheen_colour: Vec3,
    /// KHR_materials_sheen roughness, 0 to 1.
    pub sheen_roughness: f32,
    /// Scale of the normal texture's x and y.
    pub normal_scale: f32,
    /// Alpha mode.
    pub alpha: AlphaMode,
    /// Both faces are shaded, emit and store photons.
    pub double_sided: bool,
    /// KHR_materials_unlit: shown as its base colour, casts shadows, reflects and emits nothing.
    pub unlit: bool,
    /// Base colour (sRGB) and alpha.
    pub base_colour_texture: Option<TextureInfo>,
    /// Roughness in G, metallic in B.
    pub metallic_roughness_texture: Option<TextureInfo>,
    /// Tangent-space normal.
    pub normal_texture: Option<TextureInfo>,
    /// Ambient occlusion in R. Imported for completeness; global illumination computes occlusion
    /// itself, so, as in Cycles, it does not darken the image.
    pub occlusion_texture: Option<TextureInfo>,
    /// Emission (sRGB).
    pub emissive_texture: Option<TextureInfo>,
    /// Specular factor in A.
    pub specular_texture: Option<TextureInfo>,
    /// Specular colour (sRGB).
    pub specular_colour_texture: Option<TextureInfo>,
    /// Transmission in R.
    pub transmission_texture: Option<TextureInfo>,
    /// Clear coat in R.
    pub clearcoat_texture: Option<TextureInfo>,
    /// Roughness of the clear coat in G.
    pub clearcoat_roughness_texture: Option<TextureInfo>,
    /// Tangent-space normal of the clear coat, which is smooth where there is none, whatever its base is.
    pub clearcoat_normal_texture: Option<TextureInfo>,
    /// Direction of anisotropy in R and G, its strength in B.
    pub anisotropy_texture: Option<TextureInfo>,
    /// Sheen colour (sRGB).
    pub sheen_colour_texture: Option<TextureInfo>,
    /// Sheen roughness in A.
    pub sheen_roughness_texture: Option<TextureInfo>,
}

/// What light passes through inside a closed surface (KHR_materials_volume).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Volume {
    /// World length after which white light has the attenuation colour; infinite where nothing is absorbed.
    pub attenuation_distance: f32,
    /// See [`Volume::attenuation_distance`]; each 0 to 1.
    pub attenuation_colour: Vec3,
}

impl Default for Material {
    /// The material of a primitive that names none (glTF 3.7.2.1).
    fn default() -> Self {
        Material {
            name: "default".into(),
            base_colour: Vec4::ONE,
            metallic: 1.0,
            roughness: 1.0,
            emissive: Vec3::ZERO,
            ior: 1.5,
            specular: 1.0,
            specular_colour: Vec3::ONE,
            transmission: 0.0,
            volume: None,
            clearcoat: 0.0,
            clearcoat_roughness: 0.0,
            clearcoat_normal_scale: 1.0,
            anisotropy: 0.0,
            anisotropy_rotation: 0.0,
            sheen_colour: Vec3::ZERO,
            sheen_roughness: 0.0,
            normal_scale: 1.0,
            alpha: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
            base_colour_texture: None,
            metallic_roughness_texture: None,
            normal_texture: None,
            occlusion_texture: None,
            emissive_texture: None,
            specular_texture: None,
            specular_colour_texture: None,
            transmission_texture: None,
            clearcoat_texture: None,
            clearcoat_roughness_texture: None,
            clearcoat_normal_texture: None,
            anisotropy_texture: None,
            sheen_colour_texture: None,
            sheen_roughness_texture: None,
        }
    }
}

/// The one list of the textures that are seen in an image, of the material before the dot.
macro_rules! shown_slots {
    ($($material:tt)+) => {
        [
            $($material)+.base_colour_texture,
            $($material)+.metallic_roughness_texture,
            $($material)+.normal_texture,
            $($material)+.emissive_texture,
            $($material)+.specular_texture,
            $($material)+.specular_colour_texture,
            $($material)+.transmission_texture,
            $($material)+.clearcoat_texture,
            $($material)+.clearcoat_roughness_texture,
            $($material)+.clearcoat_normal_texture,
            $($material)+.anisotropy_texture,
            $($material)+.sheen_colour_texture,
            $($material)+.sheen_roughness_texture,
        ]
    };
}

impl Material {
    /// The textures it uses.
    pub fn slots(&self) -> impl Iterator<Item = &TextureInfo> {
        self.shown_slots().chain(&self.occlusion_texture)
    }

    /// The textures that are seen in an image: all but occlusion.
    pub fn shown_slots(&self) -> impl Iterator<Item = &TextureInfo> {
        shown_slots!(&self).into_iter().flatten()
    }

    /// The same material without any texture.
    pub(super) fn without_textures(mut self) -> Material {
        for slot in shown_slots!(&mut self) {
            *slot = None;
        }
        Material { occlusion_texture: None, ..self }
    }
}

/// Materials as they are read, and the textures and images they turn out to use.
pub(super) struct Materials {
    /// Materials in the order of the file.
    pub materials: Vec<Material>,
    /// Textures in the order of their first use; [`Texture::image`] indexes [`Materials::images`].
    pub textures: Vec<Texture>,
    /// Images of the file, in the order of their first use.
    pub images: Vec<usize>,
}

struct Reader<'r, 'a> {
    textures: &'r [Json<'a>],
    samplers: &'r [Json<'a>],
    images: &'r [Encoded<'a>],
    known: HashMap<Texture, u32>,
    /// Index into [`Materials::images`] of an image of the file.
    placed: HashMap<usize, u32>,
    out: Materials,
    notes: &'r mut Notes,
}

/// Reads and checks every material, texture and sampler.
pub(super) fn read<'a>(root: &Json<'a>, images: &[Encoded<'a>], notes: &mut Notes) -> Result<Materials> {
    let (textures, samplers) = (root.list("textures")?, root.list("samplers")?);
    for sampler in &samplers {
        images::sampler(Some(sampler))?;
    }
    for texture in &textures {
        texture.get("sampler")?.map_or(Ok(0), |sampler| sampler.index(samplers.len(), "sampler"))?;
        if let Some(source) = texture.get("source")? {
            let image = source.index(images.len(), "image")?;
            if !images[image].is_known() {
                return Err(source.error(format!("image {image} is neither PNG nor JPEG")));
            }
        }
    }
    let out = Materials { materials: Vec::new(), textures: Vec::new(), images: Vec::new() };
    let (known, placed) = Default::default();
    let mut reader = Reader { textures: &textures, samplers: &samplers, images, known, placed, out, notes };
    for (i, material) in root.list("materials")?.iter().enumerate() {
        let material = reader.material(i, material)?;
        reader.out.materials.push(material);
    }
    Ok(reader.out)
}

impl Reader<'_, '_> {
    fn material(&mut self, index: usize, json: &Json) -> Result<Material> {
        use ColourSpace::{Linear, Srgb};
        let mut m =
            Material { name: json.name()?.unwrap_or_else(|| format!("material {index}")), ..Default::default() };
        if let Some(pbr) = json.get("pbrMetallicRoughness")? {
            m.base_colour = pbr.numbers_in::<4>("baseColorFactor", 1.0, 0.0..=1.0)?.into();
            m.metallic = pbr.number_in("metallicFactor", 1.0, 0.0..=1.0)?;
            m.roughness = pbr.number_in("roughnessFactor", 1.0, 0.0..=1.0)?;
            m.base_colour_texture = self.slot(&pbr, "baseColorTexture", Srgb)?;
            m.metallic_roughness_texture = self.slot(&pbr, "metallicRoughnessTexture", Linear)?;
        }
        m.normal_texture = self.slot(json, "normalTexture", Linear)?;
        if let Some(normal) = json.get("normalTexture")? {
            m.normal_scale = normal.number_in("scale", 1.0, ..)?;
        }
        m.occlusion_texture = self.slot(json, "occlusionTexture", Linear)?;
        m.emissive_texture = self.slot(json, "emissiveTexture", Srgb)?;
        m.emissive = json.numbers_in::<3>("emissiveFactor", 0.0, 0.0..)?.into();
        if let Some(emission) = json.extension("KHR_materials_emissive_strength")? {
            m.emissive *= emission.number_in("emissiveStrength", 1.0, 0.0..)?;
            if !m.emissive.is_finite() {
                return Err(emission.error("the emitted radiance is out of range"));
            }
        }
        if let Some(ior) = json.extension("KHR_materials_ior")? {
            m.ior = ior.number_in("ior", 1.5, 0.0..)?;
            // The extension gives 0 a meaning of its own: full reflection.
            if m.ior > 0.0 && m.ior < 1.0 {
                return Err(ior.error(format!("ior {} is out of range: 1 or more, or 0", m.ior)));
            }
        }
        if let Some(specular) = json.extension("KHR_materials_specular")? {
            m.specular = specular.number_in("specularFactor", 1.0, 0.0..=1.0)?;
            m.specular_colour = specular.numbers_in::<3>("specularColorFactor", 1.0, 0.0..)?.into();
            m.specular_texture = self.slot(&specular, "specularTexture", Linear)?;
            m.specular_colour_texture = self.slot(&specular, "specularColorTexture", Srgb)?;
        }
        if let Some(transmission) = json.extension("KHR_materials_transmission")? {
            m.transmission = transmission.number_in("transmissionFactor", 0.0, 0.0..=1.0)?;
            m.transmission_texture = self.slot(&transmission, "transmissionTexture", Linear)?;
        }
        if let Some(volume) = json.extension("KHR_materials_volume")? {
            // How thick says the mesh itself; 0 is a thin wall.
            if volume.number_in("thicknessFactor", 0.0, 0.0..)? > 0.0 {
                m.volume = Some(Volume {
                    attenuation_distance: match volume.get("attenuationDistance")? {
                        Some(_) => volume.number_in("attenuationDistance", 1.0, 0.0..)?,
                        None => f32::INFINITY,
                    },
                    attenuation_colour: volume.numbers_in::<3>("attenuationColor", 1.0, 0.0..=1.0)?.into(),
                });
                if let Some(distance) = volume.get("attenuationDistance")?
                    && m.volume.is_some_and(|v| v.attenuation_distance == 0.0)
                {
                    return Err(distance.error("attenuationDistance is 0: it must be more"));
                }
            }
        }
        if let Some(coat) = json.extension("KHR_materials_clearcoat")? {
            m.clearcoat = coat.number_in("clearcoatFactor", 0.0, 0.0..=1.0)?;
            m.clearcoat_roughness = coat.number_in("clearcoatRoughnessFactor", 0.0, 0.0..=1.0)?;
            m.clearcoat_texture = self.slot(&coat, "clearcoatTexture", Linear)?;
            m.clearcoat_roughness_texture = self.slot(&coat, "clearcoatRoughnessTexture", Linear)?;
            m.clearcoat_normal_texture = self.slot(&coat, "clearcoatNormalTexture", Linear)?;
            if let Some(normal) = coat.get("clearcoatNormalTexture")? {
                m.clearcoat_normal_scale = normal.number_in("scale", 1.0, ..)?;
            }
        }
        if let Some(anisotropy) = json.extension("KHR_materials_anisotropy")? {
            m.anisotropy = anisotropy.number_in("anisotropyStrength", 0.0, 0.0..=1.0)?;
            m.anisotropy_rotation = anisotropy.number_in("anisotropyRotation", 0.0, ..)?;
            m.anisotropy_texture = self.slot(&anisotropy, "anisotropyTexture", Linear)?;
        }
        if let Some(sheen) = json.extension("KHR_materials_sheen")? {
            m.sheen_colour = sheen.numbers_in::<3>("sheenColorFactor", 0.0, 0.0..=1.0)?.into();
            m.sheen_roughness = sheen.number_in("sheenRoughnessFactor", 0.0, 0.0..=1.0)?;
            m.sheen_colour_texture = self.slot(&sheen, "sheenColorTexture", Srgb)?;
            m.sheen_roughness_texture = self.slot(&sheen, "sheenRoughnessTexture", Linear)?;
        }
        let cutoff = json.number_in("alphaCutoff", 0.5, 0.0..)?;
        m.alpha = match json.get("alphaMode")?.map(|mode| mode.string()).transpose()? {
            Some("MASK") => AlphaMode::Mask { cutoff },
            Some("BLEND") => AlphaMode::Blend,
            _ => AlphaMode::Opaque,
        };
        m.double_sided = json.get("doubleSided")?.map_or(Ok(false), |d| d.boolean())?;
        m.unlit = json.extension("KHR_materials_unlit")?.is_some();
        if m.unlit {
            m.emissive = Vec3::ZERO;
        }
        Ok(m)
    }

    fn slot(&mut self, owner: &Json, key: &str, space: ColourSpace) -> Result<Option<TextureInfo>> {
        let Some(json) = owner.get(key)? else { return Ok(None) };
        let index = json.require("index")?.index(self.textures.len(), "texture")?;
        let texture = &self.textures[index];
        let (scale, rotation, offset, uv_override) = match json.extension("KHR_texture_transform")? {
            Some(t) => (
                Vec2::from(t.numbers_in::<2>("scale", 1.0, ..)?),
                t.number_in("rotation", 0.0, ..)?,
                Vec2::from(t.numbers_in::<2>("offset", 0.0, ..)?),
                t.get("texCoord")?,
            ),
            None => (Vec2::ONE, 0.0, Vec2::ZERO, None),
        };
        let uv_set = match uv_override.or(json.get("texCoord")?) {
            Some(set) => set.whole()?,
            None => 0,
        };
        if uv_set > 1 {
            self.notes.push(format!(
                "texture coordinates beyond set 1 are not supported: {key} of some materials is not shown"
            ));
            return Ok(None);
        }
        let Some(source) = texture.get("source")? else {
            self.notes.push(format!("texture {index} has no image that can be shown"));
            return Ok(None);
        };
        let image = self.images[source.index(self.images.len(), "image")?].first;
        let sampler = texture.get("sampler")?.map(|s| s.index(self.samplers.len(), "sampler")).transpose()?;
        let (wrap, filter) = images::sampler(sampler.map(|i| &self.samplers[i]))?;
        let image = *self.placed.entry(image).or_insert_with(|| {
            self.out.images.push(image);
            self.out.images.len() as u32 - 1
        });
        let texture = Texture { image, wrap, filter, space };
        let texture = *self.known.entry(texture).or_insert_with(|| {
            self.out.textures.push(texture);
            self.out.textures.len() as u32 - 1
        });
        // The extension turns coordinates counter-clockwise as seen with v down, after scaling.
        let (s, c) = rotation.sin_cos();
        let matrix = Mat2::from_cols(Vec2::new(c, -s) * scale.x, Vec2::new(s, c) * scale.y);
        Ok(Some(TextureInfo { texture, uv_set: uv_set as u32, matrix, offset }))
    }
}
