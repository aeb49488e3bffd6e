// choose: the few of many lights that each point of a tile asks. In: points, the lists of lights of zones. Out: of every slot
// (turn * point_count + point) a light and what it stands for, `sampled_lights`.
//
// By zones: a light of the list of the point's zone is chosen with a probability of c v w, at most 1, that is in proportion
// to its potential w at the point and the root v of the share of its photons in the zone that arrived. It then counts as
// 1 over that, so that the mean is the sum over the list; and lights that matter most are always there. One equidistant
// comb over the cumulative probabilities chooses them all (systematic sampling), and no light twice. The last slot is an
// audit of the zones: for one of the lights that are not in the list, of a few candidates the likeliest (resampled
// importance sampling, Talbot et al. 2005). Together the mean is the sum over all lights, whatever the lists say.
// By power, or alike: the comb over the cumulative probabilities of all lights.

import package::lib::dispatch::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::light::sample_light;
import package::lib::sampled_light::NO_LIGHT;
import package::lib::point::Point;
import package::lib::rng::hash2;
import package::lib::sampling::sobol2;
@if(zones && texture_loads) import package::lib::table::table_texel;
import package::lib::grid::GridShape;
@if(zones) import package::lib::grid::cell_of;
@if(zones) import package::lib::light::light_potential;
@if(zones) import package::lib::math::oct_decode16;
@if(zones) import package::lib::rng::uniform_from_bits;
@if(zones) import package::lib::constants::ZONE_LIGHTS;
import package::lib::constants::{DIMENSION_LIGHT_SAMPLING, INVALID_POINT};

// Slots of a point.
override chosen: u32;
// The last slot is an audit.
@if(zones) override zones_audited: bool;

struct SampleLightsParameters {
    tile: Tile,
    // The grid of zones, where there are any.
    zones: GridShape,
}

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read_write> sampled_lights: array<vec2u>;
// Of each zone ZONE_LIGHTS words, four to a record; see `zones`.
@if(zones && texture_loads) @group(0) @binding(2) var zone_lists: texture_storage_2d<rgba32uint, read>;
@if(zones && !texture_loads) @group(0) @binding(2) var<storage, read> zone_lists: array<vec4u>;

var<immediate> sample_lights_pass: SampleLightsParameters;

const SAMPLE_LIGHTS_GROUP = 64u;
@if(zones) const LIST_RECORDS = ZONE_LIGHTS / 4u;
// Of which an audit takes one: more bring less than they cost.
@if(zones) const CANDIDATES = 8u;

// Of each invocation what its probabilities are in proportion to.
@if(zones) var<workgroup> weights: array<f32, SAMPLE_LIGHTS_GROUP * ZONE_LIGHTS>;

@if(zones)
fn load_list(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(zone_lists, table_texel(i)); }
    @else { return zone_lists[i]; }
}

fn put(turn: u32, i: u32, light: u32, weight: f32) {
    sampled_lights[turn * sample_lights_pass.tile.point_count + i] = vec2u(light, bitcast<u32>(weight));
}

@compute @workgroup_size(64)
fn sample_lights(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let tile = sample_lights_pass.tile;
    let i = group_index(group, groups) * SAMPLE_LIGHTS_GROUP + lane;
    if i >= tile.point_count { return; }
    let point = points[i];
    var turn = 0u;
    if point.normal != INVALID_POINT {
        let seed = hash2(pixel_seed(tile, i), DIMENSION_LIGHT_SAMPLING);
        let u = sobol2(tile_sample(tile, i), seed);
        @if(zones) {
            let list = zone_list(point.position);
            turn = sample_list(i, lane, list, point, u.x, chosen - u32(zones_audited));
            if zones_audited {
                audit_zone(i, turn, list, point, u.y, hash2(seed, tile_sample(tile, i)));
                turn++;
            }
        }
        @else { turn = sample_all(i, u.x); }
    }
    for (; turn < chosen; turn++) { put(turn, i, NO_LIGHT, 0.0); }
}

