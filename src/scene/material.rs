//! Materials: their parameters, the textures they use, and how kernels find them. Each lobe is a file of its own.

mod lobe;
pub mod lobes;
pub(super) mod specular_glossiness;

use std::collections::HashMap;

use glam::{Mat2, Vec2, Vec3, Vec4};

use super::images::{self, Encoded, Form, Use};
use super::json::Json;
use super::notes::Notes;
use super::texture::{ColourSpace, Texture, TextureInfo};
use crate::Result;

use lobe::{Layout, Lobe, LobeContext, ReadTexture};
use lobes::*;
use specular_glossiness::{Converted, INFINITE_IOR};

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

/// The volume of another object that a surface lies in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium {
    /// Its index of refraction.
    pub ior: f32,
    /// The volume's absorption.
    pub volume: Volume,
}

/// The material, and what has to be done for each of its lobes: fields given by documentation, name and type.
macro_rules! material {
    ($($(#[$doc:meta])* $lobe:ident: $type:ty),* $(,)?) => {
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
            /// Emitted radiance: emissive factor times KHR_materials_emissive_strength; zero where [`Material::unlit`].
            pub emissive: Vec3,
            /// KHR_materials_ior; 1.5 where absent. 0 stands for an infinite index, which reflects all light.
            pub ior: f32,
            /// Scale of the normal texture's x and y.
            pub normal_scale: f32,
            /// Alpha mode.
            pub alpha: AlphaMode,
            /// Both faces emit light and store photons. Without it only the front does; both are shaded in either case.
            pub double_sided: bool,
            /// KHR_materials_unlit: shown as its base colour, casts shadows, reflects and emits nothing.
            pub unlit: bool,
            /// The volume that the surface lies in; `None` for air. Import finds it: [`Medium`].
            pub medium: Option<Medium>,
            /// Base colour (sRGB) and alpha.
            pub base_colour_texture: Option<TextureInfo>,
            /// Roughness in G, metallic in B.
            pub metallic_roughness_texture: Option<TextureInfo>,
            /// Tangent-space normal.
            pub normal_texture: Option<TextureInfo>,
            /// Emission (sRGB).
            pub emissive_texture: Option<TextureInfo>,
            $($(#[$doc])* pub $lobe: $type,)*
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
                    normal_scale: 1.0,
                    alpha: AlphaMode::Opaque,
                    double_sided: false,
                    unlit: false,
                    medium: None,
                    base_colour_texture: None,
                    metallic_roughness_texture: None,
                    normal_texture: None,
                    emissive_texture: None,
                    $($lobe: Default::default(),)*
                }
            }
        }

        /// Layouts of all lobes, in the order of their texels and textures.
        const LAYOUTS: &[Layout] = &[$(<$type as Lobe>::LAYOUT),*];

        /// The glTF extensions that the lobes are read from.
        pub(super) const LOBE_EXTENSIONS: &[&str] = &[$(<$type as Lobe>::EXTENSION),*];

        impl Material {
            fn read_lobes(&mut self, json: &Json, textures: &mut dyn ReadTexture) -> Result<()> {
                $(self.$lobe = Lobe::read(json, textures)?;)*
                Ok(())
            }

            fn lobe_textures(&self) -> impl Iterator<Item = &Option<TextureInfo>> {
                std::iter::empty()$(.chain(self.$lobe.textures()))*
            }

            fn lobe_texels(&self, context: &LobeContext) -> Vec<[f32; 4]> {
                let mut texels = Vec::new();
                $(texels.extend(self.$lobe.texels(context));)*
                texels
            }

            fn lobes_without_textures(self) -> Material {
                Material { $($lobe: self.$lobe.without_textures(),)* ..self }
            }

            /// The textures whose coordinates define tangents for triangles that have none.
            pub(crate) fn tangent_textures(&self) -> impl Iterator<Item = TextureInfo> {
                self.normal_texture.into_iter()$(.chain(self.$lobe.tangent_texture()))*
            }

            /// Some lobe reflects light whatever the base and the specular factor are.
            fn has_reflecting_lobe(&self) -> bool {
                false $(|| self.$lobe.reflects())*
            }

            /// Some lobe lets light pass, as far as the base has a colour.
            pub(crate) fn has_transmitting_lobe(&self) -> bool {
                false $(|| self.$lobe.transmits())*
            }

            /// Some lobe takes all light from the diffuse base, wherever it is on the surface.
            fn replaces_base(&self) -> bool {
                false $(|| self.$lobe.replaces_base())*
            }

            /// Lower bound of the roughness of all microfacets; 0 if a texture may make them smooth.
            pub(crate) fn min_roughness(&self) -> f32 {
                let base = if self.metallic_roughness_texture.is_some() { 0.0 } else { self.roughness };
                base$(.min(self.$lobe.min_roughness()))*
            }
        }
    };
}

material! {
    /// The specular lobe.
    specular: Specular,
    /// The part that lets light pass.
    transmission: Transmission,
    /// The volume behind the surface, if the file's thickness is not 0: the surface then bends light. `None`: a thin
    /// wall.
    volume: Option<Volume>,
    /// The clear coat.
    clearcoat: Clearcoat,
    /// Reflections spread along a tangent.
    anisotropy: Anisotropy,
    /// The sheen of fibres.
    sheen: Sheen,
    /// A thin film on the specular lobe.
    iridescence: Iridescence,
    /// The part of the diffuse base that lets light pass.
    diffuse_transmission: DiffuseTransmission,
    /// How the index of refraction depends on the wavelength.
    dispersion: Dispersion,
}

impl Material {
    /// The textures it uses. As in Cycles, occlusion is not among them, because global illumination computes it.
    pub fn texture_infos(&self) -> impl Iterator<Item = &TextureInfo> {
        self.texture_uses().flatten()
    }

    /// The texture that it has or could have for each use, in the order of the kernels' constants.
    pub(crate) fn texture_uses(&self) -> impl Iterator<Item = &Option<TextureInfo>> {
        let base =
            [&self.base_colour_texture, &self.metallic_roughness_texture, &self.normal_texture, &self.emissive_texture];
        base.into_iter().chain(self.lobe_textures())
    }

    /// The same material without any texture.
    pub(super) fn without_textures(self) -> Material {
        Material {
            base_colour_texture: None,
            metallic_roughness_texture: None,
            normal_texture: None,
            emissive_texture: None,
            ..self.lobes_without_textures()
        }
    }

    /// Reflects only as a Lambertian: no metal, no dielectric layer and no other lobe.
    pub(crate) fn is_lambertian(&self) -> bool {
        let bare = self.metallic == 0.0 && self.specular.factor == 0.0;
        self.unlit || (bare && !self.has_transmitting_lobe() && !self.has_reflecting_lobe())
    }

    /// Refracts each wavelength its own way.
    pub(crate) fn disperses(&self) -> bool {
        self.dispersion.strength > 0.0 && self.transmission.is_present() && self.volume.is_some()
    }

    /// Reflects nothing and lets nothing pass.
    pub(crate) fn is_black(&self) -> bool {
        self.unlit || (self.is_lambertian() && self.base_colour.truncate() == Vec3::ZERO)
    }

    /// Some part of the surface may reflect light diffusely, as far as factors tell: textures only darken it.
    pub(crate) fn may_be_diffuse(&self) -> bool {
        let metal = self.metallic >= 1.0 && self.metallic_roughness_texture.is_none();
        let black = self.base_colour.truncate() == Vec3::ZERO;
        !self.unlit && !black && !metal && !self.replaces_base()
    }

    /// Emits light, and reflects nothing and lets nothing pass.
    pub(crate) fn is_black_lamp(&self) -> bool {
        let reflects = self.base_colour.truncate() != Vec3::ZERO || self.specular.factor > 0.0;
        let has_lobes = self.has_reflecting_lobe() || self.has_transmitting_lobe();
        self.emissive != Vec3::ZERO && !reflects && !has_lobes
    }

    /// Lets light pass, as far as the base has a colour.
    pub(crate) fn lets_light_pass(&self) -> bool {
        !self.unlit && self.has_transmitting_lobe()
    }

    /// Has a volume behind its surface that light enters. Without a lobe that lets light pass, KHR_materials_volume has
    /// no effect.
    pub(crate) fn encloses_volume(&self) -> bool {
        self.volume.is_some() && self.lets_light_pass()
    }

    /// Rays may pass it because of its alpha, as far as factors tell. `fades`: whether vertices have an alpha below 1.
    pub(crate) fn has_gaps(&self, fades: impl Fn() -> bool) -> bool {
        let varies = || self.base_colour_texture.is_some() || fades();
        match self.alpha {
            AlphaMode::Opaque => false,
            AlphaMode::Mask { cutoff } => self.base_colour.w < cutoff || varies(),
            AlphaMode::Blend => self.base_colour.w < 1.0 || varies(),
        }
    }

    /// Emits light into the volume behind its surface, which absorbs light.
    pub(crate) fn emits_into_volume(&self) -> bool {
        let absorbs = self.volume.is_some_and(|volume| volume.absorption(1.0) != [0.0; 3]) && self.encloses_volume();
        self.emissive != Vec3::ZERO && self.double_sided && absorbs
    }

    /// Its texels in the table of materials, [`MATERIAL_TEXELS`] of them. `infos` are the numbers of its texture infos,
    /// counted from 1, in the order of [`Material::texture_uses`]; 0 for none. `scale` is the factor from world lengths
    /// to normalised ones.
    pub(crate) fn texels(&self, scale: f64, infos: &[u32]) -> Vec<[u32; 4]> {
        let (alpha, cutoff) = match self.alpha {
            AlphaMode::Opaque => (0, 0.0),
            AlphaMode::Mask { cutoff } => (MASK, cutoff),
            AlphaMode::Blend => (BLEND, 0.0),
        };
        let flag = |flag: u32, on: bool| if on { flag } else { 0 };
        let faces = flag(DOUBLE_SIDED, self.double_sided) | flag(UNLIT, self.unlit);
        let lobes = flag(DIFFUSE, self.may_be_diffuse()) | flag(TRANSMITS, self.lets_light_pass());
        let flags = alpha | faces | lobes;
        let outside = self.medium.map_or(1.0, |medium| medium.ior);
        let absorption = self.medium.map_or([0.0; 3], |medium| medium.volume.absorption(scale));
        // Reflectance at normal incidence, KHR_materials_ior.
        let ior = self.ior / outside;
        let f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
        let [red, green, blue] = absorption;
        let base = [
            self.base_colour.to_array(),
            self.emissive.extend(self.metallic).to_array(),
            [self.roughness, f0, self.normal_scale, cutoff],
            [red, green, blue, 0.0],
        ];
        let encloses_volume = self.encloses_volume();
        let lobes = self.lobe_texels(&LobeContext { scale, ior: self.ior, outside, absorption, encloses_volume });
        let textures = infos.iter().enumerate().fold(0, |mask, (i, info)| mask | u32::from(*info != 0) << i);
        let mut words = vec![flags | textures << FLAG_BITS];
        words.extend(infos);
        words.resize(words.len().next_multiple_of(4), 0);
        let texels = base.into_iter().chain(lobes).map(|texel| texel.map(f32::to_bits));
        texels.chain(words.chunks_exact(4).map(|four| [four[0], four[1], four[2], four[3]])).collect()
    }
}

/// Bits of a material's flags.
const DOUBLE_SIDED: u32 = 1;
const UNLIT: u32 = 2;
const MASK: u32 = 4;
const BLEND: u32 = 8;
const DIFFUSE: u32 = 16;
const TRANSMITS: u32 = 32;
/// Number of those bits. Above them lies a bit for each texture.
const FLAG_BITS: u32 = 6;

/// Uses of textures that every material may have, in the order of [`Material::texture_uses`].
const BASE_TEXTURES: [&str; 4] =
    ["BASE_COLOUR_TEXTURE", "METALLIC_ROUGHNESS_TEXTURE", "NORMAL_TEXTURE", "EMISSION_TEXTURE"];

/// Texels that every material has before those of its lobes.
const BASE_TEXELS: [&str; 4] = ["BASE_COLOUR_TEXEL", "EMISSION_TEXEL", "SURFACE_TEXEL", "MEDIUM_TEXEL"];

/// Uses of textures that a material may have.
pub(crate) const TEXTURE_USES: usize = {
    let (mut count, mut lobe) = (BASE_TEXTURES.len(), 0);
    while lobe < LAYOUTS.len() {
        count += LAYOUTS[lobe].textures.len();
        lobe += 1;
    }
    count
};

/// Offset of the texels with the flags and the texture infos: after those of the lobes.
const TEXTURES_TEXEL: usize = {
    let (mut count, mut lobe) = (BASE_TEXELS.len(), 0);
    while lobe < LAYOUTS.len() {
        count += LAYOUTS[lobe].texels;
        lobe += 1;
    }
    count
};

/// Texels of a material in the table of materials.
pub(crate) const MATERIAL_TEXELS: usize = TEXTURES_TEXEL + (1 + TEXTURE_USES).div_ceil(4);

/// Numbers by which kernels find a material's texels and textures.
pub(crate) fn constants() -> Vec<(&'static str, u32)> {
    let mut constants = vec![
        ("MATERIAL_TEXELS", MATERIAL_TEXELS as u32),
        ("TEXTURES_TEXEL", TEXTURES_TEXEL as u32),
        ("MATERIAL_FLAG_BITS", FLAG_BITS),
        ("MATERIAL_DOUBLE_SIDED", DOUBLE_SIDED),
        ("MATERIAL_UNLIT", UNLIT),
        ("MATERIAL_MASK", MASK),
        ("MATERIAL_BLEND", BLEND),
        ("MATERIAL_DIFFUSE", DIFFUSE),
        ("MATERIAL_TRANSMITS", TRANSMITS),
    ];
    constants.extend((0..).zip(BASE_TEXELS).map(|(i, name)| (name, i)));
    constants.extend((0..).zip(BASE_TEXTURES).map(|(i, name)| (name, i)));
    let (mut texel, mut texture) = (BASE_TEXELS.len() as u32, BASE_TEXTURES.len() as u32);
    for layout in LAYOUTS {
        constants.push((layout.texel, texel));
        texel += layout.texels as u32;
        let textures = layout.textures.len() as u32;
        constants.extend((texture..).zip(layout.textures).map(|(i, name)| (*name, i)));
        constants.push((layout.mask, ((1 << textures) - 1) << texture));
        texture += textures;
        constants.extend(layout.constants);
    }
    constants
}

/// Materials as they are read, and the textures and images they turn out to use.
pub(super) struct Materials {
    /// Materials in the order of the file.
    pub materials: Vec<Material>,
    /// Textures in the order of their first use; [`Texture::image`] indexes [`Materials::images`].
    pub textures: Vec<Texture>,
    /// Images of the file, in the order of their first use.
    pub images: Vec<Use>,
}

impl Materials {
    /// The images, and the colour spaces that they are shown in: sRGB for one that is shown in both.
    pub fn images_in_spaces(&self) -> Vec<(Use, ColourSpace)> {
        let mut used: Vec<_> = self.images.iter().map(|shown| (*shown, ColourSpace::Linear)).collect();
        for texture in self.textures.iter().filter(|texture| texture.space == ColourSpace::Srgb) {
            used[texture.image as usize].1 = ColourSpace::Srgb;
        }
        used
    }
}

struct Reader<'r, 'a> {
    textures: &'r [Json<'a>],
    samplers: &'r [Json<'a>],
    images: &'r [Encoded<'a>],
    known: HashMap<Texture, u32>,
    /// Index into [`Materials::images`] of an image of the file.
    placed: HashMap<Use, u32>,
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
        images::source(texture, images)?;
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
        // The extension takes the place of metal and roughness, whose textures are not read then.
        let converted = specular_glossiness::read(json, self)?;
        if let Some(pbr) = json.get("pbrMetallicRoughness")?.filter(|_| converted.is_none()) {
            m.base_colour = pbr.numbers_in::<4>("baseColorFactor", 1.0, 0.0..=1.0)?.into();
            m.metallic = pbr.number_in("metallicFactor", 1.0, 0.0..=1.0)?;
            m.roughness = pbr.number_in("roughnessFactor", 1.0, 0.0..=1.0)?;
            m.base_colour_texture = self.texture(&pbr, "baseColorTexture", Srgb)?;
            m.metallic_roughness_texture = self.texture(&pbr, "metallicRoughnessTexture", Linear)?;
        }
        m.normal_texture = self.texture(json, "normalTexture", Linear)?;
        if let Some(normal) = json.get("normalTexture")? {
            m.normal_scale = normal.number_in("scale", 1.0, ..)?;
        }
        m.emissive_texture = self.texture(json, "emissiveTexture", Srgb)?;
        m.emissive = json.numbers_in::<3>("emissiveFactor", 0.0, 0.0..)?.into();
        if m.emissive_texture.is_none() && json.get("emissiveTexture")?.is_some() {
            // Without its texture, which cannot be shown, the whole surface would be a lamp.
            m.emissive = Vec3::ZERO;
        }
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
        m.read_lobes(json, self)?;
        if let Some(converted) = converted {
            let Converted { base_colour, base_colour_texture, roughness, roughness_texture, specular } = converted;
            let metallic_roughness_texture = roughness_texture;
            let (metallic, ior) = (0.0, INFINITE_IOR);
            m = Material { base_colour, base_colour_texture, metallic, roughness, ior, specular, ..m };
            m = Material { metallic_roughness_texture, ..m };
        }
        let cutoff = json.number_in("alphaCutoff", 0.5, 0.0..)?;
        if let Some(mode) = json.get("alphaMode")? {
            m.alpha = match mode.string()? {
                "OPAQUE" => AlphaMode::Opaque,
                "MASK" => AlphaMode::Mask { cutoff },
                "BLEND" => AlphaMode::Blend,
                other => return Err(mode.error(format!("is '{other}', not OPAQUE, MASK or BLEND"))),
            };
        }
        m.double_sided = json.get("doubleSided")?.map_or(Ok(false), |d| d.boolean())?;
        m.unlit = json.extension("KHR_materials_unlit")?.is_some();
        if m.unlit {
            m.emissive = Vec3::ZERO;
        }
        Ok(m)
    }
}

impl ReadTexture for Reader<'_, '_> {
    fn texture_of_form(
        &mut self,
        owner: &Json,
        key: &str,
        space: ColourSpace,
        form: Form,
    ) -> Result<Option<TextureInfo>> {
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
        let Some(image) = images::source(texture, self.images)? else {
            self.notes.push(format!("texture {index} has no image that can be shown"));
            return Ok(None);
        };
        let image = self.images[image].first;
        if self.images[image].is_broken() {
            return Ok(None);
        }
        let sampler = texture.get("sampler")?.map(|s| s.index(self.samplers.len(), "sampler")).transpose()?;
        let (wrap, filter) = images::sampler(sampler.map(|i| &self.samplers[i]))?;
        let shown = Use { image, form };
        let image = *self.placed.entry(shown).or_insert_with(|| {
            self.out.images.push(shown);
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
