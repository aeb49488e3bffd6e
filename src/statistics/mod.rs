//! What a render did: counts, shares with their intervals, times. `docs/statistics.md` describes the JSON form.

use std::collections::BTreeMap;

pub(crate) mod totals;

use serde::{Deserialize, Serialize};
use statrs::distribution::{Beta, ContinuousCDF};

use crate::gpu::DeviceInfo;
use crate::settings::Settings;

/// Everything about a render but the image.
#[derive(Clone, Debug, Serialize)]
pub struct Statistics {
    /// Version of this schema: raised when a key changes its meaning or goes.
    pub schema: u32,
    /// Version of Penumbra.
    pub version: &'static str,
    /// The device.
    pub device: DeviceInfo,
    /// The settings, as they were used.
    pub settings: Settings,
    /// Samples a pixel that were rendered.
    pub samples: u32,
    /// Rays by type.
    pub rays: Rays,
    /// Points by class.
    pub points: Points,
    /// Photons by light.
    pub photons: Vec<LightPhotons>,
    /// What indirect light is made of.
    pub indirect: Indirect,
    /// What audits found.
    pub audits: Audits,
    /// Samples that were not finite, and left out of the image.
    pub not_finite: u64,
    /// What the render noticed of its own arithmetic and limits.
    pub conditioning: Conditioning,
    /// Seconds.
    pub time: Times,
    /// Bytes.
    pub memory: Memory,
    /// What the scene has.
    pub scene: SceneCounts,
    /// What the kernels were composed of.
    pub kept: Vec<String>,
    /// What was left out because the scene does not need it.
    pub left_out: Vec<String>,
    /// Remarks for the user, a line each.
    pub notes: Vec<String>,
}

/// Rays by type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Rays {
    /// From the camera.
    pub camera: u64,
    /// Of photons: from lights, and on through the scene.
    pub photon: u64,
    /// From the cells of a grid to lights, before the first sample.
    pub cell: u64,
    /// To lights, for boundary points.
    pub shadow: u64,
    /// To lights, for audits of decided points.
    pub audit: u64,
    /// From surfaces along a sampled direction.
    pub bounce: u64,
    /// Of final gathers, and from the camera to where they may be needed.
    pub gather: u64,
    /// All of them.
    pub total: u64,
}

impl Rays {
    /// With `total` the sum of the rest.
    pub fn summed(mut self) -> Self {
        self.total = self.camera + self.photon + self.cell + self.shadow + self.audit + self.bounce + self.gather;
        self
    }
}

/// Points (camera sample and light) by class.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Points {
    /// Those with some of the light in front of the surface: all but `dark`.
    pub total: u64,
    /// The whole light is behind the surface's plane, or emits away from it.
    pub dark: u64,
    /// All photons near are illumination photons.
    pub lit: u64,
    /// All photons near are shadow photons.
    pub shadowed: u64,
    /// Both kinds are near, or the pixel's neighbour is a boundary.
    pub boundary: u64,
    /// Too few photons are near to tell, or there is no map.
    pub unknown: u64,
    /// Boundary and unknown points over all.
    pub boundary_share: f64,
    /// Of the boundary and unknown points, the share whose light points were neither all seen nor all hidden: a lower
    /// bound of `fill`, near it for many light points.
    pub fill_seen: f64,
}

/// Photons of a light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LightPhotons {
    /// Name of the light.
    pub light: String,
    /// Photons emitted.
    pub emitted: u64,
    /// Illumination photons stored.
    pub illumination: u64,
    /// Shadow photons stored.
    pub shadow: u64,
    /// Photons that audits added.
    pub healed: u64,
}

/// The global map and the irradiance cache.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Indirect {
    /// Rays whose photons carry flux, of all lights together.
    pub emitted: u64,
    /// Photons of the global map.
    pub photons: u64,
    /// Those of them that carry more than a photon's word holds, and lost the rest.
    pub cut: u64,
    /// Photons of the caustic maps of all samples.
    pub caustics: u64,
    /// Places where irradiance is precomputed.
    pub places: u64,
    /// Irradiance records.
    pub records: u64,
}

