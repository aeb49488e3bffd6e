// Rays of lights that are infinitely far away.

import package::lib::constants::LIGHT_DISC_TEXEL;
import package::lib::light::table::{EmittedRay, NO_EMITTER, light_texel_f32};
import package::lib::math::{PI, basis};
import package::lib::sampling::sample_disc;

// A ray of a distant light along a direction, through the disc that the scene's bounding sphere fills when seen along
// it. `irradiance` is that of a surface perpendicular to the direction, over the density with which the direction is
// sampled.
fn distant_ray(light: u32, direction: vec3f, irradiance: vec3f, u: vec2f) -> EmittedRay {
    let sphere = light_texel_f32(light, LIGHT_DISC_TEXEL);
    // Slightly wider, so that rounding does not cut off the rim.
    let reach = sphere.w * 1.001;
    let offset = basis(direction) * vec3f(reach * sample_disc(u), -2.0 * reach);
    return EmittedRay(sphere.xyz + offset, direction, direction, NO_EMITTER, irradiance * (PI * reach * reach));
}
