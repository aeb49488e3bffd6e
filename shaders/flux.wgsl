// flux: traces the photons that carry flux, for the global map and the caustic map (paper, "Extending the photon map";
// Jensen 1996). Each ray leaves a light with its share of the light's power. The ray stores a photon at every surface
// that it hits and that may be diffuse; then the BSDF scatters it, or Russian roulette ends it. With the feature
// `negative_photons`, a ray from a light stores no photon at its first hit, but shadow photons at all hits behind it.
// If `caustics_only` is 1, a ray stores a photon only after one bounce or more, all of them at focusing surfaces.
// In: the scene, and in `flux_rays` the rays of each light.
// Out: `flux_photons`, appended in any order, and `flux_counts`. Positions are in scene units after normalisation, flux
// in units of 1 / `inverse_unit` (lib/photon has its encoding).

import package::lib::bsdf::{bsdf_evaluate, bsdf_pdf, bsdf_sample, leaving_normal};
import package::lib::bsdf::diffuse::diffuse_density;
import package::lib::bsdf::surface::seen_from;
@if(transmission) import package::lib::bsdf::surface::{passes_light, seen_through};
@if(caustics) import package::lib::bsdf::focuses;
@if(caustics && alpha_test) import package::lib::alpha::alpha_coverage;
@if(caustics && alpha_test) import package::lib::bvh::has_alpha_test;
import package::lib::bvh::traversal_overrun;
import package::lib::packet::{in_any_lane, no_ray, trace_closest_together};
import package::kit::group_index;
import package::lib::light::{flux_window, light_emit};
@if(emissive_volumes) import package::lib::light::mesh::{begins_in_volume, transmittance_behind};
@if(emissive_volumes) import package::lib::light::table::NO_EMITTER;
import package::lib::math::{basis, is_finite3, oct_encode7, safe_sqrt};
import package::lib::photon::{Photon, flux_word};
import package::lib::ray::{Hit, NO_HIT, Ray, RaySample, UNBOUNDED, offset_origin};
@if(caustics && alpha_test && procedurals) import package::lib::procedural::is_procedural;
import package::lib::rng::{hash2, hash3, uniform_from_bits};
import package::lib::sampling::{sample_cosine, sobol2, sobol4};
import package::lib::surface::{SurfaceHit, stores_photons, surface_at};
@if(dispersion) import package::lib::wavelength::{begin_wavelengths, carry};
@if(negative_photons) import package::lib::surface::ray_behind;
import package::lib::constants::{DIMENSION_FLUX, MAX_FLUX};
@if(negative_photons) import package::lib::constants::PHOTON_SHADOW;
@if(caustic_irradiance) import package::lib::constants::PHOTON_CAUSTIC;
import package::lib::constants::{FLUX_CLIPPED, FLUX_COUNTS, FLUX_NOT_FINITE, FLUX_OVERRUNS, FLUX_STORED, FLUX_TRACED};

struct FluxParameters {
    first_ray: u32,
    ray_count: u32,
    light_count: u32,
    seed: u32,
    // Maximum number of bounces before a photon is stored.
    max_bounces: u32,
    // Number of photons in `flux_photons` from earlier dispatches. Photons that no longer fit are counted, not stored.
    stored: u32,
    // 1 over the unit of flux.
    inverse_unit: f32,
    // 1 for photons of the caustic map, else 0.
    caustics_only: u32,
}

var<immediate> flux_pass: FluxParameters;

@group(0) @binding(0) var<storage, read_write> flux_photons: array<Photon>;
// From index FLUX_STORED on: photons stored; rays whose traversal exceeded the loop budget; rays traced; photons whose
// flux was clipped to what their word holds; photons not stored because their flux is not finite.
@group(0) @binding(1) var<storage, read_write> flux_counts: array<atomic<u32>, FLUX_COUNTS>;
// The index of each light's first ray, and the total number of rays at the end.
@group(0) @binding(2) var<storage, read> flux_rays: array<u32>;

// Stores a photon at a position on a surface. `xi` rounds the flux at random, `kind` is that of `flux_word`.
fn store(position: vec3f, normal: vec3f, flux: vec3f, xi: f32, kind: u32) {
    if !is_finite3(flux) {
        atomicAdd(&flux_counts[FLUX_NOT_FINITE], 1u);
        return;
    }
    let largest = vec3f(f32(MAX_FLUX));
    if any(flux > largest) { atomicAdd(&flux_counts[FLUX_CLIPPED], 1u); }
    let at = flux_pass.stored + atomicAdd(&flux_counts[FLUX_STORED], 1u);
    if at >= arrayLength(&flux_photons) { return; }
    flux_photons[at] = Photon(position, flux_word(oct_encode7(normal), min(flux, largest), xi, kind));
}

