// gather: the final gather of irradiance records (Ward and Heckbert 1992, the paper's [Ward92]). `place` puts new
// records at points. `gather` traces a wave of rays over the hemisphere of each record, stratified in proportion to the
// cosine. A ray takes the radiance at its hit from precomputed irradiance; where that look-up is not valid, pass `path`
// traces a path from the hit. From the rays of a record, `record` computes irradiance, its rotational and translational
// gradients, and the harmonic mean of the hit distances, as means over this wave and the earlier ones.
// In: `points`, `surfaces`, and in `wanted` the points that get records.
// Out: `record_heads` and `record_values`; see lib/record. Lengths are in scene units after normalisation.

import package::lib::bsdf::reflects_more;
import package::lib::bvh::traversal_overrun;
import package::lib::packet::{no_ray, trace_closest_together};
import package::lib::camera::pixel_size;
import package::kit::{dispatch_groups, group_index};
import package::lib::light::BEYOND_SCENE;
import package::lib::gather_hit::{GatherHit, HIT_CAUSTIC_KNOWN, HIT_RESIDUAL};
import package::lib::math::{
    PI, basis, circle_point, invalid_sample, is_finite3, luminance, oct_decode16, oct_encode16
};
import package::lib::path_tracing::{known_light, spread_along, spread_of};
import package::lib::point::{Point, VisibleSurface, visible_surface_of};
import package::lib::visible_point::{load_point, load_surface};
import package::lib::ray::{NO_HIT, Ray, RaySample, offset_origin};
import package::lib::record::RECORD_VALUE_TEXELS;
import package::lib::rng::{hash2, hash3, uniform_from_bits};
@if(dispersion) import package::lib::rng::hash1;
@if(dispersion) import package::lib::wavelength::begin_wavelengths;
import package::lib::surface::surface_at;
import package::lib::constants::{DIMENSION_GATHER, GATHER_GROUP, PATH_GROUP, RECORD_HEAD_TEXELS};
import package::lib::constants::{COUNTER_NOT_FINITE_GATHER, COUNTER_OVERRUN};

struct GatherParameters {
    // The records of this dispatch: the first one's index, and how many.
    first_record: u32,
    count: u32,
    // Strata of the wave: rings of equal cosine-weighted area, and sectors. Both are powers of two.
    rings: u32,
    sectors: u32,
    // Rays of each record in earlier waves.
    earlier_rays: u32,
    seed: u32,
    // Height of the image in pixels.
    height: u32,
    // Minimum radius of records with the rays of this wave and the earlier ones, in pixels.
    min_radius: f32,
}

// Position of a record, and data that its waves share.
struct RecordOrigin {
    position: vec3f,
    // Normals of the triangle and of the surface, octahedral.
    geometric: u32,
    normal: u32,
    // Mean of 1 over the distances of the rays so far.
    inverse_distance: f32,
    // Variance of the irradiance by the rays so far, the sum of the channels.
    variance: f32,
    padding: u32,
}

var<immediate> gather_pass: GatherParameters;

@group(0) @binding(2) var<storage, read> wanted: array<u32>;
// Points of the wave in the unit square, by stratum: a part of a (0, 2)-sequence, so that with those of earlier waves
// they are stratified as one.
@group(0) @binding(3) var<storage, read> wave_points: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> record_origins: array<RecordOrigin>;
// For each ray: its radiance, and the distance of its hit.
@group(0) @binding(5) var<storage, read_write> gathered: array<vec4f>;
// The rays that paths continue: how many, the arguments of the dispatch over them, and their indices.
@group(0) @binding(6) var<storage, read_write> path_count: array<atomic<u32>, 1>;
@group(0) @binding(7) var<storage, read_write> path_arguments: array<u32, 3>;
@group(0) @binding(8) var<storage, read_write> path_points: array<u32>;
// The hits of these rays, by index of the ray.
@group(0) @binding(9) var<storage, read_write> hit_points: array<Point>;
@group(0) @binding(10) var<storage, read_write> hit_surfaces: array<VisibleSurface>;
@group(0) @binding(11) var<storage, read_write> gather_hits: array<GatherHit>;
@group(0) @binding(12) var<storage, read_write> record_heads: array<vec4f>;
@group(0) @binding(13) var<storage, read_write> record_values: array<vec4f>;
@group(0) @binding(14) var<storage, read_write> counters: array<atomic<u32>>;

