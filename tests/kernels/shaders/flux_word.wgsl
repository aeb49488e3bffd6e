// Encodes and decodes the words of photons that carry flux.
// In: `fluxes` and `marks`. Out: `words`; see each.

import package::kit::group_index;
import package::lib::constants::PHOTON_SHADOW;
import package::lib::photon::{flux_of, flux_word};

override count: u32;

// Flux in units, and a random number xi.
@group(0) @binding(0) var<storage, read> fluxes: array<vec4f>;
// Code of a normal, and 1 for a shadow photon.
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
// The word, and the steps decoded from it, by channel.
@group(0) @binding(2) var<storage, read_write> words: array<vec4u>;

@compute @workgroup_size(64)
fn encode(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let kind = select(0u, PHOTON_SHADOW, marks[i].y != 0u);
    let word = flux_word(marks[i].x, fluxes[i].xyz, fluxes[i].w, kind);
    words[i] = vec4u(word, bitcast<vec3u>(flux_of(word)));
}
