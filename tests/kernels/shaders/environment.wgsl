// Evaluates and samples the environment, for a test to compare.

import package::kit::group_index;
import package::lib::environment::{environment_met, environment_radiance, environment_sample};
import package::lib::light::light_emit;
import package::lib::sampling::{sobol2, sobol4};

override count: u32;
override seed: u32;

@group(0) @binding(0) var<storage, read> directions: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> results: array<vec4f>;

fn item(group: vec3u, groups: vec3u, lane: u32) -> u32 {
    return group_index(group, groups) * 64u + lane;
}

// For each direction: radiance and density; radiance only.
@compute @workgroup_size(64)
fn met(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    results[2u * i] = environment_met(directions[i].xyz);
    results[2u * i + 1u] = vec4f(environment_radiance(directions[i].xyz), 0.0);
}

// A sample: direction and density, radiance.
@compute @workgroup_size(64)
fn sampled(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let s = environment_sample(sobol2(i, seed));
    results[2u * i] = vec4f(s.direction, s.pdf);
    results[2u * i + 1u] = vec4f(s.radiance, 0.0);
}

// An emitted ray of the first light: origin, direction, flux.
@compute @workgroup_size(64)
fn emitted(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let ray = light_emit(0u, sobol4(i, seed));
    results[3u * i] = vec4f(ray.origin, 0.0);
    results[3u * i + 1u] = vec4f(ray.direction, 0.0);
    results[3u * i + 2u] = vec4f(ray.flux, 0.0);
}
