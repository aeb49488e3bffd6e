//! The features that `scenes/box.glb` does not need, and how to render it with them nevertheless.

use penumbra::Image;
use penumbra::internal::specialisation::features::Feature;

/// A feature that changes no image of the box but its last bits.
pub struct Unneeded {
    pub feature: Feature,
    /// Whether it is switched on. [`Feature::ShallowBvh`] is a need by its absence.
    pub on: bool,
    /// Features that every scene with this feature also has. Its cost is measured against these alone.
    pub beside: &'static [Feature],
}

impl Unneeded {
    /// The switches of what it is compared with.
    pub fn without(&self) -> Vec<(Feature, bool)> {
        self.beside.iter().map(|feature| (*feature, true)).collect()
    }

    /// The switches that force it.
    pub fn with(&self) -> Vec<(Feature, bool)> {
        let mut switches = self.without();
        switches.push((self.feature, self.on));
        switches
    }
}

/// The switches that force all of them.
pub fn all_unneeded() -> Vec<(Feature, bool)> {
    UNNEEDED.iter().map(|unneeded| (unneeded.feature, unneeded.on)).collect()
}

/// Features that round the rays of the box differently: distances along the plane of a needle, origins on an iris of
/// radius 0.
pub const OTHER_RAYS: [Feature; 2] = [Feature::Needles, Feature::ThinLens];

const fn alone(feature: Feature) -> Unneeded {
    beside(feature, &[])
}

const fn beside(feature: Feature, beside: &'static [Feature]) -> Unneeded {
    Unneeded { feature, on: true, beside }
}

pub const UNNEEDED: &[Unneeded] = &[
    alone(Feature::LayeredTexels),
    Unneeded { feature: Feature::ShallowBvh, on: false, beside: &[] },
    alone(Feature::Needles),
    alone(Feature::Procedurals),
    alone(Feature::SmoothNormals),
    alone(Feature::VertexColours),
    alone(Feature::Textures),
    beside(Feature::Uv1, &[Feature::Textures]),
    beside(Feature::NormalMaps, &[Feature::Textures]),
    beside(Feature::EmissiveTextures, &[Feature::Textures]),
    alone(Feature::AlphaTest),
    beside(Feature::EmissiveAlpha, &[Feature::AlphaTest]),
    alone(Feature::Unlit),
    alone(Feature::Glossy),
    beside(Feature::BsdfRays, &[Feature::Glossy]),
    beside(Feature::Anisotropy, &[Feature::Glossy]),
    beside(Feature::Iridescence, &[Feature::Glossy]),
    beside(Feature::Sheen, &[Feature::Glossy]),
    beside(Feature::Clearcoat, &[Feature::Glossy]),
    beside(Feature::CoatNormals, &[Feature::Glossy, Feature::Textures, Feature::Clearcoat]),
    beside(Feature::Transmission, &[Feature::Glossy]),
    beside(Feature::DiffuseTransmission, &[Feature::Glossy, Feature::Transmission]),
    beside(Feature::Dispersion, &[Feature::Glossy, Feature::Transmission]),
    beside(Feature::Immersed, &[Feature::Glossy, Feature::Transmission]),
    beside(Feature::EmissiveVolumes, &[Feature::Glossy, Feature::Transmission]),
    beside(Feature::SpecularChains, &[Feature::Glossy]),
    beside(Feature::Caustics, &[Feature::Glossy]),
    beside(Feature::CausticIrradiance, &[Feature::Glossy, Feature::Caustics]),
    alone(Feature::PointLights),
    alone(Feature::SpotLights),
    alone(Feature::DirectionalLights),
    alone(Feature::ManyEmitters),
    beside(Feature::EmitterPairs, &[Feature::ManyEmitters]),
    alone(Feature::SampledForms),
    alone(Feature::LightTags),
    alone(Feature::ThinLens),
    alone(Feature::AdaptiveSampling),
    alone(Feature::AovAlbedo),
    alone(Feature::AovNormal),
    alone(Feature::AovPosition),
    alone(Feature::Guides),
    alone(Feature::ShownCells),
];

/// The features that are not forced on the box, and why.
pub const NOT_FORCED: &[(&[Feature], &str)] = &[
    (&[Feature::Instances], "needs a hierarchy over instances, which the box lacks"),
    (&[Feature::TextureLoads, Feature::Interleave, Feature::Packets], "depend on the device alone"),
    (&[Feature::Environment], "needs the tables of a panorama, which the box lacks"),
    (&[Feature::HiddenEnvironment], "leaves out code of `environment`"),
    (&[Feature::FarEmitters], "leaves out code of `many_emitters` and `emitter_pairs`"),
    (
        &[
            Feature::PaperCounting,
            Feature::ExactCounts,
            Feature::AovShadow,
            Feature::VisibilityEstimate,
            Feature::Cells,
            Feature::VoxelTags,
            Feature::LightBuffer,
            Feature::Ward,
            Feature::LightSampling,
            Feature::UniformLightSampling,
            Feature::ContributionSampling,
            Feature::Zones,
            Feature::PhotonMap,
            Feature::NegativePhotons,
            Feature::Highlights,
        ],
        "another method, whose image has other noise or other errors",
    ),
];

/// Values of an image below this share of its mean count as that, or a black one would have any relative difference.
const DARK: f64 = 0.1;

/// Relative difference of two values up to which roundings of longer sums explain it. Above it, some ray has hit
/// another surface because of them.
pub const ROUNDING: f64 = 1e-4;

/// R, G and B of an image.
pub fn values(image: &Image) -> Vec<f64> {
    ["R", "G", "B"].iter().flat_map(|name| image.channel(name).unwrap()).map(|value| f64::from(*value)).collect()
}

/// The differences of the values of two images, relative to those of the first.
pub fn relative_differences(a: &[f64], b: &[f64]) -> Vec<f64> {
    let dark = DARK * a.iter().sum::<f64>() / a.len() as f64;
    assert!(dark > 0.0 && a.len() == b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / a.abs().max(dark)).collect()
}

/// The share of them that exceeds [`ROUNDING`].
pub fn share_beyond_rounding(differences: &[f64]) -> f64 {
    differences.iter().filter(|difference| **difference > ROUNDING).count() as f64 / differences.len() as f64
}
