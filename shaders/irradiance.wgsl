// irradiance: density estimates on the global map, precomputed at places all over the scene (Christensen 1999).
// In: the global map and the places, both sorted by cell. Out: irradiance and radius of the disc, by place.
// `show` estimates at the points of a tile: the map visualised directly. `caustics` adds there what the caustic map tells.

import package::lib::bvh::{trace_closest, trace_occluded, traversal_overrun};
import package::lib::dispatch::group_index;
import package::lib::irradiance::encode_disc;
import package::lib::grid::{COMPATIBLE_COSINE_SQUARED, GridShape, NORMAL_STRETCH, cell_of, counted_distance, load_photon, nearest, reach_guess, row_photons, rows_about};
@if(!(photon_map || caustics)) import package::lib::math::{PI, basis, is_finite3};
@if(photon_map || caustics) import package::lib::math::{PI, basis, is_finite3, oct_decode16, spoilt};
@if(photon_map || caustics) import package::lib::point::{Point, SURFACE_VECTORS};
@if(chains && (photon_map || caustics)) import package::lib::point::CHAIN_VECTOR;
@if(smooth_normals && (photon_map || caustics)) import package::lib::point::TRIANGLE_VECTOR;
@if(photon_map || caustics) import package::lib::constants::{COUNTER_OVERRUN, INVALID_POINT};
import package::lib::constants::COUNTER_NOT_FINITE_IRRADIANCE;
@if(negative_photons) import package::lib::light::table::{light_count, light_has_closed_form};
@if(negative_photons) import package::lib::light::{light_sample, light_unshadowed_irradiance};
@if(negative_photons) import package::lib::sampling::sobol2;
import package::lib::photon::{Photon, flux_of, photon_normal};
import package::lib::ray::{NO_HIT, Ray, offset_origin};
@if(negative_photons) import package::lib::ray::Hit;
import package::lib::rng::{hash1, hash3, uniform_from_bits};
import package::lib::bvh::hit_normal;
@if(negative_photons) import package::lib::surface::{ray_behind, surface_at};

struct IrradianceParameters {
    // Of the global map.
    grid: GridShape,
    // Places.
    count: u32,
    // Power of a step of a photon's flux.
    step: f32,
    // Radius of a disc over that of one with k photons.
    shrink: f32,
    padding: u32,
}

var<immediate> irradiance_pass: IrradianceParameters;

@group(0) @binding(0) var<storage, read> places: array<Photon>;
@group(0) @binding(1) var<storage, read_write> irradiances: array<vec4f>;

@if(photon_map || caustics) @group(0) @binding(2) var<storage, read> points: array<Point>;
@if(photon_map || caustics) @group(0) @binding(3) var<storage, read> surfaces: array<vec4f>;
@if(photon_map || caustics) @group(0) @binding(4) var<storage, read_write> radiance_indirect: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> counters: array<atomic<u32>>;

// Photons and rows that an estimate may look at: a quarter of the iterations that lavapipe grants an invocation.
const MOST_LOOKS = 16384u;

// The radius of a place that tells nothing: no path ends there.
const UNSURE = 1e30;

// Probes of a disc. At edges their error is an eighth or so, and independent from place to place.
const PROBES = 16u;

@compute @workgroup_size(64)
fn irradiance(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= irradiance_pass.count { return; }
    let found = irradiance_at(places[i].position, photon_normal(places[i].word));
    let finite = is_finite3(found.xyz);
    if !finite { atomicAdd(&counters[COUNTER_NOT_FINITE_IRRADIANCE], 1u); }
    irradiances[i] = select(vec4f(0.0, 0.0, 0.0, UNSURE), found, finite);
}

@if(photon_map)
@compute @workgroup_size(64)
fn show(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= irradiance_pass.count { return; }
    var light = vec3f(0.0);
    if points[i].normal != INVALID_POINT {
        let place = place_of(i);
        light = surfaces[i * SURFACE_VECTORS].xyz * irradiance_at(place.position, place.normal).xyz / PI;
        @if(chains) { light *= surfaces[i * SURFACE_VECTORS + CHAIN_VECTOR].xyz; }
        light = counted(light, i);
    }
    radiance_indirect[i] = vec4f(light, 1.0);
}

