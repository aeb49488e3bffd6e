//! The layout of the table of lights: the codes and offsets that the host writes and the kernels read.

/// Codes of the kinds of lights, and flags, in the first word of a light's texels.
pub(crate) const MESH: u32 = 0;
pub(crate) const POINT: u32 = 1;
pub(crate) const SPOT: u32 = 2;
pub(crate) const DIRECTIONAL: u32 = 3;
pub(crate) const ENVIRONMENT: u32 = 4;
pub(crate) const KIND_MASK: u32 = 7;
pub(crate) const TWO_SIDED: u32 = 8;
pub(crate) const CLOSED_FORM: u32 = 16;
/// Some of the surface may be missing: its material is an alpha mask or blends.
pub(crate) const COVERAGE: u32 = 32;
pub(crate) const VIEWED: u32 = 64;

/// Texels before the first light's: numbers of lights and emitter triangles; the bounds of the receivers.
pub(crate) const HEADER: u32 = 2;
pub(crate) const RECEIVERS_TEXEL: u32 = 1;
/// Texels of a light, and of an emitter triangle.
pub(crate) const TEXELS: u32 = 6;
pub(crate) const EMITTER_TEXELS: u32 = 4;
/// Offset within an emitter triangle's texels, whose first three are its corners: its partner and its probability.
pub(crate) const EMITTER_SAMPLING_TEXEL: u32 = 3;

/// Offsets within a light's texels: kind, flags and, of a mesh light, where its emitter triangles and contours are.
pub(crate) const KIND_TEXEL: u32 = 0;
/// Position and range of a point or spot light.
pub(crate) const POSITION_TEXEL: u32 = 1;
/// Bounding sphere of a mesh light.
pub(crate) const SPHERE_TEXEL: u32 = 1;
/// Radiance, intensity or irradiance.
pub(crate) const EMISSION_TEXEL: u32 = 2;
/// Direction of a spot or directional light, and the cosine of the outer cone angle.
pub(crate) const AXIS_TEXEL: u32 = 3;
/// Length of a mesh light's contours, where its views are, and the number of their cells a side.
pub(crate) const CONTOUR_TEXEL: u32 = 3;
/// Cosine of a spot light's inner cone angle.
pub(crate) const CONE_TEXEL: u32 = 4;
/// Bounding sphere of the scene, of lights that are infinitely far away.
pub(crate) const DISC_TEXEL: u32 = 4;
/// Cumulative probability, probability, strength and axis, by which lights are sampled.
pub(crate) const SAMPLING_TEXEL: u32 = 5;

/// Distance from the middle of a light, in its radii, beyond which a position is far from it. Nearer, the visible part
/// of its triangles depends on the position, and not on the direction alone. Other distances were not compared.
pub(crate) const NEAR_LIGHT: f64 = 2.0;

/// Maximum number of triangles of a light for which every position evaluates all of them, and samples one by the light
/// that each sends. A square has two. Other numbers were not compared.
pub(crate) const FEW_EMITTERS: u32 = 4;

/// Maximum number of triangles of a light for which near positions evaluate all of them. Each triangle costs about a
/// tenth of a shadow ray.
pub(crate) const FEW_NEAR_EMITTERS: u32 = 15;

/// The code in the table for the axis of a light that emits to all sides alike. No normal has it, because -32768 is no
/// signed 16-bit fraction.
pub(crate) const NO_AXIS: u32 = 0x8000_8000;
