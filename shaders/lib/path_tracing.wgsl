// Path tracing: next-event estimation, multiple importance sampling and Russian roulette. At each vertex of a path a
// shadow ray connects to one sampled light. Light that the path itself hits counts too; multiple importance sampling
// weights both (Veach 1997).
// In: the first vertex of a path, and the scene. Lengths are in scene units after normalisation.
// Out: radiance, and the numbers of rays.
//
// With the feature `indirect`, other passes have done next-event estimation at the first vertex. The only direct light
// that the path then adds is that which its first ray hits, for the specular part of the BSDF. Without `bsdf_rays` it
// does not even add that, because all lights are small compared with the lobes of all surfaces (lib/bsdf_rays). With
// `global_map`, a path ends at precomputed irradiance (Christensen 1999), once its footprint is wide enough
// (FOOTPRINT_RADII).
// With `caustics`, another pass adds the light that the diffuse part of the visible surface receives from lights by way
// of focusing surfaces only. With `caustic_irradiance`, later vertices take that light from the irradiance points: a
// path would rarely hit it, by chance.

import package::lib::bsdf::surface::Surface;
@if(indirect && transmission) import package::lib::bsdf::surface::passes_light;
import package::lib::bsdf::{BsdfSample, bsdf_evaluate, bsdf_pdf, bsdf_sample, leaving_normal};
@if(transmission) import package::lib::bsdf::bsdf_passes;
@if(global_map && glossy) import package::lib::bsdf::bsdf_less;
@if(bsdf_rays) import package::lib::bsdf::bsdf_max_density;
@if(bsdf_rays) import package::lib::bsdf_rays::takes_bsdf_rays;
@if(global_map) import package::lib::bsdf::{bsdf_seen_afar, reflects_more};
@if(caustic_irradiance || (global_map && glossy)) import package::lib::bsdf::bsdf_diffuse;
@if(caustics) import package::lib::bsdf::focuses;
@if(global_map && glossy) import package::lib::bsdf::blurred_surface;
import package::lib::bvh::{traversal_iterations, traversal_overrun};
@if(global_map) import package::lib::irradiance::irradiance_near;
@if(caustic_irradiance) import package::lib::irradiance::{NO_ESTIMATE, load_caustic_irradiance};
import package::lib::light::{BEYOND_SCENE, sample_light, is_beyond, light_sample, shadow_ray};
import package::lib::light::table::load_light_texel;
@if(environment) import package::lib::environment::environment_met;
@if(environment) import package::lib::light::table::light_count;
@if(mesh_lights) import package::lib::light::mesh::emitter_of;
@if(mesh_lights || environment) import package::lib::light::light_probability;
@if(global_map) import package::lib::math::PI;
@if(packets) import package::lib::packet::PACKET_ITERATIONS;
import package::lib::packet::{in_any_lane, no_ray, trace_closest_together, trace_occluded_together};
import package::lib::ray::{Hit, NO_HIT, Ray, RaySample, offset_origin};
import package::lib::rng::{hash2, hash3, uniform_from_bits};
import package::lib::sampling::{mis_weight, sobol2};
@if(negative_photons) import package::lib::shading_normal::share_of_sky;
import package::lib::surface::{SurfaceHit, surface_at};
@if(dispersion) import package::lib::wavelength::carry;

// Rays of this invocation so far.
var<private> shadow_rays: u32;
var<private> bounce_rays: u32;

// Vertices before Russian roulette may end a path: the first few bounces carry most of the image. None of 1, 2 and 5 is
// better in all scenes (docs/experiments.md, "Vertices before roulette").
const FIRST_ROULETTE = 3u;

// Set if the weight of a path of this invocation exceeds HEAVY_WEIGHT: either surfaces reflect more light than they
// receive, or the BSDF sampling gives some directions far too small a density. Roulette alone does not cause it:
// it leaves a weight of 1 at most. A path of eight times the weight is a bright speck.
const HEAVY_WEIGHT = 8.0;
var<private> heavy_path: bool;

// Iterations of a search for a direction of the environment, which has at most 1024 x 512 cells.
@if(environment) const ENVIRONMENT_ITERATIONS = 20u;

