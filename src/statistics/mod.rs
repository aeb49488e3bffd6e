//! Statistics of a render: counts, shares with their intervals, times. `docs/statistics.md` describes the JSON form.

mod audits;
mod counter;
pub(crate) mod totals;

use std::collections::BTreeMap;

pub use audits::{Audits, Stratum};
#[cfg(feature = "report")]
pub(crate) use audits::{NORMAL_QUANTILE, wilson};
pub use counter::Counter;
use kernel_kit::DeviceInfo;
use serde::{Deserialize, Serialize};

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
    /// Samples of a pixel that were rendered. With [`ImageSettings::noise`](crate::settings::ImageSettings::noise), of
    /// the pixels that have most; with adaptive sampling, the mean.
    pub samples: u32,
    /// Mean number of samples of a pixel.
    pub mean_samples: f64,
    /// Rays by type.
    pub rays: Rays,
    /// Points by class.
    pub points: Points,
    /// Photons by light.
    pub photons: Vec<LightPhotons>,
    /// Photons and records of indirect light.
    pub indirect: Indirect,
    /// Results of the audits.
    pub audits: Audits,
    /// Samples that were not finite, and left out of the image, counted for direct light, indirect light and each AOV.
    pub not_finite: u64,
    /// Numerical problems and limits that the render met.
    pub conditioning: Conditioning,
    /// Seconds.
    pub time: Times,
    /// Bytes.
    pub memory: Memory,
    /// Counts of the scene.
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
    /// Rays of photons: from lights, and further through the scene.
    pub photon: u64,
    /// From the cells of a grid to lights, before the first sample.
    pub cell: u64,
    /// To lights, for boundary points.
    pub shadow: u64,
    /// To lights, for audits of decided points.
    pub audit: u64,
    /// From surfaces along a sampled direction.
    pub bounce: u64,
    /// Rays of final gathers, and camera rays to points that may need one.
    pub gather: u64,
    /// All rays.
    pub total: u64,
}

impl Rays {
    /// The same with `total` set to the sum of the rest.
    pub fn summed(mut self) -> Self {
        self.total = self.camera + self.photon + self.cell + self.shadow + self.audit + self.bounce + self.gather;
        self
    }
}

/// Points (camera sample and light) by class.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Points {
    /// Points with some of the light in front of the surface: all but `dark`.
    pub total: u64,
    /// The whole light is behind the surface's plane, or emits away from it.
    pub dark: u64,
    /// The nearest photons are illumination photons.
    pub lit: u64,
    /// The nearest photons are shadow photons.
    pub shadowed: u64,
    /// Both kinds are among the nearest photons, or a neighbouring pixel is a boundary.
    pub boundary: u64,
    /// There are too few photons within the largest search radius, or there is no map.
    pub unknown: u64,
    /// Boundary and unknown points over all.
    pub boundary_share: f64,
    /// Share of the boundary and unknown points whose light points were neither all visible nor all occluded: a lower
    /// bound of the share in penumbrae, and close to it for many light points.
    pub fill_seen: f64,
}

impl Points {
    /// The share of shadow rays that were not traced, with audits counted as rays. `None` if no point was decided or no
    /// ray was traced. It assumes as many light points at each point as where shadow rays were traced.
    pub fn saved_shadow_rays(&self, rays: &Rays) -> Option<f64> {
        let (traced, undecided) = (rays.shadow + rays.audit, self.boundary + self.unknown);
        if self.lit + self.shadowed == 0 || traced == 0 {
            return None;
        }
        let rays_of_point = if undecided > 0 { rays.shadow as f64 / undecided as f64 } else { 1.0 };
        Some((1.0 - traced as f64 / (self.total as f64 * rays_of_point)).max(0.0))
    }
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
    pub repaired: u64,
}

/// The maps and the irradiance cache that indirect light comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Indirect {
    /// Rays whose photons carry flux, of all lights together.
    pub emitted: u64,
    /// Photons of the global map.
    pub photons: u64,
    /// Photons of the global map whose flux was clipped to what a photon's word holds.
    pub clipped: u64,
    /// Photons of the caustic maps of all samples.
    pub caustics: u64,
    /// Points where irradiance is precomputed.
    pub points: u64,
    /// Irradiance records.
    pub records: u64,
}

