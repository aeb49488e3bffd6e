// The rays that the photon pass sends from a light, for a test to follow.

import package::kit::group_index;
import package::lib::light::light_emit;
import package::lib::sampling::sobol4;
import package::lib::ray::offset_origin;
import package::lib::rng::hash3;
import package::lib::constants::DIMENSION_PHOTON;

override light: u32;
override seed: u32;
override count: u32;

// Origin, direction.
@group(0) @binding(0) var<storage, read_write> rays: array<vec4f>;

@compute @workgroup_size(64)
fn emit(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let ray = light_emit(light, sobol4(i, hash3(seed, DIMENSION_PHOTON, light)));
    rays[2u * i] = vec4f(offset_origin(ray.origin, ray.normal), 0.0);
    rays[2u * i + 1u] = vec4f(ray.direction, 0.0);
}
