// The environment as a light: the panorama of lib/environment.

import package::lib::constants::LIGHT_ENVIRONMENT;
import package::lib::environment::environment_sample;
import package::lib::light::distant::distant_ray;
import package::lib::light::table::{EmittedRay, FAR_DISTANCE, LightSample, light_kind};

fn is_environment(light: u32) -> bool {
    return light_kind(light) == LIGHT_ENVIRONMENT;
}

fn environment_light_sample(u: vec2f) -> LightSample {
    let sampled = environment_sample(u);
    return LightSample(sampled.direction, FAR_DISTANCE, sampled.radiance, sampled.pdf, vec3f(0.0), false);
}

// Samples a direction by radiance, and a ray along it through a disc as wide as the scene.
fn environment_emit(light: u32, u: vec4f) -> EmittedRay {
    let sampled = environment_sample(u.xy);
    return distant_ray(light, -sampled.direction, sampled.radiance / sampled.pdf, u.zw);
}
