//! Directional lights.

use std::f64::consts::PI;

use glam::Vec3;

use super::layout::{self, LightInfo, Packed, bits, mean, texels};

/// `centre` and `radius` are those of a sphere around the scene.
pub(super) fn pack((centre, radius): (Vec3, f32), direction: Vec3, irradiance: Vec3) -> Packed {
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
