// shadow: shadow rays of the candidates (a point and a light of the chunk: light * point_count + point) that the
// photons do not decide, and audits of those that they decide. In: queues of candidates, points (normalised space), the
// BVH. Out: the visibilities of each candidate's light points, a bit each, in `visibility`; photons that repair the
// visibility map where an audit contradicts a class. Paper, "Extending the photon map": case 3.

import package::kit::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::bvh::traversal_overrun;
import package::lib::packet::{largest_of_packet, no_ray, trace_occluded_together};
@if(packets) import package::lib::packet::bits_of_packet;
import package::lib::math::{oct_decode16, oct_encode7, invalid_sample, remainder};
@if(packets) import package::lib::constants::PACKET_LANES;
@if(packets) import package::lib::math::quotient;
import package::lib::light::shadow_ray;
import package::lib::light::table::max_light_points;
import package::lib::sampled_light::{nth_light_sample, audit_light_sample, candidate_light};
import package::lib::ray::RaySample;
import package::lib::rng::hash2;
import package::lib::visible_point::load_point;
@if(audit) import package::lib::photon::photon_word;
@if(audit) import package::lib::constants::REPAIR_PHOTONS;
@if(audit) import package::lib::class_word::{NEAR, SETTLED, class_of, is_decided, nearness_of};
@if(fine_cells) import package::lib::fine_cell::store_rays;
@if(fine_cells && environment) import package::lib::light::environment::is_environment;
import package::lib::constants::{
    CLASS_LIT, COUNTER_AUDITS_WRONG, COUNTER_AUDITS_WRONG_NEAR, COUNTER_AUDITS_WRONG_SETTLED, COUNTER_AUDIT_RAYS,
    COUNTER_OVERRUN, COUNTER_PENUMBRA_RAYS, COUNTER_PENUMBRA_SEEN, COUNTER_SHADOW_RAYS, DIMENSION_SHADOW_ALPHA,
    QUEUE_AUDIT, QUEUE_BOUNDARY, QUEUE_COUNT
};

struct ShadowParameters {
    tile: Tile,
    // The chunk's first light, or sampled light index.
    first_light: u32,
    // Light points of a candidate, and words of 32 visibilities that hold them.
    light_samples: u32,
    visibility_words: u32,
    // Photons that audits can add to the map.
    repair_capacity: u32,
}

@if(audit) @group(0) @binding(1) var<storage, read> classes: array<u32>;
// Candidates to trace, and candidates to audit.
@group(0) @binding(2) var<storage, read> boundary_queue: array<u32>;
@if(audit) @group(0) @binding(3) var<storage, read> audit_queue: array<u32>;
// The length of each queue.
@group(0) @binding(8) var<storage, read> queue_lengths: array<u32, QUEUE_COUNT>;
@group(0) @binding(4) var<storage, read_write> visibility: array<u32>;
@group(0) @binding(5) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(9) var<storage, read_write> radiance_direct: array<vec4f>;
// Photons of the other kind where an audit contradicted a class: first their number, then, from word REPAIR_PHOTONS,
// the photons. They share one binding, because devices allow few.
@if(audit && visibility_map) @group(0) @binding(6) var<storage, read_write> repairs: array<atomic<u32>>;

var<immediate> parameters: ShadowParameters;

var<workgroup> rays_traced: atomic<u32>;
// Candidates in penumbra, with visible and hidden light points, and their rays.
var<workgroup> penumbra_points: atomic<u32>;
var<workgroup> penumbra_rays: atomic<u32>;
// Audits that contradict the class, and those of them near boundaries.
@if(audit) var<workgroup> wrong_audits: atomic<u32>;
@if(audit) var<workgroup> wrong_near: atomic<u32>;
@if(audit) var<workgroup> wrong_settled: atomic<u32>;

// The inputs of a candidate's rays.
struct Candidate {
    position: vec3f,
    normal: vec3f,
    light: u32,
    seed: u32,
    sample_index: u32,
}

fn load_candidate(candidate: u32) -> Candidate {
    let tile = parameters.tile;
    let i = remainder(candidate, tile.point_count);
    let point = load_point(i);
    return Candidate(
        point.position,
        oct_decode16(point.normal),
        candidate_light(candidate, parameters.first_light, tile.point_count),
        pixel_seed(tile, i),
        tile_sample(tile, i),
    );
}

// Drops the sample of a candidate whose rays met the loop budget: its visibility is not known.
fn drop_sample(candidate: u32) {
    atomicAdd(&counters[COUNTER_OVERRUN], 1u);
    let i = remainder(candidate, parameters.tile.point_count);
    radiance_direct[i] = vec4f(invalid_sample(i));
}

// A candidate of a queue. Lanes beyond the queue's end have none: they are not active, and trace no rays together with
// the others.
struct Queued {
    candidate: u32,
    is_active: bool,
}