// Gradients of fewer rays are mostly noise. They would shrink records without need, and so multiply them: in
// scenes/sphere.glb 16 rays left 7,500 records, where 4,096 rays leave 1,500.
const MIN_RAYS_OF_SLOPE = 64u;
// Distance of a ray without a hit, and of a record that is not used. Its inverse adds nothing to those of hits, which
// are at least 1 / BEYOND_SCENE. It is not 0 either, so that the harmonic mean is finite if no ray has a hit.
const NO_DISTANCE = 1e30;

struct GatherRay {
    ray: Ray,
    // Probability density by solid angle; 0 where the ray would enter the surface that it leaves.
    pdf: f32,
    // Index of the ray within its record, of all waves, and the record's seed.
    number: u32,
    seed: u32,
}

@compute @workgroup_size(GATHER_GROUP)
fn place(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * GATHER_GROUP + lane;
    if i >= gather_pass.count { return; }
    let visible = load_point(wanted[i]);
    let normal = bitcast<u32>(load_surface(wanted[i]).packed.base.w);
    record_origins[gather_pass.first_record + i] =
        RecordOrigin(visible.position, visible.normal, normal, 0.0, 0.0, 0u);
}

// The point of the unit square for a stratum: its first coordinate lies in the ring, its second in the sector. All
// points of a record are shifted by an exclusive or with the same bits, which keeps them stratified. So this takes the
// point whose shifted position lies in the stratum.
fn stratified(stratum: u32, seed: u32) -> vec2f {
    let shift = vec2u(hash2(seed, 0u), hash2(seed, 1u));
    // The highest bits of a coordinate are its stratum. Their number may be 0.
    let bits = vec2u(countTrailingZeros(gather_pass.rings), countTrailingZeros(gather_pass.sectors));
    let leading = (shift >> vec2u(1u)) >> (31u - bits);
    let ring = (stratum % gather_pass.rings) ^ leading.x;
    let sector = (stratum / gather_pass.rings) ^ leading.y;
    let point = wave_points[sector * gather_pass.rings + ring] ^ shift;
    return vec2f(uniform_from_bits(point.x), uniform_from_bits(point.y));
}

