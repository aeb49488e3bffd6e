// photons: rays from the lights, straight through everything they meet. The first surface takes an illumination
// photon, every later one a shadow photon. Out: photons, in any order, appended to `traced_photons`.

import package::lib::dispatch::group_index;
import package::lib::math::oct_encode7;
import package::lib::rng::{hash2, hash3};
import package::lib::sampling::sobol4;
import package::lib::light::light_emit;
import package::lib::ray::{Hit, NO_HIT, Ray, offset_origin};
import package::lib::bvh::{Walk, begin_walk, intersect_slot, next_triangle, stops, traversal_overrun, triangle_corners, triangle_word};
import package::lib::photon::{Photon, photon_word};
import package::lib::constants::{DIMENSION_PHOTON, TRIANGLE_DOUBLE_SIDED};

// Most shadow photons that are kept of one ray, 1 to KEPT_SIZE.
override shadow_photons_per_ray: u32;

struct PhotonParameters {
    // Rays are numbered light by light of the map, round by round: any first so many are spread evenly.
    first_ray: u32,
    ray_count: u32,
    // First light of the map, and lights in it.
    first_light: u32,
    light_count: u32,
    seed: u32,
    padding: u32,
}

var<immediate> parameters: PhotonParameters;

@group(0) @binding(0) var<storage, read_write> traced_photons: array<Photon>;
// Photons appended, traversals that gave up; then by light illumination and shadow photons.
@group(0) @binding(1) var<storage, read_write> traced_counts: array<atomic<u32>>;

const KEPT_SIZE = 64;
const COUNT_HEADER = 2u;
const FAR = 1e30;

var<workgroup> group_length: atomic<u32>;
var<workgroup> group_base: u32;

// Hits as far as this are one place: coplanar surfaces, whose t differ by rounding. Positions are of unit size, and
// t is a sum of a few products of them.
fn coincide(a: f32, b: f32) -> bool {
    return abs(a - b) <= 0x1p-21 * max(a, 0.25);
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
    let double_sided = (triangle_word(slot) & TRIANGLE_DOUBLE_SIDED) != 0u;
    return Arrival(select(-normal, normal, faces), faces || double_sided);
}

// Shadow photons of a ray. Of more than fit, those whose slots have the smallest hashes: a choice by chance that does
// not depend on the order in which the hits are met.
struct Kept {
    count: u32,
    // Hits that would store, kept or not.
    hits: u32,
    seed: u32,
    slots: array<u32, KEPT_SIZE>,
    distances: array<f32, KEPT_SIZE>,
}

fn keep(kept: ptr<function, Kept>, t: f32, slot: u32, direction: vec3f) {
    if !arrival(slot, direction).stores { return; }
    var largest = 0u;
    var largest_at = 0u;
    for (var i = 0u; i < (*kept).count; i++) {
        if coincide((*kept).distances[i], t) {
            (*kept).slots[i] = min((*kept).slots[i], slot);
            return;
        }
        let priority = hash2((*kept).slots[i], (*kept).seed);
        if priority >= largest {
            largest = priority;
            largest_at = i;
        }
    }
    (*kept).hits++;
    var at = (*kept).count;
    if at == shadow_photons_per_ray {
        if hash2(slot, (*kept).seed) >= largest { return; }
        at = largest_at;
    } else {
        (*kept).count++;
    }
    (*kept).slots[at] = slot;
    (*kept).distances[at] = t;
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
    var nearest = Hit(FAR, 0.0, 0.0, NO_HIT);
    var nearest_stores = false;
    var direction = vec3f(0.0, 0.0, 1.0);
    var walk: Walk;
    var map_light = 0u;
    var stored = 0u;
    var rank = 0u;
    if i < parameters.ray_count {
        let number = parameters.first_ray + i;
        map_light = number % parameters.light_count;
        let light = parameters.first_light + map_light;
        let index = number / parameters.light_count;
        let seed = hash3(parameters.seed, DIMENSION_PHOTON, light);
        let emitted = light_emit(light, sobol4(index, seed));
        direction = emitted.direction;
        kept.seed = hash2(seed, index);
        let ray = Ray(offset_origin(emitted.origin, emitted.normal), 0.0, direction, FAR);
        walk = begin_walk(ray);
        while !walk.done {
            let slot = next_triangle(&walk, FAR);
            if slot == NO_HIT { continue; }
            let hit = intersect_slot(&walk, slot);
            if !stops(hit, 0.0, FAR, kept.seed) { continue; }
            if nearest.triangle != NO_HIT && coincide(hit.t, nearest.t) {
                // A coplanar twin is the same surface; the side that stores is the one to be seen.
                let stores = arrival(slot, direction).stores;
                if select(stores, slot < nearest.triangle, stores == nearest_stores) {
                    nearest = hit;
                    nearest_stores = stores;
                }
            } else if hit.t < nearest.t {
                if nearest.triangle != NO_HIT { keep(&kept, nearest.t, nearest.triangle, direction); }
                nearest = hit;
                nearest_stores = arrival(slot, direction).stores;
            } else {
                keep(&kept, hit.t, slot, direction);
            }
        }
        stored = kept.count + u32(nearest_stores);
        if stored > 0u { rank = atomicAdd(&group_length, stored); }
        if traversal_overrun { atomicAdd(&traced_counts[1], 1u); }
    }
    workgroupBarrier();
    if lane == 0u {
        let length = atomicLoad(&group_length);
        if length > 0u { group_base = atomicAdd(&traced_counts[0], length); }
    }
    workgroupBarrier();
    if stored == 0u { return; }
    var at = group_base + rank;
    if nearest_stores {
        append(at, &walk, nearest.triangle, direction, map_light, 1.0, false);
        at++;
        atomicAdd(&traced_counts[COUNT_HEADER + 2u * map_light], 1u);
    }
    if kept.count > 0u {
        let weight = f32(kept.hits) / f32(kept.count);
        for (var k = 0u; k < kept.count; k++) { append(at + k, &walk, kept.slots[k], direction, map_light, weight, true); }
        atomicAdd(&traced_counts[COUNT_HEADER + 2u * map_light + 1u], kept.count);
    }
}

fn append(at: u32, walk: ptr<function, Walk>, slot: u32, direction: vec3f, light: u32, weight: f32, shadow: bool) {
    // The point of the triangle itself: the far end of a long ray would be off its plane.
    let hit = intersect_slot(walk, slot);
    let corners = triangle_corners(slot);
    let position = corners[0] + hit.u * (corners[1] - corners[0]) + hit.v * (corners[2] - corners[0]);
    let normal = oct_encode7(arrival(slot, direction).normal);
    traced_photons[at] = Photon(position, photon_word(normal, light, weight, shadow));
}
