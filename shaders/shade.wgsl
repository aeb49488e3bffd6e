// shade: direct light at the points of a tile, by the class that the photons gave each point and light.
// In: points, surfaces, class words, visibilities of the queued slots. Out: added to `radiance_direct`.
// The estimator (DESIGN: direct light, auditing) with U the unshadowed answer, f_j / p_j the contributions of the N
// light points, V_j their visibilities, a the photons' visibility (equation 1 of the paper), rounded, and c 1 or 0 by class:
//   dark: 0. Lit, shadowed: c U, plus (V - c) f / (p q) where audited with probability q.
//   Boundary, unknown: a U + (1/N) sum (V_j - a) f_j / p_j.
// Where U has a closed form and most points are decided (`few_sampled`), `shade` adds c U and a U, and queues the points that
// `shade_sampled` adds the rest to.

import package::lib::dispatch::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::math::is_finite3;
import package::lib::light::table::{LightSample, light_has_closed_form};
import package::lib::light::{light_dark, light_unshadowed_irradiance};
import package::lib::sampled_light::{nth_light_sample, audit_light_sample, slot_light};
@if(light_sampling) import package::lib::sampled_light::slot_weight;
import package::lib::bsdf::surface::Surface;
import package::lib::bsdf::bsdf_diffuse;
@if(glossy) import package::lib::bsdf::bsdf_residual;
@if(indirect && glossy && (mesh_lights || environment)) import package::lib::bsdf::bsdf_pdf;
@if(indirect && glossy && (mesh_lights || environment)) import package::lib::sampling::mis_weight;
import package::lib::constants::{INVALID_POINT, COUNTER_NOT_FINITE_SHADE};
import package::lib::point::SURFACE_VECTORS;
import package::lib::seen::{points, seen_surface, surfaces};
@if(chains) import package::lib::seen::seen_chain;
import package::lib::photon::{CLASS_DARK, CLASS_LIT, CLASS_SHADOWED, asks_shadow_rays, class_of, class_visibility};
@if(aov_shadow) import package::lib::photon::{class_illumination, class_shadow};
@if(audit) import package::lib::photon::{audit_chance, is_audited};

struct ShadeParameters {
    tile: Tile,
    // Lights of the chunk, or turns where lights are chosen.
    first_light: u32,
    lights_in_chunk: u32,
    light_samples: u32,
    visibility_words: u32,
    audit_probability: f32,
    padding: u32,
}

@group(0) @binding(2) var<storage, read> classes: array<u32>;
@group(0) @binding(3) var<storage, read> visibility: array<u32>;
@group(0) @binding(4) var<storage, read_write> radiance_direct: array<vec4f>;
// Of each slot, for the AOV: class (of the render's first sample, else 0), visibility, n_i, n_s.
@if(aov_shadow) @group(0) @binding(5) var<storage, read_write> shadow_samples: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;
// The points that light points are for, and the lengths of the tile's queues.
@if(few_sampled) @group(0) @binding(7) var<storage, read_write> sampled_points: array<u32>;
@if(few_sampled) @group(0) @binding(8) var<storage, read_write> queue_lengths: array<atomic<u32>, 4>;

var<immediate> parameters: ShadeParameters;

// Queue::Sampled of src/passes/classify.rs.
const SAMPLED_QUEUE = 3u;
@if(few_sampled) var<workgroup> group_sampled: atomic<u32>;
@if(few_sampled) var<workgroup> group_base: u32;

// Everything that does not change over the lights of a point.
struct Place {
    position: vec3f,
    surface: Surface,
    seed: u32,
    sample_index: u32,
    // The shading normal is the geometric one, so that the horizon of the closed form is the surface's own.
    flat: bool,
}

// The diffuse and the remaining part of a light point's contribution over its pdf.
struct Contribution {
    diffuse: vec3f,
    @if(glossy) residual: vec3f,
}

fn contribution(place: Place, chosen: LightSample, light: u32) -> Contribution {
    if chosen.pdf <= 0.0 || dot(place.surface.geometric_normal, chosen.direction) <= 0.0 {
        @if(glossy) { return Contribution(vec3f(0.0), vec3f(0.0)); }
        @if(!glossy) { return Contribution(vec3f(0.0)); }
    }
    let incident = chosen.radiance / chosen.pdf;
    let diffuse = bsdf_diffuse(place.surface) * max(dot(place.surface.shading_normal, chosen.direction), 0.0) * incident;
    @if(glossy) {
        var residual = bsdf_residual(place.surface, chosen.direction) * incident;
        // The first ray of the path from here may meet the light too: pass `path` has the other weight.
        @if(indirect && (mesh_lights || environment)) {
            if !chosen.delta {
                residual *= mis_weight(f32(parameters.light_samples) * chosen.pdf, bsdf_pdf(place.surface, chosen.direction));
            }
        }
        return Contribution(diffuse, residual);
    }
    @if(!glossy) { return Contribution(diffuse); }
}

struct Estimate {
    radiance: vec3f,
    visibility: f32,
    // Light points have a part in it.
    sampled: bool,
}