fn gather_ray(id: u32) -> GatherRay {
    let rays = gather_pass.rings * gather_pass.sectors;
    let origin = record_origins[gather_pass.first_record + id / rays];
    let geometric = oct_decode16(origin.geometric);
    let stratum = id % rays;
    let bits = bitcast<vec3u>(origin.position);
    let seed = hash3(bits.x ^ gather_pass.seed, bits.y, bits.z + DIMENSION_GATHER);
    let xi = stratified(stratum, seed);
    let sine = sqrt(xi.x);
    let cosine = sqrt(1.0 - xi.x);
    let direction = normalize(basis(oct_decode16(origin.normal)) * vec3f(sine * circle_point(xi.y), cosine));
    // Not 0 for a direction along the surface: as xi.x is below 1, the cosine is at least 2^-12.
    let pdf = select(0.0, cosine / PI, dot(direction, geometric) > 0.0);
    let ray = Ray(offset_origin(origin.position, geometric), 0.0, direction, BEYOND_SCENE);
    return GatherRay(ray, pdf, gather_pass.earlier_rays + stratum, seed);
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
    let is_active = id < gather_pass.count * gather_pass.rings * gather_pass.sectors;
    let gathering = gather_ray(id);
    var ray = no_ray();
    if is_active && gathering.pdf > 0.0 { ray = gathering.ray; }
    let hit = trace_closest_together(ray, RaySample(~gathering.seed, gathering.number), lane);
    if !is_active { return; }
    var radiance = vec4f(0.0, 0.0, 0.0, NO_DISTANCE);
    // A traversal that gave up may have missed what is nearest: the ray counts as dark.
    if hit.triangle != NO_HIT && !traversal_overrun {
        radiance.w = hit.t;
        @if(dispersion) { begin_wavelengths(gathering.seed, hash1(gathering.number), vec3f(1.0)); }
        let found = surface_at(hit, gathering.ray);
        if !found.unlit {
            let spread = spread_along(gathering.pdf, hit.t);
            let known = known_light(found.surface, found.triangle_position, found.triangle_normal, spread);
            radiance = vec4f(known.radiance, radiance.w);
            @if(transmission) { radiance *= vec4f(found.transmittance, 1.0); }
            if !known.all || reflects_more(found.surface) {
                path_points[atomicAdd(&path_count[0], 1u)] = id;
                hit_points[id] = Point(found.position, oct_encode16(found.surface.geometric_normal));
                hit_surfaces[id] = visible_surface_of(found);
                var onward = GatherHit(
                    vec3f(1.0),
                    spread,
                    spread_of(gathering.pdf),
                    oct_encode16(-gathering.ray.direction),
                    gathering.seed,
                    gathering.number,
                );
                @if(transmission) { onward.transmittance = found.transmittance; }
                onward.number |= select(0u, HIT_RESIDUAL, known.all);
                @if(caustics) { onward.number |= select(0u, HIT_CAUSTIC_KNOWN, known.caustic); }
                gather_hits[id] = onward;
            }
        }
    }
    gathered[id] = vec4f(finite_or_dark(radiance.xyz), radiance.w);
    if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
}

@compute @workgroup_size(1)
fn arrange_paths() {
    let size = dispatch_groups(atomicLoad(&path_count[0]), PATH_GROUP);
    path_arguments = array(size.x, size.y, size.z);
}

// Sums over the rays of a record.
struct RecordSums {
    radiance: vec3f,
    inverse_distances: f32,
    // Sum of squared differences between rays of neighbouring strata.
    squares: f32,
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
            let difference = ray.xyz - below.xyz;
            let nearer = min(distance, max(below.w, min_distance));
            along += difference * (sine * (1.0 - sine * sine) / nearer);
            (*sums).squares += dot(difference, difference);
        }
        let difference = ray.xyz - neighbour.xyz;
        let nearer = min(distance, max(neighbour.w, min_distance));
        beyond += difference * ((next_sine - sine) / nearer);
        (*sums).squares += dot(difference, difference);
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
    let id = gather_pass.first_record + i;
    let origin = record_origins[id];
    let normal = oct_decode16(origin.normal);
    let footprint = pixel_size(origin.position, gather_pass.height);
    // In corners, distances go to 0 and gradients grow without bound. Distances below the minimum radius of a record
    // count as that radius: within it a gradient need not be valid.
    let min_distance = footprint * gather_pass.min_radius;
    let frame = basis(normal);
    var sums: RecordSums;
    for (var k = 0u; k < gather_pass.sectors; k++) { add_sector(&sums, i * rays, k, frame, min_distance); }
    let means = means_of_waves(sums, id);
    record_origins[id].inverse_distance = means.inverse_distance;
    record_origins[id].variance = means.variance;
    let spacing = spacing_of(means);

    // Sums may overflow, and gradients at distance 0 are infinite. A record of size 0 is not used.
    var finite = is_finite3(means.irradiance) && is_finite3(vec3f(spacing, footprint, 0.0));
    for (var c = 0u; c < 3u; c++) {
        finite &= is_finite3(means.translation[c]);
        @if(smooth_normals || normal_maps) { finite &= is_finite3(means.rotation[c]); }
    }
    if !finite { atomicAdd(&counters[COUNTER_NOT_FINITE_GATHER], 1u); }
    let head = id * RECORD_HEAD_TEXELS;
    record_heads[head] = vec4f(origin.position, select(0.0, footprint, finite));
    record_heads[head + 1u] = vec4f(normal, select(NO_DISTANCE, spacing, finite));
    let values = id * RECORD_VALUE_TEXELS;
    for (var c = 0u; c < 3u; c++) {
        record_values[values + c] = vec4f(means.translation[c], means.irradiance[c]);
        @if(smooth_normals || normal_maps) { record_values[values + 3u + c] = vec4f(means.rotation[c], 0.0); }
    }
}

