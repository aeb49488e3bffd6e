// gather: the final gather. Rays over the hemisphere of each new irradiance record, stratified by the cosine; each brings the
// light that the photons tell at the surface it meets, or is traced on where that is too close (`follow`). What a record's
// rays bring becomes its irradiance, with rotational and translational gradients (Ward and Heckbert 1992) and the harmonic
// mean of the distances (`record`).
// In: points and surfaces, and which of them want records. Out: `record_heads`, `record_values`; see lib/record.

import package::lib::bsdf::{bsdf_seen_afar, reflects_more};
@if(caustics) import package::lib::bsdf::focuses;
import package::lib::bvh::{trace_closest, traversal_overrun};
import package::lib::camera::pixel_size;
import package::lib::dispatch::{dispatch_groups, group_index};
import package::lib::irradiance::irradiance_near;
import package::lib::light::BEYOND_SCENE;
import package::lib::math::{PI, basis, is_finite3, luminance, oct_decode16};
import package::lib::point::{Point, SURFACE_VECTORS};
import package::lib::ray::{Hit, NO_HIT, Ray, offset_origin};
import package::lib::record::{RECORD_HEAD, RECORD_VALUES};
import package::lib::rng::{hash2, hash3, uniform_from_bits};
import package::lib::surface::surface_at;
import package::lib::walk::{PathStart, Vertex, bounce_rays, heavy_path, shadow_rays, spread_along, walk};
import package::lib::constants::{DIMENSION_GATHER, LEAST_RADIUS_PIXELS, COUNTER_GATHER_RAYS, COUNTER_HEAVY_PATHS, COUNTER_NOT_FINITE_GATHER, COUNTER_OVERRUN};

struct GatherParameters {
    // Of `wanted`.
    first: u32,
    count: u32,
    // Strata: rings of equal cosine-weighted area, and sectors.
    rings: u32,
    sectors: u32,
    max_bounces: u32,
    seed: u32,
    // Place of the first record among `record_values`.
    first_record: u32,
    // Height of the image.
    height: u32,
}

var<immediate> gather_pass: GatherParameters;

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read> surfaces: array<vec4f>;
@group(0) @binding(2) var<storage, read> wanted: array<u32>;
// By ray: radiance, and the distance that it came from.
@group(0) @binding(3) var<storage, read_write> gathered: array<vec4f>;
// Rays that are traced on: how many, the arguments of their dispatch; their numbers (FOLLOW_RESIDUAL in the top bit) and hits.
@group(0) @binding(4) var<storage, read_write> follow_count: array<atomic<u32>, 1>;
@group(0) @binding(5) var<storage, read_write> follow_arguments: array<u32, 3>;
@group(0) @binding(6) var<storage, read_write> follow_rays: array<u32>;
@group(0) @binding(7) var<storage, read_write> follow_hits: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> record_heads: array<vec4f>;
@group(0) @binding(9) var<storage, read_write> record_values: array<vec4f>;
@group(0) @binding(10) var<storage, read_write> counters: array<atomic<u32>>;

// Of a ray for which a look-up has brought the diffuse part: what is left is a metal's reflection.
const FOLLOW_RESIDUAL = 0x80000000u;
const GATHER_GROUP = 64u;
// Distance of what a ray did not meet.
const NOTHING = 1e30;

struct GatherRay {
    ray: Ray,
    // Density by solid angle; 0 where it goes into the surface itself.
    pdf: f32,
    // Number of the ray among the record's, and the record's seed.
    stratum: u32,
    seed: u32,
}

fn shading_normal(point: u32) -> vec3f {
    return oct_decode16(bitcast<u32>(surfaces[point * SURFACE_VECTORS].w));
}

fn gather_ray(id: u32) -> GatherRay {
    let rays = gather_pass.rings * gather_pass.sectors;
    let point = wanted[gather_pass.first + id / rays];
    let position = points[point].position;
    let geometric = oct_decode16(points[point].normal);
    let normal = shading_normal(point);
    let stratum = id % rays;
    let bits = bitcast<vec3u>(position);
    let seed = hash3(bits.x ^ gather_pass.seed, bits.y, bits.z + DIMENSION_GATHER);
    let lots = vec2f(uniform_from_bits(hash2(seed, 2u * stratum)), uniform_from_bits(hash2(seed, 2u * stratum + 1u)));
    let sine_squared = (f32(stratum % gather_pass.rings) + lots.x) / f32(gather_pass.rings);
    let angle = 2.0 * PI * (f32(stratum / gather_pass.rings) + lots.y) / f32(gather_pass.sectors);
    let sine = sqrt(sine_squared);
    let cosine = sqrt(1.0 - sine_squared);
    let direction = normalize(basis(normal) * vec3f(sine * cos(angle), sine * sin(angle), cosine));
    let pdf = select(0.0, max(cosine, 1e-3) / PI, dot(direction, geometric) > 0.0);
    return GatherRay(Ray(offset_origin(position, geometric), 0.0, direction, BEYOND_SCENE), pdf, stratum, seed);
}

