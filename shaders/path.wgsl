// path: the reference, and indirect light. From each point of the tile a path on through the scene; at each of its
// vertices one light is asked by a shadow ray, and lights that the path itself meets count too, both weighted by how
// likely either way was to find them (Veach 1997). Russian roulette ends paths by what they still carry.
// With the feature `indirect` pass `shade` has asked the lights at the points themselves: of direct light there is only
// the glossy part of what the path's first ray meets.
// In: points, surfaces. Out: direct light is added to `radiance_direct`, light of more bounces is `radiance_indirect`.

import package::lib::dispatch::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::bsdf::{BsdfSample, Surface, bsdf_evaluate, bsdf_pdf, bsdf_sample};
@if(indirect && glossy && mesh_lights) import package::lib::bsdf::bsdf_residual;
import package::lib::bvh::{trace_closest, trace_occluded, traversal_overrun, traversal_turns};
import package::lib::camera::view_direction;
import package::lib::light::{BEYOND_SCENE, choose_light, light_count, light_sample, shadow_ray};
@if(mesh_lights) import package::lib::light::{emitter_of, light_probability};
import package::lib::math::oct_decode16;
import package::lib::point::{Point, SURFACE_VECTORS, PackedSurface, unpack_surface};
import package::lib::ray::{Hit, NO_HIT, Ray, offset_origin};
import package::lib::rng::{hash2, hash3, uniform_from_bits};
import package::lib::sampling::{mis_weight, sobol2};
import package::lib::surface::{SurfaceHit, surface_at};
import package::lib::constants::{INVALID_POINT, DIMENSION_PATH, COUNTER_SHADOW_RAYS, COUNTER_BOUNCE_RAYS, COUNTER_OVERRUN};

struct PathParameters {
    tile: Tile,
    // Most bounces of indirect light: 0 for direct light alone.
    max_bounces: u32,
    // Light points that `shade` takes of each light.
    light_samples: u32,
}

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read> surfaces: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> radiance_direct: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> radiance_indirect: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> counters: array<atomic<u32>>;

var<immediate> parameters: PathParameters;

var<workgroup> shadow_rays: atomic<u32>;
var<workgroup> bounce_rays: atomic<u32>;

// Vertices before Russian roulette may end a path: the first few bounces carry most of the image.
const FIRST_ROULETTE = 3u;

// Highest chance to go on, so that paths end also where nothing is absorbed.
const MAX_SURVIVAL = 0.95;

// Loop turns that a vertex may take beside its traversals: binary searches for a light and an emitter triangle.
const VERTEX_TURNS = 80u;

struct Vertex {
    position: vec3f,
    surface: Surface,
    // For the random numbers of this vertex; two of them, for the choice of a lobe and of a light.
    seed: u32,
    sample_index: u32,
    lobe_and_light: vec2f,
}

fn reseed(vertex: ptr<function, Vertex>, seed: u32) {
    (*vertex).seed = seed;
    (*vertex).lobe_and_light = sobol2((*vertex).sample_index, hash2(seed, 2u));
}

// The light that one chosen light sends to the viewer of the vertex, over the chance to choose it.
fn light_at(vertex: Vertex) -> vec3f {
    let choice = choose_light(vertex.lobe_and_light.y);
    let chosen = light_sample(choice.light, vertex.position, sobol2(vertex.sample_index, hash2(vertex.seed, 1u)));
    if chosen.pdf <= 0.0 { return vec3f(0.0); }
    let pdf = chosen.pdf * choice.probability;
    var reflected = bsdf_evaluate(vertex.surface, chosen.direction) * chosen.radiance
        * (dot(chosen.direction, vertex.surface.shading_normal) / pdf);
    if all(reflected <= vec3f(0.0)) { return vec3f(0.0); }
    if !chosen.delta { reflected *= mis_weight(pdf, bsdf_pdf(vertex.surface, chosen.direction)); }
    atomicAdd(&shadow_rays, 1u);
    if trace_occluded(shadow_ray(vertex.position, vertex.surface.geometric_normal, chosen), hash2(vertex.seed, 4u + vertex.sample_index)) { return vec3f(0.0); }
    return reflected;
}

@compute @workgroup_size(64)
fn path(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane == 0u {
        atomicStore(&shadow_rays, 0u);
        atomicStore(&bounce_rays, 0u);
    }
    workgroupBarrier();
    let i = group_index(group, groups) * 64u + lane;
    if i < parameters.tile.point_count {
        var indirect = vec3f(0.0);
        if points[i].normal != INVALID_POINT && light_count() > 0u {
            let found = radiance_along(i);
            let so_far = radiance_direct[i];
            radiance_direct[i] = vec4f(so_far.xyz + found.direct, so_far.w);
            indirect = found.indirect;
        }
        radiance_indirect[i] = vec4f(indirect, 0.0);
    }
    workgroupBarrier();
    if lane == 0u {
        // The shadow rays that are counted as such are those of direct light, where that is another pass's.
        @if(indirect) { atomicAdd(&counters[COUNTER_BOUNCE_RAYS], atomicLoad(&bounce_rays) + atomicLoad(&shadow_rays)); }
        @else {
            atomicAdd(&counters[COUNTER_SHADOW_RAYS], atomicLoad(&shadow_rays));
            atomicAdd(&counters[COUNTER_BOUNCE_RAYS], atomicLoad(&bounce_rays));
        }
    }
}