// What a record has by the rays of all waves so far.
struct RecordMeans {
    irradiance: vec3f,
    // Variance of the irradiance, the sum of the channels; not a number if it is unknown.
    variance: f32,
    // Mean of 1 over the distances of the rays.
    inverse_distance: f32,
    // The gradients, by channel.
    translation: mat3x3f,
    @if(smooth_normals || normal_maps) rotation: mat3x3f,
}

// The means over this wave, whose sums these are, and the earlier ones. Before the first wave the contents of the
// buffers are undefined, and are not used.
fn means_of_waves(sums: RecordSums, id: u32) -> RecordMeans {
    let rays = gather_pass.rings * gather_pass.sectors;
    let share = f32(rays) / f32(gather_pass.earlier_rays + rays);
    let weight = PI / f32(rays);
    var means: RecordMeans;
    means.irradiance = sums.radiance * weight;
    means.translation = sums.translation;
    @if(smooth_normals || normal_maps) { means.rotation = sums.rotation * weight; }
    means.inverse_distance = sums.inverse_distances / f32(rays);
    // The variance of a ray within its stratum is at most half of the mean squared difference of neighbours, as
    // neighbouring strata differ by more than noise. Every ray has a neighbour in the previous sector, and every ray
    // outside the first ring one in the ring below. Once there are earlier waves, the difference of this wave from them
    // is a better estimate. A single ray is its own neighbour, so its variance is unknown.
    let pairs = f32(2u * rays - gather_pass.sectors);
    means.variance = 0.5 * sums.squares / pairs * weight * weight * f32(rays);
    if rays == 1u { means.variance = invalid_sample(id); }
    if gather_pass.earlier_rays > 0u {
        let values = id * RECORD_VALUE_TEXELS;
        means.inverse_distance = mix(record_origins[id].inverse_distance, means.inverse_distance, share);
        means.variance = 0.0;
        for (var c = 0u; c < 3u; c++) {
            let earlier = record_values[values + c];
            let change = means.irradiance[c] - earlier.w;
            means.variance += share * (1.0 - share) * change * change;
            means.irradiance[c] = mix(earlier.w, means.irradiance[c], share);
            means.translation[c] = mix(earlier.xyz, means.translation[c], share);
            @if(smooth_normals || normal_maps) {
                means.rotation[c] = mix(record_values[values + 3u + c].xyz, means.rotation[c], share);
            }
        }
    }
    return means;
}

// The distance up to which a record is valid: the harmonic mean distance, limited by the gradient.
fn spacing_of(means: RecordMeans) -> f32 {
    // The record is not valid beyond the distance at which its gradient brings the irradiance to 0. Without any light
    // there is no such distance.
    let of_axes = transpose(means.translation);
    let steepness = length(vec3f(luminance(of_axes[0]), luminance(of_axes[1]), luminance(of_axes[2])));
    var spacing = 1.0 / means.inverse_distance;
    let rays = gather_pass.earlier_rays + gather_pass.rings * gather_pass.sectors;
    if rays >= MIN_RAYS_OF_SLOPE && steepness > 0.0 {
        spacing = min(spacing, luminance(means.irradiance) / steepness);
    }
    return spacing;
}
