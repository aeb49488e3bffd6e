//! Normalised space: the scene recentred, and scaled by a power of two to about unit size.

use glam::{DVec3, Vec3};

/// Normalised space: `normalised = (world - centre) * 2^exponent`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Normalisation {
    /// Centre of the scene's bounding box, in world space.
    pub centre: DVec3,
    /// Power of two that brings the bounding sphere's radius into (1/2, 1].
    pub exponent: i32,
}

impl Normalisation {
    /// The factor from world lengths to normalised ones: `2^exponent`.
    pub fn scale(&self) -> f64 {
        2f64.powi(self.exponent)
    }

    /// From world space to normalised space.
    pub fn apply(&self, world: DVec3) -> Vec3 {
        ((world - self.centre) * self.scale()).as_vec3()
    }

    /// From normalised space to world space.
    pub fn undo(&self, normalised: Vec3) -> DVec3 {
        self.undo_f64(normalised.as_dvec3())
    }

    /// From normalised space, in double precision, to world space.
    pub fn undo_f64(&self, normalised: DVec3) -> DVec3 {
        normalised / self.scale() + self.centre
    }
}
