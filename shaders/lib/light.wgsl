// Lights: sampling, closed-form irradiance, darkness and emission. This file dispatches by kind of light; each kind has
// a file in lib/light/.

import package::lib::constants::{
    INVALID_POINT, LIGHT_DIRECTIONAL, LIGHT_EMISSION_TEXEL, LIGHT_KIND_MASK, LIGHT_KIND_TEXEL, LIGHT_MESH, LIGHT_POINT,
    LIGHT_POSITION_TEXEL, LIGHT_SAMPLING_TEXEL, LIGHT_SPOT,
};
@if(mesh_lights) import package::lib::light::contour::mesh_form_factor;
@if(directional_lights) import package::lib::light::directional::{directional_at, directional_emit};
@if(environment) import package::lib::light::environment::{environment_emit, environment_light_sample, is_environment};
@if(mesh_lights) import package::lib::light::mesh::{
    mesh_dark, mesh_emit, mesh_max_solid_angle, mesh_potential, mesh_sample,
};
@if(point_lights || spot_lights || directional_lights) import package::lib::light::point::PunctualLight;
@if(point_lights || spot_lights) import package::lib::light::point::{point_at, range_window};
@if(point_lights) import package::lib::light::point::point_emit;
@if(spot_lights) import package::lib::light::spot::{spot_emit, spot_falloff};
import package::lib::light::table::{
    EmittedRay, LightSample, MIN_COSINE, NO_EMITTER, light_count, light_kind, light_texel, light_texel_f32,
    no_light_sample,
};
@if(environment) import package::lib::math::PI;
import package::lib::math::oct_decode16;
import package::lib::point::Point;
import package::lib::ray::{Ray, offset_origin};
import package::lib::rng::BELOW_ONE;

// ---- Light sampler

struct SampledLight {
    light: u32,
    // The probability with which it is sampled.
    probability: f32,
    // The remainder of the random number, which is uniform again.
    u: f32,
}

// The probability with which `sample_light` samples the light.
fn light_probability(light: u32) -> f32 {
    @if(uniform_light_sampling) { return 1.0 / f32(light_count()); }
    @else { return light_texel_f32(light, LIGHT_SAMPLING_TEXEL).y; }
}

// Samples a light by power or uniformly. The scene must have a light.
fn sample_light(u: f32) -> SampledLight {
    @if(uniform_light_sampling) {
        let count = light_count();
        let scaled = u * f32(count);
        let light = min(u32(scaled), count - 1u);
        return SampledLight(light, 1.0 / f32(count), clamp(scaled - f32(light), 0.0, BELOW_ONE));
    }
    @else { return sample_light_by_power(u); }
}

fn sample_light_by_power(u: f32) -> SampledLight {
    // The first light whose cumulative probability exceeds u.
    var first = 0u;
    var last = light_count() - 1u;
    while first < last {
        let middle = (first + last) / 2u;
        if light_texel_f32(middle, LIGHT_SAMPLING_TEXEL).x > u { last = middle; } else { first = middle + 1u; }
    }
    let found = light_texel_f32(first, LIGHT_SAMPLING_TEXEL);
    let left = 1.0 - (found.x - u) / found.y;
    return SampledLight(first, found.y, clamp(left, 0.0, BELOW_ONE));
}

// ---- Punctual lights

// The fraction of a ray's flux that remains at a distance from the light.
fn flux_window(light: u32, distance: f32) -> f32 {
    @if(point_lights || spot_lights) {
        let kind = light_kind(light);
        if kind == LIGHT_POINT || kind == LIGHT_SPOT {
            return range_window(distance, light_texel_f32(light, LIGHT_POSITION_TEXEL).w);
        }
    }
    return 1.0;
}

@if(point_lights || spot_lights || directional_lights)
fn punctual_at(light: u32, kind: u32, position: vec3f) -> PunctualLight {
    @if(directional_lights) { if kind == LIGHT_DIRECTIONAL { return directional_at(light); } }
    @if(point_lights || spot_lights) {
        var arriving = point_at(light, position);
        @if(spot_lights) { if kind == LIGHT_SPOT { arriving.irradiance *= spot_falloff(light, -arriving.direction); } }
        return arriving;
    }
    @else { return PunctualLight(vec3f(0.0, 0.0, 1.0), 0.0, vec3f(0.0)); }
}

// ---- Darkness

