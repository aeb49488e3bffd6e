//! Normalised space, in which the scene is centred on the origin and has about unit size.

use glam::{DVec3, Vec3};

/// Maximum of coordinates: 2^996. Then the radius of the scene is below 2^1000, beyond which the square of the scale is
/// 0 in f64.
const MAX_COORDINATE: f64 = f64::from_bits((1023 + 996) << 52);

/// Whether a point can be part of a scene.
pub(super) fn is_in_range(point: DVec3) -> bool {
    point.is_finite() && point.abs().max_element() <= MAX_COORDINATE
}

/// The map between world space and normalised space: `normalised = (world - centre) * 2^exponent`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Normalisation {
    /// Centre of the scene's bounding box, in world space.
    pub centre: DVec3,
    /// Exponent of the scale. It brings the radius of the bounding sphere into (1/2, 1].
    pub exponent: i32,
}

impl Normalisation {
    /// The factor from world lengths to normalised lengths: `2^exponent`.
    pub fn scale(&self) -> f64 {
        2f64.powi(self.exponent)
    }

    /// Transforms a position from world space to normalised space.
    pub fn apply(&self, world: DVec3) -> Vec3 {
        ((world - self.centre) * self.scale()).as_vec3()
    }

    /// Transforms a position from normalised space to world space.
    pub fn undo(&self, normalised: Vec3) -> DVec3 {
        self.undo_f64(normalised.as_dvec3())
    }

    /// [`undo`](Self::undo) for a position in double precision.
    pub fn undo_f64(&self, normalised: DVec3) -> DVec3 {
        normalised / self.scale() + self.centre
    }
}
