// path: the reference path tracer, and the indirect light of the other techniques. Traces one path from each point of
// the tile (lib/path_tracing). With the feature `irradiance_cache`, records have already added the diffuse part of
// indirect light, except at points that no record covers. With `photon_map`, the map has already added the diffuse part
// of all light. The path then adds only what glossy surfaces reflect besides. With `highlights`, paths are single rays
// that may hit a light, and only points where such rays count (lib/bsdf_rays) trace them: `queue_highlights` queues
// them. With `irradiance_cache`, the kernel also continues gather rays: their hits, which pass `gather` writes, are
// points as those of a tile are.
// In: `points`, `surfaces`. Out: direct light is added to `radiance_direct`, indirect light goes to
// `radiance_indirect`. For gather rays that is their radiance so far, and w, their distance, stays.

import package::kit::group_index;
@if(highlights) import package::kit::dispatch_groups;
@if(highlights) import package::lib::bsdf::{UNBOUNDED_DENSITY, bsdf_max_density};
@if(highlights) import package::lib::bsdf_rays::takes_bsdf_rays;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::bvh::traversal_overrun;
import package::lib::light::table::light_count;
@if(irradiance_cache) import package::lib::gather_hit::{GatherHit, HIT_RESIDUAL, HIT_CAUSTIC_KNOWN};
import package::lib::math::{is_finite3, invalid_sample};
@if(irradiance_cache) import package::lib::math::oct_decode16;
import package::lib::path_tracing::{PathRadiance, PathStart, PathVertex, trace_path};
import package::lib::path_tracing::{bounce_rays, heavy_path, shadow_rays};
import package::lib::point::{Point, VisibleSurface};
import package::lib::visible_point::{load_point, load_surface, visible_surface};
@if(specular_chains) import package::lib::visible_point::visible_chain;
import package::lib::rng::hash2;
@if(dispersion && irradiance_cache) import package::lib::rng::hash1;
@if(dispersion) import package::lib::wavelength::begin_wavelengths;
import package::lib::constants::{INVALID_POINT, DIMENSION_PATH, PATH_GROUP, COUNTER_SHADOW_RAYS, COUNTER_BOUNCE_RAYS};
import package::lib::constants::{COUNTER_HEAVY_PATHS, COUNTER_NOT_FINITE_PATH, COUNTER_OVERRUN};
@if(irradiance_cache) import package::lib::constants::{COUNTER_GATHER_RAYS, COUNTER_NOT_FINITE_GATHER};

struct PathParameters {
    tile: Tile,
    // Maximum number of bounces of indirect light; 0 gives direct light alone.
    max_bounces: u32,
    // Light points that `shade` takes of each light.
    light_samples: u32,
    // Upper limit of each component of the indirect light of a path.
    max_indirect: f32,
    // 1: the points are hits of gather rays (lib/gather_hit), 0: they are points of the tile.
    from_hits: u32,
    // Paths of each point, whose mean is its light, and the number of this one. Each takes a dispatch of its own.
    paths_per_point: u32,
    path_number: u32,
}

@group(0) @binding(2) var<storage, read_write> radiance_direct: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> radiance_indirect: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> counters: array<atomic<u32>>;
// Points for which records do not give all light: those that no record covers, or those that are not Lambertian; or the
// gather rays to continue, with what their paths start from.
@if(irradiance_cache) @group(0) @binding(5) var<storage, read> path_count: array<u32, 1>;
@if(irradiance_cache) @group(0) @binding(6) var<storage, read> path_points: array<u32>;
@if(irradiance_cache) @group(0) @binding(8) var<storage, read> gather_hits: array<GatherHit>;
// The points with rays that may hit a light, and the arguments of a dispatch over them.
@if(highlights) @group(0) @binding(5) var<storage, read_write> path_count: array<atomic<u32>, 1>;
@if(highlights) @group(0) @binding(6) var<storage, read_write> path_points: array<u32>;
@if(highlights) @group(0) @binding(7) var<storage, read_write> path_arguments: array<u32, 3>;

var<immediate> parameters: PathParameters;

// Each word holds two counts of a workgroup, because four atomics would be slow on software devices. The lower
// SECOND_COUNT bits count rays, at most MAX_ITERATIONS per invocation. The upper bits count invocations whose radiance
// is not finite, or whose path is heavy.
var<workgroup> group_shadow_rays: atomic<u32>;
var<workgroup> group_bounce_rays: atomic<u32>;
const SECOND_COUNT = 24u;

