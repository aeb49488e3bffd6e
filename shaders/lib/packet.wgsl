// Packet traversal: the rays of a subgroup visit the nodes that any of them meets, all at the same time.
// In: `packet_nodes` and `bvh_triangles`; lengths in scene units after normalisation. Out: what lib/bvh gives for each
// ray alone. It is for software devices whose subgroups have PACKET_LANES lanes; elsewhere each ray is traced alone.
//
// A node has PACKET_LANES texels (src/bvh/packet.rs), so one load in which each lane has its own texel fetches all of
// it. Shuffles, and broadcasts from a constant lane, hand the planes round: both are one instruction, where the other
// operations of subgroups are loops over the lanes. The stack lies in registers whose lanes hold an entry each. Loops
// test their condition at the end, since a software device runs their bodies once whatever the condition.
//
// Every lane of a subgroup must reach the trace at the same time. One without a ray passes `no_ray()`. `lane` is the
// invocation's index within the workgroup, whose subgroups follow each other. Where a packet gives up, all of its lanes
// have `traversal_overrun` set.

import package::lib::ray::{Hit, Ray, RaySample};
import package::lib::bvh::{trace_closest, trace_occluded};
@if(!packets) import package::lib::bvh::{Traversal, begin_traversal, intersect_primitive, next_triangle};
@if(!packets) import package::lib::ray::NO_HIT;
@if(packets) import package::lib::ray::{NO_HIT, ShearedRay, intersect_triangle, nonzero_direction, shear_ray};
@if(packets) import package::lib::bvh::{NO_ENTRY, NO_KEY, ONE_TRIANGLE, precedes};
@if(packets) import package::lib::bvh_triangles::triangle_texel;
@if(!packets || !alpha_test) import package::lib::bvh::MAX_ITERATIONS;
@if(packets) import package::lib::bvh::{
    FAR_PLANE_SCALE, PLANE_MARGIN, sorted, traversal_iterations, traversal_overrun, within
};
@if(packets) import package::lib::constants::{BVH_TRIANGLE_TEXELS, PACKET_LANES};
@if(packets) import package::lib::table::table_texel;
@if(packets && alpha_test) import package::lib::alpha::alpha_blocks;
@if(packets && alpha_test) import package::lib::bvh::has_alpha_test;
@if(packets && procedurals) import package::lib::procedural::{closest_procedural, procedurals_occlude};
@if(packets && procedurals) import package::lib::procedural::procedural_ray_iterations;

@if(packets) @group(1) @binding(25) var packet_nodes: texture_storage_2d<rgba32float, read>;

// A ray that meets nothing.
fn no_ray() -> Ray {
    return Ray(vec3f(0.0), 0.0, vec3f(0.0, 0.0, 1.0), -1.0);
}

// Like trace_closest.
fn trace_closest_together(ray: Ray, sample: RaySample, lane: u32) -> Hit {
    @if(!packets) { return trace_closest(ray, sample); }
    @if(packets) {
        var closest = trace_packet(ray, sample, lane % PACKET_LANES, false);
        @if(procedurals) {
            closest = closest_procedural(ray, closest);
            traversal_iterations += procedural_ray_iterations;
        }
        return closest;
    }
}

// Like trace_occluded.
fn trace_occluded_together(ray: Ray, sample: RaySample, lane: u32) -> bool {
    @if(!packets) { return trace_occluded(ray, sample); }
    @if(packets) {
        var occluded = trace_packet(ray, sample, lane % PACKET_LANES, true).triangle != NO_HIT;
        @if(procedurals) {
            if !occluded {
                occluded = procedurals_occlude(ray);
                traversal_iterations += procedural_ray_iterations;
            }
        }
        return occluded;
    }
}

// The bits that are set in any lane of the packet.
@if(packets)
fn bits_of_packet(bits: u32, lane: u32) -> u32 {
    let own = lane % PACKET_LANES;
    var all = bits;
    all |= subgroupShuffle(all, own ^ 4u);
    all |= subgroupShuffle(all, own ^ 2u);
    all |= subgroupShuffle(all, own ^ 1u);
    return all;
}

