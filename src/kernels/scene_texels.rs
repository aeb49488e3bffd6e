//! Codes and sizes of the GPU scene that the host writes and the kernels read.

/// Bit of a triangle's material word: the triangle is flat, so the normals at its corners are not used.
pub(crate) const SURFACE_FLAT: u32 = 1 << 31;

/// Bit of a triangle's word in the BVH: its material is an alpha mask or blends.
pub(crate) const TRIANGLE_ALPHA: u32 = 1;
/// Bit of a triangle's word in the BVH: both faces are shaded and store photons.
pub(crate) const TRIANGLE_DOUBLE_SIDED: u32 = 2;

/// Texels of a texture info.
pub(crate) const TEXTURE_INFO_TEXELS: u32 = 3;
/// Bits of a texture info's flags, above two bits of wrap mode for each axis.
pub(crate) const TEXTURE_NEAREST: u32 = 16;
pub(crate) const TEXTURE_SRGB: u32 = 32;
pub(crate) const TEXTURE_UV1: u32 = 64;

/// Texels before those of the rows of cells.
pub(crate) const ENVIRONMENT_HEADER: u32 = 2;
