//! Axis-aligned boxes.

use glam::Vec3;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Minimum coordinates.
    pub min: Vec3,
    /// Maximum coordinates.
    pub max: Vec3,
}

impl Aabb {
    /// The empty box, which is the neutral element of [`union`](Self::union).
    pub const EMPTY: Aabb = Aabb { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The box around points.
    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Aabb {
        points.into_iter().fold(Aabb::EMPTY, |all, point| all.extended(point))
    }

    /// The smallest box that contains the box and the point.
    pub fn extended(&self, point: Vec3) -> Aabb {
        Aabb { min: self.min.min(point), max: self.max.max(point) }
    }

    /// The smallest box that contains both.
    pub fn union(&self, other: &Aabb) -> Aabb {
        Aabb { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    pub(super) fn half_area(&self) -> f32 {
        let extent = self.max - self.min;
        extent.x * extent.y + extent.y * extent.z + extent.z * extent.x
    }
}

impl Default for Aabb {
    fn default() -> Self {
        Aabb::EMPTY
    }
}