// Whether the condition holds in any lane of the packet; where each ray is traced alone, in this lane.
fn in_any_lane(condition: bool, lane: u32) -> bool {
    @if(!packets) { return condition; }
    @if(packets) { return subgroupBroadcast(bits_of_packet(select(0u, 1u, condition), lane), 0u) != 0u; }
}

// The largest of the packet's values; where each ray is traced alone, the lane's own.
fn largest_of_packet(value: u32, lane: u32) -> u32 {
    @if(!packets) { return value; }
    @if(packets) {
        let own = lane % PACKET_LANES;
        var largest = max(value, subgroupShuffle(value, own ^ 4u));
        largest = max(largest, subgroupShuffle(largest, own ^ 2u));
        largest = max(largest, subgroupShuffle(largest, own ^ 1u));
        return subgroupBroadcast(largest, 0u);
    }
}

// Data of a ray for the box test.
@if(packets)
struct Slabs {
    inverse_direction: vec3f,
    // Origin / direction, with the margin for near and for far planes.
    near_start: vec3f,
    far_start: vec3f,
    // Lanes that hold the near planes of child 0.
    near_lane: vec3u,
    t_min: f32,
}

// The margin is PLANE_MARGIN, 16 * 2^-24, of the largest sum of a plane's and the origin's coordinates. 9 * 2^-24 of it
// is for the error of the triangle test, which lib/bvh derives (open_node). 4 * 2^-24 is for the roundings of a plane's
// distance here: of plane / direction, of origin / direction, of its sum with the margin, and of the difference. Boxes
// are exact. The rest is as in lib/bvh.
@if(packets)
fn slabs_of(ray: Ray) -> Slabs {
    let inverse = 1.0 / nonzero_direction(ray.direction);
    // The largest coordinate of all boxes is with the upper planes of the root's first child.
    let reach = abs(ray.origin) + textureLoad(packet_nodes, table_texel(PACKET_LANES / 2u)).w;
    let slack = PLANE_MARGIN * max(reach.x, max(reach.y, reach.z)) * abs(inverse);
    let start = ray.origin * inverse;
    let near_lane = select(vec3u(PACKET_LANES / 2u), vec3u(0u), inverse > vec3f(0.0));
    return Slabs(inverse, start + slack, start - slack, near_lane, ray.t_min);
}

// The key of a child as lib/bvh has them, NO_KEY where the ray does not meet it before t_max. `texel` is the lane's
// part of the node.
@if(packets)
fn child_key(slabs: Slabs, texel: vec4f, child: u32, t_max: f32) -> u32 {
    let near = slabs.near_lane + child;
    let far = near ^ vec3u(PACKET_LANES / 2u);
    let near_planes =
        vec3f(subgroupShuffle(texel.x, near.x), subgroupShuffle(texel.y, near.y), subgroupShuffle(texel.z, near.z));
    let far_planes =
        vec3f(subgroupShuffle(texel.x, far.x), subgroupShuffle(texel.y, far.y), subgroupShuffle(texel.z, far.z));
    // Compared as integers, as in lib/bvh.
    let a = bitcast<vec3i>(near_planes * slabs.inverse_direction - slabs.near_start);
    let b = bitcast<vec3i>(far_planes * slabs.inverse_direction - slabs.far_start);
    let enter = max(max(a.x, a.y), max(a.z, bitcast<i32>(slabs.t_min)));
    let leave = min(min(b.x, b.y), min(b.z, bitcast<i32>(t_max)));
    let met = bitcast<f32>(enter) <= bitcast<f32>(leave) * FAR_PLANE_SCALE;
    return select(NO_KEY, (bitcast<u32>(enter) & 0xfffffffcu) | child, met);
}

