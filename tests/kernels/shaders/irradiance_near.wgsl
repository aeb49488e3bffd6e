// Looks up precomputed irradiance at given points, or reads its table.
// In: `queries`. Out: `found`, irradiance and radius of the disc.

import package::kit::group_index;
import package::lib::irradiance::{irradiance_near, load_irradiance_texel};
@if(caustic_irradiance) import package::lib::irradiance::load_caustic_irradiance;
import package::lib::math::oct_decode16;
import package::lib::point::Point;

override count: u32;

@group(0) @binding(0) var<storage, read> queries: array<Point>;
@group(0) @binding(1) var<storage, read_write> found: array<vec4f>;

@compute @workgroup_size(64)
fn near(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let known = irradiance_near(queries[i].position, oct_decode16(queries[i].normal));
    found[i] = vec4f(known.value, known.radius);
}

@if(caustic_irradiance)
@compute @workgroup_size(64)
fn focused(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let known = irradiance_near(queries[i].position, oct_decode16(queries[i].normal));
    found[i] = vec4f(load_caustic_irradiance(known.point), 0.0);
}

@compute @workgroup_size(64)
fn dump(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i < count { found[i] = load_irradiance_texel(i); }
}
