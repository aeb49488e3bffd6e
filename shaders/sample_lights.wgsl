// sample_lights: samples, for each point of a tile, a few of many lights. In: points (normalised space), and the zones'
// lists of lights (paper, "Results and discussion"). Out: in `sampled_lights`, for every candidate (sampled light index
// * point_count + point) a light and its weight, the inverse of its probability.
//
// With zones, a point samples the lights in the list of its zone. A light's probability is c v w, at most 1: w is its
// potential at the point, v the square root of the share of illumination photons among its photons in the zone. The
// expected value is the sum over the list, and the lights that contribute most are always sampled. Systematic sampling,
// an equidistant comb over the cumulative probabilities, samples no light twice. The last candidate audits the zones:
// from a few lights that are not in the list it takes one by resampled importance sampling (Talbot et al. 2005). So the
// expected value is the sum over all lights, whatever the lists hold.
//
// Without zones, the comb runs over the cumulative probabilities of all lights: by power, uniform, or by contribution,
// that is by potential at the point. By contribution, with one light and one light point, this is the sampling of
// Shirley, Wang and Zimmerman (1996).

import package::kit::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
@if(!contribution_sampling) import package::lib::light::sample_light;
import package::lib::point::Point;
import package::lib::rng::hash2;
import package::lib::sampling::sobol2;
@if(zones && texture_loads) import package::lib::table::table_texel;
import package::lib::grid::GridShape;
@if(zones) import package::lib::grid::{cell_of, index_in_grid};
@if(zones || contribution_sampling) import package::lib::light::light_potential;
@if(contribution_sampling) import package::lib::light::table::light_count;
@if(zones || contribution_sampling) import package::lib::math::oct_decode16;
@if(zones) import package::lib::rng::uniform_from_bits;
import package::lib::visible_point::load_point;
@if(zones) import package::lib::constants::ZONE_LIGHTS;
import package::lib::constants::{DIMENSION_LIGHT_SAMPLING, INVALID_POINT, NO_SAMPLED_LIGHT};

// Candidates of a point.
override lights_per_point: u32;
// The last candidate is an audit.
@if(zones) override zones_audited: bool;

struct SampleLightsParameters {
    // The grid of zones.
    zones: GridShape,
    tile: Tile,
}

@group(0) @binding(1) var<storage, read_write> sampled_lights: array<vec2u>;
// ZONE_LIGHTS words per zone, four to a texel; see zones.wgsl.
@if(zones && texture_loads) @group(0) @binding(2) var zone_lists: texture_storage_2d<rgba32uint, read>;
@if(zones && !texture_loads) @group(0) @binding(2) var<storage, read> zone_lists: array<vec4u>;

var<immediate> sample_lights_pass: SampleLightsParameters;

// With ZONE_LIGHTS weights for each invocation, a workgroup fills the 16 KiB of memory that WebGPU promises.
const SAMPLE_LIGHTS_GROUP = 64u;
@if(zones) const LIST_TEXELS = ZONE_LIGHTS / 4u;
// Number of lights from which an audit takes one. More would cost more than they reduce noise.
@if(zones) const AUDITED_LIGHTS = 8u;

// For each listed light and invocation: the probability times a common factor.
@if(zones) var<workgroup> weights: array<f32, SAMPLE_LIGHTS_GROUP * ZONE_LIGHTS>;

@if(zones)
fn load_list(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(zone_lists, table_texel(i)); }
    @else { return zone_lists[i]; }
}

fn write_sample(index: u32, i: u32, light: u32, weight: f32) {
    sampled_lights[index * sample_lights_pass.tile.point_count + i] = vec2u(light, bitcast<u32>(weight));
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
    let point = load_point(i);
    var sampled = 0u;
    if point.normal != INVALID_POINT {
        let seed = hash2(pixel_seed(tile, i), DIMENSION_LIGHT_SAMPLING);
        let u = sobol2(tile_sample(tile, i), seed);
        @if(zones) {
            let list = zone_list(point.position);
            sampled = sample_list(i, lane, list, point, u.x);
            if zones_audited {
                audit_zone(i, sampled, list, point, u.y, hash2(seed, tile_sample(tile, i)));
                sampled++;
            }
        }
        @if(contribution_sampling) { sampled = sample_by_contribution(i, point, u.x); }
        @if(!zones && !contribution_sampling) { sampled = sample_all(i, u.x); }
    }
    for (; sampled < lights_per_point; sampled++) { write_sample(sampled, i, NO_SAMPLED_LIGHT, 0.0); }
}

// Samples by a comb over all lights. All teeth that fall on one light make one candidate. Returns the number of
// candidates.
@if(!zones && !contribution_sampling)
fn sample_all(i: u32, u: f32) -> u32 {
    var sampled = 0u;
    var last = NO_SAMPLED_LIGHT;
    var weight = 0.0;
    for (var tooth = 0u; tooth < lights_per_point; tooth++) {
        let found = sample_light((f32(tooth) + u) / f32(lights_per_point));
        if found.light != last {
            last = found.light;
            weight = 0.0;
            sampled++;
        }
        weight += 1.0 / (f32(lights_per_point) * found.probability);
        write_sample(sampled - 1u, i, last, weight);
    }
    return sampled;
}

