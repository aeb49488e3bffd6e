// The points of a light that a surface point asks for: where on the light, and what they would contribute.

import package::lib::light::{LightSample, light_sample};
import package::lib::rng::hash2;
import package::lib::sampling::sobol2;
import package::lib::constants::{DIMENSION_LIGHT, DIMENSION_AUDIT};

// The j-th of `count` stratified points of the light for a sample of a pixel. The samples of a pixel continue one
// low-discrepancy sequence, so all of its light points together are stratified too.
fn nth_light_sample(light: u32, position: vec3f, seed: u32, sample_index: u32, j: u32, count: u32) -> LightSample {
    let u = sobol2(sample_index * count + j, hash2(hash2(seed, DIMENSION_LIGHT), light));
    return light_sample(light, position, u);
}

// The point of the light that an audit asks about.
fn audit_light_sample(light: u32, position: vec3f, seed: u32, sample_index: u32) -> LightSample {
    return light_sample(light, position, sobol2(sample_index, hash2(hash2(seed, DIMENSION_AUDIT), light)));
}
