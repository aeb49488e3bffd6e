// Points of the sequences, and warped points, for a test to count.

import package::kit::group_index;
import package::lib::sampling::{
    owen_scramble, sobol1, sobol2, sobol4, sample_cosine, sample_disc, sample_cap, sample_triangle,
    sample_spherical_triangle, spherical_triangle
};
import package::lib::math::{oct_encode16, oct_decode16, oct_encode7, oct_decode7, basis};

override count: u32;
override seed: u32;
// Which warp, 0 to 4: cosine, disc, sphere, cone of cosine `cos_max`, triangle.
override warp: u32;
override cos_max: f32;

@group(0) @binding(0) var<storage, read_write> points: array<vec4f>;
@group(0) @binding(1) var<storage, read> directions: array<vec4f>;

fn item(group: vec3u, groups: vec3u, lane: u32) -> u32 {
    return group_index(group, groups) * 64u + lane;
}

@compute @workgroup_size(64)
fn two(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i < count { points[i] = vec4f(sobol2(i, seed), sobol1(i, seed), 0.0); }
}

@compute @workgroup_size(64)
fn four(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i < count { points[i] = sobol4(i, seed); }
}

@compute @workgroup_size(64)
fn warped(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let u = sobol2(i, seed);
    var p: vec3f;
    switch warp {
        case 0u: { p = sample_cosine(u); }
        case 1u: { p = vec3f(sample_disc(u), 0.0); }
        case 2u: { p = sample_cap(u, 2.0); }
        case 3u: { p = sample_cap(u, 1.0 - cos_max); }
        default: { p = vec3f(sample_triangle(u), 0.0); }
    }
    points[i] = vec4f(p, 0.0);
}

// Barycentric coordinates of points uniform over a triangle's solid angle, the solid angle, and points uniform over the
// area. The first four `directions` are the corners and the position.
@compute @workgroup_size(64)
fn seen(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let u = sobol2(i, seed + i);
    let e1 = directions[1].xyz - directions[0].xyz;
    let e2 = directions[2].xyz - directions[0].xyz;
    let triangle = spherical_triangle(directions[0].xyz - directions[3].xyz, e1, e2, cross(e1, e2));
    points[i * 2u] = vec4f(sample_spherical_triangle(triangle, u), 2.0 * triangle.half_angle, 0.0);
    points[i * 2u + 1u] = vec4f(sample_triangle(u), 0.0, 0.0);
}

// For each direction: its vectors after 16-bit and 7-bit octahedral coding, and its basis.
@compute @workgroup_size(64)
fn coded(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let n = directions[i].xyz;
    let frame = basis(n);
    points[i * 4u] = vec4f(oct_decode16(oct_encode16(n)), 0.0);
    points[i * 4u + 1u] = vec4f(oct_decode7(oct_encode7(n)), f32(oct_encode7(n)));
    points[i * 4u + 2u] = vec4f(frame[0], 0.0);
    points[i * 4u + 3u] = vec4f(frame[1], 0.0);
}
