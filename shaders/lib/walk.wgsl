// A path on through the scene. At each of its vertices one light is asked by a shadow ray, and lights that the path
// itself meets count too, both weighted by how likely either way was to find them (Veach 1997). Russian roulette ends
// paths by what they still carry.
// With the feature `indirect` other passes have asked the lights at the first vertex: of direct light there is only the
// glossy part of what the path's first ray meets. With `global_map` a path ends where photons tell the irradiance,
// once it stands for a cone as wide as their disc. With `caustics` another pass brings what the diffuse part of the surface
// that is seen gets from lights by way of focusing surfaces alone.

import package::lib::bsdf::surface::Surface;
import package::lib::bsdf::{BsdfSample, bsdf_evaluate, bsdf_pdf, bsdf_sample, leaving_normal};
@if(transmission) import package::lib::bsdf::bsdf_passes;
@if(glossy && (global_map || (indirect && (mesh_lights || environment)))) import package::lib::bsdf::bsdf_residual;
@if(global_map) import package::lib::bsdf::{bsdf_seen_afar, reflects_more};
@if(caustics) import package::lib::bsdf::focuses;
import package::lib::bvh::{trace_closest, trace_occluded, traversal_overrun, traversal_turns};
@if(global_map) import package::lib::irradiance::irradiance_near;
import package::lib::light::{BEYOND_SCENE, sample_light, is_beyond, light_sample, shadow_ray};
import package::lib::light::table::load_light_texel;
@if(environment) import package::lib::environment::environment_met;
@if(environment) import package::lib::light::table::light_count;
@if(mesh_lights) import package::lib::light::mesh::emitter_of;
@if(mesh_lights || environment) import package::lib::light::light_probability;
@if(global_map) import package::lib::math::PI;
import package::lib::ray::{Hit, NO_HIT, Ray, offset_origin};
import package::lib::rng::{hash2, hash3, uniform_from_bits};
import package::lib::sampling::{mis_weight, sobol2};
import package::lib::surface::{SurfaceHit, surface_at};

// Rays of this invocation so far.
var<private> shadow_rays: u32;
var<private> bounce_rays: u32;

// Vertices before Russian roulette may end a path: the first few bounces carry most of the image.
const FIRST_ROULETTE = 3u;

// Whether a path of this invocation came to carry more than this weight: what surfaces reflect beyond what they get, or far more
// in some directions than paths are sent there. Roulette alone does not lead there.
const HEAVY_WEIGHT = 8.0;
var<private> heavy_path: bool;

// Turns of the searches for a direction of the environment, of 1024 x 512 cells at most.
@if(environment) const ENVIRONMENT_TURNS = 20u;

// Turns of all traversals of a path after which it gives up and says so. Software devices count turns for all lanes of a vector
// together, and in each traversal another lane may be the slowest: a quarter of what they grant.
const PATH_TURNS = 16384u;

// Loop turns that a vertex may take beside its traversals: binary searches for a light and, twice, for one of the emitter
// triangles, or for a direction of the environment.
fn vertex_turns() -> u32 {
    let header = load_light_texel(0u);
    var turns = 6u + firstLeadingBit(header.x | 1u) + 2u * firstLeadingBit(header.y | 1u);
    @if(environment) { turns += ENVIRONMENT_TURNS; }
    return turns;
}

struct Vertex {
    position: vec3f,
    surface: Surface,
    // Its diffuse part has been accounted for: what is left is the BSDF less that.
    @if(global_map && glossy) residual: bool,
    // For the random numbers of this vertex; two of them, for the choice of a lobe and of a light.
    seed: u32,
    sample_index: u32,
    lobe_and_light: vec2f,
}

fn reseed(vertex: ptr<function, Vertex>, seed: u32) {
    (*vertex).seed = seed;
    (*vertex).lobe_and_light = sobol2((*vertex).sample_index, hash2(seed, 2u));
}

// What is left of the BSDF, times the cosine.
fn reflection(vertex: Vertex, direction: vec3f) -> vec3f {
    @if(global_map && glossy) { if vertex.residual { return bsdf_residual(vertex.surface, direction); } }
    return bsdf_evaluate(vertex.surface, direction);
}

