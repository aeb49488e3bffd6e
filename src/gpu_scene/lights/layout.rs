//! The layout of a light in the table of lights, and the facts of a light that the host keeps.

use glam::Vec3;

pub(crate) use crate::kernels::light_texels::*;
use crate::specialisation::{LightFacts, Sphere};

/// The texels of a light. The data for sampling it is added once all lights are known.
pub(super) type LightTexels = [[u32; 4]; TEXELS as usize];

/// A packed light.
pub(super) struct Packed {
    pub texels: LightTexels,
    pub info: LightInfo,
}

/// Puts texels at their offsets; the others are zero.
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

/// The facts of a light that the host keeps.
#[derive(Clone, Debug, PartialEq)]
pub struct LightInfo {
    /// Emitted power, mean of the three channels, in the units of the file over normalised lengths squared. For a
    /// directional light and the environment, it is the power through the disc that covers the scene.
    pub power: f64,
    /// The share of the power that photons carry: the share of emission towards the receiver bounds, or 1.
    pub received_share: f64,
    /// Approximate emission by direction.
    pub emission: Emission,
    /// [`crate::scene::LightKind::Mesh`] of uniform radiance and few edges, or a punctual light.
    pub closed_form: bool,
    /// Number of edges of its contours; 0 for punctual lights and lights without a closed form.
    pub contour_edges: usize,
    /// Whether both sides emit.
    pub two_sided: bool,
    /// Whether it is a point, spot or directional light, whose visibility one shadow ray determines.
    pub punctual: bool,
    /// Whether it is a convex lamp with tables of the triangles that are seen from each direction.
    pub viewed: bool,
    /// Centre of a bounding sphere of the light; for a directional light, of the scene. That of a mesh light is its
    /// centre of area.
    pub centre: Vec3,
    /// Radius of that sphere; 0 for point lights, spot lights and the environment.
    pub radius: f32,
}

impl LightInfo {
    /// The facts that decide on features.
    pub(crate) fn facts(&self) -> LightFacts {
        let bounds = Sphere { centre: self.centre.as_dvec3(), radius: f64::from(self.radius) };
        LightFacts { closed_form: self.closed_form, viewed: self.viewed, bounds }
    }

    /// The facts of a punctual light.
    pub(super) fn punctual(power: f64, strength: f64, centre: Vec3, radius: f32) -> LightInfo {
        LightInfo {
            power,
            received_share: 1.0,
            emission: Emission { strength, axis: None },
            closed_form: true,
            contour_edges: 0,
            two_sided: false,
            punctual: true,
            viewed: false,
            centre,
            radius,
        }
    }
}

/// Approximate emission of a light by direction, mean of the three channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emission {
    /// Maximum radiant intensity, or without an axis the mean over all directions; for directional lights and the
    /// environment, irradiance.
    pub strength: f64,
    /// The normal of a planar light that emits from one side, by the cosine law.
    pub axis: Option<Vec3>,
}