// What light the caustic map tells at the points of a tile: focused light is far denser at some places than about them, so
// discs are small, and their edges are not measured.
@if(caustics)
@compute @workgroup_size(64)
fn caustics(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= irradiance_pass.count { return; }
    var albedo = surfaces[i * SURFACE_VECTORS].xyz;
    @if(chains) { albedo *= surfaces[i * SURFACE_VECTORS + CHAIN_VECTOR].xyz; }
    if points[i].normal == INVALID_POINT || !any(albedo > vec3f(0.0)) { return; }
    let place = place_of(i);
    let disc = flux_about(place.position, place.normal);
    if disc.radius <= 0.0 && !traversal_overrun { return; }
    radiance_indirect[i] += vec4f(counted(albedo * disc.flux / (PI * PI * disc.radius * disc.radius), i), 0.0);
}

@if(photon_map || caustics)
struct Place {
    position: vec3f,
    normal: vec3f,
}

// Where photons lie that have come to point i.
@if(photon_map || caustics)
fn place_of(i: u32) -> Place {
    @if(smooth_normals) {
        let place = surfaces[i * SURFACE_VECTORS + TRIANGLE_VECTOR];
        return Place(place.xyz, oct_decode16(bitcast<u32>(place.w)));
    }
    @else { return Place(points[i].position, oct_decode16(points[i].normal)); }
}

// The light of point i, or what the film leaves out where too many photons were in its way. Counts light that is no number.
@if(photon_map || caustics)
fn counted(light: vec3f, i: u32) -> vec3f {
    if traversal_overrun {
        atomicAdd(&counters[COUNTER_OVERRUN], 1u);
        return vec3f(spoilt(i));
    }
    if !is_finite3(light) { atomicAdd(&counters[COUNTER_NOT_FINITE_IRRADIANCE], 1u); }
    return light;
}

// What the photons tell of a point, by density estimation.
// Of direct light those with negative energy tell what is too much, and they lie on hidden surfaces as well: what is just below
// the point, or behind a wall, and near enough to be in the disc, is taken as lit too. The mean is then that of the map whose
// photons are all positive, which has none there.
fn irradiance_at(position: vec3f, normal: vec3f) -> vec4f {
    let disc = flux_about(position, normal);
    let share = covered(position, normal, disc.radius);
    // In gaps too narrow for any probe the area is anyone's guess.
    if disc.radius <= 0.0 || share.area == 0.0 { return vec4f(0.0, 0.0, 0.0, UNSURE); }
    var light = disc.flux / (PI * disc.radius * disc.radius * share.area);
    @if(negative_photons) {
        let surfaces = 1.0 + share.hidden / share.area;
        for (var l = 0u; l < light_count(); l++) { light += surfaces * unshadowed(l, position, normal); }
    }
    return vec4f(light, encode_disc(disc.radius, share.clear));
}

// Light points that stand for a light without a closed form.
@if(negative_photons) const UNSHADOWED_SAMPLES = 4u;

// The irradiance from a light with nothing in between.
@if(negative_photons)
fn unshadowed(light: u32, position: vec3f, normal: vec3f) -> vec3f {
    if light_has_closed_form(light) { return light_unshadowed_irradiance(light, position, normal); }
    let bits = bitcast<vec3u>(position);
    let seed = hash3(bits.x, bits.y, bits.z + light);
    var sum = vec3f(0.0);
    for (var j = 0u; j < UNSHADOWED_SAMPLES; j++) {
        let chosen = light_sample(light, position, sobol2(j, seed));
        let cosine = dot(chosen.direction, normal);
        if chosen.pdf > 0.0 && cosine > 0.0 { sum += chosen.radiance * (cosine / chosen.pdf); }
    }
    return sum / f32(UNSHADOWED_SAMPLES);
}

struct Disc {
    // Power of its photons.
    flux: vec3f,
    // 0 where there were too many to look at.
    radius: f32,
}

// The photons about a point. The disc is what holds k photons at the density of the 27 cells around, so its size does not
// depend on which of them lie in it, and the mean is right whatever k is.
fn flux_about(position: vec3f, normal: vec3f) -> Disc {
    let grid = irradiance_pass.grid;
    let at = (position - grid.origin) * grid.inverse_cell;
    // More than one cell would leave the 27.
    let reach = min(reach_guess(grid, 0u, cell_of(grid, position), irradiance_pass.shrink), 1.0);
    let radius = reach * grid.cell;
    let limit = radius * radius;
    var sum = vec3i(0);
    var looks = 0u;
    let rows = rows_about(grid, at, at, reach, normal, 0.0);
    for (var z = rows.y; z <= rows.w; z++) {
        for (var y = rows.x; y <= rows.z; y++) {
            let row = row_photons(grid, 0u, vec2i(y, z), at, at, reach, normal, 0.0);
            looks += row.y - row.x + 1u;
            if looks > MOST_LOOKS {
                traversal_overrun = true;
                return Disc(vec3f(0.0), 0.0);
            }
            for (var p = row.x; p < row.y; p++) {
                let photon = load_photon(p);
                sum += select(vec3i(0), flux_of(photon.w), counted_distance(photon, position, normal) <= limit);
            }
        }
    }
    return Disc(vec3f(sum) * irradiance_pass.step, radius);
}

