// Lights: sampling, closed-form irradiance, darkness and emission. Tables are made by src/tables/lights.rs.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::ray::{Ray, offset_origin};
import package::lib::math::{PI, basis};
@if(mesh_lights) import package::lib::math::{oct_decode16, safe_sqrt};
@if(mesh_lights) import package::lib::math::angle_of;
import package::lib::sampling::{sample_cap, sample_cosine, sample_disc};
@if(mesh_lights) import package::lib::sampling::{SeenTriangle, sample_seen_triangle, sample_triangle, seen_triangle};
import package::lib::constants::{
    LIGHT_MESH, LIGHT_POINT, LIGHT_SPOT, LIGHT_DIRECTIONAL, LIGHT_KIND_MASK, LIGHT_TWO_SIDED, LIGHT_CLOSED_FORM,
    LIGHT_COVERAGE, LIGHT_NO_AXIS, LIGHT_HEADER, LIGHT_RECORDS, EMITTER_RECORDS,
};
@if(many_emitters) import package::lib::constants::{FEW_EMITTERS, FEW_NEAR_EMITTERS, NEAR_LIGHT_SQUARED};
@if(emitter_pairs) import package::lib::constants::{LIGHT_VIEWED, VIEW_SIDE};
@if(emitter_pairs) import package::lib::math::oct_wrap;
@if(environment) import package::lib::constants::LIGHT_ENVIRONMENT;
@if(environment) import package::lib::environment::environment_sample;
@if(emissive_textures) import package::lib::surface::emission_at;
@if(mesh_lights && alpha_test) import package::lib::alpha::alpha_coverage;

@if(texture_loads) @group(1) @binding(7) var light_records: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(7) var<storage, read> light_records: array<vec4u>;
@if(mesh_lights && texture_loads) @group(1) @binding(8) var emitter_records: texture_storage_2d<rgba32uint, read>;
@if(mesh_lights && !texture_loads) @group(1) @binding(8) var<storage, read> emitter_records: array<vec4u>;
@if(mesh_lights && texture_loads) @group(1) @binding(9) var light_vertices: texture_storage_2d<rgba32float, read>;
@if(mesh_lights && !texture_loads) @group(1) @binding(9) var<storage, read> light_vertices: array<vec4f>;

fn load_light_record(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(light_records, table_texel(i)); }
    @else { return light_records[i]; }
}

@if(mesh_lights)
fn load_emitter_record(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(emitter_records, table_texel(i)); }
    @else { return emitter_records[i]; }
}

@if(mesh_lights)
fn load_light_vertex(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(light_vertices, table_texel(i)); }
    @else { return light_vertices[i]; }
}

// The triangle of an emitted ray that starts on none.
const NO_EMITTER = 0xffffffffu;

// Distance to a light without a place.
const FAR_DISTANCE = 3e38;

fn light_count() -> u32 {
    return load_light_record(0u).x;
}

// Record `record` of a light.
fn light_record(light: u32, record: u32) -> vec4u {
    return load_light_record(LIGHT_HEADER + light * LIGHT_RECORDS + record);
}

fn light_record_f32(light: u32, record: u32) -> vec4f {
    return bitcast<vec4f>(light_record(light, record));
}

fn light_has_closed_form(light: u32) -> bool {
    return (light_record(light, 0u).x & LIGHT_CLOSED_FORM) != 0u;
}

@if(environment)
fn is_environment(light: u32) -> bool {
    return (light_record(light, 0u).x & LIGHT_KIND_MASK) == LIGHT_ENVIRONMENT;
}

// ---- LightSampler

struct SampledLight {
    light: u32,
    // Of choosing it.
    probability: f32,
    // What is left of the random number, uniform again.
    u: f32,
}

// How likely `sample_light` is to choose the light.
fn light_probability(light: u32) -> f32 {
    @if(uniform_light_sampling) { return 1.0 / f32(light_count()); }
    @else { return light_record_f32(light, 5u).y; }
}

// A light, by power or alike; there must be one.
fn sample_light(u: f32) -> SampledLight {
    @if(uniform_light_sampling) {
        let count = light_count();
        let scaled = u * f32(count);
        let light = min(u32(scaled), count - 1u);
        return SampledLight(light, 1.0 / f32(count), clamp(scaled - f32(light), 0.0, 1.0 - 1.0 / 16777216.0));
    }
    @else { return sample_light_by_power(u); }
}

fn sample_light_by_power(u: f32) -> SampledLight {
    // The first light whose cumulative probability exceeds u.
    var first = 0u;
    var last = light_count() - 1u;
    while first < last {
        let middle = (first + last) / 2u;
        if light_record_f32(middle, 5u).x > u { last = middle; } else { first = middle + 1u; }
    }
    let found = light_record_f32(first, 5u);
    let left = 1.0 - (found.x - u) / found.y;
    return SampledLight(first, found.y, clamp(left, 0.0, 1.0 - 1.0 / 16777216.0));
}

// ---- Punctual lights

