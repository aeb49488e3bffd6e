// shade: direct light at the points of a tile, by the class of each candidate (a point and a light of the chunk). In:
// points (normalised space), surfaces, class words, visibilities of the queued candidates. Out: radiance, relative to
// the scene's unit, added to `radiance_direct`. Paper, "Extending the photon map": cases 1 to 3.
//
// The estimator, with U the unshadowed light, f_j / p_j the contributions of the N light points, V_j their
// visibilities, a the photons' visibility (equation 1) rounded to 0 or 1, and c 1 for lit and 0 for shadowed:
//   dark: 0. Lit, shadowed: c U, plus (V - c) f / (p q) where audited with probability q.
//   Boundary, unknown: a U + (1/N) sum (V_j - a) f_j / p_j.
// At boundary and unknown points the photons are a control variate: the sum has little noise where a is right, and its
// expected value is the true light whatever a is.
//
// Where classes decide most points (`few_sampled`), `shade` adds the terms c U and a U of the diffuse part of the BSDF.
// It queues the points for which `shade_sampled` adds the rest: highlights, audits that contradict the class, and light
// points with shadow rays. While classes decide few points, `shade_sampled` adds all terms at once.

import package::kit::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::math::is_finite3;
import package::lib::light::table::{LightSample, max_light_points};
@if(closed_forms) import package::lib::light::table::light_has_closed_form;
@if(closed_forms && (smooth_normals || normal_maps)) import package::lib::light::light_dark;
@if(closed_forms) import package::lib::light::light_unshadowed_irradiance;
import package::lib::sampled_light::{nth_light_sample, audit_light_sample, candidate_light};
@if(light_sampling) import package::lib::sampled_light::candidate_weight;
import package::lib::bsdf::surface::Surface;
import package::lib::bsdf::bsdf_diffuse;
@if(glossy) import package::lib::bsdf::{bsdf_less, bsdf_max_density};
@if(bsdf_rays) import package::lib::bsdf::bsdf_pdf;
@if(closed_forms && glossy) import package::lib::bsdf_rays::one_light_point_suffices;
@if(bsdf_rays) import package::lib::bsdf_rays::takes_bsdf_rays;
@if(bsdf_rays) import package::lib::sampling::mis_weight;
import package::lib::constants::{
    CLASS_DARK, CLASS_LIT, COUNTER_NOT_FINITE_SHADE, COUNTER_SAMPLED, INVALID_POINT, QUEUE_COUNT, QUEUE_SAMPLED
};
import package::lib::visible_point::{load_point, load_surface, visible_surface};
@if(specular_chains) import package::lib::visible_point::visible_chain;
import package::lib::class_word::{class_of, class_visibility, is_decided, traces_shadow_rays};
@if(aov_shadow) import package::lib::class_word::{class_illumination, class_shadow};
@if(audit) import package::lib::class_word::{AuditProbabilities, audit_probability, is_audited};

struct ShadeParameters {
    tile: Tile,
    // The chunk's lights, or sampled light indices.
    first_light: u32,
    lights_in_chunk: u32,
    // Light points of a candidate, and words of 32 visibilities that hold them.
    light_samples: u32,
    visibility_words: u32,
    // Members of AuditProbabilities: in a uniform buffer, a struct would have to begin at a multiple of 16 bytes.
    audit_away: f32,
    audit_near: f32,
    // `shade_sampled` adds all terms to all points.
    at_once: u32,
}

@group(0) @binding(2) var<storage, read> classes: array<u32>;
@group(0) @binding(3) var<storage, read> visibility: array<u32>;
@group(0) @binding(4) var<storage, read_write> radiance_direct: array<vec4f>;
// Class (of the render's first sample, else 0), visibility, n_i and n_s of each candidate, for the AOV.
@if(aov_shadow) @group(0) @binding(5) var<storage, read_write> shadow_samples: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;
// The points whose lights are sampled, and the lengths of the tile's queues.
@if(few_sampled) @group(0) @binding(7) var<storage, read_write> sampled_points: array<u32>;
@if(few_sampled) @group(0) @binding(8) var<storage, read_write> queue_lengths: array<atomic<u32>, QUEUE_COUNT>;

