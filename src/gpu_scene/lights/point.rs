//! Point lights.

use std::f64::consts::PI;

use glam::Vec3;

use super::layout::{self, LightInfo, Packed, bits, mean, texels};
use crate::gpu_scene::receivers::ReceiverBounds;

/// The range as a finite number: at 3e38 the window is 1 everywhere, as for an infinite range.
pub(super) fn finite(range: f32) -> f32 {
    range.min(f32::MAX)
}

pub(super) fn pack(position: Vec3, intensity: Vec3, range: f32, receivers: Option<ReceiverBounds>) -> Packed {
    let strength = mean(intensity);
    let share = |bounds: ReceiverBounds| bounds.cone_from(position).map_or(1.0, |cone| cone.height / 2.0);
    Packed {
        texels: texels([
            (layout::KIND_TEXEL, [layout::POINT | layout::CLOSED_FORM, 0, 0, 0]),
            (layout::POSITION_TEXEL, bits(position, finite(range))),
            (layout::EMISSION_TEXEL, bits(intensity, 0.0)),
        ]),
        info: LightInfo {
            received_share: receivers.map_or(1.0, share),
            ..LightInfo::punctual(strength * 4.0 * PI, strength, position, 0.0)
        },
    }
}