// A comb over all lights; the teeth that meet one light are one slot. How many slots there are.
@if(!zones)
fn sample_all(i: u32, u: f32) -> u32 {
    var turn = 0u;
    var last = NO_LIGHT;
    var weight = 0.0;
    for (var tooth = 0u; tooth < chosen; tooth++) {
        let choice = sample_light((f32(tooth) + u) / f32(chosen));
        if choice.light != last {
            last = choice.light;
            weight = 0.0;
            turn++;
        }
        weight += 1.0 / (f32(chosen) * choice.probability);
        put(turn - 1u, i, last, weight);
    }
    return turn;
}

// First record of the list of the zone that a point is in.
@if(zones)
fn zone_list(position: vec3f) -> u32 {
    let size = sample_lights_pass.zones.size;
    let zone = cell_of(sample_lights_pass.zones, position);
    return ((zone.z * size.y + zone.y) * size.x + zone.x) * LIST_RECORDS;
}

// How many lights of the list are chosen, `most` at most.
@if(zones)
fn sample_list(i: u32, lane: u32, list: u32, point: Point, u: f32, most: u32) -> u32 {
    let normal = oct_decode16(point.normal);
    var total = 0.0;
    for (var entry = 0u; entry < ZONE_LIGHTS; entry++) {
        let word = load_list(list + (entry >> 2u))[entry & 3u];
        if word == 0u {
            weights[entry * SAMPLE_LIGHTS_GROUP + lane] = 0.0;
            continue;
        }
        let weight = f32(word >> 16u) * light_potential(word & 0xffffu, point.position, normal);
        weights[entry * SAMPLE_LIGHTS_GROUP + lane] = weight;
        total += weight;
    }
    if total <= 0.0 { return 0u; }
    // The factor that makes weights into probabilities: those that come to 1 leave more to the others. They are found
    // round by round; what the last round leaves over is chosen a little less often than it could be.
    var factor = f32(most) / total;
    for (var round_ = 0u; round_ < 3u; round_++) {
        var rest = 0.0;
        var left = f32(most);
        for (var entry = 0u; entry < ZONE_LIGHTS; entry++) {
            let weight = weights[entry * SAMPLE_LIGHTS_GROUP + lane];
            let certain = factor * weight >= 1.0;
            rest += select(weight, 0.0, certain);
            left -= f32(certain);
        }
        if rest <= 0.0 || left <= 0.0 { break; }
        factor = max(left / rest, factor);
    }
    var turn = 0u;
    var cumulative = 0.0;
    for (var entry = 0u; entry < ZONE_LIGHTS && turn < most; entry++) {
        let probability = min(factor * weights[entry * SAMPLE_LIGHTS_GROUP + lane], 1.0);
        cumulative += probability;
        if cumulative > f32(turn) + u {
            put(turn, i, load_list(list + (entry >> 2u))[entry & 3u] & 0xffffu, 1.0 / probability);
            turn++;
        }
    }
    return turn;
}

// Whether the list has the light: lists are in the order of the lights.
@if(zones)
fn is_listed(list: u32, light: u32) -> bool {
    var first = 0u;
    var end = ZONE_LIGHTS;
    while first < end {
        let middle = (first + end) / 2u;
        let word = load_list(list + (middle >> 2u))[middle & 3u];
        if word != 0u && (word & 0xffffu) < light { first = middle + 1u; } else { end = middle; }
    }
    let word = load_list(list + (min(first, ZONE_LIGHTS - 1u) >> 2u))[first & 3u];
    return first < ZONE_LIGHTS && word != 0u && (word & 0xffffu) == light;
}

@if(zones)
fn audit_zone(i: u32, turn: u32, list: u32, point: Point, u: f32, seed: u32) {
    let normal = oct_decode16(point.normal);
    var taken = NO_LIGHT;
    var taken_potential = 1.0;
    var total = 0.0;
    for (var candidate = 0u; candidate < CANDIDATES; candidate++) {
        let choice = sample_light((f32(candidate) + u) / f32(CANDIDATES));
        let potential = light_potential(choice.light, point.position, normal);
        let weight = select(potential / choice.probability, 0.0, is_listed(list, choice.light));
        total += weight;
        if uniform_from_bits(hash2(seed, candidate)) * total < weight {
            taken = choice.light;
            taken_potential = potential;
        }
    }
    put(turn, i, taken, total / (f32(CANDIDATES) * taken_potential));
}