var<immediate> parameters: ShadeParameters;

// The state of a point that all its lights share.
struct ShadingPoint {
    position: vec3f,
    surface: Surface,
    seed: u32,
    sample_index: u32,
    // The shading normal is the geometric one, so that the horizon of the closed form is the surface's own.
    @if(closed_forms && (smooth_normals || normal_maps)) flat: bool,
    // Upper bound of the density of directions sampled from the BSDF; 0 where the BSDF is diffuse alone.
    @if(glossy) max_density: f32,
    // The diffuse part of the BSDF.
    diffuse: vec3f,
}

// The diffuse and the remaining part of a light point's contribution over its pdf.
struct Contribution {
    diffuse: vec3f,
    @if(glossy) residual: vec3f,
}

fn contribution(shading: ShadingPoint, sampled: LightSample, light: u32, with_residual: bool) -> Contribution {
    if sampled.pdf <= 0.0 || dot(shading.surface.geometric_normal, sampled.direction) <= 0.0 {
        @if(glossy) { return Contribution(vec3f(0.0), vec3f(0.0)); }
        @if(!glossy) { return Contribution(vec3f(0.0)); }
    }
    let incident = sampled.radiance / sampled.pdf;
    let cosine = max(dot(shading.surface.shading_normal, sampled.direction), 0.0);
    let diffuse = shading.diffuse * cosine * incident;
    @if(glossy) {
        if !with_residual { return Contribution(diffuse, vec3f(0.0)); }
        var residual = bsdf_less(shading.surface, sampled.direction, shading.diffuse) * incident;
        // The first ray of the path from here may meet the light too: pass `path` has the other weight.
        @if(bsdf_rays) {
            if !sampled.delta && takes_bsdf_rays(shading.max_density, shading.position, light) {
                let pdf = bsdf_pdf(shading.surface, sampled.direction);
                residual *= mis_weight(f32(parameters.light_samples) * sampled.pdf, pdf);
            }
        }
        return Contribution(diffuse, residual);
    }
    @if(!glossy) { return Contribution(diffuse); }
}

// The terms of the estimator that an entry point adds.
struct Terms {
    // c U and a U of the diffuse part of the BSDF, by the closed form or by light points without shadow rays.
    from_class: bool,
    // The terms for which `shade_sampled` samples light points: highlights, audits, light points with shadow rays.
    sampled: bool,
}

struct Estimate {
    radiance: vec3f,
    visibility: f32,
    // Whether any of the sampled terms may differ from 0.
    has_sampled: bool,
}

// The terms of the estimator that are known before any light point is sampled.
struct KnownTerms {
    // The visibility without shadow rays: by class, or the photons' own, rounded.
    visibility: f32,
    // Shadow rays find the visibility.
    traced: bool,
    // The light has a closed form at the point.
    closed: bool,
    // The light points of the diffuse part are among the sampled terms: because they have shadow rays, or because
    // all lights have a closed form nearly everywhere, so that few points need them.
    deferred: bool,
}

fn known_terms(shading: ShadingPoint, light: u32, word: u32) -> KnownTerms {
    let class_ = class_of(word);
    var visibility = class_visibility(word);
    if is_decided(class_) { visibility = f32(class_ == CLASS_LIT); }
    let traced = traces_shadow_rays(word);
    // Nearly all boundary points are wholly lit or wholly dark: if the rounded visibility is the true one, no noise
    // remains. A visibility in between would leave noise at all of them: near a wall of a dark room, the noise of the
    // light behind the wall.
    if traced { visibility = round(visibility); }
    var closed = false;
    @if(closed_forms) {
        // Without visible light a closed form has no contribution.
        if visibility > 0.0 { closed = light_has_closed_form(light); }
        // If the light crosses the horizon of the geometric normal but not that of the shading normal, only light
        // points are correct.
        @if(smooth_normals || normal_maps) {
            if closed && !shading.flat {
                closed = light_dark(light, shading.position, -shading.surface.geometric_normal);
            }
        }
    }
    var deferred = traced;
    @if(!sampled_forms) { deferred = deferred || !closed; }
    return KnownTerms(visibility, traced, closed, deferred);
}

