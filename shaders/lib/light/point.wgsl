// Point lights (KHR_lights_punctual), and what spot lights share with them.

import package::lib::constants::{LIGHT_EMISSION_TEXEL, LIGHT_POSITION_TEXEL};
import package::lib::light::receivers::receiver_cone;
import package::lib::light::table::{EmittedRay, NO_EMITTER, light_texel_f32};
import package::lib::math::{PI, basis};
import package::lib::sampling::sample_cap;

// The light that a punctual light sends to a point: `direction` towards the light, and the irradiance perpendicular to
// it.
struct PunctualLight {
    direction: vec3f,
    distance: f32,
    irradiance: vec3f,
}

// The window of KHR_lights_punctual that takes the light to 0 at its range; 1 for an infinite range.
fn range_window(distance: f32, range: f32) -> f32 {
    let relative = distance / range;
    let relative2 = relative * relative;
    return clamp(1.0 - relative2 * relative2, 0.0, 1.0);
}

fn point_at(light: u32, position: vec3f) -> PunctualLight {
    let intensity = light_texel_f32(light, LIGHT_EMISSION_TEXEL).xyz;
    let own = light_texel_f32(light, LIGHT_POSITION_TEXEL);
    let offset = own.xyz - position;
    let distance2 = dot(offset, offset);
    // At the light itself there is no direction, and no light arrives.
    if distance2 < 1e-30 { return PunctualLight(vec3f(0.0, 0.0, 1.0), 0.0, vec3f(0.0)); }
    let distance = sqrt(distance2);
    return PunctualLight(offset / distance, distance, intensity * (range_window(distance, own.w) / distance2));
}

// Samples a ray uniformly over the sphere, or over the cone of the receiver bounds if that is narrower.
fn point_emit(light: u32, u: vec2f) -> EmittedRay {
    let position = light_texel_f32(light, LIGHT_POSITION_TEXEL).xyz;
    let intensity = light_texel_f32(light, LIGHT_EMISSION_TEXEL).xyz;
    let cone = receiver_cone(position);
    let direction = basis(cone.axis) * sample_cap(u, cone.height);
    return EmittedRay(position, direction, direction, NO_EMITTER, intensity * (2.0 * PI * cone.height));
}
