//! Emission towards receiver bounds: where photons are sent. A lamp over a lone object would lose nineteen of twenty
//! past it (Jensen 1996 sends them by projection maps; one sphere around all that there is to light needs no search).

use glam::{DVec3, Vec3};

use crate::scene::{Material, Scene};

use super::bounds::bounding_sphere;

/// A sphere around all surfaces at which photons are stored or go on, normalised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceiverBounds {
    /// Its centre.
    pub centre: Vec3,
    /// Its radius, above 0.
    pub radius: f32,
}

/// Rays start off their surfaces by 2^-16 of the scene's radius, and directions are rounded: some times that.
const SPARE: f32 = 1e-4;

impl ReceiverBounds {
    /// Those of a scene: all surfaces but lamps that reflect nothing. None where there is nothing else.
    pub fn of(scene: &Scene) -> Option<ReceiverBounds> {
        let receives = |material: u32| !is_black_lamp(&scene.materials[material as usize]);
        let triangles = (0..scene.triangles.len()).filter(|i| receives(scene.triangles[*i].material));
        let corners = triangles.flat_map(|i| scene.triangle_positions(i));
        let (centre, radius) = bounding_sphere(corners.chain(scene.procedurals.iter().flat_map(|o| o.corners())));
        (radius > 0.0).then_some(ReceiverBounds { centre, radius: radius * (1.0 + SPARE) + SPARE })
    }

    /// The directions from a position to them; None within the bounds.
    pub(super) fn cone_from(&self, position: Vec3) -> Option<ReceiverCone> {
        let offset = (self.centre - position).as_dvec3();
        let squared_sine = f64::from(self.radius).powi(2) / offset.length_squared();
        // As `receiver_cone` in shaders/lib/light/receivers.wgsl.
        let height = squared_sine / (1.0 + (1.0 - squared_sine).sqrt());
        (squared_sine < 1.0).then(|| ReceiverCone { axis: offset.normalize(), squared_sine, height })
    }
}

/// Directions about an axis.
pub(super) struct ReceiverCone {
    axis: DVec3,
    /// Of the angle between the axis and the rim.
    squared_sine: f64,
    /// 1 less the cosine of that angle.
    pub height: f64,
}

impl ReceiverCone {
    /// The share of the directions about the normal, by the cosine law, to which the cone narrows them.
    pub fn share(&self, normal: DVec3) -> f64 {
        let cosine = self.axis.dot(normal);
        if cosine > 0.0 && cosine * cosine > self.squared_sine { self.squared_sine * cosine } else { 1.0 }
    }
}

fn is_black_lamp(material: &Material) -> bool {
    let reflects = material.base_colour.truncate() != Vec3::ZERO || material.specular.factor > 0.0;
    material.emissive != Vec3::ZERO && !reflects && !material.has_reflecting_lobe()
}