struct Covered {
    // Over that of the disc; 0 where no probe met any surface.
    area: f32,
    // How far from the point, in radii, there is no edge, wall or gap, as far as the probes tell.
    clear: f32,
    // Area within the ellipsoid that is not seen from the point, over that of the disc.
    @if(negative_photons) hidden: f32,
}

// A segment beyond that part of the radius is less than a probe, and may have been missed.
const NEVER_BEYOND = 0.8;

// The area of the surface within the search ellipsoid, as seen from the point, over that of the disc: at edges and in corners
// the photons lie on less than the whole disc, and an estimate that does not know would be too dark there (boundary bias; Hey
// and Purgathofer 2002 look at the geometry too). Each probe goes from the point over its place in the disc, and down to the
// surface.
fn covered(position: vec3f, normal: vec3f, radius: f32) -> Covered {
    let frame = basis(normal);
    let origin = offset_origin(position, normal);
    let bits = bitcast<vec3u>(position);
    let turn = uniform_from_bits(hash3(bits.z, bits.y, bits.x));
    // The ellipsoid is as high as that.
    let height = radius * inverseSqrt(1.0 + NORMAL_STRETCH);
    var found = 0u;
    var slant = 0.0;
    @if(negative_photons) var hidden = 0.0;
    for (var j = 0u; j < PROBES; j++) {
        // A spiral of equal areas by the golden angle.
        let part = (f32(j) + 0.5) / f32(PROBES);
        let distance = radius * sqrt(part);
        let angle = 2.0 * PI * fract(turn + f32(j) * 0.61803399);
        let across = frame * vec3f(distance * cos(angle), distance * sin(angle), 0.0);
        let above = position + across + height * normal;
        let there = Ray(origin, 0.0, above - origin, 1.0);
        // Half of the ellipsoid's height at that place.
        let reach = height * sqrt(1.0 - part);
        let down = Ray(above, height - reach, -normal, height + reach);
        let seed = hash1(bits.x + j);
        let blocked = trace_occluded(there, seed);
        @if(!negative_photons) { if blocked { continue; } }
        let hit = trace_closest(down, seed);
        if hit.triangle == NO_HIT { continue; }
        @if(negative_photons) {
            hidden += hidden_surfaces(down, hit, blocked, normal, seed);
            if blocked { continue; }
        }
        let cosine = abs(dot(normalize(hit_normal(hit)), normal));
        if cosine * cosine >= COMPATIBLE_COSINE_SQUARED {
            found++;
            slant += 1.0 / cosine;
        }
    }
    if found == 0u { return Covered(); }
    // A straight edge at x radii leaves out a segment of at most 0.5 (1 - x)^1.6 of the disc, and several edges together more.
    // One probe more, for what lies between them.
    let missing = f32(PROBES - found + 1u) / f32(PROBES);
    let clear = select(max(1.0 - pow(2.0 * missing, 0.63), 0.0), NEVER_BEYOND, found == PROBES);
    // (n + 1) / (found + 1) is without bias for one over the share, as n / found is not.
    let area = slant / f32(found) * (f32(found + 1u) / f32(PROBES + 1u));
    @if(negative_photons) { return Covered(area, clear, hidden / f32(PROBES)); } @else { return Covered(area, clear); }
}

// The area of the surfaces that a probe meets below the one that it sees, where it sees one, over that of the probe: of those
// that photons are stored at.
@if(negative_photons)
fn hidden_surfaces(probe: Ray, first: Hit, blocked: bool, normal: vec3f, seed: u32) -> f32 {
    var ray = probe;
    var hit = first;
    var is_hidden = blocked;
    var area = 0.0;
    while hit.triangle != NO_HIT && !traversal_overrun {
        let found = surface_at(hit, ray);
        let cosine = abs(dot(found.triangle_normal, normal));
        let compatible = cosine * cosine >= COMPATIBLE_COSINE_SQUARED;
        if is_hidden && compatible && any(found.surface.albedo > vec3f(0.0)) { area += 1.0 / cosine; }
        is_hidden = true;
        ray = ray_behind(found, ray.direction, ray.t_max - hit.t);
        hit = trace_closest(ray, seed);
    }
    return area;
}
