// Of places and lights what lights are chosen by, beside what they bring, for a test to compare.

import package::lib::dispatch::group_index;
import package::lib::light::{light_dark, light_potential, light_unshadowed_irradiance};

override count: u32;

// Position and light, normal.
@group(0) @binding(0) var<storage, read> places: array<vec4f>;
// Potential, irradiance of a light that has a closed form, whether it is dark.
@group(0) @binding(1) var<storage, read_write> results: array<vec4f>;

@compute @workgroup_size(64)
fn weigh(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let place = places[2u * i];
    let normal = places[2u * i + 1u].xyz;
    let light = u32(place.w);
    let irradiance = light_unshadowed_irradiance(light, place.xyz, normal);
    let dark = f32(light_dark(light, place.xyz, normal));
    results[i] = vec4f(light_potential(light, place.xyz, normal), irradiance.x, dark, 0.0);
}