// Each child's minimum key of all lanes, sorted.
@if(packets)
fn min_keys(keys: vec4u, lane: u32) -> vec4u {
    // Halves of the lanes take children 0 and 1, or 2 and 3, then one of the two: three exchanges instead of twelve.
    let upper = (lane & 4u) != 0u;
    let odd = (lane & 2u) != 0u;
    let kept = select(keys.xz, keys.yw, upper);
    let pair = min(kept, subgroupShuffle(select(keys.yw, keys.xz, upper), lane ^ 4u));
    let half = min(select(pair.x, pair.y, odd), subgroupShuffle(select(pair.y, pair.x, odd), lane ^ 2u));
    let lowest = min(half, subgroupShuffle(half, lane ^ 1u));
    let of_first = vec2u(subgroupBroadcast(lowest, 0u), subgroupBroadcast(lowest, 4u));
    return sorted(vec4u(of_first, subgroupBroadcast(lowest, 2u), subgroupBroadcast(lowest, 6u)));
}

// The entries to be visited, in the format of lib/bvh: entry 8 i + l is in lane l of word i. A node adds three at most:
// 15 in a shallow BVH, 87 in one of 29 levels. Entries at the height and above it are undefined.
@if(packets)
struct PacketStack {
    height: u32,
    @if(shallow_bvh) words: vec2u,
    @if(!shallow_bvh) low: vec4u,
    @if(!shallow_bvh) middle: vec4u,
    @if(!shallow_bvh) high: vec4u,
}

// Pushes up to eight entries; each lane passes the one for the position that it holds.
@if(packets)
fn push_entries(stack: ptr<function, PacketStack>, entry: u32, count: u32, lane: u32) {
    let height = (*stack).height;
    @if(shallow_bvh) {
        (*stack).words = select((*stack).words, vec2u(entry), vec2u(lane, lane + 8u) >= vec2u(height));
    }
    @if(!shallow_bvh) {
        let index = vec4u(lane) + vec4u(0u, 8u, 16u, 24u);
        (*stack).low = select((*stack).low, vec4u(entry), index >= vec4u(height));
        (*stack).middle = select((*stack).middle, vec4u(entry), index + 32u >= vec4u(height));
        (*stack).high = select((*stack).high, vec4u(entry), index + 64u >= vec4u(height));
    }
    (*stack).height = height + count;
}

// The entry on top of the stack, NO_ENTRY if it is empty.
@if(packets)
fn top_entry(stack: PacketStack) -> u32 {
    let index = stack.height - 1u;
    let odd = (index & 8u) != 0u;
    @if(shallow_bvh) let word = select(stack.words.x, stack.words.y, odd);
    @if(!shallow_bvh) let words =
        select(select(stack.low, stack.middle, (index & 32u) != 0u), stack.high, (index & 64u) != 0u);
    @if(!shallow_bvh) let word =
        select(select(words.x, words.y, odd), select(words.z, words.w, odd), (index & 16u) != 0u);
    return select(subgroupShuffle(word, index & 7u), NO_ENTRY, stack.height == 0u);
}

@if(packets)
fn lower_height(stack: PacketStack) -> u32 {
    return select(stack.height - 1u, 0u, stack.height == 0u);
}

// A triangle that all lanes test.
@if(packets)
struct Tested {
    corners: array<vec3f, 3>,
    primitive: u32,
    // Whether there is one.
    is_triangle: bool,
}

// The hits of a lane's ray.
@if(packets)
struct Found {
    // The first one so far. If any hit will do, t is -1 from then on, so that the ray meets no more boxes.
    closest: Hit,
    // One that an alpha test is to decide.
    @if(alpha_test) undecided: Hit,
}

@if(packets)
fn test_triangle(found: ptr<function, Found>, ray: Ray, sheared: ShearedRay, tested: Tested, any_hit: bool) {
    let closest = (*found).closest;
    let met = intersect_triangle(sheared, tested.corners[0], tested.corners[1], tested.corners[2]);
    let hit = Hit(met.x, met.y, met.z, tested.primitive);
    let stopped = tested.is_triangle && precedes(hit, closest) && within(hit, ray.t_min, closest.t);
    @if(!alpha_test) { if stopped { keep_hit(found, hit, any_hit); } }
    @if(alpha_test) {
        if stopped {
            if has_alpha_test(hit) { (*found).undecided = hit; } else { keep_hit(found, hit, any_hit); }
        }
    }
}