// A ray of a packet, or of a lane alone: its candidate, and its number among the rays of a word of visibilities.
struct PacketRay {
    candidate: Candidate,
    is_active: bool,
    number: u32,
}

// The ray that a lane traces at a step. A packet traces the rays of a few candidates at each step, not one of each:
// rays from one point to one light visit the same nodes. `rays` is the maximum of its candidates' numbers of rays.
fn packet_ray(c: Candidate, is_active: bool, step: u32, rays: u32, lane: u32) -> PacketRay {
    @if(!packets) { return PacketRay(c, is_active, step); }
    @if(packets) {
        let ray = PACKET_LANES * step + lane % PACKET_LANES;
        let from_lane = quotient(ray, rays);
        let position = vec3f(
            subgroupShuffle(c.position.x, from_lane),
            subgroupShuffle(c.position.y, from_lane),
            subgroupShuffle(c.position.z, from_lane),
        );
        let normal = vec3f(
            subgroupShuffle(c.normal.x, from_lane),
            subgroupShuffle(c.normal.y, from_lane),
            subgroupShuffle(c.normal.z, from_lane),
        );
        let light = subgroupShuffle(c.light, from_lane);
        let seed = subgroupShuffle(c.seed, from_lane);
        let sample_index = subgroupShuffle(c.sample_index, from_lane);
        let of_lane = Candidate(position, normal, light, seed, sample_index);
        return PacketRay(of_lane, subgroupShuffle(u32(is_active), from_lane) != 0u, ray - from_lane * rays);
    }
}

// The bits of a step's rays that belong to the lane's own candidate, at their positions in its word of visibilities.
fn own_bits(bit: bool, step: u32, rays: u32, lane: u32) -> u32 {
    @if(!packets) { return u32(bit) << step; }
    @if(packets) {
        let own = lane % PACKET_LANES;
        let bits = bits_of_packet(u32(bit) << own, lane);
        // The step's first ray, counted from the candidate's own first one.
        let first = i32(PACKET_LANES * step) - i32(own * rays);
        if first <= -i32(PACKET_LANES) || first >= i32(rays) { return 0u; }
        let placed = select(bits << u32(max(first, 0)), bits >> u32(max(-first, 0)), first < 0);
        return placed & (0xffffffffu >> (32u - rays));
    }
}

// Traces the candidate's rays and writes their visibilities: (rays, those that reached the light).
fn trace_candidate(queued: Queued, lane: u32) -> vec2u {
    let candidate = queued.candidate;
    let own = load_candidate(candidate);
    let own_rays = select(0u, max_light_points(own.light, parameters.light_samples), queued.is_active);
    let max_rays = largest_of_packet(own_rays, lane);
    var traced = 0u;
    var visible = 0u;
    for (var word = 0u; word < parameters.visibility_words; word++) {
        let first = word * 32u;
        let rays = min(32u, max(max_rays, first) - first);
        var facing_bits = 0u;
        var visible_bits = 0u;
        for (var step = 0u; step < rays; step++) {
            let of_packet = packet_ray(own, queued.is_active, step, rays, lane);
            let c = of_packet.candidate;
            let j = first + of_packet.number;
            let count = max_light_points(c.light, parameters.light_samples);
            let sampled = nth_light_sample(c.light, c.position, c.seed, c.sample_index, j, count);
            let is_active = of_packet.is_active && j < count;
            let faces = is_active && sampled.pdf > 0.0 && dot(sampled.direction, c.normal) > 0.0;
            var ray = no_ray();
            if faces { ray = shadow_ray(c.position, c.normal, sampled); }
            let ray_sample = RaySample(hash2(c.seed, DIMENSION_SHADOW_ALPHA + c.light), c.sample_index * count + j);
            let occluded = trace_occluded_together(ray, ray_sample, lane);
            facing_bits |= own_bits(faces, step, rays, lane);
            visible_bits |= own_bits(faces && !occluded, step, rays, lane);
        }
        if queued.is_active { visibility[candidate * parameters.visibility_words + word] = visible_bits; }
        traced += countOneBits(facing_bits);
        visible += countOneBits(visible_bits);
    }
    return vec2u(traced, visible);
}

// Leaves the photons of a candidate's rays in its fine cell.
@if(fine_cells)
fn store_in_fine_cell(c: Candidate, visible: u32, blocked: u32) {
    // Nearly every point sees a part of the environment, so that few cells would be decided, and these wrongly.
    @if(environment) { if is_environment(c.light) { return; } }
    if !traversal_overrun { store_rays(c.light, c.position, c.normal, visible, blocked); }
}

