// ward: adaptive shadow testing (Ward 1991), an earlier method. It tests the lights of each point in the order of their
// potential contribution, until the remaining lights together fall below a tolerance. It estimates the visibility of
// the remaining lights from how much of each was visible so far. In: points (normalised space), surfaces, visibilities
// from pass `shadow`. Out: class words of all candidates (a point and a light), and in each round the boundary queue
// for pass `shadow`, with one light of each point.

import package::lib::bsdf::surface::Surface;
import package::lib::bsdf::bsdf_evaluate;
import package::lib::class_word::class_word;
import package::lib::constants::{
    CLASS_BOUNDARY, CLASS_DARK, CLASS_UNKNOWN, INVALID_POINT, MAX_LIGHTS, QUEUE_BOUNDARY, QUEUE_COUNT
};
import package::kit::group_index;
@if(dark_points) import package::lib::light::light_dark;
import package::lib::light::table::max_light_points;
import package::lib::sampled_light::nth_light_sample;
import package::lib::math::luminance;
import package::lib::visible_point::{load_point, load_surface, visible_surface};
import package::lib::tile::{Tile, pixel_seed, tile_sample};

struct WardParameters {
    tile: Tile,
    light_count: u32,
    // The lights that `order` adds: the first, and the end.
    first_light: u32,
    end_light: u32,
    // Light points of a candidate, and words of 32 visibilities that hold them.
    light_samples: u32,
    visibility_words: u32,
    // Share of the light found so far. Testing stops when the remaining lights could contribute less than this.
    tolerance: f32,
}

// Progress of a point through its lights.
struct WardState {
    // Luminances: the potential of the lights not tested yet, and the contribution of the tested ones.
    rest: f32,
    found: f32,
    // Sums over the tested lights: the visible share at this point, and the expected share.
    visible: f32,
    expected: f32,
    // Number of lights not tested yet.
    waiting: u32,
    // The light being tested, counted from 1; 0 for none.
    current: u32,
}

var<immediate> ward_pass: WardParameters;

@group(0) @binding(2) var<storage, read_write> classes: array<u32>;
@group(0) @binding(3) var<storage, read> visibility: array<u32>;
@group(0) @binding(4) var<storage, read_write> queue_lengths: array<atomic<u32>, QUEUE_COUNT>;
@group(0) @binding(5) var<storage, read_write> boundary_queue: array<u32>;
// For each point a max-heap of keys. The k-th entries of all points are adjacent.
@group(0) @binding(6) var<storage, read_write> light_keys: array<u32>;
@group(0) @binding(7) var<storage, read_write> ward_states: array<WardState>;
// For each light, two words: the number of light points that were visible, and the number tested. `light_rates` counts
// those of earlier tiles, `light_tests` those of this tile.
@group(0) @binding(8) var<storage, read_write> light_rates: array<vec2u>;
@group(0) @binding(9) var<storage, read_write> light_tests: array<atomic<u32>>;

// A key holds the upper bits of the potential, and below them the light. Positive floats sort as their bits do. A
// potential loses less than a thousandth, which does not matter.
const LIGHT_MASK = MAX_LIGHTS - 1u;
// Number of light points that a potential is estimated from, if it is not 0: as many as direct light samples by
// default.
const POTENTIAL_SAMPLES = 4u;
// Counts are halved above this, so that they never overflow a word.
const MAX_TESTS = 1u << 30u;

var<workgroup> group_length: atomic<u32>;
var<workgroup> group_base: u32;

struct ShadingPoint {
    position: vec3f,
    surface: Surface,
    seed: u32,
    sample_index: u32,
}

fn shading_point(i: u32) -> ShadingPoint {
    var shading: ShadingPoint;
    let point = load_point(i);
    shading.position = point.position;
    shading.surface = visible_surface(load_surface(i), point);
    shading.seed = pixel_seed(ward_pass.tile, i);
    shading.sample_index = tile_sample(ward_pass.tile, i);
    return shading;
}

// Unshadowed luminance from the j-th light point; negative where the point faces away and is not tested.
fn unshadowed(shading: ShadingPoint, light: u32, j: u32) -> f32 {
    let count = max_light_points(light, ward_pass.light_samples);
    let sampled = nth_light_sample(light, shading.position, shading.seed, shading.sample_index, j, count);
    if sampled.pdf <= 0.0 || dot(shading.surface.geometric_normal, sampled.direction) <= 0.0 { return -1.0; }
    let reflected = bsdf_evaluate(shading.surface, sampled.direction) * sampled.radiance;
    return max(luminance(reflected), 0.0) / sampled.pdf;
}

// Unshadowed luminance of a light, estimated from a few light points. Lights of potential 0 are not tested, so it is 0
// only if no light point brings anything.
fn potential(shading: ShadingPoint, light: u32) -> f32 {
    let all = max_light_points(light, ward_pass.light_samples);
    var sum = 0.0;
    var count = 0u;
    while count < all && (count < POTENTIAL_SAMPLES || sum == 0.0) {
        sum += max(unshadowed(shading, light, count), 0.0);
        count++;
    }
    return sum / f32(count);
}

fn potential_of(key: u32) -> f32 {
    return bitcast<f32>(key & ~LIGHT_MASK);
}

fn candidate_of(light: u32, i: u32) -> u32 {
    return light * ward_pass.tile.point_count + i;
}

fn estimated_word(visibility: f32) -> u32 {
    return class_word(CLASS_BOUNDARY, 0u, 0u, visibility);
}

fn expected_share(light: u32) -> f32 {
    let rate = light_rates[light];
    return f32(rate.x) / f32(max(rate.y, 1u));
}

