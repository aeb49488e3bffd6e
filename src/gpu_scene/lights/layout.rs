//! How lights lie in the table of lights, and what the host knows of each.

use glam::Vec3;

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
/// Length of a mesh light's contours, and where its views are.
pub(crate) const CONTOUR_TEXEL: u32 = 3;
/// Cosine of a spot light's inner cone angle.
pub(crate) const CONE_TEXEL: u32 = 4;
/// Bounding sphere of the scene, of lights that are infinitely far away.
pub(crate) const DISC_TEXEL: u32 = 4;
/// Cumulative probability, probability, strength and axis, by which lights are sampled.
pub(crate) const SAMPLING_TEXEL: u32 = 5;

/// Cells a side of the octahedral map from which a convex light is seen, some 7 degrees wide each. What the points of a
/// sphere bring then spreads by 8 % about its mean; by 59 % where power alone chooses them.
pub(crate) const VIEW_SIDE: u32 = 16;

/// Radii of a light from whose middle it is far. Nearer, what its triangles show depends on the position and not on the
/// direction alone.
pub(crate) const NEAR_LIGHT: f64 = 2.0;

/// Maximum number of triangles of a light that samples all of them by what they send, wherever it is. A square has two.
pub(crate) const FEW_EMITTERS: u32 = 4;

/// Maximum number of triangles of a light that samples all of them where it is near: each costs some tenth of a shadow
/// ray.
pub(crate) const FEW_NEAR_EMITTERS: u32 = 15;

/// [`Emission::axis`] where there is none, in the table: no normal has this code, as -32768 is no signed 16-bit
/// fraction.
pub(crate) const NO_AXIS: u32 = 0x8000_8000;

/// The texels of a light. What its sampling needs is added once all lights are known.
pub(super) type LightTexels = [[u32; 4]; TEXELS as usize];

/// A light as it is packed.
pub(super) struct Packed {
    pub texels: LightTexels,
    pub info: LightInfo,
}

/// Packs texels by their offsets; the others are zero.
pub(super) fn texels<const N: usize>(of: [(u32, [u32; 4]); N]) -> LightTexels {
    let mut texels = [[0; 4]; TEXELS as usize];
    for (offset, texel) in of {
        texels[offset as usize] = texel;
    }
    texels
}

pub(super) fn bits(v: Vec3, w: f32) -> [u32; 4] {
    v.extend(w).to_array().map(f32::to_bits)
}

/// Mean of the three channels.
pub(super) fn mean(v: Vec3) -> f64 {
    v.as_dvec3().element_sum() / 3.0
}

/// What the host knows of a light.
#[derive(Clone, Debug, PartialEq)]
pub struct LightInfo {
    /// Emitted power, mean of the three channels, in the units of the file over normalised lengths squared. Of a
    /// directional light and of the environment: through the disc that covers the scene.
    pub power: f64,
    /// The share of that which photons carry: those towards the receiver bounds, where these are known.
    pub received_share: f64,
    /// What it sends where, about.
    pub emission: Emission,
    /// [`crate::scene::LightKind::Mesh`] of uniform radiance and few edges, or a punctual light.
    pub closed_form: bool,
    /// Edges of its contours; 0 where there is no closed form and of punctual lights.
    pub contour_edges: usize,
    /// Both sides emit.
    pub two_sided: bool,
    /// A point, spot or directional light: one shadow ray tells all.
    pub punctual: bool,
    /// All its emitter triangles lie in one plane and face the same way.
    pub planar: bool,
    /// Centre of a sphere around the light; of a directional light around the scene.
    pub centre: Vec3,
    /// Radius of that sphere; 0 of point and spot lights, and of the environment.
    pub radius: f32,
}

impl LightInfo {
    /// That of a punctual light.
    pub(super) fn punctual(power: f64, strength: f64, centre: Vec3, radius: f32) -> LightInfo {
        LightInfo {
            power,
            received_share: 1.0,
            emission: Emission { strength, axis: None },
            closed_form: true,
            contour_edges: 0,
            two_sided: false,
            punctual: true,
            planar: false,
            centre,
            radius,
        }
    }
}

/// About what a light sends into a direction, mean of the three channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emission {
    /// Largest radiant intensity, or the mean over all directions where there is no axis; of directional lights and the
    /// environment irradiance.
    pub strength: f64,
    /// The normal of a light that lies in a plane and shines from one side, by the cosine law.
    pub axis: Option<Vec3>,
}