// What a ray brings, where that is a number: one ray must not spoil a record, and all the points that it lights.
fn finite_or_dark(brought: vec3f) -> vec3f {
    let finite = is_finite3(brought);
    if !finite { atomicAdd(&counters[COUNTER_NOT_FINITE_GATHER], 1u); }
    return select(vec3f(0.0), brought, finite);
}

@compute @workgroup_size(64)
fn gather(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let id = group_index(group, groups) * GATHER_GROUP + lane;
    if id >= gather_pass.count * gather_pass.rings * gather_pass.sectors { return; }
    let leaving = gather_ray(id);
    var brought = vec4f(0.0, 0.0, 0.0, NOTHING);
    var hit = Hit(0.0, 0.0, 0.0, NO_HIT);
    if leaving.pdf > 0.0 { hit = trace_closest(leaving.ray, hash2(leaving.seed, ~id)); }
    if hit.triangle != NO_HIT {
        brought.w = hit.t;
        let found = surface_at(hit, leaving.ray);
        if !found.unlit {
            let known = irradiance_near(found.triangle_position, found.triangle_normal);
            var follow = 0u;
            var follows = true;
            var wide = spread_along(leaving.pdf, hit.t) >= known.radius;
            // The light of a focusing surface is in part the caustic map's; the walk knows which.
            @if(caustics) { wide = wide && !focuses(found.surface); }
            if wide {
                brought = vec4f(bsdf_seen_afar(found.surface) * known.value, brought.w);
                @if(transmission) { brought *= vec4f(found.transmittance, 1.0); }
                follow = FOLLOW_RESIDUAL;
                follows = reflects_more(found.surface);
            }
            if follows {
                let at = atomicAdd(&follow_count[0], 1u);
                follow_rays[at] = id | follow;
                follow_hits[at] = vec4f(hit.t, hit.u, hit.v, bitcast<f32>(hit.triangle));
            }
        }
    }
    gathered[id] = vec4f(finite_or_dark(brought.xyz), brought.w);
    if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
}

@compute @workgroup_size(1)
fn arrange_follow() {
    let size = dispatch_groups(atomicLoad(&follow_count[0]), GATHER_GROUP);
    follow_arguments = array(size.x, size.y, size.z);
}

@compute @workgroup_size(64)
fn follow(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * GATHER_GROUP + lane;
    if i >= atomicLoad(&follow_count[0]) { return; }
    let id = follow_rays[i] & ~FOLLOW_RESIDUAL;
    let words = follow_hits[i];
    let leaving = gather_ray(id);
    let found = surface_at(Hit(words.x, words.y, words.z, bitcast<u32>(words.w)), leaving.ray);
    var vertex: Vertex;
    vertex.position = found.position;
    vertex.surface = found.surface;
    vertex.sample_index = leaving.stratum;
    @if(glossy) { vertex.residual = (follow_rays[i] & FOLLOW_RESIDUAL) != 0u; }
    let start = PathStart(1u, spread_along(leaving.pdf, words.x));
    var brought = walk(vertex, start, leaving.seed, gather_pass.max_bounces, 0u);
    @if(transmission) { brought.indirect *= found.transmittance; }
    gathered[id] = vec4f(gathered[id].xyz + finite_or_dark(brought.indirect), words.x);
    atomicAdd(&counters[COUNTER_GATHER_RAYS], bounce_rays + shadow_rays);
    if heavy_path { atomicAdd(&counters[COUNTER_HEAVY_PATHS], 1u); }
    if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
}

