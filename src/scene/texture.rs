//! Textures and their images, and texture look-ups on the CPU for import.

use std::sync::LazyLock;

use glam::{Mat2, Vec2, Vec3, Vec4};

/// The use of a texture by a material (glTF's textureInfo).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureInfo {
    /// Index into [`Scene::textures`](super::Scene::textures).
    pub texture: u32,
    /// Texture coordinate set, an index into [`Vertex::uv`](super::Vertex::uv). KHR_texture_transform may override it.
    pub uv_set: u32,
    /// KHR_texture_transform: uv' = matrix * uv + offset.
    pub matrix: Mat2,
    /// See [`TextureInfo::matrix`].
    pub offset: Vec2,
}

/// Wrap mode of a sampler, per axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Wrap {
    /// Tiles.
    #[default]
    Repeat,
    /// Tiles, every other one mirrored.
    Mirror,
    /// Edge texels extend.
    Clamp,
}

/// Magnification filter of a sampler. As in Cycles there are no mip levels: the samples of the pixel filter minified
/// textures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Filter {
    /// Bilinear.
    #[default]
    Linear,
    /// The nearest texel.
    Nearest,
}

/// Colour space of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ColourSpace {
    /// sRGB-coded colour with linear alpha.
    Srgb,
    /// Linear values.
    Linear,
}

/// An image with a sampler and a colour space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Texture {
    /// Index into [`Scene::images`](super::Scene::images).
    pub image: u32,
    /// Wrap mode along u and v.
    pub wrap: [Wrap; 2],
    /// Filter.
    pub filter: Filter,
    /// Colour space, which follows from the material property that uses the texture.
    pub space: ColourSpace,
}

/// A decoded image, rows top to bottom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextureImage {
    /// Name, URI or `image N`.
    pub name: String,
    /// Width in texels, at least 1.
    pub width: u32,
    /// Height in texels, at least 1.
    pub height: u32,
    /// RGBA values in the code of their colour space, with 8 bits each: those of the file, or made of them where a
    /// material is converted or the image is reduced.
    pub texels: Vec<[u8; 4]>,
}

/// The sRGB decoding function (IEC 61966-2-1): the light of a code from 0 to 1.
pub fn linear_from_srgb(code: f32) -> f32 {
    if code <= 0.040_45 { code / 12.92 } else { ((code + 0.055) / 1.055).powf(2.4) }
}

/// [`linear_from_srgb`] of every byte.
static SRGB_TO_LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|byte| linear_from_srgb(byte as f32 / 255.0)));

impl Wrap {
    /// The texel for coordinate `i`, in texels, on an axis of `size` texels.
    pub(super) fn texel(self, i: i64, size: u32) -> u32 {
        let size = i64::from(size);
        let texel = match self {
            Wrap::Repeat => i.rem_euclid(size),
            Wrap::Mirror => {
                let i = i.rem_euclid(2 * size);
                if i < size { i } else { 2 * size - 1 - i }
            }
            Wrap::Clamp => i.clamp(0, size - 1),
        };
        texel as u32
    }
}

impl TextureImage {
    /// The texel at column `texel[0]` and row `texel[1]`, decoded to linear RGBA.
    pub(super) fn linear(&self, texel: [u32; 2], space: ColourSpace) -> Vec4 {
        let index = texel[1] as usize * self.width as usize + texel[0] as usize;
        let [r, g, b, a] = self.texels[index];
        let plain = |byte: u8| f32::from(byte) / 255.0;
        let colour = |byte: u8| match space {
            ColourSpace::Linear => plain(byte),
            ColourSpace::Srgb => SRGB_TO_LINEAR[byte as usize],
        };
        Vec4::new(colour(r), colour(g), colour(b), plain(a))
    }

    /// The texel whose linear RGBA is nearest to `linear`.
    pub(super) fn coded(linear: Vec4, space: ColourSpace) -> [u8; 4] {
        let plain = |value: f32| (value * 255.0).round() as u8;
        let colour = |value: f32| match space {
            ColourSpace::Linear => plain(value),
            ColourSpace::Srgb => {
                let above = SRGB_TO_LINEAR.partition_point(|code| *code < value).clamp(1, 255);
                let [low, high] = [above - 1, above].map(|code| SRGB_TO_LINEAR[code]);
                (if value - low < high - value { above - 1 } else { above }) as u8
            }
        };
        let [r, g, b, a] = linear.to_array();
        [colour(r), colour(g), colour(b), plain(a)]
    }

    /// The radiance of an RGBD texel: its sRGB colour over its alpha, where an alpha of 0 counts as 1/255. An image
    /// without alpha is a plain colour.
    pub(super) fn rgbd(&self, texel: [u32; 2]) -> Vec3 {
        let coded = self.linear(texel, ColourSpace::Srgb);
        coded.truncate() / coded.w.max(1.0 / 255.0)
    }

    /// Linear RGBA at `uv` (v down, texel centres at half-integers) with the filter and wrap modes of `texture`.
    pub(super) fn sample(&self, texture: &Texture, uv: Vec2) -> Vec4 {
        let at = |x: i64, y: i64| {
            self.linear([texture.wrap[0].texel(x, self.width), texture.wrap[1].texel(y, self.height)], texture.space)
        };
        let position = uv * Vec2::new(self.width as f32, self.height as f32);
        match texture.filter {
            Filter::Nearest => at(position.x.floor() as i64, position.y.floor() as i64),
            Filter::Linear => {
                let corner = (position - 0.5).floor();
                let weight = position - 0.5 - corner;
                let (x, y) = (corner.x as i64, corner.y as i64);
                let top = at(x, y).lerp(at(x.saturating_add(1), y), weight.x);
                let y = y.saturating_add(1);
                top.lerp(at(x, y).lerp(at(x.saturating_add(1), y), weight.x), weight.y)
            }
        }
    }
}
