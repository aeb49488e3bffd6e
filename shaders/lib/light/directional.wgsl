// Directional lights (KHR_lights_punctual).

import package::lib::constants::{LIGHT_AXIS_TEXEL, LIGHT_EMISSION_TEXEL};
import package::lib::light::distant::distant_ray;
import package::lib::light::point::PunctualLight;
import package::lib::light::table::{EmittedRay, FAR_DISTANCE, light_texel_f32};

fn directional_at(light: u32) -> PunctualLight {
    let irradiance = light_texel_f32(light, LIGHT_EMISSION_TEXEL).xyz;
    return PunctualLight(-light_texel_f32(light, LIGHT_AXIS_TEXEL).xyz, FAR_DISTANCE, irradiance);
}

// Samples a ray through a disc as wide as the scene.
fn directional_emit(light: u32, u: vec2f) -> EmittedRay {
    let direction = light_texel_f32(light, LIGHT_AXIS_TEXEL).xyz;
    return distant_ray(light, direction, light_texel_f32(light, LIGHT_EMISSION_TEXEL).xyz, u);
}