fn from_hits() -> bool {
    @if(irradiance_cache) { return parameters.from_hits != 0u; }
    @else { return false; }
}

@compute @workgroup_size(PATH_GROUP)
fn path(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    var i = group_index(group, groups) * PATH_GROUP + lane;
    var items = parameters.tile.point_count;
    @if(irradiance_cache) { items = path_count[0]; }
    @if(highlights) { items = atomicLoad(&path_count[0]); }
    let is_active = i < items;
    @if(irradiance_cache || highlights) { if is_active { i = path_points[i]; } }
    // Lanes without a point trace no rays together with the others.
    let begins = is_active && load_point(i).normal != INVALID_POINT && light_count() > 0u;
    var found = radiance_along(i, begins, lane);
    // Behind the path: lavapipe compiles what follows a barrier twice, and keeps its variables in memory.
    if lane == 0u {
        atomicStore(&group_shadow_rays, 0u);
        atomicStore(&group_bounce_rays, 0u);
    }
    workgroupBarrier();
    if is_active {
        var indirect = vec3f(0.0);
        var finite = true;
        if begins {
            finite = is_finite3(found.direct) && is_finite3(found.indirect);
            if !from_hits() {
                // The results of a path that exceeded the loop budget are wrong.
                if traversal_overrun { found = PathRadiance(vec3f(invalid_sample(i)), vec3f(invalid_sample(i))); }
                let so_far = radiance_direct[i];
                radiance_direct[i] = vec4f(so_far.xyz + found.direct / f32(parameters.paths_per_point), so_far.w);
            } else if !finite || traversal_overrun {
                // A single ray would make its record invalid, and with it all points that interpolate from the record.
                found.indirect = vec3f(0.0);
            }
            indirect = found.indirect / f32(parameters.paths_per_point);
        }
        var distance = 0.0;
        @if(irradiance_cache || photon_map) {
            let so_far = radiance_indirect[i];
            indirect += so_far.xyz;
            if from_hits() { distance = so_far.w; }
        }
        radiance_indirect[i] = vec4f(indirect, distance);
        if begins && traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
        atomicAdd(&group_shadow_rays, shadow_rays + (u32(!finite) << SECOND_COUNT));
        atomicAdd(&group_bounce_rays, bounce_rays + (u32(heavy_path) << SECOND_COUNT));
    }
    workgroupBarrier();
    if lane == 0u { add_counts_of_group(); }
}

// Adds the counts of the workgroup to the counters of the tile.
fn add_counts_of_group() {
    let shadows = atomicLoad(&group_shadow_rays);
    let bounces = atomicLoad(&group_bounce_rays);
    let rays = vec2u(shadows, bounces) & vec2u((1u << SECOND_COUNT) - 1u);
    // With `indirect`, another pass traces the shadow rays of direct light; the shadow rays of this pass count as
    // bounce rays.
    @if(indirect) {
        var counter = COUNTER_BOUNCE_RAYS;
        @if(irradiance_cache) { if from_hits() { counter = COUNTER_GATHER_RAYS; } }
        atomicAdd(&counters[counter], rays.x + rays.y);
    }
    @else {
        atomicAdd(&counters[COUNTER_SHADOW_RAYS], rays.x);
        atomicAdd(&counters[COUNTER_BOUNCE_RAYS], rays.y);
    }
    if shadows != rays.x {
        var counter = COUNTER_NOT_FINITE_PATH;
        @if(irradiance_cache) { if from_hits() { counter = COUNTER_NOT_FINITE_GATHER; } }
        atomicAdd(&counters[counter], shadows >> SECOND_COUNT);
    }
    if bounces != rays.y { atomicAdd(&counters[COUNTER_HEAVY_PATHS], bounces >> SECOND_COUNT); }
}

// A path before its first ray.
struct Beginning {
    vertex: PathVertex,
    start: PathStart,
    seed: u32,
    // Throughput of the way to the first vertex.
    throughput: vec3f,
}