struct PathRadiance {
    direct: vec3f,
    indirect: vec3f,
}

// What a path from point i brings back.
fn radiance_along(i: u32) -> PathRadiance {
    var packed: PackedSurface;
    packed.a = surfaces[i * SURFACE_VECTORS];
    @if(glossy) {
        packed.b = surfaces[i * SURFACE_VECTORS + 1u];
        packed.c = surfaces[i * SURFACE_VECTORS + 2u];
    }
    var vertex: Vertex;
    vertex.position = points[i].position;
    vertex.surface = unpack_surface(packed, oct_decode16(points[i].normal), view_direction(vertex.position));
    vertex.sample_index = tile_sample(parameters.tile, i);
    let seed = hash2(pixel_seed(parameters.tile, i), DIMENSION_PATH);

    var radiance = PathRadiance(vec3f(0.0), vec3f(0.0));
    var throughput = vec3f(1.0);
    reseed(&vertex, hash2(seed, 0u));
    @if(!indirect) { radiance.direct = light_at(vertex); }
    for (var bounce = 0u; ; bounce++) {
        traversal_turns += VERTEX_TURNS;
        let u = sobol2(vertex.sample_index, hash2(vertex.seed, 3u));
        let chosen = bsdf_sample(vertex.surface, vec3f(u, vertex.lobe_and_light.x));
        var going_on = chosen.pdf > 0.0;
        if going_on {
            throughput *= chosen.weight;
            if bounce >= FIRST_ROULETTE {
                let survival = min(max(throughput.x, max(throughput.y, throughput.z)), MAX_SURVIVAL);
                let lot = uniform_from_bits(hash3(vertex.seed, 0x726f756cu, vertex.sample_index));
                going_on = lot < survival;
                throughput /= survival;
            }
        }
        // The last ray could only find a light that has a surface.
        @if(!mesh_lights) { going_on &= bounce < parameters.max_bounces; }
        if going_on {
            atomicAdd(&bounce_rays, 1u);
            let origin = offset_origin(vertex.position, vertex.surface.geometric_normal);
            let ray = Ray(origin, 0.0, chosen.direction, BEYOND_SCENE);
            let hit = trace_closest(ray, hash2(~vertex.seed, vertex.sample_index));
            going_on = hit.triangle != NO_HIT;
            if going_on {
                let found = surface_at(hit, ray);
                going_on = !found.unlit;
                @if(mesh_lights) {
                    if going_on && any(found.emission > vec3f(0.0)) {
                        let arriving = found.emission * met_light(vertex, chosen, throughput, hit, found, bounce);
                        if bounce == 0u { radiance.direct += arriving; } else { radiance.indirect += arriving; }
                    }
                }
                vertex.position = found.position;
                vertex.surface = found.surface;
            }
        }
        if traversal_overrun {
            atomicAdd(&counters[COUNTER_OVERRUN], 1u);
            break;
        }
        if !going_on || bounce >= parameters.max_bounces { break; }
        reseed(&vertex, hash2(seed, bounce + 1u));
        radiance.indirect += throughput * light_at(vertex);
    }
    return radiance;
}

// What of a light that the path's own ray met goes to the viewer: the path's throughput, weighted against the chance that
// a shadow ray had found it.
@if(mesh_lights)
fn met_light(vertex: Vertex, chosen: BsdfSample, throughput: vec3f, hit: Hit, found: SurfaceHit, bounce: u32) -> vec3f {
    let emitter = emitter_of(hit.triangle, vertex.position);
    let offset = found.position - vertex.position;
    let cosine = abs(dot(found.surface.geometric_normal, chosen.direction));
    if emitter.density <= 0.0 || cosine <= 0.0 { return throughput; }
    let pdf = emitter.density * dot(offset, offset) / cosine;
    @if(indirect) {
        if bounce == 0u {
            @if(glossy) {
                let reflected = bsdf_residual(vertex.surface, chosen.direction) * dot(chosen.direction, vertex.surface.shading_normal);
                return reflected * (mis_weight(chosen.pdf, f32(parameters.light_samples) * pdf) / chosen.pdf);
            }
            @if(!glossy) { return vec3f(0.0); }
        }
    }
    return mis_weight(chosen.pdf, pdf * light_probability(emitter.light)) * throughput;
}
