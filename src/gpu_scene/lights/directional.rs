//! Directional lights.

use std::f64::consts::PI;

use glam::Vec3;

use super::layout::{self, LightInfo, Packed, bits, mean, texels};
use crate::gpu_scene::bounds::bounding_sphere_of_scene;
use crate::scene::Scene;

pub(super) fn pack(scene: &Scene, direction: Vec3, irradiance: Vec3) -> Packed {
    let (centre, radius) = bounding_sphere_of_scene(scene.placed_vertices());
    let area = PI * f64::from(radius).powi(2);
    Packed {
        texels: texels([
            (layout::KIND_TEXEL, [layout::DIRECTIONAL | layout::CLOSED_FORM, 0, 0, 0]),
            (layout::EMISSION_TEXEL, bits(irradiance, 0.0)),
            (layout::AXIS_TEXEL, bits(direction, 0.0)),
            (layout::DISC_TEXEL, bits(centre, radius)),
        ]),
        info: LightInfo::punctual(mean(irradiance) * area, mean(irradiance), centre, radius),
    }
}