// Maximum iterations of all traversals of a path. Beyond it, the path ends and sets `traversal_overrun`. For rays one
// by one it is a quarter of what software devices allow: they count iterations for all lanes of a vector together, and
// the slowest lane may differ between traversals. The lanes of a packet have the same iterations.
@if(!packets) const PATH_ITERATIONS = 16384u;
@if(packets) const PATH_ITERATIONS = PACKET_ITERATIONS;

// Maximum number of loop iterations at a vertex besides its traversals: binary searches for a light and, twice, for one
// of the emitter triangles, or for a direction of the environment.
fn vertex_iterations() -> u32 {
    let header = load_light_texel(0u);
    var iterations = 6u + firstLeadingBit(header.x | 1u) + 2u * firstLeadingBit(header.y | 1u);
    @if(environment) { iterations += ENVIRONMENT_ITERATIONS; }
    return iterations;
}

struct PathVertex {
    position: vec3f,
    surface: Surface,
    // The diffuse part is already accounted for: only the BSDF without it counts.
    @if(global_map && glossy) residual: bool,
    // Seed of the random numbers of this vertex.
    seed: u32,
    sample_index: u32,
    // Random numbers that select a lobe and a light.
    lobe_and_light: vec2f,
}

struct PathRadiance {
    direct: vec3f,
    indirect: vec3f,
}

// How a path reaches its first vertex.
struct PathStart {
    // Whether there is a path. Lanes without one trace no rays together with the others.
    begins: bool,
    // Bounces before the first vertex.
    bounce: u32,
    // Radius of the path's footprint there: that of the cone of directions that it samples.
    spread: f32,
    // That cone, as `spread_of` has it; 0 for a ray of the camera.
    @if(global_map && glossy) widest: f32,
    // Whether the diffuse part of the vertex has its light from focusing surfaces already.
    @if(caustics) caustic_known: bool,
}

// A path at its present vertex.
struct Path {
    vertex: PathVertex,
    // Bounces before the vertex.
    bounce: u32,
    throughput: vec3f,
    // Radiance that the path has gathered so far.
    radiance: PathRadiance,
    // Whether the path continues from the vertex.
    goes_on: bool,
    // Light points per light in pass `shade`, where that pass ran.
    light_samples: u32,
    // Radius of the path's footprint at the vertex: that of the cone of directions that it samples.
    @if(global_map) spread: f32,
    // The widest cone of directions that the path has sampled, as `spread_of` has it.
    @if(global_map && glossy) widest: f32,
    // Position and normal at which photons of the vertex are stored.
    @if(global_map) photon_position: vec3f,
    @if(global_map) photon_normal: vec3f,
    // Whether the diffuse part of the vertex has its light from focusing surfaces already.
    @if(caustics) caustic_known: bool,
    // Whether the path has met only focusing surfaces since a vertex with `caustic_known`, or since the gather point
    // before the first vertex. Light then counts only by the residual part of that vertex's BSDF.
    @if(caustics) specular_chain: bool,
    @if(caustics) residual_throughput: vec3f,
}

fn begin_path(first: PathVertex, start: PathStart, light_samples: u32) -> Path {
    var path: Path;
    path.vertex = first;
    path.goes_on = start.begins;
    path.bounce = start.bounce;
    path.throughput = vec3f(1.0);
    path.light_samples = light_samples;
    @if(global_map) {
        path.spread = start.spread;
        @if(glossy) {
            path.widest = start.widest;
            path.vertex.surface = blurred_surface(first.surface, start.widest);
        }
        path.photon_position = first.position;
        path.photon_normal = first.surface.geometric_normal;
    }
    @if(caustics) {
        path.caustic_known = start.caustic_known;
        path.specular_chain = start.caustic_known || focuses(first.surface);
        // Gather points are diffuse.
        path.residual_throughput = vec3f(0.0);
    }
    return path;
}

