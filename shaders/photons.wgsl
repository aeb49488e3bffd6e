// photons: rays from the lights, straight through everything they meet. The first surface takes an illumination
// photon, every later one a shadow photon. Out: photons, in any order, appended to `traced_photons`.

import package::lib::dispatch::group_index;
import package::lib::math::oct_encode7;
import package::lib::rng::{hash2, hash3};
import package::lib::sampling::sobol4;
import package::lib::light::light_emit;
import package::lib::ray::{NO_HIT, Ray, offset_origin};
import package::lib::bvh::{MAX_ITERATIONS, Traversal, begin_traversal, intersect_primitive, next_triangle, stops, traversal_overrun, traversal_iterations, triangle_corners, triangle_word};
import package::lib::photon::{Photon, photon_word};
@if(procedurals) import package::lib::procedural::{crossing_normal, crossing_t, enter_object, next_crossing, procedural_count, procedural_double_sided, procedural_ray_iterations};
@if(procedurals) import package::lib::procedural_functions::procedural_lost;
@if(procedurals) import package::lib::constants::{PROCEDURAL, PROCEDURAL_RAY_ITERATIONS};
import package::lib::constants::{DIMENSION_PHOTON, MAX_SHADOW_PHOTONS, TRIANGLE_DOUBLE_SIDED};

// Most shadow photons that are kept of one ray, 1 to MAX_SHADOW_PHOTONS.
override shadow_photons_per_ray: u32;

struct PhotonParameters {
    // Rays are numbered light by light of the map, round by round: any first so many are spread evenly.
    first_ray: u32,
    ray_count: u32,
    // Lights of the map.
    light_count: u32,
    seed: u32,
}

var<immediate> photon_pass: PhotonParameters;

@group(0) @binding(0) var<storage, read_write> traced_photons: array<Photon>;
// Photons appended, traversals that gave up; then by light illumination and shadow photons.
@group(0) @binding(1) var<storage, read_write> traced_counts: array<atomic<u32>>;

const COUNT_HEADER = 2u;
const FAR = 1e30;

var<workgroup> group_length: atomic<u32>;
var<workgroup> group_base: u32;

// Coplanar surfaces, whose t differ by rounding: 2^-21 is too little for one in fifty of twins whose diagonals differ,
// and walls of 1e-5 are still two surfaces, also for rays that come from four times the scene's radius.
fn coincide(a: f32, b: f32) -> bool {
    return abs(a - b) <= 1.9073486e-6 * max(a, 0.25);
}

// Normal on the side that the ray comes from, and whether the surface stores a photon there.
struct Arrival {
    normal: vec3f,
    stores: bool,
}

fn arrival(slot: u32, direction: vec3f) -> Arrival {
    let corners = triangle_corners(slot);
    let normal = normalize(cross(corners[1] - corners[0], corners[2] - corners[0]));
    let faces = dot(normal, direction) < 0.0;
    // The paper knows no sides.
    @if(paper_counting) let stores = true;
    @if(!paper_counting) let stores = faces || (triangle_word(slot) & TRIANGLE_DOUBLE_SIDED) != 0u;
    return Arrival(select(-normal, normal, faces), stores);
}

// Shadow photons of a ray. Of more than fit, those whose slots have the smallest hashes: a choice by chance that does
// not depend on the order in which the hits are met.
struct Kept {
    count: u32,
    // Hits that would store, kept or not.
    hits: u32,
    seed: u32,
    // The largest hash of those kept.
    largest: u32,
    // Turns of the loop over them.
    looks: u32,
    slots: array<u32, MAX_SHADOW_PHOTONS>,
    distances: array<f32, MAX_SHADOW_PHOTONS>,
    // Of crossings of procedural objects, as the photon has it.
    @if(procedurals) normals: array<u32, MAX_SHADOW_PHOTONS>,
}

// What a ray has met that may be its first surface.
struct Nearest {
    t: f32,
    slot: u32,
    arrival: Arrival,
}

fn keep(kept: ptr<function, Kept>, t: f32, slot: u32, found: Arrival) {
    if !found.stores { return; }
    let full = (*kept).count == shadow_photons_per_ray;
    let priority = hash2(slot, (*kept).seed);
    // Of many hits most end here, without a loop: loops share the budget of the traversal.
    if full && priority >= (*kept).largest {
        (*kept).hits++;
        return;
    }
    var largest = 0u;
    var second = 0u;
    var largest_at = 0u;
    for (var i = 0u; i < (*kept).count; i++) {
        (*kept).looks++;
        if coincide((*kept).distances[i], t) { return; }
        let other = hash2((*kept).slots[i], (*kept).seed);
        second = max(second, min(largest, other));
        if other >= largest {
            largest = other;
            largest_at = i;
        }
    }
    (*kept).hits++;
    let at = select((*kept).count, largest_at, full);
    (*kept).count = min((*kept).count + 1u, shadow_photons_per_ray);
    (*kept).slots[at] = slot;
    (*kept).distances[at] = t;
    @if(procedurals) { (*kept).normals[at] = oct_encode7(found.normal); }
    (*kept).largest = max(priority, select(largest, second, full));
}

