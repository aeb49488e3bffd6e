// The potentials of lights at points, by which lights are sampled, and their irradiance, for a test to compare.

import package::kit::group_index;
import package::lib::light::{light_dark, light_potential, light_unshadowed_irradiance};

override count: u32;

// Position and light, normal.
@group(0) @binding(0) var<storage, read> queries: array<vec4f>;
// Potential, irradiance of a light with a closed form, whether it is dark.
@group(0) @binding(1) var<storage, read_write> results: array<vec4f>;

@compute @workgroup_size(64)
fn weigh(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let query = queries[2u * i];
    let normal = queries[2u * i + 1u].xyz;
    let light = u32(query.w);
    let irradiance = light_unshadowed_irradiance(light, query.xyz, normal);
    let dark = f32(light_dark(light, query.xyz, normal));
    results[i] = vec4f(light_potential(light, query.xyz, normal), irradiance.x, dark, 0.0);
}
