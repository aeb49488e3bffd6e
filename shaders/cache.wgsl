// cache: the irradiance cache. `place` finds the points for which no record speaks well enough: they get records of their own.
// `interpolate` lights the points of a tile from the records; those that none speaks for are queued for paths, and those that
// reflect more than their diffuse part.

import package::lib::dispatch::{dispatch_groups, group_index};
import package::lib::math::{PI, oct_decode16};
import package::lib::point::{Point, SURFACE_VECTORS};
@if(glossy) import package::lib::bsdf::surface::{PACKED_VECTORS, PackedSurface, reflects_beyond_diffuse};
@if(chains) import package::lib::point::CHAIN_VECTOR;
import package::lib::record::{Interpolated, interpolate_records};
import package::lib::tile::{Tile, tile_pixel};
import package::lib::constants::{INVALID_POINT, PATH_GROUP};

struct CacheParameters {
    tile: Tile,
    // Blocks of the image along x and y, in pixels of the image over the size of a block.
    blocks: vec2f,
    // Blocks in a row.
    block_columns: u32,
    block_rows: u32,
}

var<immediate> cache_pass: CacheParameters;

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read> surfaces: array<vec4f>;
// How many points want a record, and which.
@group(0) @binding(2) var<storage, read_write> wanted_count: array<atomic<u32>, 1>;
@group(0) @binding(3) var<storage, read_write> wanted_points: array<u32>;
// w: 1 where the diffuse part of the light is there.
@group(0) @binding(4) var<storage, read_write> radiance_indirect: array<vec4f>;
// How many points have light left for paths, which, and the arguments of a dispatch over them.
@group(0) @binding(5) var<storage, read_write> path_count: array<atomic<u32>, 1>;
@group(0) @binding(6) var<storage, read_write> path_points: array<u32>;
@group(0) @binding(7) var<storage, read_write> path_arguments: array<u32, 3>;

// Records weigh up to 1 each. With less than this together a point lies at their rims, where gradients reach far.
const ENOUGH = 0.3;

fn at_point(i: u32) -> Interpolated {
    let film = (vec2f(tile_pixel(cache_pass.tile, i)) + 0.5) / vec2f(f32(cache_pass.tile.width), f32(cache_pass.tile.height));
    let last = vec2u(cache_pass.block_columns, cache_pass.block_rows) - 1u;
    let block = min(vec2u(film * cache_pass.blocks), last);
    let normal = oct_decode16(bitcast<u32>(surfaces[i * SURFACE_VECTORS].w));
    return interpolate_records(block.y * cache_pass.block_columns + block.x, points[i].position, normal);
}

// Whether a chain leads to the point: blocks list the records that the camera sees there itself.
fn is_behind_chain(i: u32) -> bool {
    @if(chains) { return bitcast<u32>(surfaces[i * SURFACE_VECTORS + CHAIN_VECTOR].w) != INVALID_POINT; }
    @else { return false; }
}

// Whether there is a surface that reflects diffusely.
fn asks_irradiance(i: u32) -> bool {
    return points[i].normal != INVALID_POINT && any(surfaces[i * SURFACE_VECTORS].xyz > vec3f(0.0));
}

@compute @workgroup_size(64)
fn place(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= cache_pass.tile.point_count || !asks_irradiance(i) || is_behind_chain(i) { return; }
    if at_point(i).weight < ENOUGH { wanted_points[atomicAdd(&wanted_count[0], 1u)] = i; }
}

// Whether there is a surface whose light is not all its diffuse part's.
fn reflects_beyond(i: u32) -> bool {
    @if(glossy) {
        if points[i].normal == INVALID_POINT { return false; }
        var packed: PackedSurface;
        for (var v = 0u; v < PACKED_VECTORS; v++) { packed.vectors[v] = surfaces[i * SURFACE_VECTORS + v]; }
        return reflects_beyond_diffuse(packed);
    }
    @else { return false; }
}

@compute @workgroup_size(64)
fn interpolate(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= cache_pass.tile.point_count { return; }
    var light = vec4f(0.0, 0.0, 0.0, 1.0);
    var queued = reflects_beyond(i);
    if points[i].normal != INVALID_POINT && is_behind_chain(i) {
        light = vec4f(0.0);
        queued = true;
    } else if asks_irradiance(i) {
        let found = at_point(i);
        light = vec4f(surfaces[i * SURFACE_VECTORS].xyz * found.irradiance * (1.0 / PI), 1.0);
        if found.weight <= 0.0 {
            light = vec4f(0.0);
            queued = true;
        }
    }
    if queued { path_points[atomicAdd(&path_count[0], 1u)] = i; }
    radiance_indirect[i] = light;
}

@compute @workgroup_size(1)
fn arrange_paths() {
    let size = dispatch_groups(atomicLoad(&path_count[0]), PATH_GROUP);
    path_arguments = array(size.x, size.y, size.z);
}