// Whether the whole light is behind the surface's plane or emits away from the position, so that no light can arrive.
// Exact for lights with a closed form; for others it may be false although the light is dark.
fn light_dark(light: u32, position: vec3f, normal: vec3f) -> bool {
    let header = light_texel(light, LIGHT_KIND_TEXEL);
    // No surface faces away from the whole environment.
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

// Whether no light can arrive at a shading point, as `light_dark` finds, or there is no surface.
fn is_dark(light: u32, point: Point) -> bool {
    if point.normal == INVALID_POINT { return true; }
    @if(dark_points) { return light_dark(light, point.position, oct_decode16(point.normal)); }
    @else { return false; }
}

// ---- Potential

// Approximate unoccluded irradiance of the surface from the light, in the same units for all lights. It is the weight
// for sampling lights, so it is positive wherever `light_dark` is false and the light emits.
fn light_potential(light: u32, position: vec3f, normal: vec3f) -> f32 {
    let strength = bitcast<f32>(light_texel(light, LIGHT_SAMPLING_TEXEL).z);
    @if(environment) { if is_environment(light) { return strength; } }
    @if(point_lights || spot_lights || directional_lights) {
        let kind = light_kind(light);
        if kind != LIGHT_MESH {
            let arriving = punctual_at(light, kind, position);
            let cosine = dot(arriving.direction, normal);
            let irradiance = (arriving.irradiance.x + arriving.irradiance.y + arriving.irradiance.z) / 3.0;
            return select(0.0, strength * irradiance * max(cosine, MIN_COSINE), cosine > 0.0);
        }
    }
    @if(mesh_lights) { return mesh_potential(light, position, normal); }
    @else { return 0.0; }
}

// ---- Solid angle

// Upper bound of the solid angle within which rays from a position hit the light: 0 for lights that no ray hits.
fn light_max_solid_angle(light: u32, position: vec3f) -> f32 {
    @if(environment) { if is_environment(light) { return 4.0 * PI; } }
    @if(mesh_lights) { if light_kind(light) == LIGHT_MESH { return mesh_max_solid_angle(light, position); } }
    return 0.0;
}

// ---- Sampling

// Samples a point of the light for a position, without regard to occluders and horizon.
fn light_sample(light: u32, position: vec3f, u: vec2f) -> LightSample {
    let header = light_texel(light, LIGHT_KIND_TEXEL);
    @if(environment) { if is_environment(light) { return environment_light_sample(u); } }
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

// A distance beyond every occluder: the scene has unit size.
const BEYOND_SCENE = 4.0;

// The shadow ray from a surface to a light point, with t from 0 to 1; both ends are offset from their surfaces. It
// leads to the light point itself, not along the sample's direction: from the offset origin, that direction would miss
// the point by as much, and could hit a curved light before the ray ends. Where light and surface are closer than these
// offsets, the ray would begin beyond the light or end below the surface. No occluder fits in between, and the ray is
// empty. Lights without a size may lie in a surface, as lamps in a ceiling do: the ray ends where their photons begin.
fn shadow_ray(position: vec3f, normal: vec3f, sampled: LightSample) -> Ray {
    let origin = offset_origin(position, normal);
    let side = select(sampled.normal, -sampled.direction, sampled.delta);
    let end = offset_origin(light_point(position, sampled), side);
    let crossed = is_beyond(origin, position, sampled) || dot(end - position, normal) < 0.0;
    return Ray(origin, 0.0, end - origin, select(1.0, 0.0, crossed));
}

fn light_point(position: vec3f, sampled: LightSample) -> vec3f {
    return position + min(sampled.distance, BEYOND_SCENE) * sampled.direction;
}

// Whether the offset origin of a position's rays lies beyond the sampled light, so that the rays cannot hit it.
fn is_beyond(origin: vec3f, position: vec3f, sampled: LightSample) -> bool {
    return dot(origin - light_point(position, sampled), sampled.normal) < 0.0;
}

// ---- Closed form

// Unoccluded irradiance of the surface from the light in closed form, for lights that have one.
fn light_unshadowed_irradiance(light: u32, position: vec3f, normal: vec3f) -> vec3f {
    let header = light_texel(light, LIGHT_KIND_TEXEL);
    @if(point_lights || spot_lights || directional_lights) {
        let kind = header.x & LIGHT_KIND_MASK;
        if kind != LIGHT_MESH {
            let arriving = punctual_at(light, kind, position);
            return arriving.irradiance * max(dot(arriving.direction, normal), 0.0);
        }
    }
    @if(mesh_lights) {
        return light_texel_f32(light, LIGHT_EMISSION_TEXEL).xyz * mesh_form_factor(light, header, position, normal);
    }
    @else { return vec3f(0.0); }
}

// ---- Emission

// Samples a ray that leaves the light. The file of each kind states the density.
fn light_emit(light: u32, u: vec4f) -> EmittedRay {
    @if(environment) { if is_environment(light) { return environment_emit(light, u); } }
    @if(point_lights || spot_lights || directional_lights) {
        let kind = light_kind(light);
        if kind != LIGHT_MESH {
            @if(directional_lights) { if kind == LIGHT_DIRECTIONAL { return directional_emit(light, u.xy); } }
            @if(spot_lights) { if kind == LIGHT_SPOT { return spot_emit(light, u.xy); } }
            @if(point_lights) { return point_emit(light, u.xy); }
        }
    }
    @if(mesh_lights) { return mesh_emit(light, u); }
    @else { return EmittedRay(vec3f(0.0), vec3f(0.0, 0.0, 1.0), vec3f(0.0, 0.0, 1.0), NO_EMITTER, vec3f(0.0)); }
}