// What a punctual light sends to a point: `direction` towards the light, irradiance across it.
@if(point_lights || spot_lights || directional_lights)
struct PunctualLight {
    direction: vec3f,
    distance: f32,
    irradiance: vec3f,
}

// KHR_lights_punctual: the window that brings the light to nothing at its range; infinite range gives 1.
@if(point_lights || spot_lights)
fn range_window(distance: f32, range: f32) -> f32 {
    let relative = distance / range;
    let relative2 = relative * relative;
    return clamp(1.0 - relative2 * relative2, 0.0, 1.0);
}

// How much of its intensity a spot light sends along a direction; `axis` is its record of axis and outer cosine.
@if(spot_lights)
fn spot_falloff(light: u32, axis: vec4f, direction: vec3f) -> f32 {
    // KHR_lights_punctual's reference code, the 0.001 included.
    let scale = 1.0 / max(0.001, light_record_f32(light, 4u).x - axis.w);
    let falloff = clamp((dot(axis.xyz, direction) - axis.w) * scale, 0.0, 1.0);
    return falloff * falloff;
}

// What is left of a ray's flux at that distance from the light.
fn flux_window(light: u32, distance: f32) -> f32 {
    @if(point_lights || spot_lights) {
        let kind = light_record(light, 0u).x & LIGHT_KIND_MASK;
        if kind == LIGHT_POINT || kind == LIGHT_SPOT { return range_window(distance, light_record_f32(light, 1u).w); }
    }
    return 1.0;
}

@if(point_lights || spot_lights || directional_lights)
fn punctual_at(light: u32, kind: u32, position: vec3f) -> PunctualLight {
    let intensity = light_record_f32(light, 2u).xyz;
    @if(directional_lights) {
        if kind == LIGHT_DIRECTIONAL {
            return PunctualLight(-light_record_f32(light, 3u).xyz, FAR_DISTANCE, intensity);
        }
    }
    @if(point_lights || spot_lights) {
        let place = light_record_f32(light, 1u);
        let offset = place.xyz - position;
        let distance2 = dot(offset, offset);
        // At the light itself there is no direction: nothing arrives.
        if distance2 < 1e-30 { return PunctualLight(vec3f(0.0, 0.0, 1.0), 0.0, vec3f(0.0)); }
        let distance = sqrt(distance2);
        let direction = offset / distance;
        var irradiance = intensity * (range_window(distance, place.w) / distance2);
        @if(spot_lights) {
            if kind == LIGHT_SPOT { irradiance *= spot_falloff(light, light_record_f32(light, 3u), -direction); }
        }
        return PunctualLight(direction, distance, irradiance);
    }
    @else { return PunctualLight(vec3f(0.0, 0.0, 1.0), 0.0, vec3f(0.0)); }
}

// ---- Darkness

// The whole light is behind the surface's plane or emits away from the position: nothing arrives, whatever is in
// between. Exact for lights of a closed form; of others some dark ones may be called not dark.
fn light_dark(light: u32, position: vec3f, normal: vec3f) -> bool {
    let header = light_record(light, 0u);
    // Nobody turns away from all that is around.
    @if(environment) { if is_environment(light) { return false; } }
    @if(point_lights || spot_lights || directional_lights) {
        let kind = header.x & LIGHT_KIND_MASK;
        if kind != LIGHT_MESH {
            let arriving = punctual_at(light, kind, position);
            return dot(arriving.direction, normal) <= 0.0 || all(arriving.irradiance <= vec3f(0.0));
        }
    }
    @if(mesh_lights) { return mesh_dark(light, header, position, normal); }
    @else { return true; }
}

@if(mesh_lights)
fn mesh_dark(light: u32, header: vec4u, position: vec3f, normal: vec3f) -> bool {
    let sphere = light_record_f32(light, 1u);
    let height = dot(normal, sphere.xyz - position);
    if height <= -sphere.w { return true; }
    if (header.x & LIGHT_CLOSED_FORM) == 0u { return false; }
    let two_sided = (header.x & LIGHT_TWO_SIDED) != 0u;
    let end = header.w + light_record(light, 3u).x;
    var at = header.w;
    while at < end {
        let plane = load_light_vertex(at);
        let loop_end = at + 1u + u32(plane.w);
        at += 1u;
        let first = load_light_vertex(at).xyz - position;
        let side = dot(plane.xyz, first);
        if select(side < 0.0, side != 0.0, two_sided) {
            if height > sphere.w { return false; }
            while at < loop_end {
                if dot(normal, load_light_vertex(at).xyz - position) > 0.0 { return false; }
                at += 1u;
            }
        }
        at = loop_end;
    }
    return true;
}

// ---- Potential

// Cosines at the surface and at the emitter that count at least, where any light may arrive: the light is wider than its
// middle, and normals are rounded. No light that arrives may be left to a chance of nearly nothing.
const LEAST_COSINE = 0.1;
const LEAST_EMITTED_COSINE = 0.02;
// An emitter's normal is rounded to 16 bits a coordinate.
const BEHIND_EMITTER = -1e-3;

