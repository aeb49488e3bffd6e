// photons: rays from a light straight through the scene (the paper's figure 1). The first hit of a ray leaves an
// illumination photon, every later one a shadow photon; of many shadow photons some are chosen at random and stand
// for all.
// In: the scene. Out: photons appended to `traced_photons`; in `photon_counts` how many, how many of them illumination
// photons, and rays that met the loop budget.

import package::lib::dispatch::group_index;
import package::lib::bvh::{Walk, begin_walk, next_triangle, intersect_slot, stops, triangle_word, triangle_corners, traversal_overrun};
import package::lib::ray::{Ray, Hit, NO_HIT, MISSED, offset_origin};
import package::lib::light::light_emit;
import package::lib::sampling::sobol4;
import package::lib::math::oct_encode7;
import package::lib::photon::{Photon, photon_word};
import package::lib::rng::{hash2, hash3};
import package::lib::constants::{TRIANGLE_DOUBLE_SIDED, DIMENSION_PHOTON, DIMENSION_PHOTON_ALPHA, MAX_SHADOW_PHOTONS};

// Most shadow photons of a ray: at most MAX_SHADOW_PHOTONS.
override shadow_photons_per_ray: u32;

struct PhotonParameters {
    light: u32,
    // Rays of the light: the first of this batch, and how many.
    first_ray: u32,
    ray_count: u32,
    seed: u32,
}

@group(0) @binding(0) var<storage, read_write> traced_photons: array<Photon>;
@group(0) @binding(1) var<storage, read_write> photon_counts: array<atomic<u32>, 4>;

var<immediate> photon_pass: PhotonParameters;

var<workgroup> group_photons: atomic<u32>;
var<workgroup> group_illumination: atomic<u32>;
var<workgroup> group_start: u32;

// Hits this near to each other are of surfaces that coincide: a few roundings of t. The twin of the first hit is lit
// as that is; it leaves no shadow photon.
const SAME_HIT = 1e-6;

var<private> kept_hits: array<Hit, MAX_SHADOW_PHOTONS>;

// The photon that a hit leaves.
fn photon_at(hit: Hit, direction: vec3f, weight: f32, shadow: bool) -> Photon {
    let corners = triangle_corners(hit.triangle);
    let e1 = corners[1] - corners[0];
    let e2 = corners[2] - corners[0];
    var normal = normalize(cross(e1, e2));
    if dot(normal, direction) > 0.0 { normal = -normal; }
    let word = photon_word(oct_encode7(normal), photon_pass.light, weight, shadow);
    return Photon(corners[0] + hit.u * e1 + hit.v * e2, word);
}

// Whether a hit leaves a photon: none on the back of a single-sided surface, which occludes all the same.
fn stores(hit: Hit, direction: vec3f) -> bool {
    if (triangle_word(hit.triangle) & TRIANGLE_DOUBLE_SIDED) != 0u { return true; }
    let corners = triangle_corners(hit.triangle);
    return dot(cross(corners[1] - corners[0], corners[2] - corners[0]), direction) < 0.0;
}

@compute @workgroup_size(64)
fn photons_of_light(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let item = group_index(group, groups) * 64u + lane;
    if lane == 0u {
        atomicStore(&group_photons, 0u);
        atomicStore(&group_illumination, 0u);
    }
    workgroupBarrier();
    // Candidates for shadow photons so far, those of them that are kept, and the nearest hit of all.
    var candidates = 0u;
    var kept = 0u;
    var first = Hit(MISSED, 0.0, 0.0, NO_HIT);
    var direction = vec3f(0.0);
    if item < photon_pass.ray_count {
        let ray_index = photon_pass.first_ray + item;
        let light_seed = hash3(photon_pass.seed, DIMENSION_PHOTON, photon_pass.light);
        let emitted = light_emit(photon_pass.light, sobol4(ray_index, light_seed));
        direction = emitted.direction;
        let ray = Ray(offset_origin(emitted.origin, emitted.normal), 0.0, direction, MISSED * 0.5);
        let ray_seed = hash3(light_seed, DIMENSION_PHOTON_ALPHA, ray_index);
        var choice = ray_seed;
        var walk = begin_walk(ray);
        while !walk.done {
            let slot = next_triangle(&walk, ray.t_max);
            if slot == NO_HIT { continue; }
            let hit = intersect_slot(&walk, slot);
            if !stops(hit, ray.t_min, ray.t_max, ray_seed) { continue; }
            var later = hit;
            if hit.t < first.t || (hit.t == first.t && slot < first.triangle) {
                later = first;
                first = hit;
            }
            if later.triangle == NO_HIT || later.t - first.t <= SAME_HIT * first.t || !stores(later, direction) { continue; }
            // A reservoir: each candidate is among the kept with the same probability.
            var place = candidates;
            candidates++;
            if place >= shadow_photons_per_ray {
                choice = hash2(choice, candidates);
                place = choice % candidates;
            }
            if place < shadow_photons_per_ray { kept_hits[place] = later; }
        }
        kept = min(candidates, shadow_photons_per_ray);
    }
    let weight = f32(candidates) / f32(max(kept, 1u));
    let illumination = first.triangle != NO_HIT && stores(first, direction);
    // A twin may have been taken for a later hit before the first one was found.
    var shadows = 0u;
    for (var k = 0u; k < kept; k++) {
        shadows += u32(kept_hits[k].t - first.t > SAME_HIT * first.t);
    }
    let own = shadows + u32(illumination);
    var place = 0u;
    if own > 0u { place = atomicAdd(&group_photons, own); }
    if illumination { atomicAdd(&group_illumination, 1u); }
    workgroupBarrier();
    if lane == 0u {
        group_start = atomicAdd(&photon_counts[0], atomicLoad(&group_photons));
        atomicAdd(&photon_counts[1], atomicLoad(&group_illumination));
    }
    workgroupBarrier();
    if traversal_overrun { atomicAdd(&photon_counts[2], 1u); }
    place += group_start;
    if illumination {
        traced_photons[place] = photon_at(first, direction, 1.0, false);
        place++;
    }
    for (var k = 0u; k < kept; k++) {
        if kept_hits[k].t - first.t > SAME_HIT * first.t {
            traced_photons[place] = photon_at(kept_hits[k], direction, weight, true);
            place++;
        }
    }
}