// The light that one chosen light sends to the viewer of the vertex, over the chance to choose it.
fn light_at(vertex: Vertex, bounce: u32) -> vec3f {
    let choice = sample_light(vertex.lobe_and_light.y);
    let chosen = light_sample(choice.light, vertex.position, sobol2(vertex.sample_index, hash2(vertex.seed, 1u)));
    if chosen.pdf <= 0.0 { return vec3f(0.0); }
    // `shade` asks for what arrives on the viewer's side.
    @if(indirect && transmission) { if bounce == 0u && !bsdf_passes(vertex.surface, chosen.direction) { return vec3f(0.0); } }
    let pdf = chosen.pdf * choice.probability;
    var reflected = reflection(vertex, chosen.direction) * chosen.radiance / pdf;
    if all(reflected == vec3f(0.0)) { return vec3f(0.0); }
    let ray = shadow_ray(vertex.position, leaving_normal(vertex.surface, chosen.direction), chosen);
    if !chosen.delta && !is_beyond(ray.origin, vertex.position, chosen) {
        reflected *= mis_weight(pdf, bsdf_pdf(vertex.surface, chosen.direction));
    }
    shadow_rays++;
    if trace_occluded(ray, hash2(vertex.seed, 4u + vertex.sample_index)) { return vec3f(0.0); }
    return reflected;
}

struct PathRadiance {
    direct: vec3f,
    indirect: vec3f,
}

// How a path comes to its first vertex here.
struct PathStart {
    // Bounces before it.
    bounce: u32,
    // Radius of the cone that the path stands for, where it has come to.
    spread: f32,
}

// What a path from the vertex brings back. `light_samples`: light points that `shade` took of each light, where it did.
fn walk(first: Vertex, start: PathStart, seed: u32, max_bounces: u32, light_samples: u32) -> PathRadiance {
    var vertex = first;
    var throughput = vec3f(1.0);
    var radiance = PathRadiance(vec3f(0.0), vec3f(0.0));
    @if(global_map) var spread = start.spread;
    // Where photons lie that have come to the vertex.
    @if(global_map) var place = vertex.position;
    @if(global_map) var place_normal = vertex.surface.geometric_normal;
    // Since the point that is seen, a gather's before the first vertex, there were focusing surfaces only: what light counts
    // by is then the residual part of that point's BSDF.
    @if(caustics) var chain = start.bounce == 0u || focuses(first.surface);
    @if(caustics) var residual_throughput = vec3f(f32(start.bounce == 0u));
    for (var bounce = start.bounce; ; bounce++) {
        traversal_turns += vertex_turns();
        reseed(&vertex, hash2(seed, bounce));
        var asks = true;
        @if(indirect && !transmission) { asks = bounce > 0u; }
        @if(indirect && transmission) { asks = bounce > 0u || any(vertex.surface.transmission.tint > vec3f(0.0)); }
        if asks {
            var counted = throughput;
            @if(caustics) { counted = select(throughput, residual_throughput, chain); }
            let arriving = counted * light_at(vertex, bounce);
            if bounce == 0u { radiance.direct += arriving; } else { radiance.indirect += arriving; }
        }
        let u = sobol2(vertex.sample_index, hash2(vertex.seed, 3u));
        var chosen = bsdf_sample(vertex.surface, vec3f(u, vertex.lobe_and_light.x));
        @if(global_map && glossy) {
            if vertex.residual && chosen.pdf > 0.0 {
                chosen.weight = bsdf_residual(vertex.surface, chosen.direction) / chosen.pdf;
            }
        }
        var going_on = chosen.pdf > 0.0 && any(chosen.weight != vec3f(0.0));
        if going_on {
            throughput *= chosen.weight;
            @if(caustics) {
                var left = chosen.weight;
                if bounce == 0u { left = bsdf_residual(vertex.surface, chosen.direction) / chosen.pdf; }
                residual_throughput *= left;
            }
            if bounce >= FIRST_ROULETTE {
                let size = abs(throughput);
                // Not less than what the path carries: the weights of the few long paths would outgrow their number where
                // little is absorbed, and an image miss their light without a sign of it. (At most 0.95, a closed room of
                // albedo 0.99 was 17 % too dark.) So paths in white rooms end by the bounces that are asked for.
                let survival = min(max(size.x, max(size.y, size.z)), 1.0);
                let lot = uniform_from_bits(hash3(vertex.seed, 0x726f756cu, vertex.sample_index));
                going_on = lot < survival;
                throughput /= survival;
                heavy_path |= going_on && max(size.x, max(size.y, size.z)) > HEAVY_WEIGHT * survival;
                @if(caustics) { residual_throughput /= survival; }
            }
        }
        // The last ray could only find a light that rays can meet.
        @if(!mesh_lights && !environment) { going_on &= bounce < max_bounces; }
        if going_on {
            bounce_rays++;
            let origin = offset_origin(vertex.position, leaving_normal(vertex.surface, chosen.direction));
            let ray = Ray(origin, 0.0, chosen.direction, BEYOND_SCENE);
            let hit = trace_closest(ray, hash2(~vertex.seed, vertex.sample_index));
            going_on = hit.triangle != NO_HIT;
            @if(environment) {
                if !going_on {
                    let met = environment_met(ray.direction);
                    var counted = throughput;
                    @if(caustics) { counted = select(throughput, residual_throughput, chain && bounce > 0u); }
                    // The environment is the last light.
                    let weight = met_weight(vertex, chosen, counted, vec3f(1.0), met.w, light_count() - 1u, bounce, light_samples);
                    if bounce == 0u { radiance.direct += met.xyz * weight; } else { radiance.indirect += met.xyz * weight; }
                }
            }
            if going_on {
                let found = surface_at(hit, ray);
                going_on = !found.unlit;
                @if(transmission) { throughput *= found.transmittance; }
                @if(caustics && transmission) { residual_throughput *= found.transmittance; }
                @if(mesh_lights) {
                    if going_on && any(found.emission > vec3f(0.0)) {
                        var counted = throughput;
                        @if(caustics) { counted = select(throughput, residual_throughput, chain && bounce > 0u); }
                        let arriving = found.emission * met_light(vertex, chosen, counted, hit, found, bounce, light_samples);
                        if bounce == 0u { radiance.direct += arriving; } else { radiance.indirect += arriving; }
                    }
                }
                vertex.position = found.position;
                vertex.surface = found.surface;
                @if(global_map) {
                    place = found.triangle_position;
                    place_normal = found.triangle_normal;
                    spread += spread_along(chosen.pdf, hit.t);
                }
            }
        }
        traversal_overrun |= traversal_turns > PATH_TURNS;
        if traversal_overrun || !going_on || bounce >= max_bounces { break; }
        @if(global_map) {
            let known = irradiance_near(place, place_normal);
            var wide = spread >= known.radius;
            @if(caustics) {
                let focusing = focuses(vertex.surface);
                chain = chain && focusing;
                wide = wide && !focusing;
            }
            if wide {
                radiance.indirect += throughput * bsdf_seen_afar(vertex.surface) * known.value;
                if !reflects_more(vertex.surface) { break; }
            }
            @if(glossy) { vertex.residual = wide; }
        }
    }
    return radiance;
}