@compute @workgroup_size(64)
fn shadow(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let item = group_index(group, groups) * 64u + lane;
    var queued = Queued(0u, item < queue_lengths[QUEUE_BOUNDARY]);
    if queued.is_active { queued.candidate = boundary_queue[item]; }
    let rays = trace_candidate(queued, lane);
    // Behind the rays: lavapipe compiles what follows a barrier twice, and keeps its variables in memory.
    if lane == 0u {
        atomicStore(&rays_traced, 0u);
        atomicStore(&penumbra_points, 0u);
        atomicStore(&penumbra_rays, 0u);
    }
    workgroupBarrier();
    if queued.is_active {
        atomicAdd(&rays_traced, rays.x);
        if rays.y > 0u && rays.y < rays.x {
            atomicAdd(&penumbra_points, 1u);
            atomicAdd(&penumbra_rays, rays.x);
        }
        if traversal_overrun { drop_sample(queued.candidate); }
        @if(fine_cells) { store_in_fine_cell(load_candidate(queued.candidate), rays.y, rays.x - rays.y); }
    }
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&counters[COUNTER_SHADOW_RAYS], atomicLoad(&rays_traced));
        atomicAdd(&counters[COUNTER_PENUMBRA_SEEN], atomicLoad(&penumbra_points));
        atomicAdd(&counters[COUNTER_PENUMBRA_RAYS], atomicLoad(&penumbra_rays));
    }
}

// What an audit found.
@if(audit)
struct Audited {
    // The light is visible, as the ray shows, or by class where the light point faces away.
    visible: bool,
    traced: bool,
    // The ray contradicts the class.
    wrong: bool,
}

// Traces the audit's ray. Where it contradicts the class, adds a photon of the other kind.
@if(audit)
fn audit_candidate(queued: Queued, lane: u32) -> Audited {
    let candidate = queued.candidate;
    let c = load_candidate(candidate);
    let sampled = audit_light_sample(c.light, c.position, c.seed, c.sample_index);
    let lit = class_of(classes[candidate]) == CLASS_LIT;
    let faces = queued.is_active && sampled.pdf > 0.0 && dot(sampled.direction, c.normal) > 0.0;
    var ray = no_ray();
    if faces { ray = shadow_ray(c.position, c.normal, sampled); }
    let ray_sample = RaySample(~hash2(c.seed, DIMENSION_SHADOW_ALPHA + c.light), c.sample_index);
    let visible = !trace_occluded_together(ray, ray_sample, lane);
    // If the light point faces away, no ray is traced, and the class is kept.
    if !faces { return Audited(lit, false, false); }
    @if(fine_cells) { store_in_fine_cell(c, u32(visible), u32(!visible)); }
    let wrong = visible != lit && !traversal_overrun;
    if wrong {
        @if(visibility_map) {
            let index = atomicAdd(&repairs[0], 1u);
            if index < parameters.repair_capacity {
                let word = photon_word(oct_encode7(c.normal), c.light, 1.0, !visible);
                let words = vec4u(bitcast<vec3u>(c.position), word);
                for (var i = 0u; i < 4u; i++) { atomicStore(&repairs[REPAIR_PHOTONS + 4u * index + i], words[i]); }
            }
        }
    }
    return Audited(visible, true, wrong);
}

@if(audit)
@compute @workgroup_size(64)
fn audit(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let item = group_index(group, groups) * 64u + lane;
    var queued = Queued(0u, item < queue_lengths[QUEUE_AUDIT]);
    if queued.is_active {
        queued.candidate = audit_queue[item];
        // Dilation has made a boundary of some.
        queued.is_active = is_decided(class_of(classes[queued.candidate]));
    }
    let found = audit_candidate(queued, lane);
    // Behind the rays, as in `shadow`.
    if lane == 0u {
        atomicStore(&rays_traced, 0u);
        atomicStore(&wrong_audits, 0u);
        atomicStore(&wrong_near, 0u);
        atomicStore(&wrong_settled, 0u);
    }
    workgroupBarrier();
    if found.traced { atomicAdd(&rays_traced, 1u); }
    if found.wrong {
        atomicAdd(&wrong_audits, 1u);
        let nearness = nearness_of(classes[queued.candidate]);
        if nearness == NEAR { atomicAdd(&wrong_near, 1u); }
        if nearness == SETTLED { atomicAdd(&wrong_settled, 1u); }
    }
    if queued.is_active {
        visibility[queued.candidate * parameters.visibility_words] = u32(found.visible);
        if traversal_overrun { drop_sample(queued.candidate); }
    }
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&counters[COUNTER_AUDIT_RAYS], atomicLoad(&rays_traced));
        atomicAdd(&counters[COUNTER_AUDITS_WRONG], atomicLoad(&wrong_audits));
        atomicAdd(&counters[COUNTER_AUDITS_WRONG_NEAR], atomicLoad(&wrong_near));
        atomicAdd(&counters[COUNTER_AUDITS_WRONG_SETTLED], atomicLoad(&wrong_settled));
    }
}
