// Intersection and offset of lib/ray, and angles of lib/math, on given numbers, for a test to compare with double
// precision. In: `items`. Out: `results`, three for each item; see each entry point.

import package::kit::group_index;
import package::lib::math::{angle_of, circle_point};
import package::lib::ray::{Ray, intersect_triangle, offset_origin, shear_ray};

override count: u32;

// For each item: origin, direction, three corners.
@group(0) @binding(0) var<storage, read> items: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> results: array<vec4f>;

// The hit as t, u, v; its point on the triangle; and that as an origin of rays on the side of the ray.
@compute @workgroup_size(64)
fn intersect(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let ray = Ray(items[5u * i].xyz, 0.0, items[5u * i + 1u].xyz, 1e30);
    let a = items[5u * i + 2u].xyz;
    let b = items[5u * i + 3u].xyz;
    let c = items[5u * i + 4u].xyz;
    let hit = intersect_triangle(shear_ray(ray), a, b, c);
    let point = a + hit.y * (b - a) + hit.z * (c - a);
    let across = normalize(cross(b - a, c - a));
    let normal = select(across, -across, dot(across, ray.direction) > 0.0);
    results[3u * i] = vec4f(hit, 0.0);
    results[3u * i + 1u] = vec4f(point, 0.0);
    results[3u * i + 2u] = vec4f(offset_origin(point, normal), 0.0);
}

// The point of the unit circle at x turns; the angle of (z, y).
@compute @workgroup_size(64)
fn angles(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let item = items[5u * i];
    results[3u * i] = vec4f(circle_point(item.x), angle_of(item.y, item.z), 0.0);
}

// fma(a, b, -a b): the rounding error of the product where fma is fused, else 0.
@compute @workgroup_size(64)
fn fused(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let pair = items[5u * i].xy;
    results[3u * i] = vec4f(fma(pair.x, pair.y, -(pair.x * pair.y)), 0.0, 0.0, 0.0);
}
