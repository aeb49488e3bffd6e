// Which light a slot is about, the points of a light that a surface point asks for, and what they would contribute.

import package::lib::light::table::LightSample;
import package::lib::light::light_sample;
import package::lib::rng::hash2;
import package::lib::sampling::sobol2;
import package::lib::constants::{DIMENSION_LIGHT, DIMENSION_AUDIT};

// Of each slot of all chunks, where few of many lights are chosen: the light, and by how much what it sends counts
// more.
@if(light_sampling) @group(0) @binding(15) var<storage, read> sampled_lights: array<vec2u>;

// The light of a slot. A slot of a chunk is light * points + point, or turn * points + point where lights are chosen;
// `first` is the chunk's first light or turn.
fn candidate_light(slot: u32, first: u32, points: u32) -> u32 {
    @if(light_sampling) { return sampled_lights[first * points + slot].x; }
    @else { return first + slot / points; }
}

// What the light of a slot stands for: 1 over the probability that it was chosen.
@if(light_sampling)
fn candidate_weight(slot: u32, first: u32, points: u32) -> f32 {
    return bitcast<f32>(sampled_lights[first * points + slot].y);
}

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