fn visibility_bit(candidate: u32, j: u32) -> u32 {
    return (visibility[candidate * parameters.visibility_words + (j >> 5u)] >> (j & 31u)) & 1u;
}

// The light points' part of the estimate, and the visible share of them if shadow rays are traced.
struct LightPoints {
    radiance: vec3f,
    visible: f32,
}

// Shadow rays lead to all light points. Without them, one is enough for highlights of small lights. (For the diffuse
// part of light without a closed form it is not: in the marble sphere's scene, relMSE was 3.7 times as large.)
fn light_point_count(shading: ShadingPoint, light: u32, known: KnownTerms) -> u32 {
    let all = max_light_points(light, parameters.light_samples);
    @if(closed_forms && glossy) {
        let one = known.closed && !known.traced
            && one_light_point_suffices(shading.max_density, shading.position, light);
        return select(all, 1u, one);
    }
    @else { return all; }
}

fn sum_light_points(
    shading: ShadingPoint,
    light: u32,
    candidate: u32,
    known: KnownTerms,
    terms: Terms,
) -> LightPoints {
    let count = light_point_count(shading, light, known);
    // The visibility with which the closed form has already added the diffuse light.
    let added = select(0.0, known.visibility, known.closed);
    let adds_diffuse = select(terms.from_class, terms.sampled, known.deferred);
    var sum = vec3f(0.0);
    // Light points that are visible, and those that could be: facing the surface, and above its horizon.
    var visible = 0u;
    var facing = 0u;
    for (var j = 0u; j < count; j++) {
        let sampled = nth_light_sample(light, shading.position, shading.seed, shading.sample_index, j, count);
        let f = contribution(shading, sampled, light, terms.sampled);
        var v = known.visibility;
        if terms.sampled && known.traced {
            let bit = visibility_bit(candidate, j);
            let faces = u32(sampled.pdf > 0.0 && dot(shading.surface.geometric_normal, sampled.direction) > 0.0);
            visible += bit * faces;
            facing += faces;
            v = f32(bit);
        }
        sum += select(0.0, v - added, adds_diffuse) * f.diffuse;
        @if(glossy) { sum += v * f.residual; }
    }
    // A device may divide a number by itself and not get 1.
    let all = visible == facing && facing > 0u;
    let share = select(f32(visible) / f32(max(facing, 1u)), 1.0, all);
    return LightPoints(sum / f32(count), share);
}

// Direct light of one light at one point.
fn direct_light(shading: ShadingPoint, light: u32, candidate: u32, word: u32, terms: Terms) -> Estimate {
    if class_of(word) == CLASS_DARK { return Estimate(vec3f(0.0), 0.0, false); }
    let known = known_terms(shading, light, word);
    var radiance = vec3f(0.0);
    @if(closed_forms) {
        if terms.from_class && known.closed && known.visibility > 0.0 {
            radiance = known.visibility * shading.diffuse
                * light_unshadowed_irradiance(light, shading.position, shading.surface.shading_normal);
        }
    }
    let lit = known.visibility > 0.0;
    var has_sampled = known.traced || (known.deferred && lit);
    @if(glossy) { has_sampled = has_sampled || (lit && shading.max_density > 0.0); }
    var by_points = terms.sampled && has_sampled;
    @if(sampled_forms) { by_points = by_points || (terms.from_class && lit && !known.deferred && !known.closed); }
    var estimate = select(known.visibility, 0.0, known.traced);
    if by_points {
        let found = sum_light_points(shading, light, candidate, known, terms);
        radiance += found.radiance;
        estimate = select(known.visibility, found.visible, known.traced);
    }
    @if(audit) {
        let probabilities = AuditProbabilities(parameters.audit_away, parameters.audit_near);
        let probability = audit_probability(word, probabilities);
        let audited = is_decided(class_of(word)) && is_audited(shading.seed, shading.sample_index, light, probability);
        var error = 0.0;
        if audited { error = f32(visibility_bit(candidate, 0u)) - known.visibility; }
        // Nearly all audits agree with the class, and add nothing.
        has_sampled = has_sampled || error != 0.0;
        if terms.sampled && error != 0.0 {
            radiance += (error / probability) * audited_contribution(shading, light);
            estimate += error / probability;
        }
    }
    return Estimate(radiance, estimate, has_sampled);
}