@if(packets)
fn keep_hit(found: ptr<function, Found>, hit: Hit, any_hit: bool) {
    (*found).closest = hit;
    (*found).closest.t = select(hit.t, -1.0, any_hit);
}

// Triangles of a leaf that one iteration tests. The alpha test, with its textures, is outside the loops, as in lib/bvh,
// so that one triangle at a time can be undecided.
@if(packets && !alpha_test) const PACKET_TRIANGLES: u32 = 2u;
@if(packets && alpha_test) const PACKET_TRIANGLES: u32 = 1u;

// The budget, in place of MAX_ITERATIONS. The outermost loop of the alpha test does not count its own iterations, but
// counts at least three in each of them: 45,000 counted iterations are at most 60,000.
@if(packets && alpha_test) const PACKET_ITERATIONS: u32 = 45000u;
@if(packets && !alpha_test) const PACKET_ITERATIONS: u32 = MAX_ITERATIONS;

// Iterations so far, the same in all lanes, which share the budget of a loop.
@if(packets)
fn shared_iterations(lane: u32) -> u32 {
    return largest_of_packet(traversal_iterations, lane);
}

// The first hit of each lane's ray; with `any_hit` any hit, whose t is not valid.
@if(packets)
fn trace_packet(ray: Ray, sample: RaySample, lane: u32, any_hit: bool) -> Hit {
    let slabs = slabs_of(ray);
    let sheared = shear_ray(ray);
    var found: Found;
    found.closest = Hit(ray.t_max, 0.0, 0.0, NO_HIT);
    var stack: PacketStack;
    var entry = 0u;
    var iterations = shared_iterations(lane);
    @if(!alpha_test) {
        loop {
            iterations++;
            entry = visit_nodes(&stack, &iterations, entry, slabs, found.closest.t, lane, false);
            entry = visit_leaves(&stack, &iterations, entry, &found, ray, sheared, lane, any_hit);
            if entry == NO_ENTRY { break; }
        }
    }
    @if(alpha_test) {
        loop {
            found.undecided.triangle = NO_HIT;
            var waits = false;
            loop {
                iterations++;
                entry = visit_nodes(&stack, &iterations, entry, slabs, found.closest.t, lane, true);
                entry = visit_leaves(&stack, &iterations, entry, &found, ray, sheared, lane, any_hit);
                waits = in_any_lane(found.undecided.triangle != NO_HIT, lane);
                if entry == NO_ENTRY || waits { break; }
            }
            let hit = found.undecided;
            if hit.triangle != NO_HIT && alpha_blocks(hit, sample) {
                keep_hit(&found, hit, any_hit);
            }
            if entry == NO_ENTRY { break; }
        }
    }
    traversal_iterations = iterations;
    traversal_overrun |= iterations >= PACKET_ITERATIONS;
    return found.closest;
}