// About the irradiance that the light brings to the surface with nothing in between, in units that all lights share. It is
// positive wherever `light_dark` is false and the light sends anything: what lights are chosen by.
fn light_potential(light: u32, position: vec3f, normal: vec3f) -> f32 {
    let emission = light_record(light, 5u).zw;
    let strength = bitcast<f32>(emission.x);
    let header = light_record(light, 0u);
    @if(environment) { if is_environment(light) { return strength; } }
    @if(point_lights || spot_lights || directional_lights) {
        let kind = header.x & LIGHT_KIND_MASK;
        if kind != LIGHT_MESH {
            let arriving = punctual_at(light, kind, position);
            let cosine = dot(arriving.direction, normal);
            let irradiance = (arriving.irradiance.x + arriving.irradiance.y + arriving.irradiance.z) / 3.0;
            return select(0.0, strength * irradiance * max(cosine, LEAST_COSINE), cosine > 0.0);
        }
    }
    @if(mesh_lights) {
        let sphere = light_record_f32(light, 1u);
        let offset = sphere.xyz - position;
        let radius2 = sphere.w * sphere.w;
        let distance2 = dot(offset, offset);
        let inverse = inverseSqrt(max(distance2, radius2));
        let height = dot(normal, offset) + sphere.w;
        let behind = dot(oct_decode16(emission.y), offset) * inverse;
        var emitted = 1.0;
        if emission.y != LIGHT_NO_AXIS { emitted = select(max(-behind, LEAST_EMITTED_COSINE), 0.0, -behind <= BEHIND_EMITTER); }
        let cosine = clamp(height * inverse, LEAST_COSINE, 1.0);
        return select(0.0, strength * emitted * cosine / (distance2 + radius2), height > 0.0);
    }
    @else { return 0.0; }
}

// ---- Sampling

struct LightSample {
    // Unit vector from the position to the light.
    direction: vec3f,
    distance: f32,
    // Emitted towards the position; of punctual lights the irradiance across the direction.
    radiance: vec3f,
    // By solid angle, 0 where nothing arrives; 1 of punctual lights.
    pdf: f32,
    // Geometric normal of the emitter on the side of the position; 0 of lights without a surface.
    normal: vec3f,
    // There is one direction only: no other way of sampling finds this light.
    delta: bool,
}

fn no_light_sample() -> LightSample {
    return LightSample(vec3f(0.0, 0.0, 1.0), 0.0, vec3f(0.0), 0.0, vec3f(0.0), false);
}

// A point of the light as the position sees it, occluders and horizon aside.
fn light_sample(light: u32, position: vec3f, u: vec2f) -> LightSample {
    let header = light_record(light, 0u);
    @if(environment) {
        if is_environment(light) {
            let chosen = environment_sample(u);
            return LightSample(chosen.direction, FAR_DISTANCE, chosen.radiance, chosen.pdf, vec3f(0.0), false);
        }
    }
    @if(point_lights || spot_lights || directional_lights) {
        let kind = header.x & LIGHT_KIND_MASK;
        if kind != LIGHT_MESH {
            let arriving = punctual_at(light, kind, position);
            let pdf = select(0.0, 1.0, any(arriving.irradiance > vec3f(0.0)));
            return LightSample(arriving.direction, arriving.distance, arriving.irradiance, pdf, vec3f(0.0), true);
        }
    }
    @if(mesh_lights) { return mesh_sample(light, header, position, u); }
    @else { return no_light_sample(); }
}

// A point of a mesh light.
@if(mesh_lights)
struct MeshPoint {
    position: vec3f,
    // Unit, on the front.
    normal: vec3f,
    // Emitted radiance.
    radiance: vec3f,
}

// An emitter triangle.
@if(mesh_lights)
struct EmitterTriangle {
    a: vec3f,
    e1: vec3f,
    e2: vec3f,
    // e1 x e2: along the normal, twice the area long.
    across: vec3f,
    // By area, of points chosen by power: as much as its radiance is of the light's.
    density: f32,
    slot: u32,
}

@if(mesh_lights)
fn load_emitter(emitter: u32) -> EmitterTriangle {
    let r0 = load_emitter_record(emitter * EMITTER_RECORDS);
    let r1 = load_emitter_record(emitter * EMITTER_RECORDS + 1u);
    let r2 = load_emitter_record(emitter * EMITTER_RECORDS + 2u);
    let a = bitcast<vec3f>(r0.xyz);
    let e1 = bitcast<vec3f>(r1.xyz) - a;
    let e2 = bitcast<vec3f>(r2.xyz) - a;
    return EmitterTriangle(a, e1, e2, cross(e1, e2), bitcast<f32>(r2.w), r0.w);
}

// How likely an emitter triangle is to be chosen by power.
@if(many_emitters)
fn emitter_power(emitter: u32) -> f32 {
    return bitcast<f32>(load_emitter_record(emitter * EMITTER_RECORDS + 3u).y);
}