/// What audits found about the decided points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Audits {
    /// Decided points that were audited.
    pub audited: u64,
    /// Those whose shadow ray contradicted the class.
    pub wrong: u64,
    /// Estimated miss bias: the mean of |V - c| over all points.
    pub miss_bias: f64,
    /// Its 95 % interval: those of Jeffreys of points near boundaries and of the others, combined.
    pub miss_bias_interval: [f64; 2],
}

/// Decided points of one kind: what share of all points they are, how many were audited, how many of these wrong.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stratum {
    /// Share of all points, 0 to 1.
    pub share: f64,
    /// Audited points.
    pub audited: u64,
    /// Those whose shadow ray contradicted the class.
    pub wrong: u64,
}

/// Wilson's score interval at 95 % of a share, of which `part` of `whole` were found: its centre and its half width.
#[cfg(feature = "report")]
pub(crate) fn wilson(part: u64, whole: u64) -> (f64, f64) {
    // 97.5 % quantile of the normal distribution.
    const Z: f64 = 1.959_964;
    if whole == 0 {
        return (0.5, 0.5);
    }
    let n = whole as f64;
    let p = part as f64 / n;
    let scale = 1.0 + Z * Z / n;
    ((p + Z * Z / (2.0 * n)) / scale, Z / scale * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt())
}

/// The interval of Jeffreys at 95 % of a share, of which `part` of `whole` were found (Brown, Cai and DasGupta 2001): of the
/// handful of wrong audits that a render has, Wilson's leaves the truth out in one of ten renders, and that of Clopper and
/// Pearson in none.
fn jeffreys(part: u64, whole: u64) -> [f64; 2] {
    // Of parameters of at least a half, which are never refused.
    let beta = Beta::new(part as f64 + 0.5, (whole - part) as f64 + 0.5);
    let quantile = |p: f64| beta.as_ref().map_or(f64::NAN, |beta| beta.inverse_cdf(p));
    [if part == 0 { 0.0 } else { quantile(0.025) }, if part == whole { 1.0 } else { quantile(0.975) }]
}

impl Audits {
    /// The estimate from points that were audited with different probabilities. The intervals of the strata, which are
    /// independent, are combined as Zou and Donner (2008) do: each end lies away from the estimate by the root of the sum
    /// of the squares of what the strata's ends do.
    pub fn new(strata: &[Stratum]) -> Self {
        let mut audits = Audits::default();
        let (mut below, mut above) = (0.0, 0.0);
        for stratum in strata.iter().filter(|s| s.share > 0.0) {
            audits.audited += stratum.audited;
            audits.wrong += stratum.wrong;
            let found = stratum.wrong as f64 / stratum.audited.max(1) as f64;
            audits.miss_bias += stratum.share * found;
            let [low, high] = jeffreys(stratum.wrong, stratum.audited);
            below += (stratum.share * (found - low)).powi(2);
            above += (stratum.share * (high - found)).powi(2);
        }
        audits.miss_bias_interval =
            [(audits.miss_bias - below.sqrt()).max(0.0), (audits.miss_bias + above.sqrt()).min(1.0)];
        audits
    }
}

/// What a render notices of its own arithmetic and limits. Where a count says that the image may be wrong or needlessly dear,
/// [`Statistics::notes`] has a line on it, and an EXR the attribute `penumbra:conditioning`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Conditioning {
    /// Values that were not finite, by the pass that made them.
    pub not_finite: NotFinite,
    /// Sums of a pixel beyond 2^104, once for each of the batches that left them there, and squares that overflow.
    pub near_overflow: u64,
    /// Points that asked the visibility map and found too few photons near; see [`Points::unknown`].
    pub unknown: u64,
    /// Irradiance records of the least radius, three pixels.
    pub least_records: u64,
    /// Paths that came to carry a weight above 8 after Russian roulette.
    pub heavy_paths: u64,
    /// Invocations of kernels that met the loop budget. Their samples are left out of the image, their photons of the maps.
    pub overruns: u64,
    /// Rays that a procedural object was lost for, as its function took too many turns.
    pub procedural_overruns: u64,
    /// Rays that a procedural object was lost for, as its function's answer was none.
    pub procedural_nonsense: u64,
    /// Bounces of a photon of the global map on average, or of a path where there is no such map.
    pub mean_bounces: u64,
    /// Devices that were lost, and replaced, under the render.
    pub devices_lost: u64,
}