// Takes a surface that stops light: the nearest is what it lights, all others lie in its shadow.
fn meet(kept: ptr<function, Kept>, nearest: ptr<function, Nearest>, t: f32, slot: u32, found: Arrival) {
    let first = *nearest;
    if first.slot != NO_HIT && coincide(t, first.t) {
        // A coplanar twin is the same surface; the side that stores is the one to be seen.
        if select(found.stores, slot < first.slot, found.stores == first.arrival.stores) { *nearest = Nearest(t, slot, found); }
    } else if t < first.t {
        if first.slot != NO_HIT { keep(kept, first.t, first.slot, first.arrival); }
        *nearest = Nearest(t, slot, found);
    } else {
        keep(kept, t, slot, found);
    }
}

// Bits of a crossing's slot above the object's number.
@if(procedurals) const CROSSING_SHIFT = 8u;

// Takes the crossings of the ray with procedural objects: the first one of each, and those behind as far as turns go. Surfaces
// of an object behind so many others then have too few photons, and ask shadow rays.
@if(procedurals)
fn meet_procedurals(kept: ptr<function, Kept>, nearest: ptr<function, Nearest>, ray: Ray) {
    procedural_ray_iterations = 0u;
    for (var object = 0u; object < procedural_count; object++) {
        let inside = enter_object(object, ray, FAR);
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
            meet(kept, nearest, crossing_t(inside, met), PROCEDURAL | (number << CROSSING_SHIFT) | object, found);
            number++;
            if procedural_ray_iterations >= PROCEDURAL_RAY_ITERATIONS {
                _ = procedural_lost(false);
                break;
            }
        }
    }
    traversal_iterations += procedural_ray_iterations;
}

@compute @workgroup_size(64)
fn photons(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane == 0u { atomicStore(&group_length, 0u); }
    workgroupBarrier();
    let i = group_index(group, groups) * 64u + lane;
    var kept: Kept;
    var nearest = Nearest(FAR, NO_HIT, Arrival(vec3f(0.0), false));
    var direction = vec3f(0.0, 0.0, 1.0);
    var walk: Traversal;
    var light = 0u;
    var stored = 0u;
    var rank = 0u;
    if i < photon_pass.ray_count {
        let number = photon_pass.first_ray + i;
        light = number % photon_pass.light_count;
        let index = number / photon_pass.light_count;
        let seed = hash3(photon_pass.seed, DIMENSION_PHOTON, light);
        let emitted = light_emit(light, sobol4(index, seed));
        direction = emitted.direction;
        kept.seed = hash2(seed, index);
        let ray = Ray(offset_origin(emitted.origin, emitted.normal), 0.0, direction, FAR);
        walk = begin_traversal(ray);
        while !walk.done {
            let slot = next_triangle(&walk, FAR);
            if slot == NO_HIT { continue; }
            let hit = intersect_primitive(&walk, slot);
            if !stops(hit, 0.0, FAR, kept.seed) { continue; }
            meet(&kept, &nearest, hit.t, slot, arrival(slot, direction));
        }
        @if(procedurals) { meet_procedurals(&kept, &nearest, ray); }
        stored = kept.count + u32(nearest.arrival.stores);
        // Lavapipe ends all loops of an invocation in silence when they have taken some 65,000 turns together. What the ray
        // has met until then may not be its nearest surface.
        if traversal_overrun || traversal_iterations + kept.looks > MAX_ITERATIONS {
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
    var at = group_base + rank;
    if nearest.arrival.stores {
        @if(!procedurals) { append(at, &walk, nearest.slot, direction, light, 1.0, false); }
        @if(procedurals) { append(at, &walk, nearest.slot, direction, light, 1.0, false, nearest.t, oct_encode7(nearest.arrival.normal)); }
        at++;
        atomicAdd(&traced_counts[COUNT_HEADER + 2u * light], 1u);
    }
    if kept.count > 0u {
        let weight = f32(kept.hits) / f32(kept.count);
        for (var k = 0u; k < kept.count; k++) {
            @if(!procedurals) { append(at + k, &walk, kept.slots[k], direction, light, weight, true); }
            @if(procedurals) { append(at + k, &walk, kept.slots[k], direction, light, weight, true, kept.distances[k], kept.normals[k]); }
        }
        atomicAdd(&traced_counts[COUNT_HEADER + 2u * light + 1u], kept.count);
    }
}

fn append(
    at: u32,
    walk: ptr<function, Traversal>,
    slot: u32,
    direction: vec3f,
    light: u32,
    weight: f32,
    shadow: bool,
    @if(procedurals) t: f32,
    @if(procedurals) object_normal: u32,
) {
    @if(procedurals) {
        if (slot & PROCEDURAL) != 0u {
            let place = (*walk).sheared.origin + t * direction;
            traced_photons[at] = Photon(place, photon_word(object_normal, light, weight, shadow));
            return;
        }
    }
    // The point of the triangle itself: the far end of a long ray would be off its plane.
    let hit = intersect_primitive(walk, slot);
    let corners = triangle_corners(slot);
    let position = corners[0] + hit.u * (corners[1] - corners[0]) + hit.v * (corners[2] - corners[0]);
    let normal = oct_encode7(arrival(slot, direction).normal);
    traced_photons[at] = Photon(position, photon_word(normal, light, weight, shadow));
}
