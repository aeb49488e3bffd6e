//! Spot lights.

use std::f64::consts::PI;

use glam::Vec3;

use super::layout::{self, LightInfo, Packed, bits, mean, texels};
use super::point::finite;
use crate::gpu_scene::receivers::ReceiverBounds;

/// Position and axis of a spot light, and the cosines of its cone angles.
#[derive(Clone, Copy)]
pub(super) struct Cone {
    pub position: Vec3,
    pub direction: Vec3,
    pub cos_inner: f32,
    pub cos_outer: f32,
}

pub(super) fn pack(cone: Cone, intensity: Vec3, range: f32, receivers: Option<ReceiverBounds>) -> Packed {
    let Cone { position, direction, cos_inner, cos_outer } = cone;
    let height = height(f64::from(cos_inner), f64::from(cos_outer));
    let share = |bounds: ReceiverBounds| {
        let receivers = bounds.cone_from(position).filter(|cone| cone.height < 1.0 - f64::from(cos_outer));
        // As if the receivers were in the brightest part of the cone.
        receivers.map_or(1.0, |cone| (cone.height / height).min(1.0))
    };
    let steradians = 2.0 * PI * height;
    Packed {
        texels: texels([
            (layout::KIND_TEXEL, [layout::SPOT | layout::CLOSED_FORM, 0, 0, 0]),
            (layout::POSITION_TEXEL, bits(position, finite(range))),
            (layout::EMISSION_TEXEL, bits(intensity, 0.0)),
            (layout::AXIS_TEXEL, bits(direction, cos_outer)),
            (layout::CONE_TEXEL, [cos_inner.to_bits(), 0, 0, 0]),
        ]),
        info: LightInfo {
            received_share: receivers.map_or(1.0, share),
            ..LightInfo::punctual(mean(intensity) * steradians, mean(intensity), position, 0.0)
        },
    }
}

/// Height of the spherical cap into which a spot light of full intensity sends the same power.
fn height(cos_inner: f64, cos_outer: f64) -> f64 {
    // The falloff is the square of a linear ramp in the cosine, so the cap between the cones counts a third.
    (1.0 - cos_inner) + (cos_inner - cos_outer) / 3.0
}
