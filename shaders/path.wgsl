// path: the reference path tracer, and the indirect light of the other techniques. Traces one path from each point of
// the tile (lib/path_tracing). With the feature `irradiance_cache`, records have already added the diffuse part of
// indirect light, except at points that no record covers. With `photon_map`, the map has already added the diffuse part
// of all light. The path then adds only what glossy surfaces reflect besides.
// In: `points`, `surfaces`. Out: direct light is added to `radiance_direct`, indirect light goes to
// `radiance_indirect`.

import package::kit::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::bvh::traversal_overrun;
import package::lib::light::table::light_count;
import package::lib::math::{is_finite3, invalid_sample};
import package::lib::path_tracing::{PathRadiance, PathStart, PathVertex, trace_path};
import package::lib::path_tracing::{bounce_rays, heavy_path, shadow_rays};
import package::lib::visible_point::{points, visible_surface};
@if(specular_chains) import package::lib::visible_point::visible_chain;
import package::lib::rng::hash2;
import package::lib::constants::{INVALID_POINT, DIMENSION_PATH, PATH_GROUP, COUNTER_SHADOW_RAYS, COUNTER_BOUNCE_RAYS};
import package::lib::constants::{COUNTER_HEAVY_PATHS, COUNTER_NOT_FINITE_PATH, COUNTER_OVERRUN};

struct PathParameters {
    tile: Tile,
    // Maximum number of bounces of indirect light; 0 gives direct light alone.
    max_bounces: u32,
    // Light points that `shade` takes of each light.
    light_samples: u32,
}

@group(0) @binding(2) var<storage, read_write> radiance_direct: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> radiance_indirect: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> counters: array<atomic<u32>>;
// The points for which records do not give all light: those that no record covers, and those that are not Lambertian.
@if(irradiance_cache) @group(0) @binding(5) var<storage, read> path_count: array<u32, 1>;
@if(irradiance_cache) @group(0) @binding(6) var<storage, read> path_points: array<u32>;

var<immediate> parameters: PathParameters;

// Each word holds two counts of a workgroup, because four atomics would be slow on software devices. The lower
// SECOND_COUNT bits count rays, at most MAX_ITERATIONS per invocation. The upper bits count invocations whose radiance
// is not finite, or whose path is heavy.
var<workgroup> group_shadow_rays: atomic<u32>;
var<workgroup> group_bounce_rays: atomic<u32>;
const SECOND_COUNT = 24u;

@compute @workgroup_size(PATH_GROUP)
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
    var i = group_index(group, groups) * PATH_GROUP + lane;
    var items = parameters.tile.point_count;
    @if(irradiance_cache) { items = path_count[0]; }
    if i < items {
        @if(irradiance_cache) { i = path_points[i]; }
        var indirect = vec3f(0.0);
        var finite = true;
        if points[i].normal != INVALID_POINT && light_count() > 0u {
            var found = radiance_along(i);
            finite = is_finite3(found.direct) && is_finite3(found.indirect);
            // The results of a path that exceeded the loop budget are wrong.
            if traversal_overrun { found = PathRadiance(vec3f(invalid_sample(i)), vec3f(invalid_sample(i))); }
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
        // With `indirect`, another pass traces the shadow rays of direct light; the shadow rays of this pass count as
        // bounce rays.
        @if(indirect) { atomicAdd(&counters[COUNTER_BOUNCE_RAYS], rays.x + rays.y); }
        @else {
            atomicAdd(&counters[COUNTER_SHADOW_RAYS], rays.x);
            atomicAdd(&counters[COUNTER_BOUNCE_RAYS], rays.y);
        }
        if shadows != rays.x { atomicAdd(&counters[COUNTER_NOT_FINITE_PATH], shadows >> SECOND_COUNT); }
        if bounces != rays.y { atomicAdd(&counters[COUNTER_HEAVY_PATHS], bounces >> SECOND_COUNT); }
    }
}

// The radiance of a path from point i, as it reaches the camera through the specular chain.
fn radiance_along(i: u32) -> PathRadiance {
    var vertex: PathVertex;
    vertex.position = points[i].position;
    vertex.surface = visible_surface(i);
    vertex.sample_index = tile_sample(parameters.tile, i);
    @if((irradiance_cache || photon_map) && glossy) { vertex.residual = radiance_indirect[i].w != 0.0; }
    let seed = hash2(pixel_seed(parameters.tile, i), DIMENSION_PATH);
    var found = trace_path(vertex, PathStart(0u, 0.0), seed, parameters.max_bounces, parameters.light_samples);
    @if(specular_chains) {
        let throughput = visible_chain(i).throughput;
        found.direct *= throughput;
        found.indirect *= throughput;
    }
    return found;
}