// The radiance that a path gathers from its first vertex. `light_samples`: light points per light in pass `shade`, if
// that pass ran. All lanes of a subgroup trace at the same time (lib/packet); those whose path has ended trace no rays.
fn trace_path(
    first: PathVertex,
    start: PathStart,
    seed: u32,
    max_bounces: u32,
    light_samples: u32,
    lane: u32,
) -> PathRadiance {
    var path = begin_path(first, start, light_samples);
    for (; ; path.bounce++) {
        let begins = path.goes_on;
        traversal_iterations += vertex_iterations();
        path.vertex.seed = hash2(seed, path.bounce);
        let vertex_seed = path.vertex.seed;
        let sample_index = path.vertex.sample_index;
        path.vertex.lobe_and_light = sobol2(sample_index, hash2(vertex_seed, 2u));
        var connection = Connection(no_ray(), vec3f(0.0));
        if begins { connection = connection_of(&path); }
        let blocked = trace_occluded_together(connection.ray, RaySample(hash2(vertex_seed, 4u), sample_index), lane);
        var scattered: BsdfSample;
        if begins {
            if !blocked { add_radiance(&path, light_throughput(&path) * connection.reflected); }
            scattered = scatter_path(&path);
        }
        // Without lights that a ray can hit, the last ray would find nothing.
        @if(!mesh_lights && !environment) { path.goes_on &= path.bounce < max_bounces; }
        var ray = no_ray();
        if path.goes_on { ray = scattered_ray(path.vertex, scattered); }
        let hit = trace_closest_together(ray, RaySample(~vertex_seed, sample_index), lane);
        if path.goes_on { extend_path(&path, scattered, ray, hit); }
        traversal_overrun |= begins && traversal_iterations > PATH_ITERATIONS;
        path.goes_on &= !traversal_overrun && path.bounce < max_bounces;
        @if(global_map) { if path.goes_on { path.goes_on = !add_known_light(&path); } }
        if !in_any_lane(path.goes_on, lane) { break; }
    }
    return path.radiance;
}

fn add_radiance(path: ptr<function, Path>, arriving: vec3f) {
    if (*path).bounce == 0u { (*path).radiance.direct += arriving; } else { (*path).radiance.indirect += arriving; }
}

// The throughput that weights light at the vertex, and light that the ray from the vertex hits.
fn light_throughput(path: ptr<function, Path>) -> vec3f {
    @if(caustics) {
        let residual = (*path).specular_chain && !(*path).caustic_known;
        return select((*path).throughput, (*path).residual_throughput, residual);
    }
    @else { return (*path).throughput; }
}

// The BSDF times the cosine, or only its residual part. Both are evaluated in one place, because lavapipe compiles
// every place on its own.
fn reflection(vertex: PathVertex, direction: vec3f) -> vec3f {
    @if(global_map && glossy) {
        let diffuse = select(vec3f(0.0), bsdf_diffuse(vertex.surface), vertex.residual);
        return bsdf_less(vertex.surface, direction, diffuse);
    }
    @else { return bsdf_evaluate(vertex.surface, direction); }
}

// A shadow ray to one sampled light.
struct Connection {
    ray: Ray,
    // The light reflected by the vertex if nothing stops the ray, over the probability of sampling that light.
    reflected: vec3f,
}

// Next-event estimation, unless another pass has done it.
fn connection_of(path: ptr<function, Path>) -> Connection {
    let nothing = Connection(no_ray(), vec3f(0.0));
    @if(indirect && !transmission) { if (*path).bounce == 0u { return nothing; } }
    @if(indirect && transmission) {
        if (*path).bounce == 0u && !passes_light((*path).vertex.surface) { return nothing; }
    }
    return connect((*path).vertex, (*path).bounce);
}

fn connect(vertex: PathVertex, bounce: u32) -> Connection {
    let nothing = Connection(no_ray(), vec3f(0.0));
    let selected = sample_light(vertex.lobe_and_light.y);
    let lit = light_sample(selected.light, vertex.position, sobol2(vertex.sample_index, hash2(vertex.seed, 1u)));
    if lit.pdf <= 0.0 { return nothing; }
    // `shade` has sampled the lights on the viewer's side.
    @if(indirect && transmission) { if bounce == 0u && !bsdf_passes(vertex.surface, lit.direction) { return nothing; } }
    let pdf = lit.pdf * selected.probability;
    var reflected = reflection(vertex, lit.direction) * lit.radiance / pdf;
    if all(reflected == vec3f(0.0)) { return nothing; }
    let ray = shadow_ray(vertex.position, leaving_normal(vertex.surface, lit.direction), lit);
    if !lit.delta && !is_beyond(ray.origin, vertex.position, lit) {
        reflected *= mis_weight(pdf, bsdf_pdf(vertex.surface, lit.direction));
    }
    shadow_rays++;
    return Connection(ray, reflected);
}

