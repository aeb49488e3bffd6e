// shadow: shadow rays, for the points and lights that the photons do not decide, and for audits of those they do.
// In: queues of slots (a slot is a point and a light of the chunk: light * point_count + point). Out: for every queued
// slot the visibilities of its light points, a bit each, in `visibility`.

import package::lib::dispatch::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::bvh::{trace_occluded, traversal_overrun};
import package::lib::math::{oct_decode16, oct_encode7, invalid_sample};
import package::lib::light::shadow_ray;
import package::lib::sampled_light::{nth_light_sample, audit_light_sample, slot_light};
import package::lib::point::Point;
import package::lib::rng::{hash2, hash3};
@if(audit) import package::lib::photon::{Photon, CLASS_LIT, class_of, is_near, photon_word};
import package::lib::constants::{
    DIMENSION_SHADOW_ALPHA, COUNTER_SHADOW_RAYS, COUNTER_AUDIT_RAYS, COUNTER_AUDITS_WRONG, COUNTER_AUDITS_WRONG_NEAR,
    COUNTER_OVERRUN, COUNTER_PENUMBRA_SEEN
};

struct ShadowParameters {
    tile: Tile,
    // The chunk's first light, or turn.
    first_light: u32,
    // Light points of a slot, and words of 32 visibilities that hold them.
    light_samples: u32,
    visibility_words: u32,
    // Photons that audits can add to the map.
    heal_capacity: u32,
}

@group(0) @binding(0) var<storage, read> points: array<Point>;
@if(audit) @group(0) @binding(1) var<storage, read> classes: array<u32>;
// Slots to trace and slots to audit.
@group(0) @binding(2) var<storage, read> boundary_queue: array<u32>;
@if(audit) @group(0) @binding(3) var<storage, read> audit_queue: array<u32>;
// Lengths of the queues: of the searches', the boundary and the audit queue.
@group(0) @binding(8) var<storage, read> queue_lengths: array<u32, 4>;
@group(0) @binding(4) var<storage, read_write> visibility: array<u32>;
@group(0) @binding(5) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(9) var<storage, read_write> radiance_direct: array<vec4f>;
// Photons of the other kind where an audit contradicted a class, and how many.
@if(audit) @group(0) @binding(6) var<storage, read_write> heal_photons: array<Photon>;
@if(audit) @group(0) @binding(7) var<storage, read_write> heal_count: atomic<u32>;

var<immediate> parameters: ShadowParameters;

var<workgroup> rays_traced: atomic<u32>;
var<workgroup> mixed_points: atomic<u32>;
@if(audit) var<workgroup> wrong_near: atomic<u32>;

// What a slot asks: from where, about which light, and by which random numbers.
struct Asked {
    position: vec3f,
    normal: vec3f,
    light: u32,
    seed: u32,
    sample_index: u32,
}

fn asked_by(slot: u32) -> Asked {
    let tile = parameters.tile;
    let i = slot % tile.point_count;
    return Asked(
        points[i].position,
        oct_decode16(points[i].normal),
        slot_light(slot, parameters.first_light, tile.point_count),
        pixel_seed(tile, i),
        tile_sample(tile, i),
    );
}

// Of a slot whose rays met the loop budget nothing is known, and so nothing of the sample.
fn leave_out(slot: u32) {
    atomicAdd(&counters[COUNTER_OVERRUN], 1u);
    let i = slot % parameters.tile.point_count;
    radiance_direct[i] = vec4f(invalid_sample(i));
}

@compute @workgroup_size(64)
fn shadow(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane == 0u {
        atomicStore(&rays_traced, 0u);
        atomicStore(&mixed_points, 0u);
    }
    workgroupBarrier();
    let item = group_index(group, groups) * 64u + lane;
    if item < queue_lengths[1] {
        let slot = boundary_queue[item];
        let asked = asked_by(slot);
        var traced = 0u;
        var seen = 0u;
        for (var word = 0u; word < parameters.visibility_words; word++) {
            var bits = 0u;
            let first = word * 32u;
            for (var j = first; j < min(first + 32u, parameters.light_samples); j++) {
                let chosen = nth_light_sample(asked.light, asked.position, asked.seed, asked.sample_index, j, parameters.light_samples);
                if chosen.pdf <= 0.0 || dot(chosen.direction, asked.normal) <= 0.0 { continue; }
                traced++;
                let ray_seed = hash3(asked.seed, DIMENSION_SHADOW_ALPHA + asked.light, asked.sample_index * parameters.light_samples + j);
                if !trace_occluded(shadow_ray(asked.position, asked.normal, chosen), ray_seed) { bits |= 1u << (j - first); }
            }
            visibility[slot * parameters.visibility_words + word] = bits;
            seen += countOneBits(bits);
        }
        atomicAdd(&rays_traced, traced);
        if seen > 0u && seen < traced { atomicAdd(&mixed_points, 1u); }
        if traversal_overrun { leave_out(slot); }
    }
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&counters[COUNTER_SHADOW_RAYS], atomicLoad(&rays_traced));
        atomicAdd(&counters[COUNTER_PENUMBRA_SEEN], atomicLoad(&mixed_points));
    }
}

@if(audit)
@compute @workgroup_size(64)
fn audit(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane == 0u {
        atomicStore(&rays_traced, 0u);
        atomicStore(&mixed_points, 0u);
        atomicStore(&wrong_near, 0u);
    }
    workgroupBarrier();
    let item = group_index(group, groups) * 64u + lane;
    if item < queue_lengths[2] {
        let slot = audit_queue[item];
        let asked = asked_by(slot);
        let chosen = audit_light_sample(asked.light, asked.position, asked.seed, asked.sample_index);
        // Where the light point faces away nothing is asked, and the class stands.
        let lit = class_of(classes[slot]) == CLASS_LIT;
        var seen = lit;
        if chosen.pdf > 0.0 && dot(chosen.direction, asked.normal) > 0.0 {
            atomicAdd(&rays_traced, 1u);
            let ray_seed = hash3(asked.seed, DIMENSION_SHADOW_ALPHA + asked.light, ~asked.sample_index);
            seen = !trace_occluded(shadow_ray(asked.position, asked.normal, chosen), ray_seed);
            if seen != lit && !traversal_overrun {
                atomicAdd(&mixed_points, 1u);
                if is_near(classes[slot]) { atomicAdd(&wrong_near, 1u); }
                let at = atomicAdd(&heal_count, 1u);
                if at < parameters.heal_capacity {
                    heal_photons[at] = Photon(asked.position, photon_word(oct_encode7(asked.normal), asked.light, 1.0, !seen));
                }
            }
        }
        visibility[slot * parameters.visibility_words] = u32(seen);
        if traversal_overrun { leave_out(slot); }
    }
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&counters[COUNTER_AUDIT_RAYS], atomicLoad(&rays_traced));
        atomicAdd(&counters[COUNTER_AUDITS_WRONG], atomicLoad(&mixed_points));
        atomicAdd(&counters[COUNTER_AUDITS_WRONG_NEAR], atomicLoad(&wrong_near));
    }
}
