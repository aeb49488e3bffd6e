//! A panorama of radiance infinitely far away.

use std::fmt;

/// An equirectangular panorama of linear Rec.709 radiance, rows from the zenith (+Y) to the nadir.
///
/// It is turned as in Blender and in the Khronos viewers: its middle column is seen along +X, the column a quarter of the
/// width to the left of it along -Z, the one a quarter to the right along +Z, and its edges meet along -X.
#[derive(Clone, PartialEq)]
pub struct Panorama {
    /// Width in texels, 1 to [`Panorama::MAX_SIDE`].
    pub width: u32,
    /// Height in texels, 1 to [`Panorama::MAX_SIDE`].
    pub height: u32,
    /// Radiance, row by row from the top: `width * height` texels, no channel negative or infinite.
    pub texels: Vec<[f32; 3]>,
}

impl fmt::Debug for Panorama {
    /// Its size: the texels are millions.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Panorama({} x {})", self.width, self.height)
    }
}

impl Panorama {
    /// Largest side in texels: what graphics devices take of a texture.
    pub const MAX_SIDE: u32 = 16_384;

    /// The largest channel of any texel.
    pub(super) fn brightest(&self) -> f32 {
        self.texels.as_flattened().iter().copied().fold(0.0, f32::max)
    }
}