// A choice of an emitter triangle, and what is left of the random number, uniform again.
@if(mesh_lights)
struct SampledEmitter {
    emitter: u32,
    probability: f32,
    u: f32,
}

// What is left of u within a share of the probability that ends at `cumulative`.
@if(mesh_lights)
fn left_of(u: f32, cumulative: f32, share: f32) -> f32 {
    return clamp(1.0 - (cumulative - u) / share, 0.0, 1.0 - 1.0 / 16777216.0);
}

@if(mesh_lights)
fn sample_emitter(header: vec4u, u: f32) -> SampledEmitter {
    // The first emitter triangle whose cumulative probability exceeds u.
    var first = header.y;
    var last = header.y + header.z - 1u;
    while first < last {
        let middle = (first + last) / 2u;
        if bitcast<f32>(load_emitter_record(middle * EMITTER_RECORDS + 3u).z) > u { last = middle; } else { first = middle + 1u; }
    }
    let found = bitcast<vec2f>(load_emitter_record(first * EMITTER_RECORDS + 3u).yz);
    return SampledEmitter(first, found.x, left_of(u, found.y, found.x));
}

// The point of an emitter triangle at barycentric coordinates.
@if(mesh_lights)
fn mesh_point(light: u32, header: vec4u, triangle: EmitterTriangle, uv: vec2f) -> MeshPoint {
    var radiance: vec3f;
    @if(emissive_textures) { radiance = emission_at(triangle.slot, uv.x, uv.y); }
    @else { radiance = light_record_f32(light, 2u).xyz; }
    @if(alpha_test) {
        // Through what is not there, the light does not shine.
        if (header.x & LIGHT_COVERAGE) != 0u { radiance *= alpha_coverage(triangle.slot, uv.x, uv.y); }
    }
    return MeshPoint(triangle.a + uv.x * triangle.e1 + uv.y * triangle.e2, normalize(triangle.across), radiance);
}

@if(mesh_lights)
fn emitter_faces(triangle: EmitterTriangle, position: vec3f) -> bool {
    return dot(triangle.across, position - triangle.a) > 0.0;
}

// Whether the position is so near to a light that what its triangles show hangs on the place, and not on the direction alone.
@if(many_emitters)
fn is_near_light(light: u32, position: vec3f) -> bool {
    let sphere = light_record_f32(light, 1u);
    let offset = position - sphere.xyz;
    return dot(offset, offset) < f32(NEAR_LIGHT_SQUARED) * sphere.w * sphere.w;
}

// Of a convex lamp what its triangles show from afar hangs on the direction alone: for each of some directions there are
// cumulative probabilities by power times cosine, so that all points bring about the same light.
@if(emitter_pairs) const NO_VIEW = 0xffffffffu;

// The first record of the probabilities for a position, or NO_VIEW.
@if(emitter_pairs)
fn view_of(light: u32, header: vec4u, position: vec3f) -> u32 {
    if (header.x & LIGHT_VIEWED) == 0u || is_near_light(light, position) { return NO_VIEW; }
    let offset = position - light_record_f32(light, 1u).xyz;
    let place = vec2u((oct_wrap(offset) + 1.0) * (0.5 * f32(VIEW_SIDE)));
    let cell = min(place, vec2u(VIEW_SIDE - 1u));
    return light_record(light, 3u).y + (cell.y * VIEW_SIDE + cell.x) * ((header.z + 3u) / 4u);
}

// Cumulative probability of a view's emitter triangle `i`, those before it included.
@if(emitter_pairs)
fn view_cumulative(view: u32, i: u32) -> f32 {
    return load_light_vertex(view + i / 4u)[i & 3u];
}

// Probability of a view's emitter triangle `i`.
@if(emitter_pairs)
fn view_share(view: u32, i: u32) -> f32 {
    if i == 0u { return view_cumulative(view, 0u); }
    return view_cumulative(view, i) - view_cumulative(view, i - 1u);
}

@if(emitter_pairs)
fn sample_viewed_emitter(header: vec4u, view: u32, u: f32) -> SampledEmitter {
    // The first record with a cumulative probability above u, and that one of it.
    var first = 0u;
    var last = (header.z + 3u) / 4u - 1u;
    while first < last {
        let middle = (first + last) / 2u;
        if load_light_vertex(view + middle).w > u { last = middle; } else { first = middle + 1u; }
    }
    let below = vec3u(load_light_vertex(view + first).xyz <= vec3f(u));
    let i = 4u * first + below.x + below.y + below.z;
    let share = view_share(view, i);
    return SampledEmitter(header.y + i, share, left_of(u, view_cumulative(view, i), share));
}

// The emitter triangles that may be chosen for a position: one, with that probability, or all, by what they send to it.
@if(mesh_lights)
struct EmitterRange {
    first: u32,
    end: u32,
    all: bool,
    probability: f32,
    // What is left of the random number.
    u: f32,
}

@if(mesh_lights)
fn all_emitters(header: vec4u, u: f32) -> EmitterRange {
    return EmitterRange(header.y, header.y + header.z, true, 1.0, u);
}

