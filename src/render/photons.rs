//! The photons of the visibility map, for those who want to see them.

use glam::{DVec3, Vec3};

use super::renderer::Renderer;
use crate::Result;
use crate::gpu_scene::oct_decode7;
use crate::kernels::{COMPATIBLE_COSINE, NORMAL_OFFSET_WEIGHT, photon_word};

/// A photon of the visibility map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibilityPhoton {
    /// Position, in normalised space.
    pub position: Vec3,
    /// Unit normal on the side that it hit, within 0.034 radians.
    pub normal: DVec3,
    /// Index of its light.
    pub light: u32,
    /// Whether it is a shadow photon, and not an illumination photon.
    pub is_shadow: bool,
}

/// A point of a surface, in normalised space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position.
    pub position: Vec3,
    /// Unit geometric normal on the side of the camera.
    pub normal: DVec3,
}

/// The nearest photons of a light to a point, by which the visibility map classifies it.
#[derive(Clone, Debug, PartialEq)]
pub struct NearestPhotons {
    /// The point.
    pub point: SurfacePoint,
    /// The light.
    pub light: u32,
    /// The photons: k of them, or fewer if the largest search radius has no more.
    pub photons: Vec<VisibilityPhoton>,
    /// The radius, in normalised space, of the disc on the surface that was searched: it ends at the k-th photon.
    pub radius: f32,
}

impl NearestPhotons {
    /// n_i and n_s: how many are illumination photons and shadow photons.
    pub fn counts(&self) -> [usize; 2] {
        let shadow = self.photons.iter().filter(|photon| photon.is_shadow).count();
        [self.photons.len() - shadow, shadow]
    }
}

impl Renderer<'_> {
    /// The photons of the visibility map, in any order; `None` without a map: some techniques have none, others none
    /// before the second sample.
    ///
    /// # Errors
    /// As [`kernel_kit::Gpu::read`].
    pub fn visibility_photons(&self) -> Result<Option<Vec<VisibilityPhoton>>> {
        let Some(map) = &self.view.lighting.visibility_map else { return Ok(None) };
        let photons = map.photons(self.gpu)?.into_iter().map(|photon| VisibilityPhoton {
            position: photon.position.into(),
            normal: oct_decode7(photon.word & photon_word::NORMAL_MASK),
            light: photon.light(),
            is_shadow: photon.word & photon_word::SHADOW != 0,
        });
        Ok(Some(photons.collect()))
    }

    /// The nearest of these `photons` to a point, which decide its class for a light; `None` without a map.
    pub fn nearest_photons(
        &self,
        photons: &[VisibilityPhoton],
        point: SurfacePoint,
        light: u32,
    ) -> Option<NearestPhotons> {
        let farthest = f64::from(self.view.lighting.visibility_map.as_ref()?.reach());
        let map = &self.settings.visibility_map;
        let with_normals = !map.paper_counting;
        let weight = if with_normals { f64::from(NORMAL_OFFSET_WEIGHT) } else { 0.0 };
        let here = point.position.as_dvec3();
        let counted = |photon: &VisibilityPhoton| {
            let counts =
                photon.light == light && (!with_normals || photon.normal.dot(point.normal) >= COMPATIBLE_COSINE);
            let offset = photon.position.as_dvec3() - here;
            let squared = offset.length_squared() + weight * offset.dot(point.normal).powi(2);
            (counts && squared <= farthest * farthest).then_some((squared, *photon))
        };
        let mut found: Vec<(f64, VisibilityPhoton)> = photons.iter().filter_map(counted).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(map.nearest as usize);
        let is_full = found.len() == map.nearest as usize;
        let last = found.last().filter(|_| is_full).map_or(farthest, |(squared, _)| squared.sqrt());
        let photons = found.into_iter().map(|(_, photon)| photon).collect();
        Some(NearestPhotons { point, light, photons, radius: last as f32 })
    }
}
