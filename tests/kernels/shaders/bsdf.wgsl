// Evaluates and samples the BSDF module, for a test to compare.

import package::kit::group_index;
import package::lib::bsdf::surface::Surface;
@if(coat_normals) import package::lib::bsdf::surface::seen_from;
import package::lib::bsdf::{bsdf_diffuse, bsdf_evaluate, bsdf_faces, bsdf_pdf, bsdf_sample, bsdf_seen_afar};
@if(glossy) import package::lib::bsdf::{bsdf_less, bsdf_max_density};
import package::lib::sampling::sobol4;

override count: u32;
override seed: u32;
// 1: all samples are from one sequence; 0: each is from a sequence of its own, so that they are independent.
override stratified: u32;

// Albedo and alpha; f0 and f90; the dielectric's two, geometric normal's x and z; shading normal, coat normal's x;
// view, coat normal's z; tint and eta; coat, alpha along the tangent +x; sheen; film; tint of diffuse transmission.
@group(0) @binding(0) var<storage, read> surface: array<vec4f>;
@group(0) @binding(1) var<storage, read> directions: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> results: array<vec4f>;

fn item(group: vec3u, groups: vec3u, lane: u32) -> u32 {
    return group_index(group, groups) * 64u + lane;
}

fn tested_surface() -> Surface {
    var s: Surface;
    s.albedo = surface[0].xyz;
    @if(glossy) {
        s.specular.alpha = surface[0].w;
        s.specular.f0 = surface[1].xyz;
        s.specular.f90 = surface[1].w;
        s.specular.dielectric = surface[2].xy;
    }
    s.geometric_normal = vec3f(surface[2].z, 0.0, surface[2].w);
    s.shading_normal = surface[3].xyz;
    s.view = surface[4].xyz;
    @if(transmission) {
        s.transmission.tint = surface[5].xyz;
        s.transmission.eta = surface[5].w;
    }
    @if(diffuse_transmission) { s.diffuse_transmission.tint = surface[9].xyz; }
    @if(clearcoat) { s.clearcoat.factor = surface[6].x; s.clearcoat.alpha = surface[6].y; }
    @if(coat_normals) { s.clearcoat.normal = vec3f(surface[3].w, 0.0, surface[4].w); }
    @if(sheen) { s.sheen.colour = surface[7].xyz; s.sheen.roughness = surface[7].w; }
    @if(iridescence) {
        s.iridescence.factor = surface[8].x;
        s.iridescence.ior = surface[8].y;
        s.iridescence.thickness = surface[8].z;
    }
    @if(anisotropy) {
        s.anisotropy.tangent = vec3f(1.0, 0.0, 0.0);
        s.anisotropy.alpha_along = surface[6].z;
    }
    // Bends a coat's normal that faces away from the viewer, as at the hit of a ray.
    @if(coat_normals) { s = seen_from(s, s.view); }
    return s;
}

// The BSDF times the cosine and its density, for each direction; then its two parts' sum, where the base reflects, and
// the bound of the density.
@compute @workgroup_size(64)
fn evaluated(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let s = tested_surface();
    let direction = directions[i].xyz;
    results[2u * i] = vec4f(bsdf_evaluate(s, direction), bsdf_pdf(s, direction));
    let base = select(vec3f(0.0), bsdf_diffuse(s) * dot(direction, s.shading_normal), bsdf_faces(s, direction));
    var max_density = 0.0;
    var residual = vec3f(0.0);
    @if(glossy) {
        max_density = bsdf_max_density(s);
        residual = bsdf_less(s, direction, bsdf_diffuse(s));
    }
    results[2u * i + 1u] = vec4f(base + residual, max_density);
}

// Samples: direction and density, weight of radiance, that of flux.
@compute @workgroup_size(64)
fn sampled(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    let s = bsdf_sample(tested_surface(), sobol4(i, select(seed + i, seed, stratified == 1u)).xyz);
    results[2u * i] = vec4f(s.direction, s.pdf);
    var flux = s.weight.x;
    @if(transmission) { flux /= max(s.concentration.x, 1e-20); }
    results[2u * i + 1u] = vec4f(s.weight, flux);
}

// The albedo of the surface where a path ends.
@compute @workgroup_size(64)
fn seen_afar(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = item(group, groups, lane);
    if i >= count { return; }
    results[2u * i] = vec4f(bsdf_seen_afar(tested_surface()) * 3.14159265, 0.0);
    results[2u * i + 1u] = vec4f(0.0);
}