// The contribution of the light point that an audit traces.
@if(audit)
fn audited_contribution(shading: ShadingPoint, light: u32) -> vec3f {
    let sampled = audit_light_sample(light, shading.position, shading.seed, shading.sample_index);
    let f = contribution(shading, sampled, light, true);
    var all = f.diffuse;
    @if(glossy) { all += f.residual; }
    return all;
}

// Adds terms of the chunk's lights to a point. Returns whether any of its sampled terms may differ from 0.
fn shade_point(i: u32, terms: Terms) -> bool {
    let point_count = parameters.tile.point_count;
    let point = load_point(i);
    if point.normal == INVALID_POINT {
        @if(aov_shadow) {
            for (var l = 0u; l < parameters.lights_in_chunk; l++) {
                shadow_samples[l * point_count + i] = vec4f(0.0);
            }
        }
        return false;
    }
    var shading: ShadingPoint;
    let stored = load_surface(i);
    shading.position = point.position;
    shading.surface = visible_surface(stored, point);
    shading.seed = pixel_seed(parameters.tile, i);
    shading.sample_index = tile_sample(parameters.tile, i);
    @if(closed_forms && (smooth_normals || normal_maps)) {
        shading.flat = bitcast<u32>(stored.packed.base.w) == point.normal;
    }
    shading.diffuse = bsdf_diffuse(shading.surface);
    @if(glossy) { shading.max_density = bsdf_max_density(shading.surface); }
    var sum = vec3f(0.0);
    var has_sampled = false;
    for (var l = 0u; l < parameters.lights_in_chunk; l++) {
        let candidate = l * point_count + i;
        let light = candidate_light(candidate, parameters.first_light, point_count);
        let word = classes[candidate];
        let estimate = direct_light(shading, light, candidate, word, terms);
        has_sampled = has_sampled || estimate.has_sampled;
        @if(light_sampling) {
            sum += estimate.radiance * candidate_weight(candidate, parameters.first_light, point_count);
        }
        @else { sum += estimate.radiance; }
        @if(aov_shadow) {
            let class_ = select(0u, class_of(word), shading.sample_index == 0u);
            shadow_samples[candidate] = vec4f(vec4u(class_, 0u, class_illumination(word), class_shadow(word)));
            shadow_samples[candidate].y = estimate.visibility;
        }
    }
    @if(specular_chains) { sum *= visible_chain(stored, point).throughput; }
    let so_far = radiance_direct[i];
    let radiance = so_far.xyz + sum;
    // Once, however many chunks of lights and entry points add to it.
    if is_finite3(so_far.xyz) && !is_finite3(radiance) { atomicAdd(&counters[COUNTER_NOT_FINITE_SHADE], 1u); }
    radiance_direct[i] = vec4f(radiance, so_far.w);
    return has_sampled;
}

@compute @workgroup_size(64)
fn shade(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= parameters.tile.point_count { return; }
    @if(!few_sampled) { _ = shade_point(i, Terms(true, true)); }
    @if(few_sampled) let has_sampled = shade_point(i, Terms(true, false));
    // One atomic operation for each point. One for a whole workgroup, between barriers, would cost a fifth of the pass
    // on software devices.
    @if(few_sampled) { if has_sampled { sampled_points[atomicAdd(&queue_lengths[QUEUE_SAMPLED], 1u)] = i; } }
}

// The sampled terms at the points that `shade` queued. Few points have any, but software devices would execute them for
// all points. Or all terms at all points.
@if(few_sampled)
@compute @workgroup_size(64)
fn shade_sampled(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let item = group_index(group, groups) * 64u + lane;
    let at_once = parameters.at_once != 0u;
    if item >= select(atomicLoad(&queue_lengths[QUEUE_SAMPLED]), parameters.tile.point_count, at_once) { return; }
    var i = item;
    if !at_once { i = sampled_points[item]; }
    if shade_point(i, Terms(at_once, true)) { atomicAdd(&counters[COUNTER_SAMPLED], 1u); }
}