// By how much a ray of that density by solid angle widens the cone that it stands for over the distance: as much as a ray of
// a Lambertian surface at most, so that in corners, too, look-ups stand for places that are some way off.
@if(global_map)
fn spread_along(pdf: f32, distance: f32) -> f32 {
    return distance * min(inverseSqrt(PI * pdf), 1.0);
}

// What of a light that the path's own ray met goes to the viewer: the path's throughput, weighted against the chance that
// a shadow ray had found it.
@if(mesh_lights)
fn met_light(vertex: Vertex, chosen: BsdfSample, throughput: vec3f, hit: Hit, found: SurfaceHit, bounce: u32, light_samples: u32) -> vec3f {
    let emitter = emitter_of(hit.triangle, vertex.position);
    if emitter.pdf <= 0.0 { return throughput; }
    var passing = vec3f(1.0);
    @if(transmission) { passing = found.transmittance; }
    return met_weight(vertex, chosen, throughput, passing, emitter.pdf, emitter.light, bounce, light_samples);
}

// The same of a light that is met where `light_sample` chooses it with density `pdf` by solid angle; the throughput has in it
// what passes along the ray.
@if(mesh_lights || environment)
fn met_weight(
    vertex: Vertex,
    chosen: BsdfSample,
    throughput: vec3f,
    passing: vec3f,
    pdf: f32,
    light: u32,
    bounce: u32,
    light_samples: u32,
) -> vec3f {
    @if(indirect) {
        var shaded = bounce == 0u;
        @if(transmission) { shaded = shaded && !bsdf_passes(vertex.surface, chosen.direction); }
        if shaded {
            @if(glossy) {
                return bsdf_residual(vertex.surface, chosen.direction) * passing * (mis_weight(chosen.pdf, f32(light_samples) * pdf) / chosen.pdf);
            }
            @if(!glossy) { return vec3f(0.0); }
        }
    }
    return mis_weight(chosen.pdf, pdf * light_probability(light)) * throughput;
}
