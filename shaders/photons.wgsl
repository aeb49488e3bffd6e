// photons: rays from the lights, straight on through everything they hit. The first surface stores an illumination
// photon, every later one a shadow photon. In: the lights and the BVH (normalised space). Out: photons in any order,
// appended to `traced_photons`, and counts by light. Paper, "Extending the photon map": shadow photons.

import package::kit::group_index;
import package::lib::math::oct_encode7;
import package::lib::rng::{hash2, hash3};
import package::lib::sampling::sobol4;
import package::lib::light::light_emit;
import package::lib::ray::{Hit, NO_HIT, Ray, RaySample, UNBOUNDED, intersect_triangle, offset_origin, shear_ray};
import package::lib::bvh::{
    stops, traversal_iterations, traversal_overrun, triangle_corners, triangle_normal, triangle_word
};
import package::lib::packet::{LINE_ITERATIONS, begin_line, next_on_line, no_ray};
import package::lib::photon::{Photon, photon_word};
@if(procedurals) import package::lib::procedural::{
    crossing_normal, crossing_t, enter_object, next_crossing, procedural_count, procedural_double_sided,
    procedural_ray_iterations
};
@if(procedurals) import package::lib::procedural_functions::procedural_lost;
@if(procedurals) import package::lib::constants::{PROCEDURAL, PROCEDURAL_RAY_ITERATIONS};
import package::lib::constants::{
    DIMENSION_PHOTON, MAX_SHADOW_PHOTONS, PHOTON_COUNTS_PER_LIGHT, PHOTON_COUNT_HEADER, TRIANGLE_DOUBLE_SIDED
};

// Maximum number of shadow photons that are kept of one ray, 1 to MAX_SHADOW_PHOTONS.
override shadow_photons_per_ray: u32;

struct PhotonParameters {
    // Consecutive rays leave consecutive lights of the map, round by round, so that any number of rays is spread evenly
    // over the lights.
    first_ray: u32,
    ray_count: u32,
    // Lights of the map.
    light_count: u32,
    seed: u32,
}

var<immediate> photon_pass: PhotonParameters;

@group(0) @binding(0) var<storage, read_write> traced_photons: array<Photon>;
// Photons appended, rays that met the loop budget; then by light illumination and shadow photons.
@group(0) @binding(1) var<storage, read_write> traced_counts: array<atomic<u32>>;

var<workgroup> group_length: atomic<u32>;
var<workgroup> group_base: u32;

// Whether two hits are of coplanar surfaces, whose t differ by rounding. The tolerance is 2^-19 of t, at least 2^-21.
// With 2^-21 of t, one in fifty coplanar pairs with different diagonals counted as two surfaces. Walls 1e-5 thick are
// still two surfaces, also for rays from four times the scene's radius.
fn coincide(a: f32, b: f32) -> bool {
    return abs(a - b) <= 1.9073486e-6 * max(a, 0.25);
}

// Normal on the side that the ray comes from, and whether the surface stores a photon there.
struct Arrival {
    normal: vec3f,
    stores: bool,
}

fn arrival(primitive: u32, direction: vec3f) -> Arrival {
    let normal = normalize(triangle_normal(primitive));
    let faces = dot(normal, direction) < 0.0;
    // The paper does not distinguish sides.
    @if(paper_counting) let stores = true;
    @if(!paper_counting) let stores = faces || (triangle_word(primitive) & TRIANGLE_DOUBLE_SIDED) != 0u;
    return Arrival(select(-normal, normal, faces), stores);
}

// Shadow photons of a ray. If there are more than fit, the ones of the smallest priorities are kept: a random sample
// that does not depend on the order of the hits.
struct Kept {
    count: u32,
    // Hits that would store, kept or not.
    hits: u32,
    // Those of the kept photons: more than `count` where surfaces are coplanar, which count as one.
    own_hits: u32,
    seed: u32,
    // The largest priority of those kept.
    largest: u32,
    primitives: array<u32, MAX_SHADOW_PHOTONS>,
    distances: array<f32, MAX_SHADOW_PHOTONS>,
    // Hits at the place of each, itself included.
    hits_there: array<u32, MAX_SHADOW_PHOTONS>,
    // Octahedral normals of crossings of procedural objects, as the photon has them.
    @if(procedurals) normals: array<u32, MAX_SHADOW_PHOTONS>,
}

// The nearest surface of a ray so far.
struct Nearest {
    t: f32,
    primitive: u32,
    arrival: Arrival,
}

// Bits of a priority that differ between coplanar surfaces.
const PRIORITY_OF_SURFACE = 0xffu;

