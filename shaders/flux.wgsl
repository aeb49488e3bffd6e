// flux: photons that carry flux, the global map. Each ray leaves a light with its share of the light's power, is
// stored at every diffuse surface that it meets, and goes on by Russian roulette on the BSDF, sampled by it (section 2
// of the paper; Jensen 1996). With the feature `negative_photons` the light's own rays leave shadow photons behind their
// first hit in place of a photon there. Out: photons, in any order, appended to `flux_photons`.
// With `caustic_photons` 1 they are the caustic map's: those that have met focusing surfaces alone, and at least one.

import package::lib::bsdf::{bsdf_sample, leaving_normal};
@if(caustics) import package::lib::bsdf::focuses;
import package::lib::bvh::{trace_closest, traversal_overrun, traversal_turns};
import package::lib::dispatch::group_index;
import package::lib::light::{flux_window, light_emit};
import package::lib::math::{is_finite3, oct_encode7};
import package::lib::photon::{MAX_FLUX, Photon, flux_word};
import package::lib::ray::{NO_HIT, Ray, offset_origin};
@if(negative_photons) import package::lib::ray::Hit;
import package::lib::rng::{hash2, hash3, uniform_from_bits};
import package::lib::sampling::{sobol2, sobol4};
import package::lib::surface::surface_at;
@if(negative_photons) import package::lib::surface::{SurfaceHit, ray_behind};
import package::lib::constants::DIMENSION_FLUX;

struct FluxParameters {
    first_ray: u32,
    ray_count: u32,
    light_count: u32,
    seed: u32,
    // Most bounces before a photon is stored.
    max_bounces: u32,
    // Photons that were stored by the rays before; more than `flux_photons` holds are counted and not stored.
    stored: u32,
    // 1 over the unit of flux.
    inverse_unit: f32,
    padding: u32,
}

var<immediate> flux_pass: FluxParameters;

@group(0) @binding(0) var<storage, read_write> flux_photons: array<Photon>;
// Photons stored, traversals that gave up, rays traced, photons that carry more than their word holds, photons that are lost
// as what they carry is no number.
@group(0) @binding(1) var<storage, read_write> flux_counts: array<atomic<u32>, 5>;
// The first ray of each light; behind the last one's the end.
@group(0) @binding(2) var<storage, read> flux_rays: array<u32>;

@if(caustics) override caustic_photons: u32;

const FAR_AWAY = 1e30;

fn store(position: vec3f, normal: vec3f, flux: vec3f, lot: f32, shadow: bool) {
    if !is_finite3(flux) {
        atomicAdd(&flux_counts[4], 1u);
        return;
    }
    if any(flux > vec3f(MAX_FLUX)) { atomicAdd(&flux_counts[3], 1u); }
    let at = flux_pass.stored + atomicAdd(&flux_counts[0], 1u);
    if at >= arrayLength(&flux_photons) { return; }
    flux_photons[at] = Photon(position, flux_word(oct_encode7(normal), min(flux, vec3f(MAX_FLUX)), lot, shadow));
}

// Goes straight on through the scene and leaves shadow photons; the number of rays that it took.
@if(negative_photons)
fn store_shadows(light: u32, first: Ray, first_hit: Hit, first_found: SurfaceHit, flux: vec3f, lot: f32, seed: u32) -> u32 {
    var found = first_found;
    var distance = first_hit.t;
    // What the light's range takes is told by the whole way.
    let emitted = flux / max(flux_window(light, distance), 1e-20);
    for (var rays = 0u; ; rays++) {
        let on = ray_behind(found, first.direction, FAR_AWAY);
        let hit = trace_closest(on, seed);
        if hit.triangle == NO_HIT || traversal_overrun { return rays + 1u; }
        found = surface_at(hit, on);
        distance += hit.t;
        if any(found.surface.albedo > vec3f(0.0)) {
            store(found.triangle_position, found.triangle_normal, emitted * flux_window(light, distance), lot, true);
        }
    }
    return 0u;
}

@compute @workgroup_size(64)
fn flux(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= flux_pass.ray_count { return; }
    let ray = flux_pass.first_ray + i;
    // The last light whose first ray is not after this one.
    var light = 0u;
    var end = flux_pass.light_count;
    while light + 1u < end {
        let middle = (light + end) / 2u;
        if flux_rays[middle] <= ray { light = middle; } else { end = middle; }
    }
    let first = flux_rays[light];
    let seed = hash3(flux_pass.seed, DIMENSION_FLUX, light);
    let emitted = light_emit(light, sobol4(ray - first, seed));
    var flux = emitted.flux * (flux_pass.inverse_unit / f32(flux_rays[light + 1u] - first));
    var position = emitted.origin;
    var normal = emitted.normal;
    var direction = emitted.direction;
    var rays = 0u;
    for (var bounce = 0u; ; bounce++) {
        let here = Ray(offset_origin(position, normal), 0.0, direction, FAR_AWAY);
        let bounce_seed = hash3(seed, ray, bounce);
        let hit = trace_closest(here, bounce_seed);
        rays++;
        if hit.triangle == NO_HIT || traversal_overrun { break; }
        let found = surface_at(hit, here);
        if bounce == 0u { flux *= flux_window(light, hit.t); }
        @if(transmission) { flux *= found.transmittance; }
        let lots = vec2f(uniform_from_bits(hash2(bounce_seed, 1u)), uniform_from_bits(hash2(bounce_seed, 2u)));
        let reflects = any(found.surface.albedo > vec3f(0.0));
        var stores = reflects;
        @if(negative_photons) {
            // The first surface is lit anyway, as all behind it are: they lose what they should not have.
            stores &= bounce > 0u;
            if bounce == 0u { rays += store_shadows(light, here, hit, found, flux, lots.x, bounce_seed); }
        }
        if found.unlit { break; }
        var goes_on = bounce < flux_pass.max_bounces;
        @if(caustics) {
            if caustic_photons == 1u {
                stores &= bounce > 0u;
                goes_on &= focuses(found.surface);
            }
        }
        if stores { store(found.triangle_position, found.triangle_normal, flux, lots.x, false); }
        if !goes_on { break; }
        // The first bounce of all rays together is as even as the rays themselves.
        let u = sobol2(ray, hash3(seed, bounce, 3u));
        let chosen = bsdf_sample(found.surface, vec3f(u, uniform_from_bits(hash2(bounce_seed, 4u))));
        if chosen.pdf <= 0.0 { break; }
        var reflected = flux * chosen.weight;
        @if(transmission) { reflected /= chosen.concentration; }
        let survival = max(reflected.x, max(reflected.y, reflected.z)) / max(flux.x, max(flux.y, flux.z));
        // Photons that survive carry as much as those that came, in the strongest channel.
        if !(lots.y < survival) { break; }
        flux = reflected / min(survival, 1.0);
        position = found.position;
        normal = leaving_normal(found.surface, chosen.direction);
        direction = chosen.direction;
    }
    atomicAdd(&flux_counts[2], rays);
    if traversal_overrun { atomicAdd(&flux_counts[1], 1u); }
}