/// Counts of numerical problems and limits. If a count shows that the image may be wrong or needlessly expensive,
/// [`Statistics::notes`] has a line on it, and an EXR has the attribute `penumbra:conditioning`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Conditioning {
    /// Values that were not finite, by the pass that made them.
    pub not_finite: NotFinite,
    /// Sums of a pixel beyond 2^104, once for each batch that left them there, and squares that are left out of their
    /// sum because it would overflow.
    pub near_overflow: u64,
    /// Points for which the visibility map had too few photons; see [`Points::unknown`].
    pub unknown: u64,
    /// Irradiance records of the minimum radius: three pixels, and less for records with more than 128 gather rays.
    pub min_radius_records: u64,
    /// Paths whose weight rose above 8 after Russian roulette.
    pub heavy_paths: u64,
    /// Kernel invocations that exceeded the loop budget. Their samples are left out of the image, and their photons out
    /// of the maps.
    pub overruns: u64,
    /// Rays that passed through a procedural object because its function took too many iterations.
    pub procedural_overruns: u64,
    /// Rays that passed through a procedural object because its function returned an invalid result.
    pub procedural_invalid: u64,
    /// Mean number of bounces of a photon of the global map, or of a path where there is no such map, rounded to an
    /// integer.
    pub mean_bounces: u64,
    /// Devices that were lost and replaced during the render.
    pub devices_lost: u64,
}

/// Values that were not finite, by the pass that made them. The samples that they belong to are left out of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct NotFinite {
    /// Photons of the global map: not stored.
    pub flux: u64,
    /// Precomputed irradiance, which is then not used; and points at which the map is shown.
    pub irradiance: u64,
    /// Rays of final gathers, which count as dark, and irradiance records, which are dropped.
    pub gather: u64,
    /// Camera rays.
    pub primary: u64,
    /// Direct light of points.
    pub shade: u64,
    /// Paths.
    pub path: u64,
}

impl NotFinite {
    /// All of them.
    pub fn total(&self) -> u64 {
        let NotFinite { flux, irradiance, gather, primary, shade, path } = *self;
        flux + irradiance + gather + primary + shade + path
    }
}

/// Seconds of wall time, and of the device by pass.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Times {
    /// The whole run, up to when this is written.
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
    /// The part of `render` up to the end of the first batch of samples.
    pub first_sample: f64,
    /// Denoising the image; 0 until the caller of [`crate::Renderer::add_denoised`] sets it.
    pub denoise: f64,
    /// On the device, by kernel and entry point; empty where the device has no timestamps.
    pub passes: BTreeMap<String, f64>,
}

/// Bytes on the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Memory {
    /// The scene's tables: BVH, surfaces, textures, lights.
    pub scene: u64,
    /// Photons, their grids, lists of zones, irradiance points and records.
    pub photons: u64,
    /// Points, classes, radiance, film.
    pub frame: u64,
}

/// Counts of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SceneCounts {
    /// Triangles; a mesh that instances share counts once.
    pub triangles: u64,
    /// Instances of meshes that are stored once.
    pub instances: u64,
    /// Lights.
    pub lights: u64,
    /// Materials.
    pub materials: u64,
    /// Images.
    pub images: u64,
    /// Deepest path in the BVH.
    pub bvh_depth: u32,
}

#[cfg(test)]
mod tests {
    use super::{Points, Rays};

    /// Ten points of four light points each, of which two trace shadow rays and two of the others are audited.
    #[test]
    fn saved_shadow_rays_count_audits_as_rays() {
        let points = Points { total: 10, lit: 5, shadowed: 3, boundary: 1, unknown: 1, ..Points::default() };
        let rays = Rays { shadow: 8, audit: 2, ..Rays::default() };
        assert_eq!(points.saved_shadow_rays(&rays), Some(0.75));
        assert_eq!(points.saved_shadow_rays(&Rays::default()), None, "no ray");
        let undecided = Points { total: 2, unknown: 2, ..Points::default() };
        assert_eq!(undecided.saved_shadow_rays(&rays), None, "no class");
        let decided = Points { total: 8, lit: 8, ..Points::default() };
        assert_eq!(decided.saved_shadow_rays(&Rays { audit: 2, ..Rays::default() }), Some(0.75), "one light point");
    }
}