@compute @workgroup_size(64)
fn record(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * GATHER_GROUP + lane;
    if i >= gather_pass.count { return; }
    let rings = gather_pass.rings;
    let sectors = gather_pass.sectors;
    let point = wanted[gather_pass.first + i];
    let position = points[point].position;
    let normal = shading_normal(point);
    let frame = basis(normal);
    let footprint = pixel_size(position, gather_pass.height);
    // In corners distances go to 0 and gradients grow without bound: nearer than the least radius of a record they say nothing.
    let nearest_distance = footprint * f32(LEAST_RADIUS_PIXELS);
    let base = i * rings * sectors;

    var sum = vec3f(0.0);
    var inverse_distances = 0.0;
    var translation = mat3x3f();
    @if(smooth_normals || normal_maps) var rotation = mat3x3f();
    for (var k = 0u; k < sectors; k++) {
        let here = base + k * rings;
        let beside = base + select(k - 1u, sectors - 1u, k == 0u) * rings;
        let angle = 2.0 * PI * (f32(k) + 0.5) / f32(sectors);
        let edge_angle = 2.0 * PI * f32(k) / f32(sectors);
        // Towards the sector's middle, and across its first edge.
        let outwards = frame * vec3f(cos(angle), sin(angle), 0.0);
        let across_edge = frame * vec3f(-sin(edge_angle), cos(edge_angle), 0.0);
        @if(smooth_normals || normal_maps) let across = frame * vec3f(-sin(angle), cos(angle), 0.0);
        // Equation 4's sums over the rings of this sector.
        var along = vec3f(0.0);
        var beyond = vec3f(0.0);
        @if(smooth_normals || normal_maps) var turning = vec3f(0.0);
        var below = vec4f(0.0);
        var sine = 0.0;
        for (var j = 0u; j < rings; j++) {
            let ray = gathered[here + j];
            let neighbour = gathered[beside + j];
            let distance = max(ray.w, nearest_distance);
            let next_sine = sqrt(f32(j + 1u) / f32(rings));
            if j > 0u {
                let nearer = min(distance, max(below.w, nearest_distance));
                along += (ray.xyz - below.xyz) * (sine * (1.0 - sine * sine) / nearer);
            }
            let nearer = min(distance, max(neighbour.w, nearest_distance));
            beyond += (ray.xyz - neighbour.xyz) * ((next_sine - sine) / nearer);
            @if(smooth_normals || normal_maps) {
                let middle = (f32(j) + 0.5) / f32(rings);
                // Light from where the normal turns to gains by the tangent; `across` is the axis of that turn, n_i x n (Ward
                // and Heckbert's minus sign goes with n x n_i).
                turning += ray.xyz * sqrt(middle / (1.0 - middle));
            }
            sum += ray.xyz;
            inverse_distances += 1.0 / distance;
            below = ray;
            sine = next_sine;
        }
        along *= 2.0 * PI / f32(sectors);
        translation += outer(outwards, along) + outer(across_edge, beyond);
        @if(smooth_normals || normal_maps) { rotation += outer(across, turning); }
    }
    let weight = PI / f32(rings * sectors);
    let irradiance = sum * weight;
    // Farther than it takes the gradient to bring the irradiance to nothing the record says nothing.
    let slope = translation * vec3f(0.2126, 0.7152, 0.0722);
    var spacing = f32(rings * sectors) / inverse_distances;
    spacing = min(spacing, luminance(irradiance) / max(length(slope), 1e-20));

    // A sum that overflows, or a gradient at no distance at all: a record of size 0 says nothing to anyone.
    var finite = is_finite3(irradiance) && is_finite3(vec3f(spacing, footprint, 0.0));
    for (var c = 0u; c < 3u; c++) {
        finite &= is_finite3(translation[c]);
        @if(smooth_normals || normal_maps) { finite &= is_finite3(rotation[c]); }
    }
    if !finite { atomicAdd(&counters[COUNTER_NOT_FINITE_GATHER], 1u); }
    let head = (gather_pass.first + i) * RECORD_HEAD;
    record_heads[head] = vec4f(position, select(0.0, footprint, finite));
    record_heads[head + 1u] = vec4f(normal, select(NOTHING, spacing, finite));
    let values = (gather_pass.first_record + i) * RECORD_VALUES;
    for (var c = 0u; c < 3u; c++) {
        record_values[values + c] = vec4f(translation[c], irradiance[c]);
        @if(smooth_normals || normal_maps) { record_values[values + 3u + c] = vec4f(weight * rotation[c], 0.0); }
    }
}

// A vector for each channel: columns v times a channel's number.
fn outer(v: vec3f, channels: vec3f) -> mat3x3f {
    return mat3x3f(v * channels.x, v * channels.y, v * channels.z);
}
