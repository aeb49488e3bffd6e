// What kernels read of the triangle that a ray hits, where it may be one of an instance.
// In: `rays`, two texels each (origin, t_min; direction, t_max). Out: `answers`, five words of four for each ray.

import package::kit::group_index;
import package::lib::ray::{Ray, RaySample, NO_HIT};
import package::lib::bvh::{trace_closest, triangle_corners, triangle_word};
import package::lib::instance::{placed_normal, placed_tangent, stored_triangle};

override ray_count: u32;

@group(0) @binding(0) var<storage, read> rays: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> answers: array<vec4u>;

// The corners, a normal and a tangent; in w: the primitive, where it is stored, and its word.
@compute @workgroup_size(64)
fn met(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= ray_count { return; }
    let ray = Ray(rays[2u * i].xyz, rays[2u * i].w, rays[2u * i + 1u].xyz, rays[2u * i + 1u].w);
    let hit = trace_closest(ray, RaySample(0u, 0u));
    for (var k = 0u; k < 5u; k++) { answers[5u * i + k] = vec4u(NO_HIT); }
    if hit.triangle == NO_HIT { return; }
    let corners = triangle_corners(hit.triangle);
    let of_mesh = normalize(ray.direction);
    answers[5u * i] = vec4u(bitcast<vec3u>(corners[0]), hit.triangle);
    answers[5u * i + 1u] = vec4u(bitcast<vec3u>(corners[1]), stored_triangle(hit.triangle));
    answers[5u * i + 2u] = vec4u(bitcast<vec3u>(corners[2]), triangle_word(hit.triangle));
    answers[5u * i + 3u] = vec4u(bitcast<vec3u>(placed_normal(hit.triangle, of_mesh)), 0u);
    answers[5u * i + 4u] = vec4u(bitcast<vec3u>(placed_tangent(hit.triangle, of_mesh)), 0u);
}