// Samples the BSDF for the next ray, and updates the throughput; `goes_on` is false where the BSDF or roulette ends the
// path.
fn scatter_path(path: ptr<function, Path>) -> BsdfSample {
    let vertex = (*path).vertex;
    let u = sobol2(vertex.sample_index, hash2(vertex.seed, 3u));
    var scattered = bsdf_sample(vertex.surface, vec3f(u, vertex.lobe_and_light.x));
    @if(global_map && glossy) {
        if vertex.residual && scattered.pdf > 0.0 {
            scattered.weight = scattered.residual / scattered.pdf;
        }
    }
    (*path).goes_on = scattered.pdf > 0.0 && any(scattered.weight != vec3f(0.0));
    if (*path).goes_on {
        @if(caustics) {
            if (*path).caustic_known {
                (*path).residual_throughput = (*path).throughput * scattered.residual / scattered.pdf;
            } else {
                (*path).residual_throughput *= scattered.weight;
            }
        }
        (*path).throughput *= scattered.weight;
        if (*path).bounce >= FIRST_ROULETTE { play_roulette(path); }
    }
    return scattered;
}

// Russian roulette by the path's throughput.
fn play_roulette(path: ptr<function, Path>) {
    let size = abs((*path).throughput);
    // The probability of survival is never below the throughput. A lower one would concentrate the light of scenes that
    // absorb little in a few long paths of large weight. An image that misses these paths is too dark without showing
    // noise. (With a probability of at most 0.95, a closed room of albedo 0.99 was 17 % too dark.) So paths in white
    // rooms end at the maximum number of bounces.
    let survival = min(max(size.x, max(size.y, size.z)), 1.0);
    let xi = uniform_from_bits(hash3((*path).vertex.seed, 0x726f756cu, (*path).vertex.sample_index));
    (*path).goes_on = xi < survival;
    (*path).throughput /= survival;
    heavy_path |= (*path).goes_on && max(size.x, max(size.y, size.z)) > HEAVY_WEIGHT * survival;
    @if(caustics) { (*path).residual_throughput /= survival; }
}

fn scattered_ray(vertex: PathVertex, scattered: BsdfSample) -> Ray {
    bounce_rays++;
    let origin = offset_origin(vertex.position, leaving_normal(vertex.surface, scattered.direction));
    return Ray(origin, 0.0, scattered.direction, BEYOND_SCENE);
}

// Adds the light that the scattered ray hits, and moves to the next vertex.
fn extend_path(path: ptr<function, Path>, scattered: BsdfSample, ray: Ray, hit: Hit) {
    if hit.triangle == NO_HIT {
        (*path).goes_on = false;
        @if(environment) {
            let met = environment_met(ray.direction);
            // The environment is the last light.
            add_radiance(path, met.xyz * hit_weight(path, scattered, vec3f(1.0), met.w, light_count() - 1u));
        }
        return;
    }
    @if(dispersion && !caustics) { carry((*path).throughput); }
    @if(dispersion && caustics) { carry(abs((*path).throughput) + abs((*path).residual_throughput)); }
    let found = surface_at(hit, ray);
    (*path).goes_on = !found.unlit;
    @if(transmission) { (*path).throughput *= found.transmittance; }
    @if(caustics && transmission) { (*path).residual_throughput *= found.transmittance; }
    @if(mesh_lights) {
        if (*path).goes_on && any(found.emission > vec3f(0.0)) {
            add_radiance(path, found.emission * emission_weight(path, scattered, hit, found));
        }
    }
    (*path).vertex.position = found.position;
    (*path).vertex.surface = found.surface;
    @if(global_map && glossy) {
        (*path).widest = max((*path).widest, spread_of(scattered.pdf));
        (*path).vertex.surface = blurred_surface(found.surface, (*path).widest);
    }
    @if(global_map) {
        (*path).photon_position = found.triangle_position;
        (*path).photon_normal = found.triangle_normal;
        (*path).spread += spread_along(scattered.pdf, hit.t);
    }
}

// The part of a surface's reflected light that the irradiance points give.
@if(global_map)
struct KnownLight {
    radiance: vec3f,
    // The footprint is wide enough for the whole diffuse light.
    all: bool,
    @if(caustics) focusing: bool,
    // The footprint is narrower, and only the light from focusing surfaces is taken.
    @if(caustics) caustic: bool,
}

