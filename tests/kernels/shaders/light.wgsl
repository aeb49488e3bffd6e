// Evaluates and samples the light module, for a test to compare.

import package::kit::group_index;
import package::lib::light::table::{light_count, light_has_closed_form};
import package::lib::light::{light_dark, light_unshadowed_irradiance, light_sample, light_emit, light_max_solid_angle};
import package::lib::sampling::{sobol2, sobol4};
@if(mesh_lights) import package::lib::light::mesh::emitter_of;

override count: u32;
override seed: u32;
// Samples a place.
override samples: u32;

// Position and light, normal.
@group(0) @binding(0) var<storage, read> places: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> results: array<vec4f>;

fn item(group: vec3u, groups: vec3u, lane: u32) -> u32 {
    return group_index(group, groups) * 64u + lane;
}

// Irradiance, and bits: 1 dark, 2 closed form, 4 no such light.
@compute @workgroup_size(64)
fn closed(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let place = places[2u * i];
    let normal = places[2u * i + 1u].xyz;
    let light = u32(place.w);
    let bits = u32(light_dark(light, place.xyz, normal)) | (u32(light_has_closed_form(light)) << 1u)
        | (u32(light >= light_count()) << 2u);
    results[i] = vec4f(light_unshadowed_irradiance(light, place.xyz, normal), f32(bits));
}

// The bound of the light's solid angle.
@compute @workgroup_size(64)
fn solid_angles(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let place = places[2u * i];
    results[i] = vec4f(light_max_solid_angle(u32(place.w), place.xyz), 0.0, 0.0, 0.0);
}

// The mean over a position's samples of radiance times cosine over density, and the mean square of its red.
@compute @workgroup_size(64)
fn sampled(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let place = places[2u * i];
    let normal = places[2u * i + 1u].xyz;
    var sum = vec4f(0.0);
    for (var j = 0u; j < samples; j++) {
        // Each sample is from a sequence of its own, so that the samples are independent and their spread gives the
        // error.
        let s = light_sample(u32(place.w), place.xyz, sobol2(j, seed + j));
        if s.pdf > 0.0 {
            let f = s.radiance * (max(dot(s.direction, normal), 0.0) / s.pdf);
            sum += vec4f(f, f.x * f.x);
        }
    }
    results[i] = sum / f32(samples);
}

// The samples of one position: direction and density, radiance and distance.
@compute @workgroup_size(64)
fn listed(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let s = light_sample(u32(places[0].w), places[0].xyz, sobol2(i, seed + i));
    results[2u * i] = vec4f(s.direction, s.pdf);
    results[2u * i + 1u] = vec4f(s.radiance, s.distance);
}

// Emitted rays: origin and triangle, direction and flux, normal.
@compute @workgroup_size(64)
fn emitted(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let ray = light_emit(u32(places[0].w), sobol4(i, seed + i));
    results[3u * i] = vec4f(ray.origin, f32(ray.triangle));
    results[3u * i + 1u] = vec4f(ray.direction, ray.flux.x);
    results[3u * i + 2u] = vec4f(ray.normal, 0.0);
}

// The density by solid angle with which a light point on a triangle is sampled from a position, and the triangle's
// light. The x of the place's normal is the triangle's index.
@if(mesh_lights)
@compute @workgroup_size(64)
fn densities(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let emitter = emitter_of(u32(places[2u * i + 1u].x), places[2u * i].xyz);
    results[i] = vec4f(emitter.pdf, f32(emitter.light), 0.0, 0.0);
}