// The first hit of a light's ray, and how the ray left the light.
@if(negative_photons)
struct LightHit {
    light: u32,
    ray: Ray,
    hit: Hit,
    found: SurfaceHit,
    emitted: FluxRay,
}

// Continues a light's ray straight on behind its first hit, if there is one, and stores shadow photons. Returns the
// number of rays traced.
@if(negative_photons)
fn store_shadows(first: LightHit, is_active: bool, xi: f32, seed: u32, lane: u32) -> u32 {
    var found = first.found;
    var distance = first.hit.t;
    var goes_on = is_active;
    var rays = 0u;
    loop {
        var on = no_ray();
        if goes_on {
            on = ray_behind(found, first.ray.direction, UNBOUNDED);
            rays++;
        }
        let hit = trace_closest_together(on, RaySample(seed, 0u), lane);
        goes_on &= hit.triangle != NO_HIT && !traversal_overrun;
        if goes_on {
            found = surface_at(hit, on);
            distance += hit.t;
            if stores_photons(hit) {
                let flux = flux_from_light(first.emitted, first.light, distance);
                store(found.triangle_position, found.triangle_normal, flux, xi, PHOTON_SHADOW);
            }
        }
        if !in_any_lane(goes_on, lane) { break; }
    }
    return rays;
}

// The share of rays that the surface at a hit stops. A blended surface stores photons of this share of its light alone.
// For the global map, the probes of a disc measure the share. For the caustic map there are no probes, so the flux of
// its photons is divided by the share.
@if(caustics && alpha_test)
fn stopped_share(hit: Hit) -> f32 {
    @if(procedurals) { if is_procedural(hit.triangle) { return 1.0; } }
    if !has_alpha_test(hit) { return 1.0; }
    return alpha_coverage(hit.triangle, hit.u, hit.v);
}

// The light that emits a ray: the last light whose first ray does not come after it.
fn light_of_ray(ray: u32) -> u32 {
    var light = 0u;
    var end = flux_pass.light_count;
    while light + 1u < end {
        let middle = (light + end) / 2u;
        if flux_rays[middle] <= ray { light = middle; } else { end = middle; }
    }
    return light;
}

// A ray that leaves a light or a surface. The normal is on the ray's side.
struct FluxRay {
    position: vec3f,
    normal: vec3f,
    direction: vec3f,
    flux: vec3f,
    // Only focusing surfaces have scattered the ray since it left the light.
    @if(caustics) focused: bool,
    // The emitter triangle if the ray began in the volume behind it, or NO_EMITTER.
    @if(emissive_volumes) volume_of: u32,
}

// Ray number `number` of a light, with its share of the light's power.
fn emitted_ray(light: u32, number: u32, seed: u32) -> FluxRay {
    let emitted = light_emit(light, sobol4(number, seed));
    let ray_count = flux_rays[light + 1u] - flux_rays[light];
    var ray: FluxRay;
    ray.position = emitted.origin;
    ray.normal = emitted.normal;
    ray.direction = emitted.direction;
    ray.flux = emitted.flux * (flux_pass.inverse_unit / f32(ray_count));
    @if(caustics) { ray.focused = true; }
    @if(emissive_volumes) { ray.volume_of = select(NO_EMITTER, emitted.triangle, begins_in_volume(emitted)); }
    return ray;
}

// The flux of an emitted ray of `light` at a distance from the light. Lamps count as outside of the volumes of other
// objects, so only a volume of their own absorbs their light.
fn flux_from_light(emitted: FluxRay, light: u32, distance: f32) -> vec3f {
    var flux = emitted.flux * flux_window(light, distance);
    @if(emissive_volumes) {
        if emitted.volume_of != NO_EMITTER { flux *= transmittance_behind(emitted.volume_of, distance); }
    }
    return flux;
}

// The flux of a ray of `light` where it arrives, at `distance` from its origin. `bounce` counts the surfaces that have
// scattered it.
fn arriving_flux(leaving: FluxRay, light: u32, found: SurfaceHit, distance: f32, bounce: u32) -> vec3f {
    if bounce == 0u { return flux_from_light(leaving, light, distance); }
    @if(transmission) { return leaving.flux * found.transmittance; }
    @else { return leaving.flux; }
}