// The path from point i of the tile, as it reaches the camera through the specular chain.
fn begin_at_tile(path: ptr<function, Beginning>, i: u32, point: Point, surface: VisibleSurface) {
    let sample = tile_sample(parameters.tile, i);
    // The paths of all samples of a pixel are stratified together.
    (*path).vertex.sample_index = sample * parameters.paths_per_point + parameters.path_number;
    @if((irradiance_cache || photon_map) && glossy) { (*path).vertex.residual = radiance_indirect[i].w != 0.0; }
    (*path).seed = hash2(pixel_seed(parameters.tile, i), DIMENSION_PATH);
    @if(caustics) { (*path).start.caustic_known = true; }
    @if(specular_chains) { (*path).throughput = visible_chain(surface, point).throughput; }
    @if(dispersion) { begin_wavelengths(pixel_seed(parameters.tile, i), sample, (*path).throughput); }
}

// The path from hit i of a gather ray, as it reaches the ray's record.
@if(irradiance_cache)
fn begin_at_hit(path: ptr<function, Beginning>, i: u32) {
    let hit = gather_hits[i];
    let number = hit.number & ~(HIT_RESIDUAL | HIT_CAUSTIC_KNOWN);
    (*path).vertex.surface.view = oct_decode16(hit.view);
    (*path).vertex.sample_index = number;
    @if(glossy) {
        (*path).vertex.residual = (hit.number & HIT_RESIDUAL) != 0u;
        (*path).start.widest = hit.widest;
    }
    (*path).start.bounce = 1u;
    (*path).start.spread = hit.spread;
    @if(caustics) { (*path).start.caustic_known = (hit.number & HIT_CAUSTIC_KNOWN) != 0u; }
    (*path).seed = hit.seed;
    (*path).throughput = hit.transmittance;
    @if(dispersion) { begin_wavelengths(hit.seed, hash1(number), vec3f(1.0)); }
}

// The radiance of a path from point i, if it begins.
fn radiance_along(i: u32, begins: bool, lane: u32) -> PathRadiance {
    var path: Beginning;
    path.throughput = vec3f(1.0);
    path.start.begins = begins;
    let point = load_point(i);
    let surface = load_surface(i);
    if begins {
        path.vertex.position = point.position;
        path.vertex.surface = visible_surface(surface, point);
    }
    if !from_hits() { begin_at_tile(&path, i, point, surface); }
    @if(irradiance_cache) { if from_hits() { begin_at_hit(&path, i); } }
    let light_samples = parameters.light_samples;
    var found = trace_path(path.vertex, path.start, path.seed, parameters.max_bounces, light_samples, lane);
    // A sample that is not finite stays so, and is counted.
    if is_finite3(found.indirect) { found.indirect = min(found.indirect, vec3f(parameters.max_indirect)); }
    @if(specular_chains || transmission) {
        found.direct *= path.throughput;
        found.indirect *= path.throughput;
    }
    return found;
}

// With more lights than this, `queue_highlights` does not test each of them for each point.
@if(highlights) const MAX_TESTED_LIGHTS = 64u;

// Whether a ray from point i may add light: what `shade` left to rays, or light that passes through the surface.
@if(highlights)
fn may_have_highlight(i: u32) -> bool {
    let point = load_point(i);
    if point.normal == INVALID_POINT { return false; }
    let density = bsdf_max_density(visible_surface(load_surface(i), point));
    if density == 0.0 || density == UNBOUNDED_DENSITY { return density != 0.0; }
    let count = light_count();
    if count > MAX_TESTED_LIGHTS { return true; }
    for (var light = 0u; light < count; light++) {
        if takes_bsdf_rays(density, point.position, light) { return true; }
    }
    return false;
}

@if(highlights) var<workgroup> group_queued: atomic<u32>;
@if(highlights) var<workgroup> group_base: u32;

@if(highlights)
@compute @workgroup_size(64)
fn queue_highlights(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane == 0u { atomicStore(&group_queued, 0u); }
    workgroupBarrier();
    let i = group_index(group, groups) * 64u + lane;
    var queued = false;
    if i < parameters.tile.point_count {
        queued = may_have_highlight(i);
        radiance_indirect[i] = vec4f(0.0);
    }
    var rank = 0u;
    if queued { rank = atomicAdd(&group_queued, 1u); }
    workgroupBarrier();
    if lane == 0u { group_base = atomicAdd(&path_count[0], atomicLoad(&group_queued)); }
    workgroupBarrier();
    if queued { path_points[group_base + rank] = i; }
}

@if(highlights)
@compute @workgroup_size(1)
fn arrange_highlights() {
    let size = dispatch_groups(atomicLoad(&path_count[0]), PATH_GROUP);
    path_arguments = array(size.x, size.y, size.z);
}