// A comb over the potentials of all lights at the point. Returns the number of candidates.
@if(contribution_sampling)
fn sample_by_contribution(i: u32, point: Point, u: f32) -> u32 {
    let normal = oct_decode16(point.normal);
    let lights = light_count();
    var total = 0.0;
    for (var light = 0u; light < lights; light++) { total += light_potential(light, point.position, normal); }
    let spacing = total / f32(lights_per_point);
    var sampled = 0u;
    var tooth = 0u;
    var cumulative = 0.0;
    for (var light = 0u; light < lights && tooth < lights_per_point; light++) {
        let potential = light_potential(light, point.position, normal);
        cumulative += potential;
        var met = 0u;
        while tooth < lights_per_point && (f32(tooth) + u) * spacing < cumulative {
            met++;
            tooth++;
        }
        if met > 0u {
            write_sample(sampled, i, light, f32(met) * spacing / potential);
            sampled++;
        }
    }
    return sampled;
}

// First texel of the list of the zone that a point is in.
@if(zones)
fn zone_list(position: vec3f) -> u32 {
    let zones = sample_lights_pass.zones;
    return index_in_grid(zones, cell_of(zones, position)) * LIST_TEXELS;
}

@if(zones)
fn weight_index(entry: u32, lane: u32) -> u32 {
    return entry * SAMPLE_LIGHTS_GROUP + lane;
}

@if(zones)
fn list_word(list: u32, entry: u32) -> u32 {
    return load_list(list + (entry >> 2u))[entry & 3u];
}

// Stores the weights of the listed lights at the point, and returns their sum.
@if(zones)
fn weigh_list(lane: u32, list: u32, point: Point) -> f32 {
    let normal = oct_decode16(point.normal);
    var total = 0.0;
    for (var entry = 0u; entry < ZONE_LIGHTS; entry++) {
        let word = list_word(list, entry);
        if word == 0u {
            weights[weight_index(entry, lane)] = 0.0;
            continue;
        }
        let weight = f32(word >> 16u) * light_potential(word & 0xffffu, point.position, normal);
        weights[weight_index(entry, lane)] = weight;
        total += weight;
    }
    return total;
}

// The factor that scales weights to probabilities of sum `expected`. Lights whose probability is clamped to 1 leave
// more to the others, and each round finds further such lights. What those leave that are clamped after the last round
// is not used: the others are sampled slightly less often than they could be.
@if(zones)
fn probability_factor(lane: u32, total: f32, expected: u32) -> f32 {
    var factor = f32(expected) / total;
    for (var round_ = 0u; round_ < 3u; round_++) {
        var rest = 0.0;
        var left = f32(expected);
        for (var entry = 0u; entry < ZONE_LIGHTS; entry++) {
            let weight = weights[weight_index(entry, lane)];
            let certain = factor * weight >= 1.0;
            rest += select(weight, 0.0, certain);
            left -= f32(certain);
        }
        if rest <= 0.0 || left <= 0.0 { break; }
        factor = max(left / rest, factor);
    }
    return factor;
}

// Samples lights of the list; returns how many.
@if(zones)
fn sample_list(i: u32, lane: u32, list: u32, point: Point, u: f32) -> u32 {
    let max_sampled = lights_per_point - u32(zones_audited);
    let total = weigh_list(lane, list, point);
    if total <= 0.0 { return 0u; }
    let factor = probability_factor(lane, total, max_sampled);
    var sampled = 0u;
    var cumulative = 0.0;
    for (var entry = 0u; entry < ZONE_LIGHTS && sampled < max_sampled; entry++) {
        let probability = min(factor * weights[weight_index(entry, lane)], 1.0);
        cumulative += probability;
        // Rounding may bring the sum to the threshold at a light that has none.
        if probability > 0.0 && cumulative > f32(sampled) + u {
            write_sample(sampled, i, list_word(list, entry) & 0xffffu, 1.0 / probability);
            sampled++;
        }
    }
    return sampled;
}

// Whether the list has the light. Lists are sorted by light.
@if(zones)
fn is_listed(list: u32, light: u32) -> bool {
    var first = 0u;
    var end = ZONE_LIGHTS;
    while first < end {
        let middle = (first + end) / 2u;
        let word = list_word(list, middle);
        if word != 0u && (word & 0xffffu) < light { first = middle + 1u; } else { end = middle; }
    }
    let word = load_list(list + (min(first, ZONE_LIGHTS - 1u) >> 2u))[first & 3u];
    return first < ZONE_LIGHTS && word != 0u && (word & 0xffffu) == light;
}

// Samples one of the lights that are not in the list.
@if(zones)
fn audit_zone(i: u32, index: u32, list: u32, point: Point, u: f32, seed: u32) {
    let normal = oct_decode16(point.normal);
    var sampled = NO_SAMPLED_LIGHT;
    var sampled_potential = 1.0;
    var total = 0.0;
    for (var tooth = 0u; tooth < AUDITED_LIGHTS; tooth++) {
        let found = sample_light((f32(tooth) + u) / f32(AUDITED_LIGHTS));
        let potential = light_potential(found.light, point.position, normal);
        let weight = select(potential / found.probability, 0.0, is_listed(list, found.light));
        total += weight;
        if uniform_from_bits(hash2(seed, tooth)) * total < weight {
            sampled = found.light;
            sampled_potential = potential;
        }
    }
    write_sample(index, i, sampled, total / (f32(AUDITED_LIGHTS) * sampled_potential));
}