// Adds the potentials of some lights to the heap, except dark lights and lights of potential 0.
@compute @workgroup_size(64)
fn order(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= ward_pass.tile.point_count { return; }
    var state = WardState(0.0, 0.0, 0.0, 0.0, 0u, 0u);
    if ward_pass.first_light > 0u { state = ward_states[i]; }
    let shading = shading_point(i);
    let empty = load_point(i).normal == INVALID_POINT;
    for (var light = ward_pass.first_light; light < ward_pass.end_light; light++) {
        var dark = empty;
        @if(dark_points) { dark = dark || light_dark(light, shading.position, shading.surface.geometric_normal); }
        if dark {
            classes[candidate_of(light, i)] = class_word(CLASS_DARK, 0u, 0u, 0.0);
            continue;
        }
        let key = (bitcast<u32>(potential(shading, light)) & ~LIGHT_MASK) | light;
        classes[candidate_of(light, i)] = estimated_word(0.0);
        if potential_of(key) > 0.0 {
            insert(i, state.waiting, key);
            state.waiting++;
            state.rest += potential_of(key);
        }
    }
    ward_states[i] = state;
}

fn key_at(i: u32, k: u32) -> u32 {
    return light_keys[k * ward_pass.tile.point_count + i];
}

fn put_key(i: u32, k: u32, key: u32) {
    light_keys[k * ward_pass.tile.point_count + i] = key;
}

fn insert(i: u32, last: u32, key: u32) {
    var at = last;
    while at > 0u {
        let parent = (at - 1u) / 2u;
        let above = key_at(i, parent);
        if above >= key { break; }
        put_key(i, at, above);
        at = parent;
    }
    put_key(i, at, key);
}

// Removes the greatest of `count` keys and returns it.
fn take(i: u32, count: u32) -> u32 {
    let greatest = key_at(i, 0u);
    let left = count - 1u;
    let last = key_at(i, left);
    var at = 0u;
    while 2u * at + 1u < left {
        var child = 2u * at + 1u;
        if child + 1u < left && key_at(i, child + 1u) > key_at(i, child) { child++; }
        let below = key_at(i, child);
        if below <= last { break; }
        put_key(i, at, below);
        at = child;
    }
    put_key(i, at, last);
    return greatest;
}

// Adds the result of the shadow rays to the light being tested.
fn add_test(i: u32, state: ptr<function, WardState>) {
    if (*state).current == 0u { return; }
    let light = (*state).current - 1u;
    let shading = shading_point(i);
    let first = candidate_of(light, i) * ward_pass.visibility_words;
    var sum = 0.0;
    var visible = 0u;
    var tested = 0u;
    let count = max_light_points(light, ward_pass.light_samples);
    for (var j = 0u; j < count; j++) {
        let contributed = unshadowed(shading, light, j);
        let bit = (visibility[first + (j >> 5u)] >> (j & 31u)) & 1u;
        if contributed >= 0.0 {
            tested++;
            visible += bit;
            sum += f32(bit) * contributed;
        }
    }
    (*state).found += sum / f32(count);
    (*state).visible += f32(visible) / f32(max(tested, 1u));
    (*state).expected += expected_share(light);
    (*state).current = 0u;
    atomicAdd(&light_tests[2u * light], visible);
    atomicAdd(&light_tests[2u * light + 1u], tested);
}

// Queues each point's next light, unless the rest is below the tolerance.
@compute @workgroup_size(64)
fn next(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if lane == 0u { atomicStore(&group_length, 0u); }
    workgroupBarrier();
    var candidate = 0u;
    var rank = 0u;
    var queued = false;
    if i < ward_pass.tile.point_count {
        var state = ward_states[i];
        add_test(i, &state);
        queued = state.waiting > 0u && !(state.rest < ward_pass.tolerance * state.found);
        if queued {
            let key = take(i, state.waiting);
            state.waiting--;
            // Rounding must not make it negative: then a tolerance of 0 tests all lights.
            state.rest = max(state.rest - potential_of(key), 0.0);
            let light = key & LIGHT_MASK;
            state.current = light + 1u;
            candidate = candidate_of(light, i);
            classes[candidate] = class_word(CLASS_UNKNOWN, 0u, 0u, 0.0);
            rank = atomicAdd(&group_length, 1u);
        }
        ward_states[i] = state;
    }
    workgroupBarrier();
    if lane == 0u {
        let length = atomicLoad(&group_length);
        if length > 0u { group_base = atomicAdd(&queue_lengths[QUEUE_BOUNDARY], length); }
    }
    workgroupBarrier();
    if queued { boundary_queue[group_base + rank] = candidate; }
}

// Estimates the visibility of the lights that were not tested: the share of each that was visible so far, times the
// ratio of visible to expected shares over the lights tested at this point.
@compute @workgroup_size(64)
fn estimate(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= ward_pass.tile.point_count { return; }
    var state = ward_states[i];
    add_test(i, &state);
    // If no tested light was expected to be visible there is no ratio, and 0.5 stands for it.
    let ratio = select(0.5, state.visible / state.expected, state.expected > 0.0);
    for (var k = 0u; k < state.waiting; k++) {
        let light = key_at(i, k) & LIGHT_MASK;
        classes[candidate_of(light, i)] = estimated_word(min(ratio * expected_share(light), 1.0));
    }
}

// Adds the tile's tests to those of earlier tiles.
@compute @workgroup_size(64)
fn learn(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let light = group_index(group, groups) * 64u + lane;
    if light >= ward_pass.light_count { return; }
    let visible = atomicExchange(&light_tests[2u * light], 0u);
    let tested = atomicExchange(&light_tests[2u * light + 1u], 0u);
    let rate = light_rates[light] + vec2u(visible, tested);
    light_rates[light] = select(rate, rate / 2u, rate.y > MAX_TESTS);
}