// Whether all of a light's triangles are asked what they send to a position: those of the usual lamp, a square, always; more
// of them where they are near and differ.
@if(mesh_lights)
fn asks_all(light: u32, header: vec4u, position: vec3f) -> bool {
    @if(many_emitters) {
        return header.z <= FEW_EMITTERS || (header.z <= FEW_NEAR_EMITTERS && is_near_light(light, position));
    }
    @else { return true; }
}

// How likely `emitter_range` is to come to an emitter triangle, where it does not ask all. Of closed lights, from near or
// with few triangles, those that face away are each paired with one that faces about the other way, which is taken in its
// place. So a triangle that faces the position is chosen for itself, and for its partner where that faces away.
@if(many_emitters)
fn emitter_probability(light: u32, header: vec4u, emitter: u32, position: vec3f) -> f32 {
    @if(emitter_pairs) {
        let view = view_of(light, header, position);
        if view != NO_VIEW { return view_share(view, emitter - header.y); }
    }
    return paired_power(emitter, position);
}

@if(many_emitters)
fn paired_power(emitter: u32, position: vec3f) -> f32 {
    var power = emitter_power(emitter);
    @if(emitter_pairs) {
        let partner = load_emitter_record(emitter * EMITTER_RECORDS + 3u).x;
        if partner != emitter && !emitter_faces(load_emitter(partner), position) { power += emitter_power(partner); }
    }
    return power;
}

@if(many_emitters)
fn emitter_range(light: u32, header: vec4u, position: vec3f, u: f32) -> EmitterRange {
    if asks_all(light, header, position) { return all_emitters(header, u); }
    var chosen: SampledEmitter;
    @if(emitter_pairs) {
        let view = view_of(light, header, position);
        if view != NO_VIEW {
            chosen = sample_viewed_emitter(header, view, u);
        } else {
            chosen = sample_emitter(header, u);
            if !emitter_faces(load_emitter(chosen.emitter), position) {
                chosen.emitter = load_emitter_record(chosen.emitter * EMITTER_RECORDS + 3u).x;
            }
            chosen.probability = paired_power(chosen.emitter, position);
        }
    }
    @else { chosen = sample_emitter(header, u); }
    return EmitterRange(chosen.emitter, chosen.emitter + 1u, false, chosen.probability, chosen.u);
}

// What an emitter triangle sends to a position, in units that those of its light share: its solid angle, of all of a light
// times its radiance; 0 where it faces away.
@if(mesh_lights)
fn emitter_sends(header: vec4u, triangle: EmitterTriangle, seen: SeenTriangle, position: vec3f, all: bool) -> f32 {
    let shines = (header.x & LIGHT_TWO_SIDED) != 0u || emitter_faces(triangle, position);
    return select(0.0, 2.0 * seen.half_angle * select(1.0, triangle.density, all), shines);
}

@if(mesh_lights)
fn seen_emitter(triangle: EmitterTriangle, position: vec3f) -> SeenTriangle {
    return seen_triangle(triangle.a - position, triangle.e1, triangle.e2, triangle.across);
}

@if(mesh_lights)
fn mesh_sample(light: u32, header: vec4u, position: vec3f, u: vec2f) -> LightSample {
    @if(many_emitters) let range = emitter_range(light, header, position, u.x);
    @if(!many_emitters) let range = all_emitters(header, u.x);
    var triangle: EmitterTriangle;
    var seen: SeenTriangle;
    var left = range.u;
    var sum = 0.0;
    for (var i = range.first; i < range.end; i++) {
        let next = load_emitter(i);
        let next_seen = seen_emitter(next, position);
        let sends = emitter_sends(header, next, next_seen, position, range.all);
        sum += sends;
        // A reservoir of one (Chao 1982), which keeps what is left of the random number.
        let chance = sends / sum;
        if left < chance {
            triangle = next;
            seen = next_seen;
            left /= chance;
        } else if sum > 0.0 {
            left = (left - chance) / (1.0 - chance);
        }
        left = min(left, 1.0 - 1.0 / 16777216.0);
    }
    let pdf = select(range.probability, triangle.density, range.all) / sum;
    // Nothing faces the position, or it is on the light's plane; or grazing beyond what the numbers hold.
    if sum <= 0.0 || !(pdf < 1e30) { return no_light_sample(); }
    let point = mesh_point(light, header, triangle, sample_seen_triangle(seen, vec2f(left, u.y)));
    let offset = point.position - position;
    let distance2 = dot(offset, offset);
    if distance2 < 1e-30 { return no_light_sample(); }
    let distance = sqrt(distance2);
    let normal = select(-point.normal, point.normal, emitter_faces(triangle, position));
    return LightSample(offset / distance, distance, point.radiance, pdf, normal, false);
}

// The light of an emitter triangle, and the density by solid angle with which its points are chosen; 0 for a triangle that
// is no emitter.
struct Emitter {
    light: u32,
    pdf: f32,
}

