//! Panoramas: radiance from infinitely far away.

use std::fmt;

/// An equirectangular panorama of linear Rec.709 radiance, rows from the zenith (+Y) to the nadir.
///
/// The orientation is that of Blender and the Khronos viewers: the middle column is seen along +X, the column a quarter
/// of the width to the left of it along -Z, the column a quarter to the right along +Z. The edges meet along -X.
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
    /// Prints only the size, as there are millions of texels.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Panorama({} x {})", self.width, self.height)
    }
}

impl Panorama {
    /// Maximum width and height in texels, the common texture limit of graphics devices.
    pub const MAX_SIDE: u32 = 16_384;

    /// The largest channel of any texel.
    pub(super) fn brightest(&self) -> f32 {
        self.texels.as_flattened().iter().copied().fold(0.0, f32::max)
    }
}
