//! The counters of kernels.

/// Counts by kernels, each in its own word of the buffer `counters`; the host sums them.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Counter {
    /// [`super::Rays::shadow`].
    ShadowRays,
    /// [`super::Rays::audit`].
    AuditRays,
    /// [`super::Rays::bounce`].
    BounceRays,
    /// [`super::Rays::gather`].
    GatherRays,
    /// [`super::Audits::audited`].
    Audited,
    /// [`super::Audits::wrong`].
    AuditsWrong,
    /// Boundary points whose light points are neither all visible nor all occluded.
    PenumbraSeen,
    /// Their shadow rays.
    PenumbraRays,
    /// [`super::Statistics::not_finite`].
    NotFinite,
    /// [`super::Conditioning::overruns`].
    Overrun,
    /// [`super::Points::dark`].
    Dark,
    /// [`super::Points::lit`].
    Lit,
    /// [`super::Points::shadowed`].
    Shadowed,
    /// [`super::Points::boundary`].
    Boundary,
    /// [`super::Points::unknown`].
    Unknown,
    /// Decided points near boundaries: with photons of both kinds in reach of their cell, or in a part of a divided
    /// cell that has few photons.
    Near,
    /// Those of them that are audited.
    NearAudited,
    /// Decided points in parts of divided cells that have many photons.
    Settled,
    /// Those of them that are audited.
    SettledAudited,
    /// Audited points near boundaries whose shadow ray contradicted the class.
    AuditsWrongNear,
    /// Audited points in settled cells whose shadow ray contradicted the class.
    AuditsWrongSettled,
    /// [`super::Conditioning::near_overflow`].
    NearOverflow,
    /// [`super::Conditioning::heavy_paths`].
    HeavyPaths,
    /// [`super::NotFinite::flux`]: the pass counts it in a buffer of its own, and the host adds it.
    NotFiniteFlux,
    /// [`super::NotFinite::irradiance`].
    NotFiniteIrradiance,
    /// [`super::NotFinite::gather`].
    NotFiniteGather,
    /// [`super::NotFinite::primary`].
    NotFinitePrimary,
    /// [`super::NotFinite::shade`].
    NotFiniteShade,
    /// [`super::NotFinite::path`].
    NotFinitePath,
    /// [`super::Conditioning::procedural_overruns`]: kernels count it in a buffer of its own.
    ProceduralOverruns,
    /// [`super::Conditioning::procedural_invalid`]: likewise.
    ProceduralInvalid,
    /// Points for which pass `shade` samples light points, because some terms are not given by classes; once for each
    /// chunk of lights.
    Sampled,
}

impl Counter {
    /// Words of the buffer `counters`.
    pub const COUNT: usize = 32;
}