// Direct light of one light at one place: what the closed form says of it, what light points do, or both.
fn direct_light(place: Place, light: u32, slot: u32, word: u32, by_form: bool, by_points: bool) -> Estimate {
    let class_ = class_of(word);
    if class_ == CLASS_DARK { return Estimate(vec3f(0.0), 0.0, false); }
    let decided = class_ == CLASS_LIT || class_ == CLASS_SHADOWED;
    // The visibility that is taken for granted: the class, or the photons' guess.
    var granted = class_visibility(word);
    if decided { granted = f32(class_ == CLASS_LIT); }
    let traced = asks_shadow_rays(word);
    // Rays tell the rest: most boundary points are wholly lit or wholly dark, and where the guess is that, nothing is left
    // to noise. A guess in between would leave some at all of them: near a wall of a dark room, the noise of the light
    // behind it.
    if traced { granted = round(granted); }

    // Where the light crosses the surface's own horizon but not the shading normal's, only light points can tell.
    let closed = light_has_closed_form(light)
        && (place.flat || light_dark(light, place.position, -place.surface.geometric_normal));
    var radiance = vec3f(0.0);
    if by_form && closed && granted > 0.0 {
        radiance = granted * bsdf_diffuse(place.surface)
            * light_unshadowed_irradiance(light, place.position, place.surface.shading_normal);
    }
    // Light points that are seen, and those that could be: facing the surface, and above its horizon.
    var seen = 0u;
    var facing = 0u;
    @if(glossy) let sampled = traced || granted > 0.0;
    @if(!glossy) let sampled = traced || (granted > 0.0 && !closed);
    if by_points && sampled {
        let count = parameters.light_samples;
        var sum = vec3f(0.0);
        for (var j = 0u; j < count; j++) {
            let chosen = nth_light_sample(light, place.position, place.seed, place.sample_index, j, count);
            let f = contribution(place, chosen, light);
            var v = granted;
            if traced {
                let bit = (visibility[slot * parameters.visibility_words + (j >> 5u)] >> (j & 31u)) & 1u;
                let faces = u32(chosen.pdf > 0.0 && dot(place.surface.geometric_normal, chosen.direction) > 0.0);
                seen += bit * faces;
                facing += faces;
                v = f32(bit);
            }
            sum += select(v, v - granted, closed) * f.diffuse;
            @if(glossy) { sum += v * f.residual; }
        }
        radiance += sum / f32(count);
    }
    var estimate = select(granted, f32(seen) / f32(max(facing, 1u)), traced);
    var audited = false;
    @if(audit) {
        let chance = audit_chance(word, parameters.audit_probability);
        audited = decided && is_audited(place.seed, place.sample_index, light, chance);
        if by_points && audited {
            let error = f32(visibility[slot * parameters.visibility_words] & 1u) - granted;
            if error != 0.0 {
                let chosen = audit_light_sample(light, place.position, place.seed, place.sample_index);
                let f = contribution(place, chosen, light);
                var all = f.diffuse;
                @if(glossy) { all += f.residual; }
                radiance += (error / chance) * all;
                estimate += error / chance;
            }
        }
    }
    return Estimate(radiance, estimate, sampled || audited);
}

// Adds the light of the chunk's lights to a point, or the part of it that one of the two says; whether light points have a part.
fn shade_point(i: u32, by_form: bool, by_points: bool) -> bool {
    if points[i].normal == INVALID_POINT {
        @if(aov_shadow) {
            for (var l = 0u; l < parameters.lights_in_chunk; l++) {
                shadow_samples[l * parameters.tile.point_count + i] = vec4f(0.0);
            }
        }
        return false;
    }
    var place: Place;
    place.position = points[i].position;
    place.surface = seen_surface(i);
    place.seed = pixel_seed(parameters.tile, i);
    place.sample_index = tile_sample(parameters.tile, i);
    place.flat = bitcast<u32>(surfaces[i * SURFACE_VECTORS].w) == points[i].normal;
    var sum = vec3f(0.0);
    var sampled = false;
    for (var l = 0u; l < parameters.lights_in_chunk; l++) {
        let slot = l * parameters.tile.point_count + i;
        let light = slot_light(slot, parameters.first_light, parameters.tile.point_count);
        let estimate = direct_light(place, light, slot, classes[slot], by_form, by_points);
        sampled = sampled || estimate.sampled;
        @if(light_sampling) { sum += estimate.radiance * slot_weight(slot, parameters.first_light, parameters.tile.point_count); }
        @else { sum += estimate.radiance; }
        @if(aov_shadow) {
            let word = classes[slot];
            let class_ = select(0u, class_of(word), place.sample_index == 0u);
            shadow_samples[slot] = vec4f(vec4u(class_, 0u, class_illumination(word), class_shadow(word)));
            shadow_samples[slot].y = estimate.visibility;
        }
    }
    @if(chains) { sum *= seen_chain(i).throughput; }
    let so_far = radiance_direct[i];
    let radiance = so_far.xyz + sum;
    // Once, however many chunks of lights and entry points add to it.
    if is_finite3(so_far.xyz) && !is_finite3(radiance) { atomicAdd(&counters[COUNTER_NOT_FINITE_SHADE], 1u); }
    radiance_direct[i] = vec4f(radiance, so_far.w);
    return sampled;
}

@compute @workgroup_size(64)
fn shade(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    @if(!few_sampled) {
        if i < parameters.tile.point_count { _ = shade_point(i, true, true); }
    }
    @if(few_sampled) {
        if lane == 0u { atomicStore(&group_sampled, 0u); }
        workgroupBarrier();
        var sampled = false;
        var rank = 0u;
        if i < parameters.tile.point_count { sampled = shade_point(i, true, false); }
        if sampled { rank = atomicAdd(&group_sampled, 1u); }
        workgroupBarrier();
        if lane == 0u { group_base = atomicAdd(&queue_lengths[SAMPLED_QUEUE], atomicLoad(&group_sampled)); }
        workgroupBarrier();
        if sampled { sampled_points[group_base + rank] = i; }
    }
}

// What light points say, at the points that `shade` has queued: most have none, and software devices would choose them all the same.
@if(few_sampled)
@compute @workgroup_size(64)
fn shade_sampled(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i < atomicLoad(&queue_lengths[SAMPLED_QUEUE]) { _ = shade_point(sampled_points[i], false, true); }
}