/// Values that were not finite, by the pass that made them. What a sample of a pixel then brings is left out of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct NotFinite {
    /// Photons of the global map: not stored.
    pub flux: u64,
    /// Irradiance at places, which then tell nothing; and points that are shown the map.
    pub irradiance: u64,
    /// Rays of final gathers, taken for dark, and records, taken for none.
    pub gather: u64,
    /// Camera rays.
    pub primary: u64,
    /// Direct light of points.
    pub shade: u64,
    /// Paths.
    pub path: u64,
}

impl NotFinite {
    /// The counts with the names of their passes, in the order in which those run.
    pub fn named(&self) -> [(&'static str, u64); 6] {
        let NotFinite { flux, irradiance, gather, primary, shade, path } = *self;
        [
            ("flux", flux),
            ("irradiance", irradiance),
            ("gather", gather),
            ("primary", primary),
            ("shade", shade),
            ("path", path),
        ]
    }

    /// All of them.
    pub fn total(&self) -> u64 {
        self.named().iter().map(|(_, count)| count).sum()
    }
}

/// Seconds of wall time, and of the device by pass.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Times {
    /// The whole run, as far as it is known when this is written.
    pub total: f64,
    /// Opening the device.
    pub start: f64,
    /// Reading the scene.
    pub import: f64,
    /// Building the BVH.
    pub bvh: f64,
    /// Composing and compiling kernels.
    pub compile: f64,
    /// Photons, grid and all samples.
    pub render: f64,
    /// On the device, by kernel and entry point; empty where the device has no timestamps.
    pub passes: BTreeMap<String, f64>,
}

/// Bytes on the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Memory {
    /// The scene's tables: BVH, surfaces, textures, lights.
    pub scene: u64,
    /// Photons, their grids, irradiance records.
    pub photons: u64,
    /// Points, classes, radiance, film.
    pub frame: u64,
}

/// What the scene has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SceneCounts {
    /// Triangles.
    pub triangles: u64,
    /// Lights.
    pub lights: u64,
    /// Materials.
    pub materials: u64,
    /// Images.
    pub images: u64,
    /// Deepest path in the BVH.
    pub bvh_depth: u32,
}

/// What kernels count, each in its word of the buffer `counters`; the host adds them up.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Counter {
    /// [`Rays::shadow`].
    ShadowRays,
    /// [`Rays::audit`].
    AuditRays,
    /// [`Rays::bounce`].
    BounceRays,
    /// [`Rays::gather`].
    GatherRays,
    /// [`Audits::audited`].
    Audited,
    /// [`Audits::wrong`].
    AuditsWrong,
    /// Boundary points whose light points disagree.
    PenumbraSeen,
    /// [`Statistics::not_finite`].
    NotFinite,
    /// [`Conditioning::overruns`].
    Overrun,
    /// [`Points::dark`].
    Dark,
    /// [`Points::lit`].
    Lit,
    /// [`Points::shadowed`].
    Shadowed,
    /// [`Points::boundary`].
    Boundary,
    /// [`Points::unknown`].
    Unknown,
    /// Decided points near boundaries: with photons of both kinds in reach of their cell.
    Near,
    /// Those of them that are audited.
    NearAudited,
    /// Those of them whose shadow ray contradicted the class.
    AuditsWrongNear,
    /// [`Conditioning::near_overflow`].
    NearOverflow,
    /// [`Conditioning::heavy_paths`].
    HeavyPaths,
    /// [`NotFinite::flux`]: the host adds what the pass counts apart.
    NotFiniteFlux,
    /// [`NotFinite::irradiance`].
    NotFiniteIrradiance,
    /// [`NotFinite::gather`].
    NotFiniteGather,
    /// [`NotFinite::primary`].
    NotFinitePrimary,
    /// [`NotFinite::shade`].
    NotFiniteShade,
    /// [`NotFinite::path`].
    NotFinitePath,
    /// [`Conditioning::procedural_overruns`]: the kernels count it in a buffer of its own.
    ProceduralOverruns,
    /// [`Conditioning::procedural_nonsense`]: likewise.
    ProceduralNonsense,
}

impl Counter {
    /// Words of the buffer `counters`.
    pub const COUNT: usize = 27;
}
