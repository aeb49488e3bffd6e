// Spot lights (KHR_lights_punctual): point lights with a cone.

import package::lib::constants::{LIGHT_AXIS_TEXEL, LIGHT_CONE_TEXEL, LIGHT_EMISSION_TEXEL, LIGHT_POSITION_TEXEL};
import package::lib::light::receivers::receiver_cone;
import package::lib::light::table::{EmittedRay, NO_EMITTER, light_texel_f32};
import package::lib::math::{PI, basis};
import package::lib::sampling::sample_cap;

// The fraction of its intensity that a spot light emits along a direction.
fn spot_falloff(light: u32, direction: vec3f) -> f32 {
    // The axis, and the cosine of the outer cone angle.
    let axis = light_texel_f32(light, LIGHT_AXIS_TEXEL);
    // KHR_lights_punctual's reference code, the 0.001 included.
    let scale = 1.0 / max(0.001, light_texel_f32(light, LIGHT_CONE_TEXEL).x - axis.w);
    let falloff = clamp((dot(axis.xyz, direction) - axis.w) * scale, 0.0, 1.0);
    return falloff * falloff;
}

// Samples a ray uniformly over the outer cone, or over the cone of the receiver bounds if that is narrower.
fn spot_emit(light: u32, u: vec2f) -> EmittedRay {
    let position = light_texel_f32(light, LIGHT_POSITION_TEXEL).xyz;
    let intensity = light_texel_f32(light, LIGHT_EMISSION_TEXEL).xyz;
    let axis = light_texel_f32(light, LIGHT_AXIS_TEXEL);
    let cone = receiver_cone(position);
    let narrower = cone.height < 1.0 - axis.w;
    let height = select(1.0 - axis.w, cone.height, narrower);
    let direction = basis(select(axis.xyz, cone.axis, narrower)) * sample_cap(u, height);
    let flux = intensity * (spot_falloff(light, direction) * 2.0 * PI * height);
    return EmittedRay(position, direction, direction, NO_EMITTER, flux);
}
