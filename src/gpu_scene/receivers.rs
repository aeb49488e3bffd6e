//! Emission towards receiver bounds. Nineteen of twenty photons of a lamp over a single object would miss it, so lights
//! emit only towards one sphere around everything that receives light. (Jensen 1996 uses projection maps, which need a
//! search.)

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::bounds::bounding_sphere_of_scene;
use crate::scene::Scene;

/// A sphere around all surfaces that store or scatter photons, in normalised space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceiverBounds {
    /// Its centre.
    pub centre: Vec3,
    /// Its radius, above 0.
    pub radius: f32,
}

/// Margin, because rays start 2^-16 of the scene's radius off their surfaces and directions are rounded.
const SPARE: f32 = 1e-4;

impl ReceiverBounds {
    /// The bounds of all surfaces of a scene except lamps that reflect nothing. Returns `None` if there are no others.
    pub fn of(scene: &Scene) -> Option<ReceiverBounds> {
        // Instances do not emit.
        let corners = scene.placed_corners(|triangle| !scene.materials[triangle.material as usize].is_black_lamp());
        let objects = scene.procedurals.par_iter().flat_map_iter(|object| object.corners());
        let (centre, radius) = bounding_sphere_of_scene(corners.chain(objects));
        (radius > 0.0).then_some(ReceiverBounds { centre, radius: radius * (1.0 + SPARE) + SPARE })
    }

    /// The distance from a position, along a unit `direction`, to the middle of the ray's segment within the bounds;
    /// `None` if the ray misses them.
    pub(super) fn middle_distance(&self, position: Vec3, direction: DVec3) -> Option<f64> {
        let offset = (self.centre - position).as_dvec3();
        let nearest = offset.dot(direction);
        let half_squared = f64::from(self.radius).powi(2) - (offset - nearest * direction).length_squared();
        let half = half_squared.max(0.0).sqrt();
        let (entry, exit) = ((nearest - half).max(0.0), nearest + half);
        (half > 0.0 && exit > 0.0).then_some((entry + exit) / 2.0)
    }

    /// The cone of directions from a position to the bounds; `None` within them.
    pub(super) fn cone_from(&self, position: Vec3) -> Option<ReceiverCone> {
        let offset = (self.centre - position).as_dvec3();
        let squared_sine = f64::from(self.radius).powi(2) / offset.length_squared();
        // The same formula as in `receiver_cone` in shaders/lib/light/receivers.wgsl.
        let height = squared_sine / (1.0 + (1.0 - squared_sine).sqrt());
        (squared_sine < 1.0).then(|| ReceiverCone { axis: offset.normalize(), squared_sine, height })
    }
}

/// A cone of directions about an axis.
pub(super) struct ReceiverCone {
    axis: DVec3,
    /// Squared sine of the angle between the axis and the rim.
    squared_sine: f64,
    /// 1 less the cosine of that angle.
    pub height: f64,
}

impl ReceiverCone {
    /// The share of the emission about the normal, by the cosine law, that is in the cone; 1 if the cone reaches below
    /// the surface, which then emits over its whole hemisphere.
    pub fn share(&self, normal: DVec3) -> f64 {
        let cosine = self.axis.dot(normal);
        if cosine > 0.0 && cosine * cosine > self.squared_sine { self.squared_sine * cosine } else { 1.0 }
    }
}