// Photons lie on triangles, but surfaces reflect by their shading normals, which face the viewer. So that photons carry
// the same light as paths do, a photon reflects by the BSDF that a path from its new direction finds, and its flux has
// the cosines to the triangle (Veach 1997, section 5.3).

// Maximum weight of a photon that arrives or is scattered. A surface bent by 20 degrees loses less than 0.2 % of a
// diffuse light by it.
const MAX_WEIGHT = 100.0;

// A direction above the triangle, with a density in proportion to its cosine.
fn above_triangle(found: SurfaceHit, u: vec2f) -> vec3f {
    return basis(found.triangle_normal) * sample_cosine(u);
}

// Irradiance of the surface with its shading normal over that of the triangle, for light along the ray that found it
// and a viewer in a random direction. Photons are looked up from all directions.
fn arriving_ratio(found: SurfaceHit, u: vec2f) -> f32 {
    let light = found.surface.view;
    let seen = seen_from(found.surface, above_triangle(found, u));
    return clamp(dot(light, seen.shading_normal) / dot(light, found.triangle_normal), 0.0, MAX_WEIGHT);
}

// A direction, and the flux that leaves in it over that which arrived and over the density of the direction.
struct Scattered {
    direction: vec3f,
    // 0 where the path ends.
    weight: vec3f,
}

fn scattered_by(found: SurfaceHit, u: vec3f) -> Scattered {
    let s = found.surface;
    @if(!(smooth_normals || normal_maps || coat_normals)) {
        let sampled = bsdf_sample(s, u);
        if sampled.pdf <= 0.0 { return Scattered(); }
        @if(transmission) { return Scattered(sampled.direction, sampled.weight / sampled.concentration); }
        @else { return Scattered(sampled.direction, sampled.weight); }
    }
    @else {
        let light_cosine = dot(s.view, found.triangle_normal);
        // Viewers behind the shading normal see it bent towards them, but `bsdf_sample` samples no directions there. So
        // this share of the samples is from all directions above the triangle. It is the sine of half the angle between
        // the two normals. Of these directions, a share of its square is behind the shading normal, so no weight is
        // large. Where the surface transmits light, half of these samples are from below the triangle.
        let share = safe_sqrt(0.5 - 0.5 * dot(s.shading_normal, found.triangle_normal));
        var sides = 1.0;
        @if(transmission) { sides = select(1.0, 2.0, passes_light(s)); }
        var direction: vec3f;
        var pdf: f32;
        if u.z < share {
            direction = above_triangle(found, u.xy);
            @if(transmission) { if u.z * sides >= share { direction = -direction; } }
            pdf = bsdf_pdf(s, direction);
        } else {
            let sampled = bsdf_sample(s, vec3f(u.xy, (u.z - share) / (1.0 - share)));
            if sampled.pdf <= 0.0 { return Scattered(); }
            direction = sampled.direction;
            pdf = sampled.pdf;
        }
        let height = dot(direction, found.triangle_normal);
        if height == 0.0 || (sides == 1.0 && height < 0.0) { return Scattered(); }
        let density = mix(pdf, diffuse_density(abs(height)) / sides, share);
        var seen = seen_from(s, direction);
        @if(transmission) { if height < 0.0 { seen = seen_through(s, direction); } }
        let value = bsdf_evaluate(seen, s.view);
        return Scattered(direction, min(value * (abs(height) / (light_cosine * density)), vec3f(MAX_WEIGHT)));
    }
}

// Scatters the ray by the BSDF. Returns false if the BSDF or Russian roulette ends it. `u` samples the direction, `xi`
// decides roulette.
fn scatter(ray: ptr<function, FluxRay>, found: SurfaceHit, u: vec3f, xi: f32) -> bool {
    let scattered = scattered_by(found, u);
    let flux = (*ray).flux;
    let reflected = flux * scattered.weight;
    // A surviving photon carries as much flux as the one that arrived, in the strongest channel.
    let survival = max(reflected.x, max(reflected.y, reflected.z)) / max(flux.x, max(flux.y, flux.z));
    if !(xi < survival) { return false; }
    (*ray).position = found.position;
    (*ray).normal = leaving_normal(found.surface, scattered.direction);
    (*ray).direction = scattered.direction;
    (*ray).flux = reflected / min(survival, 1.0);
    return true;
}