// Visits nodes until the next entry is a leaf, or there is none; a leaf stays the next entry. `resumes`: the first
// entry may be a leaf whose triangles are not all tested yet.
@if(packets)
fn visit_nodes(
    stack: ptr<function, PacketStack>,
    iterations: ptr<function, u32>,
    first_entry: u32,
    slabs: Slabs,
    t_max: f32,
    lane: u32,
    resumes: bool,
) -> u32 {
    var entry = first_entry;
    loop {
        *iterations += 1u;
        let texel = textureLoad(packet_nodes, table_texel(PACKET_LANES * entry + lane));
        let low_keys = vec2u(child_key(slabs, texel, 0u, t_max), child_key(slabs, texel, 1u, t_max));
        let high_keys = vec2u(child_key(slabs, texel, 2u, t_max), child_key(slabs, texel, 3u, t_max));
        let keys = min_keys(vec4u(low_keys, high_keys), lane);
        let reference = bitcast<u32>(texel.w);
        let each = select(vec3u(0u), vec3u(1u), keys.yzw != vec3u(NO_KEY));
        let count = each.x + each.y + each.z;
        // The nearer of the pending children are nearer to the top.
        let height = (*stack).height;
        let below = (height + count - 1u - lane) & 7u;
        let pending = select(select(keys.w, keys.z, below == 1u), keys.y, below == 0u);
        push_entries(stack, subgroupShuffle(reference, pending & 3u), count, lane);
        let nearest = subgroupShuffle(reference, keys.x & 3u);
        let pops = keys.x == NO_KEY;
        var next = select(nearest, top_entry(*stack), pops);
        var next_height = select((*stack).height, lower_height(*stack), pops);
        if resumes {
            next = select(next, entry, entry >= ONE_TRIANGLE);
            next_height = select(next_height, height, entry >= ONE_TRIANGLE);
        }
        let gives_up = *iterations >= PACKET_ITERATIONS;
        // Broadcast, so that the compiler knows that all lanes agree.
        entry = subgroupBroadcast(select(next, NO_ENTRY, gives_up), 0u);
        (*stack).height = subgroupBroadcast(select(next_height, 0u, gives_up), 0u);
        if entry >= ONE_TRIANGLE { break; }
    }
    return entry;
}

// Tests the triangles of leaves until the next entry is a node, or there is none, or an alpha test is due.
@if(packets)
fn visit_leaves(
    stack: ptr<function, PacketStack>,
    iterations: ptr<function, u32>,
    first_entry: u32,
    found: ptr<function, Found>,
    ray: Ray,
    sheared: ShearedRay,
    lane: u32,
    any_hit: bool,
) -> u32 {
    var entry = first_entry;
    loop {
        *iterations += 1u;
        let first = entry & (ONE_TRIANGLE - 1u);
        let count = select(entry / ONE_TRIANGLE, 0u, entry == NO_ENTRY);
        let texel = triangle_texel(BVH_TRIANGLE_TEXELS * first + lane).xyz;
        let corners = array(subgroupBroadcast(texel, 0u), subgroupBroadcast(texel, 1u), subgroupBroadcast(texel, 2u));
        test_triangle(found, ray, sheared, Tested(corners, first, count > 0u), any_hit);
        @if(!alpha_test) {
            let others =
                array(subgroupBroadcast(texel, 3u), subgroupBroadcast(texel, 4u), subgroupBroadcast(texel, 5u));
            test_triangle(found, ray, sheared, Tested(others, first + 1u, count > 1u), any_hit);
        }
        let more = count > PACKET_TRIANGLES;
        let rest = entry - PACKET_TRIANGLES * ONE_TRIANGLE + PACKET_TRIANGLES;
        let next = select(top_entry(*stack), rest, more);
        let height = select(lower_height(*stack), (*stack).height, more);
        var ends = false;
        if any_hit { ends = !in_any_lane((*found).closest.t >= 0.0, lane); }
        entry = subgroupBroadcast(select(next, NO_ENTRY, ends), 0u);
        (*stack).height = subgroupBroadcast(height, 0u);
        var waits = false;
        @if(alpha_test) { waits = in_any_lane((*found).undecided.triangle != NO_HIT, lane); }
        if entry < ONE_TRIANGLE || entry == NO_ENTRY || waits { break; }
    }
    return entry;
}

// All surfaces along a ray, in any order:
//
//     var line = begin_line(ray, lane);
//     while !line.done {
//         let hits = next_on_line(&line, lane);
//         if hits.first.triangle != NO_HIT && stops(hits.first, ray.t_min, ray.t_max, sample) { ... }
//         if hits.second.triangle != NO_HIT && stops(hits.second, ray.t_min, ray.t_max, sample) { ... }
//     }
//
// A packet goes on until one of its lanes has two hits: what a kernel does with hits takes as long for one lane as for
// all.
struct Line {
    done: bool,
    @if(!packets) t_max: f32,
    @if(!packets) traversal: Traversal,
    @if(packets) ray: Ray,
    @if(packets) slabs: Slabs,
    @if(packets) sheared: ShearedRay,
    @if(packets) stack: PacketStack,
    @if(packets) entry: u32,
}