// Radius of a footprint for which a look-up is accurate enough, over that of the irradiance point's disc. Where
// surfaces meet, a disc's blur shows: with 1 the lower side of a ball on a floor was 4.5 % too bright, with 2 it is
// 2.8 %, with 4 less than 1 %. But elsewhere, paths instead of look-ups add noise
// (docs/decisions.md, "Look-ups only for wide footprints").
@if(global_map) const FOOTPRINT_RADII = 2.0;

// Photons of the surface are stored at the position and normal; `spread` is the radius of the path's footprint there.
@if(global_map)
fn known_light(surface: Surface, position: vec3f, normal: vec3f, spread: f32) -> KnownLight {
    let known = irradiance_near(position, normal);
    var light: KnownLight;
    light.all = spread >= FOOTPRINT_RADII * known.radius;
    @if(caustics) {
        // The caustic map holds part of a focusing surface's light. The path tracer separates it.
        light.focusing = focuses(surface);
        light.all = light.all && !light.focusing;
    }
    if light.all {
        light.radiance = bsdf_seen_afar(surface) * known.value;
        // With negative photons, irradiance is that of the triangle.
        @if(negative_photons) { light.radiance *= share_of_sky(surface.shading_normal, normal); }
    }
    @if(caustic_irradiance) {
        light.caustic = !light.all && !light.focusing && known.radius < NO_ESTIMATE;
        if light.caustic { light.radiance = bsdf_diffuse(surface) * load_caustic_irradiance(known.point); }
    }
    return light;
}

// Adds the light that the irradiance points give at the vertex. Returns true if nothing remains to be traced.
@if(global_map)
fn add_known_light(path: ptr<function, Path>) -> bool {
    let surface = (*path).vertex.surface;
    let known = known_light(surface, (*path).photon_position, (*path).photon_normal, (*path).spread);
    @if(caustics) {
        (*path).caustic_known = known.caustic;
        (*path).specular_chain = known.caustic || ((*path).specular_chain && known.focusing);
    }
    @if(glossy) { (*path).vertex.residual = known.all; }
    if any(known.radiance != vec3f(0.0)) { (*path).radiance.indirect += (*path).throughput * known.radiance; }
    return known.all && !reflects_more(surface);
}

// By how much a ray with the given density by solid angle widens the path's footprint over a distance. The result is at
// most that of a ray from a Lambertian surface, so that in corners too, look-ups happen only at some distance.
@if(global_map)
fn spread_along(pdf: f32, distance: f32) -> f32 {
    return distance * spread_of(pdf);
}

// The same for a distance of 1.
@if(global_map)
fn spread_of(pdf: f32) -> f32 {
    return min(inverseSqrt(PI * pdf), 1.0);
}

// The weight of the emission of a surface that the scattered ray hit: throughput and multiple importance sampling.
@if(mesh_lights)
fn emission_weight(path: ptr<function, Path>, scattered: BsdfSample, hit: Hit, found: SurfaceHit) -> vec3f {
    let emitter = emitter_of(hit.triangle, (*path).vertex.position);
    if emitter.pdf <= 0.0 { return light_throughput(path); }
    var passing = vec3f(1.0);
    @if(transmission) { passing = found.transmittance; }
    return hit_weight(path, scattered, passing, emitter.pdf, emitter.light);
}

// The weight of light that the scattered ray hit, and that `light_sample` samples with density `pdf` by solid angle.
// `passing` is the transmittance along the ray; the throughput includes it.
@if(mesh_lights || environment)
fn hit_weight(path: ptr<function, Path>, scattered: BsdfSample, passing: vec3f, pdf: f32, light: u32) -> vec3f {
    @if(indirect) {
        var shaded = (*path).bounce == 0u;
        @if(transmission) { shaded = shaded && !bsdf_passes((*path).vertex.surface, scattered.direction); }
        if shaded {
            @if(bsdf_rays) {
                let density = bsdf_max_density((*path).vertex.surface);
                if !takes_bsdf_rays(density, (*path).vertex.position, light) { return vec3f(0.0); }
                let weight = mis_weight(scattered.pdf, f32((*path).light_samples) * pdf) / scattered.pdf;
                return scattered.residual * passing * weight;
            }
            @if(!bsdf_rays) { return vec3f(0.0); }
        }
    }
    return mis_weight(scattered.pdf, pdf * light_probability(light)) * light_throughput(path);
}