// Stores the photon of a ray that arrived at a surface. `u` samples the viewer that looks it up.
fn store_arriving(ray: FluxRay, hit: Hit, found: SurfaceHit, u: vec2f, xi: f32, kind: u32) {
    var flux = ray.flux;
    // With negative photons, direct light is that of the triangle.
    @if((smooth_normals || normal_maps) && !negative_photons) { flux *= arriving_ratio(found, u); }
    @if(caustics && alpha_test) { if flux_pass.caustics_only == 1u { flux /= stopped_share(hit); } }
    store(found.triangle_position, found.triangle_normal, flux, xi, kind);
}

// Stores a photon where a ray arrived at a surface, and scatters the ray there. Returns whether the ray goes on.
// `xi` has a random number to round the flux and one for Russian roulette.
fn store_and_scatter(
    ray: ptr<function, FluxRay>,
    hit: Hit,
    found: SurfaceHit,
    bounce: u32,
    u: vec2f,
    xi: vec2f,
    bounce_seed: u32,
) -> bool {
    var stores = stores_photons(hit);
    @if(negative_photons) { stores &= bounce > 0u; }
    var goes_on = bounce < flux_pass.max_bounces;
    var kind = 0u;
    @if(caustics) {
        @if(caustic_irradiance) { if (*ray).focused && bounce > 0u { kind = PHOTON_CAUSTIC; } }
        (*ray).focused &= focuses(found.surface);
        if flux_pass.caustics_only == 1u {
            stores &= bounce > 0u;
            goes_on &= (*ray).focused;
        }
    }
    if stores { store_arriving(*ray, hit, found, u, xi.x, kind); }
    let lobe = uniform_from_bits(hash2(bounce_seed, 4u));
    if goes_on { goes_on = scatter(ray, found, vec3f(u, lobe), xi.y); }
    return goes_on;
}

@compute @workgroup_size(64)
fn flux(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    // Lanes whose ray has ended trace no ray together with the others.
    let is_active = i < flux_pass.ray_count;
    let ray = flux_pass.first_ray + min(i, flux_pass.ray_count - 1u);
    let light = light_of_ray(ray);
    let number = ray - flux_rays[light];
    let seed = hash3(flux_pass.seed, DIMENSION_FLUX, light);
    var leaving = emitted_ray(light, number, seed);
    var goes_on = is_active;
    var rays = 0u;
    @if(dispersion) { begin_wavelengths(seed, number, vec3f(1.0)); }
    for (var bounce = 0u; ; bounce++) {
        var here = no_ray();
        if goes_on {
            here = Ray(offset_origin(leaving.position, leaving.normal), 0.0, leaving.direction, UNBOUNDED);
            rays++;
        }
        let bounce_seed = hash3(seed, ray, bounce);
        let hit = trace_closest_together(here, RaySample(bounce_seed, 0u), lane);
        goes_on &= hit.triangle != NO_HIT && !traversal_overrun;
        let xi = vec2f(uniform_from_bits(hash2(bounce_seed, 1u)), uniform_from_bits(hash2(bounce_seed, 2u)));
        var found: SurfaceHit;
        @if(negative_photons) let emitted = leaving;
        if goes_on {
            @if(dispersion) { carry(leaving.flux); }
            found = surface_at(hit, here);
            leaving.flux = arriving_flux(leaving, light, found, hit.t, bounce);
        }
        @if(negative_photons) {
            // Direct light counts as unshadowed at the first hit and at all hits behind it; shadow photons subtract the
            // excess.
            if bounce == 0u {
                let met = LightHit(light, here, hit, found, emitted);
                rays += store_shadows(met, goes_on, xi.x, bounce_seed, lane);
            }
        }
        goes_on &= !found.unlit;
        if goes_on {
            // One Sobol sequence over all rays stratifies their bounces together, as it stratifies their emission.
            let u = sobol2(ray, hash3(seed, bounce, 3u));
            goes_on = store_and_scatter(&leaving, hit, found, bounce, u, xi, bounce_seed);
        }
        if !in_any_lane(goes_on, lane) { break; }
    }
    if !is_active { return; }
    atomicAdd(&flux_counts[FLUX_TRACED], rays);
    if traversal_overrun { atomicAdd(&flux_counts[FLUX_OVERRUNS], 1u); }
}
