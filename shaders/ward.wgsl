// ward: the lights of each point in the order of what they could contribute. They are tested one after the other, until what
// is left could not matter; the rest is guessed by how much of each light was seen so far (Ward, "Adaptive shadow testing
// for ray tracing", 1991). Pass `shadow` traces what `next` queues, one light of each point a round.

import package::lib::bsdf::surface::Surface;
import package::lib::bsdf::bsdf_evaluate;
import package::lib::constants::INVALID_POINT;
import package::lib::dispatch::group_index;
@if(dark_points) import package::lib::light::light_dark;
import package::lib::sampled_light::nth_light_sample;
import package::lib::math::luminance;
import package::lib::photon::{CLASS_BOUNDARY, CLASS_DARK, CLASS_UNKNOWN, class_word};
import package::lib::seen::{points, seen_surface};
import package::lib::tile::{Tile, pixel_seed, tile_sample};

struct WardParameters {
    tile: Tile,
    light_count: u32,
    // The lights that `order` adds, from the first one to before the end.
    first_light: u32,
    end_light: u32,
    // Light points of a slot, and words of 32 visibilities that hold them.
    light_samples: u32,
    visibility_words: u32,
    // Share of the light found below which the rest is not tested.
    tolerance: f32,
    padding: vec2u,
}

// Where a point is in its list of lights.
struct WardState {
    // What the lights that wait could contribute, and what those that were tested did: luminances.
    rest: f32,
    found: f32,
    // Sums over the tested lights of the share that was seen here, and of the share that was to be expected.
    seen: f32,
    expected: f32,
    // Lights that wait.
    waiting: u32,
    // The light that is being tested, counted from 1; 0 for none.
    current: u32,
}

var<immediate> ward_pass: WardParameters;

@group(0) @binding(2) var<storage, read_write> classes: array<u32>;
@group(0) @binding(3) var<storage, read> visibility: array<u32>;
@group(0) @binding(4) var<storage, read_write> queue_lengths: array<atomic<u32>, 4>;
@group(0) @binding(5) var<storage, read_write> boundary_queue: array<u32>;
// Of each point a heap of keys, the greatest first: the entry k of all points lies together.
@group(0) @binding(6) var<storage, read_write> light_keys: array<u32>;
@group(0) @binding(7) var<storage, read_write> ward_states: array<WardState>;
// By light: light points that were seen, and that were asked for, before this tile; and of this tile, one after the other.
@group(0) @binding(8) var<storage, read_write> light_rates: array<vec2u>;
@group(0) @binding(9) var<storage, read_write> light_tests: array<atomic<u32>>;

// A key has the potential's bits above those of the light: positive floats sort as their bits do, and what a thousandth of
// a potential is worth decides nothing.
const LIGHT_BITS = 0x7ffu;
// Light points that a potential is judged by.
const POTENTIAL_SAMPLES = 4u;
const BOUNDARY_QUEUE = 1u;
// Counts are halved before they fill a word.
const MOST_TESTS = 1u << 30u;

var<workgroup> group_length: atomic<u32>;
var<workgroup> group_base: u32;

struct Place {
    position: vec3f,
    surface: Surface,
    seed: u32,
    sample_index: u32,
}

fn place_of(i: u32) -> Place {
    var place: Place;
    place.position = points[i].position;
    place.surface = seen_surface(i);
    place.seed = pixel_seed(ward_pass.tile, i);
    place.sample_index = tile_sample(ward_pass.tile, i);
    return place;
}

// Luminance of what the j-th light point brings where nothing is in between; negative where it is not asked for.
fn unshadowed(place: Place, light: u32, j: u32) -> f32 {
    let chosen = nth_light_sample(light, place.position, place.seed, place.sample_index, j, ward_pass.light_samples);
    if chosen.pdf <= 0.0 || dot(place.surface.geometric_normal, chosen.direction) <= 0.0 { return -1.0; }
    let reflected = bsdf_evaluate(place.surface, chosen.direction) * chosen.radiance;
    return max(luminance(reflected), 0.0) / chosen.pdf;
}

fn potential(place: Place, light: u32) -> f32 {
    let count = min(ward_pass.light_samples, POTENTIAL_SAMPLES);
    var sum = 0.0;
    for (var j = 0u; j < count; j++) { sum += max(unshadowed(place, light, j), 0.0); }
    return sum / f32(count);
}

fn potential_of(key: u32) -> f32 {
    return bitcast<f32>(key & ~LIGHT_BITS);
}

fn slot_of(light: u32, i: u32) -> u32 {
    return light * ward_pass.tile.point_count + i;
}

fn guessed(visibility: f32) -> u32 {
    return class_word(CLASS_BOUNDARY, 0u, 0u, visibility);
}

fn expected_share(light: u32) -> f32 {
    let rate = light_rates[light];
    return f32(rate.x) / f32(max(rate.y, 1u));
}