// The random priority of a hit. Coplanar surfaces have the same but for the lowest bits, so that a surface is kept with
// the same probability however many are coplanar, and all hits at its place are known. The place is the interval of t
// that the hit is in: 2^-15 of t, 16 times the tolerance of `coincide`. Two of them seldom have a border between them.
fn priority_of(t: f32, primitive: u32, seed: u32) -> u32 {
    let place = bitcast<u32>(t + 0.25) >> 8u;
    return (hash2(place, seed) & ~PRIORITY_OF_SURFACE) | (hash2(primitive, seed) & PRIORITY_OF_SURFACE);
}

// Adds a hit to the shadow photons.
fn keep(kept: ptr<function, Kept>, t: f32, primitive: u32, found: Arrival) {
    if !found.stores { return; }
    (*kept).hits++;
    let full = (*kept).count == shadow_photons_per_ray;
    let priority = priority_of(t, primitive, (*kept).seed);
    // If there are many hits, most end here, without a loop: loops share the budget of the traversal.
    if full && priority > ((*kept).largest | PRIORITY_OF_SURFACE) { return; }
    var largest = 0u;
    var second = 0u;
    var largest_at = 0u;
    for (var i = 0u; i < (*kept).count; i++) {
        traversal_iterations++;
        if coincide((*kept).distances[i], t) {
            (*kept).hits_there[i]++;
            (*kept).own_hits++;
            return;
        }
        let other = priority_of((*kept).distances[i], (*kept).primitives[i], (*kept).seed);
        second = max(second, min(largest, other));
        if other >= largest {
            largest = other;
            largest_at = i;
        }
    }
    if full && priority >= largest { return; }
    let at = select((*kept).count, largest_at, full);
    (*kept).own_hits = (*kept).own_hits + 1u - (*kept).hits_there[at];
    (*kept).hits_there[at] = 1u;
    (*kept).count = min((*kept).count + 1u, shadow_photons_per_ray);
    (*kept).primitives[at] = primitive;
    (*kept).distances[at] = t;
    @if(procedurals) { (*kept).normals[at] = oct_encode7(found.normal); }
    (*kept).largest = max(priority, select(largest, second, full));
}

// Adds a hit with a surface that stops light: the nearest is lit, all others lie in its shadow.
fn meet(kept: ptr<function, Kept>, nearest: ptr<function, Nearest>, t: f32, primitive: u32, found: Arrival) {
    let first = *nearest;
    let met = Nearest(t, primitive, found);
    // The farther of both. One call of `keep` serves both cases: software devices execute both branches, whose loops
    // would share the loop budget.
    var farther = met;
    if first.primitive != NO_HIT && coincide(t, first.t) {
        // Coplanar surfaces count as one: that which stores a photon, else that of the lower primitive index.
        let same_side = found.stores == first.arrival.stores;
        if select(found.stores, primitive < first.primitive, same_side) { *nearest = met; }
        farther.arrival.stores = false;
    } else if t < first.t {
        *nearest = met;
        farther = first;
    }
    keep(kept, farther.t, farther.primitive, farther.arrival);
}

fn meet_triangle(kept: ptr<function, Kept>, nearest: ptr<function, Nearest>, hit: Hit, direction: vec3f) {
    // On software devices, the loop of `keep` runs once even where there is no hit.
    @if(packets) { traversal_iterations++; }
    if hit.triangle == NO_HIT || !stops(hit, 0.0, UNBOUNDED, RaySample((*kept).seed, 0u)) { return; }
    meet(kept, nearest, hit.t, hit.triangle, arrival(hit.triangle, direction));
}

// Bits of the object's number in a crossing's primitive index.
@if(procedurals) const CROSSING_SHIFT = 8u;

// Adds the crossings of the ray with procedural objects: the first one of each, and those behind it as far as the loop
// budget allows. Surfaces of an object behind very many others then have too few photons, and need shadow rays.
@if(procedurals)
fn meet_procedurals(kept: ptr<function, Kept>, nearest: ptr<function, Nearest>, ray: Ray) {
    procedural_ray_iterations = 0u;
    for (var object = 0u; object < procedural_count; object++) {
        let inside = enter_object(object, ray, UNBOUNDED);
        var so_far = 0.0;
        var number = 0u;
        while so_far < inside.length {
            let met = next_crossing(inside, so_far);
            if met.w <= so_far { break; }
            so_far = met.w;
            let outward = crossing_normal(object, inside, met);
            let faces = dot(outward, ray.direction) < 0.0;
            @if(paper_counting) let stores = true;
            @if(!paper_counting) let stores = faces || procedural_double_sided(object);
            let found = Arrival(select(-outward, outward, faces), stores);
            let primitive = PROCEDURAL | (number << CROSSING_SHIFT) | object;
            meet(kept, nearest, crossing_t(inside, met), primitive, found);
            number++;
            if procedural_ray_iterations >= PROCEDURAL_RAY_ITERATIONS {
                _ = procedural_lost(false);
                break;
            }
        }
    }
    traversal_iterations += procedural_ray_iterations;
}