// The light that a BVH slot is a part of, and the density by solid angle with which `light_sample` chooses its points for
// a position that it faces; a density of 0 where it is none.
@if(mesh_lights)
fn emitter_of(triangle: u32, position: vec3f) -> Emitter {
    let header = load_light_record(0u);
    // The list of emitters by slot lies behind their records.
    let base = header.y * EMITTER_RECORDS;
    var first = base;
    var end = base + header.y;
    while first < end {
        let middle = (first + end) / 2u;
        if load_emitter_record(middle).x < triangle { first = middle + 1u; } else { end = middle; }
    }
    if first < base + header.y {
        let found = load_emitter_record(first);
        if found.x == triangle { return Emitter(found.y, emitter_pdf(found.y, found.z, position)); }
    }
    return Emitter(0u, 0.0);
}

@if(mesh_lights)
fn emitter_pdf(light: u32, emitter: u32, position: vec3f) -> f32 {
    let header = light_record(light, 0u);
    let all = asks_all(light, header, position);
    var range = all_emitters(header, 0.0);
    @if(many_emitters) {
        if !all { range = EmitterRange(emitter, emitter + 1u, false, emitter_probability(light, header, emitter, position), 0.0); }
    }
    var sum = 0.0;
    for (var i = range.first; i < range.end; i++) {
        let triangle = load_emitter(i);
        sum += emitter_sends(header, triangle, seen_emitter(triangle, position), position, all);
    }
    let probability = select(range.probability, load_emitter(emitter).density, all);
    return select(0.0, min(probability / sum, 1e30), sum > 0.0);
}

// Further than any occluder can be: the scene has unit size.
const BEYOND_SCENE = 4.0;

// The whole way from a surface to a light point, clear of both surfaces, with t from 0 to 1. It leads to the point
// itself and not along the sample's direction: from an origin that was moved, that would miss the point by as much, and
// enter a curved light before its end. Where light and surface are nearer to each other than they are kept clear of, it
// would begin beyond the one or end beyond the other; nothing has room in between, and the ray is empty.
fn shadow_ray(position: vec3f, normal: vec3f, chosen: LightSample) -> Ray {
    let origin = offset_origin(position, normal);
    let end = offset_origin(light_point(position, chosen), chosen.normal);
    let crossed = is_beyond(origin, position, chosen) || dot(end - position, normal) < 0.0;
    return Ray(origin, 0.0, end - origin, select(1.0, 0.0, crossed));
}

fn light_point(position: vec3f, chosen: LightSample) -> vec3f {
    return position + min(chosen.distance, BEYOND_SCENE) * chosen.direction;
}

// Whether an origin of rays from a position is already beyond the light that the sample is on: they do not find it.
fn is_beyond(origin: vec3f, position: vec3f, chosen: LightSample) -> bool {
    return dot(origin - light_point(position, chosen), chosen.normal) < 0.0;
}

// ---- Closed form

// The irradiance of the surface from the light, nothing in between, in closed form; for lights that have one.
fn light_unshadowed_irradiance(light: u32, position: vec3f, normal: vec3f) -> vec3f {
    let header = light_record(light, 0u);
    @if(point_lights || spot_lights || directional_lights) {
        let kind = header.x & LIGHT_KIND_MASK;
        if kind != LIGHT_MESH {
            let arriving = punctual_at(light, kind, position);
            return arriving.irradiance * max(dot(arriving.direction, normal), 0.0);
        }
    }
    @if(mesh_lights) {
        return light_record_f32(light, 2u).xyz * mesh_form_factor(light, header, position, normal);
    }
    @else { return vec3f(0.0); }
}

// Lambert's term of the edge from a to b, both relative to the position: the angle it spans times the component
// along n of the unit normal of the plane of position and edge.
@if(mesh_lights)
fn edge_term(a: vec3f, b: vec3f, n: vec3f) -> f32 {
    // a x (b - a), and not a x b, keeps the digits of edges that are short against their distance.
    let c = cross(a, b - a);
    let sine = length(c);
    // An edge in line with the position spans no angle.
    if sine == 0.0 { return 0.0; }
    return angle_of(sine, dot(a, b)) * (dot(n, c) / sine);
}

// A light farther away than so many radii of its bounding sphere is small: `small_edge_term` loses less there.
const SMALL_LIGHT = 8.0;

