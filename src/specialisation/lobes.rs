//! The lobes of materials: which materials need them, and their role in the kernels.

use crate::scene::Material;
use crate::specialisation::features::{Feature, Features};

/// A lobe that not every scene needs.
pub(crate) struct LobeFeature {
    /// The feature that puts it in the kernels.
    pub feature: Feature,
    /// Its role in the kernels. `None` if its code is in the shaders of all lobes.
    pub role: Option<LobeRole>,
    /// Whether a material needs it.
    pub has: fn(&Material) -> bool,
    /// Description of the materials that need it, which follows their number.
    pub materials: &'static str,
    /// The reason for leaving it out.
    pub unneeded: &'static str,
    /// Its cost.
    pub cost: &'static str,
    /// Whether it needs the tangents of triangles, 16 B each.
    pub tangents: bool,
}

/// The effect of a lobe on light. It decides which functions of the lobe's file, `shaders/lib/bsdf/NAME.wgsl`, the
/// shaders call. NAME is the name of the feature. Every file has these:
///
/// - `Name` and `NameFactors`, the types of the lobe at a hit and of what its textures contribute;
/// - `NAME_untextured`, `NAME_textures` and `NAME_texture`: the factors without a texture, a bit for each texture that
///   counts, and the factors with one more texture;
/// - `NAME_lobe`: the lobe at a hit;
/// - `NAME_is_present`: whether it does anything there;
/// - `pack_NAME` and `unpack_NAME`: the lobe as a vector.
///
/// The shaders name lobes in lines that begin with `@each(ROLE)`: [`crate::kernels::expand_each`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum LobeRole {
    /// It takes light from the diffuse base, and lets it pass or reflects it in its own way: `NAME_base`, the albedo
    /// that it leaves, `NAME_blocked`, the lobe of unlit materials, and `NAME_turned`, the lobe from the other side.
    /// `bsdf.wgsl` evaluates it.
    Base,
    /// It changes the reflectance of the microfacets: `NAME_reflectance`, `NAME_kept` and `NAME_through`.
    Film,
    /// It changes the distribution of the microfacets: `NAME_frame` and `NAME_alpha`.
    Spread,
    /// A layer over the microfacets that reflects to all sides, with their normal: `NAME_through`, `NAME_value`,
    /// `NAME_chance`, `NAME_sample`, `NAME_density`, `NAME_max_density` and `NAME_mean`.
    WideLayer,
    /// A layer of other microfacets, above all wide layers and with a normal of its own: `NAME_through`, `NAME_value`,
    /// `NAME_chance`, `NAME_has_normal`, `NAME_axes`, `NAME_pair`, `NAME_faces`, `NAME_max_density`,
    /// `NAME_seen_afar`, `NAME_seen_from` and `NAME_turned`.
    GlossyLayer,
}

/// All lobes, layers from the lowest to the highest. A packed surface has one more vector, for albedo and normal.
pub(crate) const LOBES: &[LobeFeature] = &[
    LobeFeature {
        feature: Feature::Glossy,
        role: None,
        has: |m| !m.is_lambertian(),
        materials: "not Lambertian",
        unneeded: "every material is Lambertian",
        cost: "specular terms at every light point; 32 B per point",
        tangents: false,
    },
    LobeFeature {
        feature: Feature::Transmission,
        role: Some(LobeRole::Base),
        has: |m| !m.unlit && (m.transmission.is_present() || m.diffuse_transmission.is_present()),
        materials: "that may transmit light",
        unneeded: "no material transmits light",
        cost: LOBE_COST,
        tangents: false,
    },
    LobeFeature {
        feature: Feature::DiffuseTransmission,
        role: Some(LobeRole::Base),
        has: |m| !m.unlit && m.diffuse_transmission.is_present(),
        materials: "that transmit light diffusely",
        unneeded: "no material transmits light diffusely",
        cost: LOBE_COST,
        tangents: false,
    },
    LobeFeature {
        feature: Feature::Dispersion,
        role: None,
        has: |m| !m.unlit && m.disperses(),
        materials: "with dispersion",
        unneeded: "every index of refraction is the same for all wavelengths",
        cost: "paths that refract go on with one of three wavelengths",
        tangents: false,
    },
    LobeFeature {
        feature: Feature::Immersed,
        role: None,
        has: |m| m.medium.is_some(),
        materials: "in the volume of another object",
        unneeded: "every surface is in air",
        cost: "absorption before every surface",
        tangents: false,
    },
    LobeFeature {
        feature: Feature::Anisotropy,
        role: Some(LobeRole::Spread),
        has: |m| !m.is_lambertian() && m.anisotropy.is_present(),
        materials: "with anisotropic reflections",
        unneeded: "every material is isotropic",
        cost: "a tangent at every surface; 16 B per point",
        tangents: true,
    },
    LobeFeature {
        feature: Feature::Iridescence,
        role: Some(LobeRole::Film),
        has: |m| !m.unlit && m.iridescence.is_present(),
        materials: "with iridescence",
        unneeded: "no material is iridescent",
        cost: "the reflectance of a thin film at every glossy surface; 16 B per point",
        tangents: false,
    },
    LobeFeature {
        feature: Feature::Sheen,
        role: Some(LobeRole::WideLayer),
        has: |m| !m.unlit && m.sheen.is_present(),
        materials: "with a sheen of fibres",
        unneeded: "no material has a sheen",
        cost: "one more lobe at every glossy surface; a table of 31 kB; 16 B per point",
        tangents: false,
    },
    LobeFeature {
        feature: Feature::Clearcoat,
        role: Some(LobeRole::GlossyLayer),
        has: |m| !m.unlit && m.clearcoat.is_present(),
        materials: "with a clear coat",
        unneeded: "no material has a clear coat",
        cost: LOBE_COST,
        tangents: false,
    },
    LobeFeature {
        feature: Feature::CoatNormals,
        role: None,
        has: |m| !m.unlit && m.clearcoat.has_own_normal(m.normal_texture.map(|map| (map, m.normal_scale))),
        materials: "whose clear coat has a normal of its own",
        unneeded: "every clear coat has the normal of its base",
        cost: "a normal at every coat",
        tangents: true,
    },
];

/// The cost of most lobes.
const LOBE_COST: &str = "one more lobe at every glossy surface; 16 B per point";

/// Number of vectors of a point's surface: `VisibleSurface` of `shaders/lib/point.wgsl`.
pub fn surface_vectors(features: &Features) -> u32 {
    // Albedo and shading normal; the two vectors of `PackedSpecular`; one for every other lobe.
    let specular = 2 * u32::from(features.has(Feature::Glossy));
    let lobes = LOBES.iter().filter(|lobe| lobe.role.is_some() && features.has(lobe.feature)).count() as u32;
    let chain = u32::from(features.has(Feature::SpecularChains));
    let photons_shown = features.has(Feature::PhotonMap) || features.has(Feature::Caustics);
    let triangle = u32::from(features.has(Feature::SmoothNormals) && photons_shown);
    let eye = u32::from(features.has(Feature::ThinLens));
    1 + specular + lobes + chain + eye + triangle
}

/// Whether the material has a lobe of that role.
pub(super) fn has_lobe(m: &Material, role: LobeRole) -> bool {
    LOBES.iter().any(|lobe| lobe.role == Some(role) && (lobe.has)(m))
}