// A photon to store.
struct Stored {
    primitive: u32,
    light: u32,
    // Hits that it represents.
    weight: f32,
    shadow: bool,
    @if(procedurals) t: f32,
    // Octahedral normal, where a procedural object was hit.
    @if(procedurals) object_normal: u32,
}

@compute @workgroup_size(64)
fn photons(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    var kept: Kept;
    var nearest = Nearest(UNBOUNDED, NO_HIT, Arrival(vec3f(0.0), false));
    var light = 0u;
    var stored = 0u;
    var rank = 0u;
    // Lanes without a ray trace none together with the others.
    let is_active = i < photon_pass.ray_count;
    var ray = no_ray();
    if is_active {
        let number = photon_pass.first_ray + i;
        light = number % photon_pass.light_count;
        let index = number / photon_pass.light_count;
        let seed = hash3(photon_pass.seed, DIMENSION_PHOTON, light);
        let emitted = light_emit(light, sobol4(index, seed));
        kept.seed = hash2(seed, index);
        ray = Ray(offset_origin(emitted.origin, emitted.normal), 0.0, emitted.direction, UNBOUNDED);
    }
    var line = begin_line(ray, lane);
    while !line.done {
        let hits = next_on_line(&line, lane);
        meet_triangle(&kept, &nearest, hits.first, ray.direction);
        @if(packets) { meet_triangle(&kept, &nearest, hits.second, ray.direction); }
    }
    // Behind the ray: lavapipe compiles what follows a barrier twice, and keeps its variables in memory.
    if lane == 0u { atomicStore(&group_length, 0u); }
    workgroupBarrier();
    if is_active {
        @if(procedurals) { meet_procedurals(&kept, &nearest, ray); }
        stored = kept.count + u32(nearest.arrival.stores);
        // Lavapipe silently ends all loops of an invocation after some 65,000 iterations together. The nearest surface
        // until then may not be the ray's nearest.
        if traversal_overrun || traversal_iterations > LINE_ITERATIONS {
            atomicAdd(&traced_counts[1], 1u);
            stored = 0u;
        }
        if stored > 0u { rank = atomicAdd(&group_length, stored); }
    }
    workgroupBarrier();
    if lane == 0u {
        let length = atomicLoad(&group_length);
        if length > 0u { group_base = atomicAdd(&traced_counts[0], length); }
    }
    workgroupBarrier();
    if stored == 0u { return; }
    let next = store_nearest(group_base + rank, ray, nearest, light);
    if kept.count > 0u { store_kept(next, ray, &kept, light); }
}

// Index in `traced_counts` of the number of a light's illumination photons; the number of its shadow photons follows.
fn count_index(light: u32) -> u32 {
    return PHOTON_COUNT_HEADER + PHOTON_COUNTS_PER_LIGHT * light;
}

// Stores the illumination photon at index `at`, if there is one, and returns the next free index.
fn store_nearest(at: u32, ray: Ray, nearest: Nearest, light: u32) -> u32 {
    if !nearest.arrival.stores { return at; }
    var photon: Stored;
    photon.primitive = nearest.primitive;
    photon.light = light;
    photon.weight = 1.0;
    photon.shadow = false;
    @if(procedurals) {
        photon.t = nearest.t;
        photon.object_normal = oct_encode7(nearest.arrival.normal);
    }
    store(at, ray, photon);
    atomicAdd(&traced_counts[count_index(light)], 1u);
    return at + 1u;
}

// Stores the shadow photons from index `at` on.
fn store_kept(at: u32, ray: Ray, kept: ptr<function, Kept>, light: u32) {
    var photon: Stored;
    photon.light = light;
    photon.weight = f32((*kept).hits) / f32((*kept).own_hits);
    photon.shadow = true;
    for (var k = 0u; k < (*kept).count; k++) {
        photon.primitive = (*kept).primitives[k];
        @if(procedurals) {
            photon.t = (*kept).distances[k];
            photon.object_normal = (*kept).normals[k];
        }
        store(at + k, ray, photon);
    }
    atomicAdd(&traced_counts[count_index(light) + 1u], (*kept).count);
}

fn store(at: u32, ray: Ray, photon: Stored) {
    @if(procedurals) {
        if (photon.primitive & PROCEDURAL) != 0u {
            let position = ray.origin + photon.t * ray.direction;
            let word = photon_word(photon.object_normal, photon.light, photon.weight, photon.shadow);
            traced_photons[at] = Photon(position, word);
            return;
        }
    }
    // The point of the triangle itself: the far end of a long ray would be off its plane.
    let corners = triangle_corners(photon.primitive);
    let hit = intersect_triangle(shear_ray(ray), corners[0], corners[1], corners[2]);
    let position = corners[0] + hit.y * (corners[1] - corners[0]) + hit.z * (corners[2] - corners[0]);
    let normal = oct_encode7(arrival(photon.primitive, ray.direction).normal);
    traced_photons[at] = Photon(position, photon_word(normal, photon.light, photon.weight, photon.shadow));
}
