// path: the reference, and indirect light. From each point of the tile a path on through the scene (lib/walk).
// With the feature `irradiance_cache` records have brought the diffuse part of the indirect light, but for the points
// that they do not cover; with `photon_map` the map has brought that of all light. Of glossy surfaces the rest is left.
// In: points, surfaces. Out: direct light is added to `radiance_direct`, light of more bounces is `radiance_indirect`.

import package::lib::dispatch::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::bvh::traversal_overrun;
import package::lib::light::table::light_count;
import package::lib::math::{is_finite3, spoilt};
import package::lib::seen::{points, seen_surface};
@if(chains) import package::lib::seen::seen_chain;
import package::lib::rng::hash2;
import package::lib::walk::{PathRadiance, PathStart, Vertex, bounce_rays, heavy_path, shadow_rays, walk};
import package::lib::constants::{INVALID_POINT, DIMENSION_PATH, COUNTER_SHADOW_RAYS, COUNTER_BOUNCE_RAYS, COUNTER_HEAVY_PATHS, COUNTER_NOT_FINITE_PATH, COUNTER_OVERRUN};

struct PathParameters {
    tile: Tile,
    // Most bounces of indirect light: 0 for direct light alone.
    max_bounces: u32,
    // Light points that `shade` takes of each light.
    light_samples: u32,
}

@group(0) @binding(2) var<storage, read_write> radiance_direct: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> radiance_indirect: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> counters: array<atomic<u32>>;
// Points that records do not bring all light to: those that none speaks for, and those that are not Lambertian.
@if(irradiance_cache) @group(0) @binding(5) var<storage, read> path_count: array<u32, 1>;
@if(irradiance_cache) @group(0) @binding(6) var<storage, read> path_points: array<u32>;

var<immediate> parameters: PathParameters;

// Counts of two things: rays, of which an invocation traces no more than the MAX_TURNS of its loops, and above them
// invocations whose radiance is not finite or whose path is heavy. An atomic for each would cost software devices more than the
// counts tell.
var<workgroup> group_shadow_rays: atomic<u32>;
var<workgroup> group_bounce_rays: atomic<u32>;
const SECOND_COUNT = 24u;

@compute @workgroup_size(64)
fn path(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane == 0u {
        atomicStore(&group_shadow_rays, 0u);
        atomicStore(&group_bounce_rays, 0u);
    }
    workgroupBarrier();
    var i = group_index(group, groups) * 64u + lane;
    var items = parameters.tile.point_count;
    @if(irradiance_cache) { items = path_count[0]; }
    if i < items {
        @if(irradiance_cache) { i = path_points[i]; }
        var indirect = vec3f(0.0);
        var finite = true;
        if points[i].normal != INVALID_POINT && light_count() > 0u {
            var found = radiance_along(i);
            finite = is_finite3(found.direct) && is_finite3(found.indirect);
            // Of a path that met the loop budget nothing is known.
            if traversal_overrun { found = PathRadiance(vec3f(spoilt(i)), vec3f(spoilt(i))); }
            let so_far = radiance_direct[i];
            radiance_direct[i] = vec4f(so_far.xyz + found.direct, so_far.w);
            indirect = found.indirect;
        }
        @if(irradiance_cache || photon_map) { indirect += radiance_indirect[i].xyz; }
        radiance_indirect[i] = vec4f(indirect, 0.0);
        if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
        atomicAdd(&group_shadow_rays, shadow_rays + (u32(!finite) << SECOND_COUNT));
        atomicAdd(&group_bounce_rays, bounce_rays + (u32(heavy_path) << SECOND_COUNT));
    }
    workgroupBarrier();
    if lane == 0u {
        let shadows = atomicLoad(&group_shadow_rays);
        let bounces = atomicLoad(&group_bounce_rays);
        let rays = vec2u(shadows, bounces) & vec2u((1u << SECOND_COUNT) - 1u);
        // The shadow rays that are counted as such are those of direct light, where that is another pass's.
        @if(indirect) { atomicAdd(&counters[COUNTER_BOUNCE_RAYS], rays.x + rays.y); }
        @else {
            atomicAdd(&counters[COUNTER_SHADOW_RAYS], rays.x);
            atomicAdd(&counters[COUNTER_BOUNCE_RAYS], rays.y);
        }
        if shadows != rays.x { atomicAdd(&counters[COUNTER_NOT_FINITE_PATH], shadows >> SECOND_COUNT); }
        if bounces != rays.y { atomicAdd(&counters[COUNTER_HEAVY_PATHS], bounces >> SECOND_COUNT); }
    }
}

// What a path from point i brings back.
fn radiance_along(i: u32) -> PathRadiance {
    var vertex: Vertex;
    vertex.position = points[i].position;
    vertex.surface = seen_surface(i);
    vertex.sample_index = tile_sample(parameters.tile, i);
    @if((irradiance_cache || photon_map) && glossy) { vertex.residual = radiance_indirect[i].w != 0.0; }
    let seed = hash2(pixel_seed(parameters.tile, i), DIMENSION_PATH);
    var found = walk(vertex, PathStart(0u, 0.0), seed, parameters.max_bounces, parameters.light_samples);
    @if(chains) {
        let throughput = seen_chain(i).throughput;
        found.direct *= throughput;
        found.indirect *= throughput;
    }
    return found;
}
