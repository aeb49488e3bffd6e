// gather: the final gather of new irradiance records (section 2 of the paper; Ward and Heckbert 1992). `gather` traces
// rays over the hemisphere of each record, stratified in proportion to the cosine. A ray takes the radiance at its hit
// from precomputed irradiance; where that look-up is not valid, `follow` traces a path from the hit. From the rays of a
// record, `record` computes irradiance, its rotational and translational gradients, and the harmonic mean of the hit
// distances.
// In: `points`, `surfaces`, and in `wanted` the points that get records.
// Out: `record_heads` and `record_values`; see lib/record. Lengths are in scene units after normalisation.

import package::lib::bsdf::{bsdf_seen_afar, reflects_more};
@if(caustics) import package::lib::bsdf::focuses;
import package::lib::bvh::traversal_overrun;
import package::lib::packet::{no_ray, trace_closest_together};
import package::lib::camera::pixel_size;
import package::kit::{dispatch_groups, group_index};
import package::lib::irradiance::irradiance_near;
import package::lib::light::BEYOND_SCENE;
import package::lib::math::{PI, basis, circle_point, is_finite3, luminance, oct_decode16};
import package::lib::path_tracing::{PathStart, PathVertex, spread_along, trace_path};
import package::lib::path_tracing::{bounce_rays, heavy_path, shadow_rays};
import package::lib::visible_point::{load_point, load_surface};
import package::lib::ray::{Hit, NO_HIT, Ray, RaySample, offset_origin};
import package::lib::record::RECORD_VALUE_TEXELS;
import package::lib::rng::{hash2, hash3, uniform_from_bits};
@if(dispersion) import package::lib::rng::hash1;
@if(dispersion) import package::lib::wavelength::begin_wavelengths;
import package::lib::surface::{SurfaceHit, surface_at};
import package::lib::constants::{DIMENSION_GATHER, GATHER_GROUP, MIN_RADIUS_PIXELS, RECORD_HEAD_TEXELS};
import package::lib::constants::{COUNTER_GATHER_RAYS, COUNTER_HEAVY_PATHS, COUNTER_NOT_FINITE_GATHER, COUNTER_OVERRUN};

struct GatherParameters {
    // The records of this dispatch: the first one's index in `wanted`, and how many.
    first: u32,
    count: u32,
    // Strata: rings of equal cosine-weighted area, and sectors.
    rings: u32,
    sectors: u32,
    max_bounces: u32,
    seed: u32,
    // Index of the first record in `record_values`.
    first_record: u32,
    // Height of the image in pixels.
    height: u32,
}

var<immediate> gather_pass: GatherParameters;

@group(0) @binding(2) var<storage, read> wanted: array<u32>;
// For each ray: its radiance, and the distance of its hit.
@group(0) @binding(3) var<storage, read_write> gathered: array<vec4f>;
// The rays that `follow` continues: how many, the arguments of the dispatch over them, their numbers (with
// FOLLOW_RESIDUAL in the top bit) and their hits.
@group(0) @binding(4) var<storage, read_write> follow_count: array<atomic<u32>, 1>;
@group(0) @binding(5) var<storage, read_write> follow_arguments: array<u32, 3>;
@group(0) @binding(6) var<storage, read_write> follow_rays: array<u32>;
@group(0) @binding(7) var<storage, read_write> follow_hits: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> record_heads: array<vec4f>;
@group(0) @binding(9) var<storage, read_write> record_values: array<vec4f>;
@group(0) @binding(10) var<storage, read_write> counters: array<atomic<u32>>;

// Marks a ray whose look-up gave the diffuse part: its path adds only the rest, the reflection of a metal.
const FOLLOW_RESIDUAL = 0x80000000u;
// Distance of a ray without a hit.
const NO_DISTANCE = 1e30;

struct GatherRay {
    ray: Ray,
    // Probability density by solid angle; 0 where the ray would enter the surface that it leaves.
    pdf: f32,
    // Index of the ray within its record, and the record's seed.
    stratum: u32,
    seed: u32,
}

fn shading_normal(point: u32) -> vec3f {
    return oct_decode16(bitcast<u32>(load_surface(point).packed.base.w));
}

fn gather_ray(id: u32) -> GatherRay {
    let rays = gather_pass.rings * gather_pass.sectors;
    let point = wanted[gather_pass.first + id / rays];
    let visible = load_point(point);
    let position = visible.position;
    let geometric = oct_decode16(visible.normal);
    let normal = shading_normal(point);
    let stratum = id % rays;
    let bits = bitcast<vec3u>(position);
    let seed = hash3(bits.x ^ gather_pass.seed, bits.y, bits.z + DIMENSION_GATHER);
    let xi = vec2f(uniform_from_bits(hash2(seed, 2u * stratum)), uniform_from_bits(hash2(seed, 2u * stratum + 1u)));
    let sine_squared = (f32(stratum % gather_pass.rings) + xi.x) / f32(gather_pass.rings);
    let turns = (f32(stratum / gather_pass.rings) + xi.y) / f32(gather_pass.sectors);
    let sine = sqrt(sine_squared);
    let cosine = sqrt(1.0 - sine_squared);
    let direction = normalize(basis(normal) * vec3f(sine * circle_point(turns), cosine));
    let pdf = select(0.0, max(cosine, 1e-3) / PI, dot(direction, geometric) > 0.0);
    return GatherRay(Ray(offset_origin(position, geometric), 0.0, direction, BEYOND_SCENE), pdf, stratum, seed);
}

