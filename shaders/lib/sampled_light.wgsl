// The light of a candidate, and its light points.

import package::lib::light::table::LightSample;
@if(!light_sampling) import package::lib::math::quotient;
import package::lib::light::light_sample;
import package::lib::rng::hash2;
import package::lib::sampling::sobol2;
import package::lib::constants::{DIMENSION_LIGHT, DIMENSION_AUDIT};

// For each candidate of all chunks, where points sample a few of many lights: the light, and 1 over the probability
// that it was sampled.
@if(light_sampling) @group(0) @binding(15) var<storage, read> sampled_lights: array<vec2u>;

// The light of a candidate. Candidate i of a chunk is light * points + point, or sample * points + point where points
// sample lights; `first` is the first light, or the first sample, of the chunk.
fn candidate_light(candidate: u32, first: u32, points: u32) -> u32 {
    @if(light_sampling) { return sampled_lights[first * points + candidate].x; }
    @else { return first + quotient(candidate, points); }
}

// 1 over the probability that the light of a candidate was sampled.
@if(light_sampling)
fn candidate_weight(candidate: u32, first: u32, points: u32) -> f32 {
    return bitcast<f32>(sampled_lights[first * points + candidate].y);
}

// The j-th of `count` stratified light points for a sample of a pixel. All samples of a pixel continue one
// low-discrepancy sequence, so that their light points together are stratified too.
fn nth_light_sample(light: u32, position: vec3f, seed: u32, sample_index: u32, j: u32, count: u32) -> LightSample {
    let u = sobol2(sample_index * count + j, hash2(hash2(seed, DIMENSION_LIGHT), light));
    return light_sample(light, position, u);
}

// The point of the light to which an audit traces its ray.
fn audit_light_sample(light: u32, position: vec3f, seed: u32, sample_index: u32) -> LightSample {
    return light_sample(light, position, sobol2(sample_index, hash2(hash2(seed, DIMENSION_AUDIT), light)));
}
