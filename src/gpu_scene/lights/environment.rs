//! The environment as a light.

use std::f64::consts::PI;

use glam::Vec3;

use super::layout::{self, Emission, LightInfo, Packed, bits, texels};

/// `centre` and `radius` are those of a sphere around the scene; `irradiance` is the integral of the panorama's
/// radiance, mean of the three channels, over solid angle.
pub(super) fn pack((centre, radius): (Vec3, f32), irradiance: f64) -> Packed {
    Packed {
        texels: texels([
            (layout::KIND_TEXEL, [layout::ENVIRONMENT, 0, 0, 0]),
            (layout::DISC_TEXEL, bits(centre, radius)),
        ]),
        info: LightInfo {
            power: irradiance * PI * f64::from(radius).powi(2),
            received_share: 1.0,
            // A surface receives about half of the light from all directions.
            emission: Emission { strength: irradiance / 2.0, axis: None },
            closed_form: false,
            contour_edges: 0,
            two_sided: false,
            punctual: false,
            viewed: false,
            centre,
            radius: 0.0,
        },
    }
}