// The radiance, or 0 where it is not finite, which is counted. Otherwise a single ray would make its record invalid,
// and with it all points that interpolate from the record.
fn finite_or_dark(radiance: vec3f) -> vec3f {
    let finite = is_finite3(radiance);
    if !finite { atomicAdd(&counters[COUNTER_NOT_FINITE_GATHER], 1u); }
    return select(vec3f(0.0), radiance, finite);
}

@compute @workgroup_size(GATHER_GROUP)
fn gather(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let id = group_index(group, groups) * GATHER_GROUP + lane;
    let there = id < gather_pass.count * gather_pass.rings * gather_pass.sectors;
    let gathering = gather_ray(id);
    var ray = no_ray();
    if there && gathering.pdf > 0.0 { ray = gathering.ray; }
    let hit = trace_closest_together(ray, RaySample(~gathering.seed, gathering.stratum), lane);
    if !there { return; }
    var radiance = vec4f(0.0, 0.0, 0.0, NO_DISTANCE);
    if hit.triangle != NO_HIT {
        radiance.w = hit.t;
        @if(dispersion) { begin_wavelengths(gathering.seed, hash1(gathering.stratum), vec3f(1.0)); }
        let found = surface_at(hit, gathering.ray);
        if !found.unlit {
            let known = irradiance_near(found.triangle_position, found.triangle_normal);
            var follow = 0u;
            var follows = true;
            var wide = spread_along(gathering.pdf, hit.t) >= known.radius;
            // The caustic map holds part of a focusing surface's light. The path tracer separates it.
            @if(caustics) { wide = wide && !focuses(found.surface); }
            if wide {
                radiance = vec4f(bsdf_seen_afar(found.surface) * known.value, radiance.w);
                @if(transmission) { radiance *= vec4f(found.transmittance, 1.0); }
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
    gathered[id] = vec4f(finite_or_dark(radiance.xyz), radiance.w);
    if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
}

@compute @workgroup_size(1)
fn arrange_follow() {
    let size = dispatch_groups(atomicLoad(&follow_count[0]), GATHER_GROUP);
    follow_arguments = array(size.x, size.y, size.z);
}

@compute @workgroup_size(GATHER_GROUP)
fn follow(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * GATHER_GROUP + lane;
    let there = i < atomicLoad(&follow_count[0]);
    var id = 0u;
    var words = vec4f(0.0);
    var gathering: GatherRay;
    var found: SurfaceHit;
    var vertex: PathVertex;
    if there {
        id = follow_rays[i] & ~FOLLOW_RESIDUAL;
        words = follow_hits[i];
        gathering = gather_ray(id);
        @if(dispersion) { begin_wavelengths(gathering.seed, hash1(gathering.stratum), vec3f(1.0)); }
        found = surface_at(Hit(words.x, words.y, words.z, bitcast<u32>(words.w)), gathering.ray);
        vertex.position = found.position;
        vertex.surface = found.surface;
        vertex.sample_index = gathering.stratum;
        @if(glossy) { vertex.residual = (follow_rays[i] & FOLLOW_RESIDUAL) != 0u; }
    }
    let start = PathStart(there, 1u, spread_along(gathering.pdf, words.x));
    var radiance = trace_path(vertex, start, gathering.seed, gather_pass.max_bounces, 0u, lane).indirect;
    if !there { return; }
    @if(transmission) { radiance *= found.transmittance; }
    gathered[id] = vec4f(gathered[id].xyz + finite_or_dark(radiance), words.x);
    atomicAdd(&counters[COUNTER_GATHER_RAYS], bounce_rays + shadow_rays);
    if heavy_path { atomicAdd(&counters[COUNTER_HEAVY_PATHS], 1u); }
    if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
}

// Sums over the rays of a record.
struct RecordSums {
    radiance: vec3f,
    inverse_distances: f32,
    // The translational gradient, by channel.
    translation: mat3x3f,
    // The rotational gradient, by channel, over the weight of a stratum.
    @if(smooth_normals || normal_maps) rotation: mat3x3f,
}

// The outer product: column c is v times channel c.
fn outer(v: vec3f, channels: vec3f) -> mat3x3f {
    return mat3x3f(v * channels.x, v * channels.y, v * channels.z);
}

// Adds the rays of sector k; `base` is the record's first ray. Distances below `min_distance` count as that.
fn add_sector(sums: ptr<function, RecordSums>, base: u32, k: u32, frame: mat3x3f, min_distance: f32) {
    let rings = gather_pass.rings;
    let sectors = gather_pass.sectors;
    let here = base + k * rings;
    let previous = base + select(k - 1u, sectors - 1u, k == 0u) * rings;
    let middle = circle_point((f32(k) + 0.5) / f32(sectors));
    let edge = circle_point(f32(k) / f32(sectors));
    // Unit vectors towards the sector's middle, and across its first edge.
    let outwards = frame * vec3f(middle, 0.0);
    let across_edge = frame * vec3f(-edge.y, edge.x, 0.0);
    @if(smooth_normals || normal_maps) let across = frame * vec3f(-middle.y, middle.x, 0.0);
    // The sums of Ward and Heckbert's equation 4 over the rings of this sector.
    var along = vec3f(0.0);
    var beyond = vec3f(0.0);
    @if(smooth_normals || normal_maps) var tilting = vec3f(0.0);
    var below = vec4f(0.0);
    var sine = 0.0;
    for (var j = 0u; j < rings; j++) {
        let ray = gathered[here + j];
        let neighbour = gathered[previous + j];
        let distance = max(ray.w, min_distance);
        let next_sine = sqrt(f32(j + 1u) / f32(rings));
        if j > 0u {
            let nearer = min(distance, max(below.w, min_distance));
            along += (ray.xyz - below.xyz) * (sine * (1.0 - sine * sine) / nearer);
        }
        let nearer = min(distance, max(neighbour.w, min_distance));
        beyond += (ray.xyz - neighbour.xyz) * ((next_sine - sine) / nearer);
        @if(smooth_normals || normal_maps) {
            let middle = (f32(j) + 0.5) / f32(rings);
            // Tilting the normal towards a ray increases the irradiance in proportion to the tangent of the ray's polar
            // angle. `across` is the axis n_i x n of the rotation (Ward and Heckbert's minus sign is for n x n_i).
            tilting += ray.xyz * sqrt(middle / (1.0 - middle));
        }
        (*sums).radiance += ray.xyz;
        (*sums).inverse_distances += 1.0 / distance;
        below = ray;
        sine = next_sine;
    }
    along *= 2.0 * PI / f32(sectors);
    (*sums).translation += outer(outwards, along) + outer(across_edge, beyond);
    @if(smooth_normals || normal_maps) { (*sums).rotation += outer(across, tilting); }
}

@compute @workgroup_size(GATHER_GROUP)
fn record(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * GATHER_GROUP + lane;
    if i >= gather_pass.count { return; }
    let rays = gather_pass.rings * gather_pass.sectors;
    let point = wanted[gather_pass.first + i];
    let position = load_point(point).position;
    let normal = shading_normal(point);
    let footprint = pixel_size(position, gather_pass.height);
    // In corners, distances go to 0 and gradients grow without bound. Distances below the minimum radius of a record
    // count as that radius: within it a gradient need not be valid.
    let min_distance = footprint * f32(MIN_RADIUS_PIXELS);
    let frame = basis(normal);
    var sums: RecordSums;
    for (var k = 0u; k < gather_pass.sectors; k++) { add_sector(&sums, i * rays, k, frame, min_distance); }
    let weight = PI / f32(rays);
    let irradiance = sums.radiance * weight;
    // The record is not valid beyond the distance at which its gradient brings the irradiance to 0.
    let slope = sums.translation * vec3f(0.2126, 0.7152, 0.0722);
    var spacing = f32(rays) / sums.inverse_distances;
    spacing = min(spacing, luminance(irradiance) / max(length(slope), 1e-20));

    // Sums may overflow, and gradients at distance 0 are infinite. A record of size 0 is not used.
    var finite = is_finite3(irradiance) && is_finite3(vec3f(spacing, footprint, 0.0));
    for (var c = 0u; c < 3u; c++) {
        finite &= is_finite3(sums.translation[c]);
        @if(smooth_normals || normal_maps) { finite &= is_finite3(sums.rotation[c]); }
    }
    if !finite { atomicAdd(&counters[COUNTER_NOT_FINITE_GATHER], 1u); }
    let head = (gather_pass.first + i) * RECORD_HEAD_TEXELS;
    record_heads[head] = vec4f(position, select(0.0, footprint, finite));
    record_heads[head + 1u] = vec4f(normal, select(NO_DISTANCE, spacing, finite));
    let values = (gather_pass.first_record + i) * RECORD_VALUE_TEXELS;
    for (var c = 0u; c < 3u; c++) {
        record_values[values + c] = vec4f(sums.translation[c], irradiance[c]);
        @if(smooth_normals || normal_maps) { record_values[values + 3u + c] = vec4f(weight * sums.rotation[c], 0.0); }
    }
}