// The same for an edge of a small light, over the squared length of `base`, the way to some point of the contour's plane
// from which `offset_a` and `offset_b` lead to the edge's ends.
//
// Terms are as long as the light is wide and add up to its area: of a light a thousandth as wide as it is far, Lambert's
// formula keeps three digits. As n . (a x b) f(a, b), with f the angle over |a x b|, that part adds up by itself, from
// differences of vertices, which have all their digits: f = 1 / base^2 leaves n . (offset_a x offset_b) of a closed
// contour. What remains is f base^2 - 1, small of itself: by the ends' distances, and by the angle over its sine.
@if(mesh_lights)
fn small_edge_term(base: vec3f, offset_a: vec3f, offset_b: vec3f, n: vec3f) -> f32 {
    let inverse = 1.0 / dot(base, base);
    let area = cross(offset_a, offset_b);
    let across = cross(base, offset_b - offset_a) + area;
    // Of the squared distances, relative to base^2: how far they are above 1.
    let farther_a = dot(offset_a, offset_a + 2.0 * base) * inverse;
    let farther_b = dot(offset_b, offset_b + 2.0 * base) * inverse;
    let farther = farther_a + farther_b + farther_a * farther_b;
    let root = sqrt(1.0 + farther);
    let nearer = -farther / (root * (1.0 + root));
    // The series of asin(x) / x - 1: x is at most 1/4, and what is left out 2e-8.
    let sine2 = dot(across, across) * inverse * inverse / (1.0 + farther);
    let bent = sine2 * (1.0 / 6.0 + sine2 * (3.0 / 40.0 + sine2 * (5.0 / 112.0 + sine2 * (35.0 / 1152.0))));
    return dot(n, area + across * (nearer + bent + nearer * bent));
}

@if(mesh_lights)
fn contour_term(small: bool, base: vec3f, a: vec3f, b: vec3f, n: vec3f) -> f32 {
    if small { return small_edge_term(base, a, b, n); }
    return edge_term(a, b, n);
}

// The integral of the cosine over the directions in which the position sees the light, by Lambert's formula over its
// contours clipped at the surface's horizon. Its error is about 1e-6 of itself where the light is in front of the
// position altogether, and 1e-6 times the angle it spans where the horizon cuts through it.
@if(mesh_lights)
fn mesh_form_factor(light: u32, header: vec4u, position: vec3f, normal: vec3f) -> f32 {
    let two_sided = (header.x & LIGHT_TWO_SIDED) != 0u;
    let sphere = light_record_f32(light, 1u);
    let centre = sphere.xyz - position;
    let small = dot(centre, centre) > SMALL_LIGHT * SMALL_LIGHT * sphere.w * sphere.w;
    let end = header.w + light_record(light, 3u).x;
    var at = header.w;
    var sum = 0.0;
    while at < end {
        let plane = load_light_vertex(at);
        let loop_end = at + 1u + u32(plane.w);
        at += 1u;
        let start = load_light_vertex(at).xyz;
        let base = start - position;
        let side = dot(plane.xyz, base);
        if select(side < 0.0, side != 0.0, two_sided) {
            // Sutherland and Hodgman's clipping, each point used as it comes. Contours are closed: the last vertex
            // is the first again. Points are relative to the position, of a small light to the contour's first.
            let origin = select(position, start, small);
            var loop_sum = 0.0;
            var started = false;
            var first: vec3f;
            var last: vec3f;
            var a = start - origin;
            var height_a = dot(normal, base);
            for (at += 1u; at < loop_end; at += 1u) {
                let vertex = load_light_vertex(at).xyz;
                let b = vertex - origin;
                let height_b = dot(normal, vertex - position);
                if height_a > 0.0 {
                    if started { loop_sum += contour_term(small, base, last, a, normal); } else { first = a; started = true; }
                    last = a;
                }
                if (height_a > 0.0) != (height_b > 0.0) {
                    let crossing = a + (b - a) * (height_a / (height_a - height_b));
                    if started { loop_sum += contour_term(small, base, last, crossing, normal); } else { first = crossing; started = true; }
                    last = crossing;
                }
                a = b;
                height_a = height_b;
            }
            if started { loop_sum += contour_term(small, base, last, first, normal); }
            loop_sum = select(loop_sum, loop_sum / dot(base, base), small);
            // Counter-clockwise seen from the front is clockwise seen along the rays that arrive.
            sum += select(loop_sum, -loop_sum, side < 0.0);
        }
        at = loop_end;
    }
    return max(0.5 * sum, 0.0);
}

// ---- Emission

struct EmittedRay {
    origin: vec3f,
    // Unit.
    direction: vec3f,
    // Geometric normal on the side that the ray leaves; the direction of punctual lights.
    normal: vec3f,
    // BVH slot of the emitter triangle, or NO_EMITTER.
    triangle: u32,
    // Power over the density of the ray's choice: the mean over rays is the light's power.
    flux: vec3f,
}

// A ray along a direction through the disc that the scene's bounding sphere is across it, of a light that is far away;
// `irradiance` over the density of the direction's choice.
@if(directional_lights || environment)
fn far_ray(light: u32, direction: vec3f, irradiance: vec3f, u: vec2f) -> EmittedRay {
    let sphere = light_record_f32(light, 4u);
    // Some more, so that no rounding leaves out the rim.
    let reach = sphere.w * 1.001;
    let offset = basis(direction) * vec3f(reach * sample_disc(u), -2.0 * reach);
    return EmittedRay(sphere.xyz + offset, direction, direction, NO_EMITTER, irradiance * (PI * reach * reach));
}