// The next hits of a lane; `triangle` is NO_HIT where there is none. A ray that is traced alone has no second.
struct LineHits {
    first: Hit,
    second: Hit,
}

// The budget of a line. The caller's loop, one iteration for two hits, is counted.
@if(!packets) const LINE_ITERATIONS: u32 = MAX_ITERATIONS;
@if(packets) const LINE_ITERATIONS: u32 = PACKET_ITERATIONS;

fn begin_line(ray: Ray, lane: u32) -> Line {
    var line: Line;
    @if(!packets) {
        line.t_max = ray.t_max;
        line.traversal = begin_traversal(ray);
    }
    @if(packets) {
        line.ray = ray;
        line.slabs = slabs_of(ray);
        line.sheared = shear_ray(ray);
    }
    return line;
}

fn next_on_line(line: ptr<function, Line>, lane: u32) -> LineHits {
    let none = Hit(0.0, 0.0, 0.0, NO_HIT);
    var hits = LineHits(none, none);
    @if(!packets) {
        var traversal = (*line).traversal;
        let primitive = next_triangle(&traversal, (*line).t_max);
        if primitive != NO_HIT { hits.first = intersect_primitive(&traversal, primitive); }
        (*line).done = traversal.done;
        (*line).traversal = traversal;
    }
    @if(packets) {
        let packet_lane = lane % PACKET_LANES;
        let t_max = (*line).ray.t_max;
        var iterations = shared_iterations(packet_lane) + 1u;
        var stack = (*line).stack;
        var entry = (*line).entry;
        var full = false;
        loop {
            iterations++;
            entry = visit_nodes(&stack, &iterations, entry, (*line).slabs, t_max, packet_lane, true);
            entry = visit_leaves_on_line(*line, &stack, &iterations, entry, &hits, packet_lane);
            full = in_any_lane(hits.second.triangle != NO_HIT, packet_lane);
            if entry == NO_ENTRY || full { break; }
        }
        (*line).stack = stack;
        (*line).entry = entry;
        (*line).done = entry == NO_ENTRY;
        traversal_iterations = iterations;
        traversal_overrun |= iterations >= PACKET_ITERATIONS;
    }
    return hits;
}

// Tests the triangles of leaves until the next entry is a node, or there is none, or a lane has two hits.
@if(packets)
fn visit_leaves_on_line(
    line: Line,
    stack: ptr<function, PacketStack>,
    iterations: ptr<function, u32>,
    first_entry: u32,
    hits: ptr<function, LineHits>,
    lane: u32,
) -> u32 {
    var entry = first_entry;
    loop {
        *iterations += 1u;
        let primitive = entry & (ONE_TRIANGLE - 1u);
        let is_entry = entry != NO_ENTRY;
        let texel = triangle_texel(BVH_TRIANGLE_TEXELS * primitive + lane).xyz;
        let corners = array(subgroupBroadcast(texel, 0u), subgroupBroadcast(texel, 1u), subgroupBroadcast(texel, 2u));
        let met = intersect_triangle(line.sheared, corners[0], corners[1], corners[2]);
        let hit = Hit(met.x, met.y, met.z, primitive);
        if is_entry && within(hit, line.ray.t_min, line.ray.t_max) {
            if (*hits).first.triangle == NO_HIT { (*hits).first = hit; } else { (*hits).second = hit; }
        }
        let more = is_entry && entry >= 2u * ONE_TRIANGLE;
        let next = select(top_entry(*stack), entry + 1u - ONE_TRIANGLE, more);
        let height = select(lower_height(*stack), (*stack).height, more);
        entry = subgroupBroadcast(next, 0u);
        (*stack).height = subgroupBroadcast(height, 0u);
        let full = in_any_lane((*hits).second.triangle != NO_HIT, lane);
        if entry < ONE_TRIANGLE || entry == NO_ENTRY || full { break; }
    }
    return entry;
}