// The potentials of some lights, added to the heap. Dark ones are no part of it, nor are those that could bring nothing.
@compute @workgroup_size(64)
fn order(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= ward_pass.tile.point_count { return; }
    var state = WardState(0.0, 0.0, 0.0, 0.0, 0u, 0u);
    if ward_pass.first_light > 0u { state = ward_states[i]; }
    let place = place_of(i);
    let empty = points[i].normal == INVALID_POINT;
    for (var light = ward_pass.first_light; light < ward_pass.end_light; light++) {
        var dark = empty;
        @if(dark_points) { dark = dark || light_dark(light, place.position, place.surface.geometric_normal); }
        if dark {
            classes[slot_of(light, i)] = class_word(CLASS_DARK, 0u, 0u, 0.0);
            continue;
        }
        let key = (bitcast<u32>(potential(place, light)) & ~LIGHT_BITS) | light;
        classes[slot_of(light, i)] = guessed(0.0);
        if potential_of(key) > 0.0 {
            insert(i, state.waiting, key);
            state.waiting++;
            state.rest += potential_of(key);
        }
    }
    ward_states[i] = state;
}

fn key_at(i: u32, place: u32) -> u32 {
    return light_keys[place * ward_pass.tile.point_count + i];
}

fn put_key(i: u32, place: u32, key: u32) {
    light_keys[place * ward_pass.tile.point_count + i] = key;
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

// The greatest of `count` keys, taken out.
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

// Takes in what the shadow rays found of the light that is being tested.
fn take_in(i: u32, state: ptr<function, WardState>) {
    if (*state).current == 0u { return; }
    let light = (*state).current - 1u;
    let place = place_of(i);
    let first = slot_of(light, i) * ward_pass.visibility_words;
    var sum = 0.0;
    var seen = 0u;
    var asked = 0u;
    for (var j = 0u; j < ward_pass.light_samples; j++) {
        let brought = unshadowed(place, light, j);
        let bit = (visibility[first + (j >> 5u)] >> (j & 31u)) & 1u;
        if brought >= 0.0 {
            asked++;
            seen += bit;
            sum += f32(bit) * brought;
        }
    }
    (*state).found += sum / f32(ward_pass.light_samples);
    (*state).seen += f32(seen) / f32(max(asked, 1u));
    (*state).expected += expected_share(light);
    (*state).current = 0u;
    atomicAdd(&light_tests[2u * light], seen);
    atomicAdd(&light_tests[2u * light + 1u], asked);
}

// Queues each point's next light, unless what is left is below the tolerance.
@compute @workgroup_size(64)
fn next(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if lane == 0u { atomicStore(&group_length, 0u); }
    workgroupBarrier();
    var slot = 0u;
    var rank = 0u;
    var queued = false;
    if i < ward_pass.tile.point_count {
        var state = ward_states[i];
        take_in(i, &state);
        queued = state.waiting > 0u && !(state.rest < ward_pass.tolerance * state.found);
        if queued {
            let key = take(i, state.waiting);
            state.waiting--;
            // Never negative by rounding: a tolerance of 0 tests all.
            state.rest = max(state.rest - potential_of(key), 0.0);
            let light = key & LIGHT_BITS;
            state.current = light + 1u;
            slot = slot_of(light, i);
            classes[slot] = class_word(CLASS_UNKNOWN, 0u, 0u, 0.0);
            rank = atomicAdd(&group_length, 1u);
        }
        ward_states[i] = state;
    }
    workgroupBarrier();
    if lane == 0u {
        let length = atomicLoad(&group_length);
        if length > 0u { group_base = atomicAdd(&queue_lengths[BOUNDARY_QUEUE], length); }
    }
    workgroupBarrier();
    if queued { boundary_queue[group_base + rank] = slot; }
}

// What the lights that were not tested are taken to be seen of: what was seen of each before, times how much more or less
// was seen here of those that were tested.
@compute @workgroup_size(64)
fn guess(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= ward_pass.tile.point_count { return; }
    var state = ward_states[i];
    take_in(i, &state);
    // Where nothing was to be expected nothing is known.
    let here = select(0.5, state.seen / state.expected, state.expected > 0.0);
    for (var k = 0u; k < state.waiting; k++) {
        let light = key_at(i, k) & LIGHT_BITS;
        classes[slot_of(light, i)] = guessed(min(here * expected_share(light), 1.0));
    }
}

// Adds the tile's tests to those before.
@compute @workgroup_size(64)
fn learn(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let light = group_index(group, groups) * 64u + lane;
    if light >= ward_pass.light_count { return; }
    let seen = atomicExchange(&light_tests[2u * light], 0u);
    let asked = atomicExchange(&light_tests[2u * light + 1u], 0u);
    let rate = light_rates[light] + vec2u(seen, asked);
    light_rates[light] = select(rate, rate / 2u, rate.y > MOST_TESTS);
}