// The directions from a place to all that there is to light: about an axis.
@if(mesh_lights || point_lights || spot_lights || directional_lights)
struct Cap {
    axis: vec3f,
    // Of the angle between the axis and the rim; 1 where the place is among the receivers, or nobody knows them.
    squared_sine: f32,
    // 1 less the cosine of that angle; 2, all directions, there.
    height: f32,
}

@if(mesh_lights || point_lights || spot_lights || directional_lights)
fn receivers_from(place: vec3f) -> Cap {
    let sphere = bitcast<vec4f>(load_light_record(1u));
    let offset = sphere.xyz - place;
    let squared_sine = sphere.w * sphere.w / dot(offset, offset);
    if sphere.w == 0.0 || !(squared_sine < 1.0) { return Cap(vec3f(0.0, 0.0, 1.0), 1.0, 2.0); }
    return Cap(normalize(offset), squared_sine, squared_sine / (1.0 + sqrt(1.0 - squared_sine)));
}

@if(mesh_lights)
struct AimedDirection {
    direction: vec3f,
    // Of the directions about the normal, by the cosine law.
    share: f32,
}

// By the cosine law about the normal, and within the cap where that is over the horizon: such directions are the even points of
// the unit disc under the hemisphere (Nusselt), and the cap's rim is an ellipse there.
@if(mesh_lights)
fn sample_aimed_cosine(normal: vec3f, cap: Cap, u: vec2f) -> AimedDirection {
    let cosine = dot(cap.axis, normal);
    let frame = basis(normal);
    if cosine <= 0.0 || cosine * cosine <= cap.squared_sine { return AimedDirection(frame * sample_cosine(u), 1.0); }
    let along = cap.axis - cosine * normal;
    let sine = length(along);
    var radial = frame[0];
    // Straight above, the ellipse is a circle.
    if sine > 1e-4 { radial = along / sine; }
    let p = sqrt(cap.squared_sine) * sample_disc(u);
    let below = along * (1.0 - cap.height) + radial * (cosine * p.x) + cross(normal, radial) * p.y;
    let up = safe_sqrt(1.0 - dot(below, below));
    return AimedDirection(below + up * normal, cap.squared_sine * cosine);
}

// A ray that leaves the light: from mesh lights by emitted power and cosine, from point lights uniform over the
// sphere, from spot lights over the outer cone, but towards the receivers alone where they are in fewer directions; from
// directional lights over a disc as wide as the scene, from the environment over such a disc across a direction chosen by radiance.
fn light_emit(light: u32, u: vec4f) -> EmittedRay {
    let header = light_record(light, 0u);
    @if(environment) {
        if is_environment(light) {
            let chosen = environment_sample(u.xy);
            return far_ray(light, -chosen.direction, chosen.radiance / chosen.pdf, u.zw);
        }
    }
    @if(point_lights || spot_lights || directional_lights) {
        let kind = header.x & LIGHT_KIND_MASK;
        if kind != LIGHT_MESH {
            let place = light_record_f32(light, 1u);
            let intensity = light_record_f32(light, 2u).xyz;
            let axis = light_record_f32(light, 3u);
            @if(directional_lights) {
                if kind == LIGHT_DIRECTIONAL {
                    return far_ray(light, axis.xyz, intensity, u.xy);
                }
            }
            @if(spot_lights) {
                if kind == LIGHT_SPOT {
                    let aim = receivers_from(place.xyz);
                    let narrower = aim.height < 1.0 - axis.w;
                    let height = select(1.0 - axis.w, aim.height, narrower);
                    let direction = basis(select(axis.xyz, aim.axis, narrower)) * sample_cap(u.xy, height);
                    let flux = intensity * (spot_falloff(light, axis, direction) * 2.0 * PI * height);
                    return EmittedRay(place.xyz, direction, direction, NO_EMITTER, flux);
                }
            }
            let aim = receivers_from(place.xyz);
            let direction = basis(aim.axis) * sample_cap(u.xy, aim.height);
            return EmittedRay(place.xyz, direction, direction, NO_EMITTER, intensity * (2.0 * PI * aim.height));
        }
    }
    @if(mesh_lights) {
        let chosen = sample_emitter(header, u.x);
        let triangle = load_emitter(chosen.emitter);
        let point = mesh_point(light, header, triangle, sample_triangle(vec2f(chosen.u, u.y)));
        var normal = point.normal;
        var v = u.zw;
        var flux = point.radiance * (PI / triangle.density);
        if (header.x & LIGHT_TWO_SIDED) != 0u {
            if v.x < 0.5 { normal = -normal; }
            v.x = fract(2.0 * v.x);
            flux *= 2.0;
        }
        let aimed = sample_aimed_cosine(normal, receivers_from(point.position), v);
        return EmittedRay(point.position, aimed.direction, normal, triangle.slot, flux * aimed.share);
    }
    @else { return EmittedRay(vec3f(0.0), vec3f(0.0, 0.0, 1.0), vec3f(0.0, 0.0, 1.0), NO_EMITTER, vec3f(0.0)); }
}
