// Traces given rays, one for each invocation, by each traversal of lib/bvh.
// In: `rays`, two texels each (origin, t_min; direction, t_max). Out: `answers`; see each entry point.

import package::kit::group_index;
import package::lib::ray::{Ray, RaySample, Hit, NO_HIT, offset_origin};
import package::lib::bvh::{begin_traversal, next_triangle, intersect_primitive, stops, traversal_overrun};
import package::lib::bvh::{trace_closest, trace_occluded};
import package::lib::packet::{begin_line, next_on_line, no_ray, trace_closest_together, trace_occluded_together};

override ray_count: u32;
override primitive_count: u32;

// Nothing is partly transparent here.
const ANY_SAMPLE = RaySample(0u, 0u);

@group(0) @binding(0) var<storage, read> rays: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> answers: array<vec4u>;

fn ray_of(i: u32) -> Ray {
    return Ray(rays[2u * i].xyz, rays[2u * i].w, rays[2u * i + 1u].xyz, rays[2u * i + 1u].w);
}

// Ray i, or one that meets nothing: every lane traces.
fn ray_or_none(i: u32) -> Ray {
    var ray = no_ray();
    if i < ray_count { ray = ray_of(i); }
    return ray;
}

fn answer(i: u32, hit: Hit) {
    answers[i] = vec4u(bitcast<vec3u>(vec3f(hit.t, hit.u, hit.v)), hit.triangle);
}

// t, u, v, primitive index.
@compute @workgroup_size(64)
fn closest(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i < ray_count { answer(i, trace_closest(ray_of(i), ANY_SAMPLE)); }
}

// As closest, by a loop over all triangles.
@compute @workgroup_size(64)
fn exhaustive(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= ray_count { return; }
    let ray = ray_of(i);
    var traversal = begin_traversal(ray);
    var first = Hit(ray.t_max, 0.0, 0.0, NO_HIT);
    for (var primitive = 0u; primitive < primitive_count; primitive++) {
        let hit = intersect_primitive(&traversal, primitive);
        let nearer = hit.t < first.t || first.triangle == NO_HIT;
        if nearer && stops(hit, ray.t_min, ray.t_max, ANY_SAMPLE) { first = hit; }
    }
    answer(i, first);
}

// As closest, in packets.
@compute @workgroup_size(64)
fn closest_together(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let hit = trace_closest_together(ray_or_none(i), ANY_SAMPLE, lane);
    if i < ray_count { answer(i, hit); }
}

// As occluded, in packets.
@compute @workgroup_size(64)
fn occluded_together(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let stopped = trace_occluded_together(ray_or_none(i), ANY_SAMPLE, lane);
    if i < ray_count { answers[i] = vec4u(u32(stopped), u32(traversal_overrun), 0u, 0u); }
}

// Occluded, overrun, 0, 0.
@compute @workgroup_size(64)
fn occluded(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= ray_count { return; }
    let stopped = trace_occluded(ray_of(i), ANY_SAMPLE);
    answers[i] = vec4u(u32(stopped), u32(traversal_overrun), 0u, 0u);
}

// Every surface along the ray: how many, the sum of their primitive indices, overrun, 0.
@compute @workgroup_size(64)
fn line(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= ray_count { return; }
    let ray = ray_of(i);
    var traversal = begin_traversal(ray);
    var count = 0u;
    var sum = 0u;
    while !traversal.done {
        let primitive = next_triangle(&traversal, ray.t_max);
        if primitive != NO_HIT && stops(intersect_primitive(&traversal, primitive), ray.t_min, ray.t_max, ANY_SAMPLE) {
            count++;
            sum += primitive;
        }
    }
    answers[i] = vec4u(count, sum, u32(traversal_overrun), 0u);
}

// As line, in packets.
@compute @workgroup_size(64)
fn line_together(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let ray = ray_or_none(i);
    var line = begin_line(ray, lane);
    var count = 0u;
    var sum = 0u;
    while !line.done {
        let hits = next_on_line(&line, lane);
        if hits.first.triangle != NO_HIT && stops(hits.first, ray.t_min, ray.t_max, ANY_SAMPLE) {
            count++;
            sum += hits.first.triangle;
        }
        if hits.second.triangle != NO_HIT && stops(hits.second, ray.t_min, ray.t_max, ANY_SAMPLE) {
            count++;
            sum += hits.second.triangle;
        }
    }
    if i < ray_count { answers[i] = vec4u(count, sum, u32(traversal_overrun), 0u); }
}

// The origin of ray i, offset as if the direction were the normal.
@compute @workgroup_size(64)
fn offset(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i < ray_count { answers[i] = vec4u(bitcast<vec3u>(offset_origin(ray_of(i).origin, ray_of(i).direction)), 0u); }
}
