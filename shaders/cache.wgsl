// cache: the irradiance cache (Ward and Heckbert 1992). `request` lists the points that the existing records do not
// cover well enough: these points get records of their own. `interpolate` interpolates the diffuse indirect light of a
// tile's points from the records. It queues for path tracing the points that are not Lambertian or are seen in mirrors.
// The points that no record covers have a queue of their own.
// In: `points`, `surfaces` and the records (lib/record).
// Out: `wanted_points`, `radiance_indirect`, `path_points` and `uncovered_points`.

import package::kit::{dispatch_groups, group_index};
import package::lib::bsdf::bsdf_diffuse;
import package::lib::math::oct_decode16;
@if(glossy) import package::lib::bsdf::surface::reflects_beyond_diffuse;
import package::lib::record::{Interpolated, NO_BLOCK, interpolate_records};
import package::lib::point::{Point, VisibleSurface};
import package::lib::visible_point::{load_point, load_surface, visible_surface};
import package::lib::tile::Tile;
@if(!thin_lens) import package::lib::tile::tile_pixel;
@if(thin_lens) import package::lib::camera::film_position;
import package::lib::constants::{INVALID_POINT, PATH_GROUP, RECORD_MIN_WEIGHT};

struct CacheParameters {
    tile: Tile,
    // Size of the image in blocks.
    blocks: vec2f,
    // Blocks in a row.
    block_columns: u32,
    block_rows: u32,
}

var<immediate> cache_pass: CacheParameters;

// Number of points that need a record, and their indices.
@group(0) @binding(2) var<storage, read_write> wanted_count: array<atomic<u32>, 1>;
@group(0) @binding(3) var<storage, read_write> wanted_points: array<u32>;
// w is 1 where the diffuse part of the light is complete.
@group(0) @binding(4) var<storage, read_write> radiance_indirect: array<vec4f>;
// Number of points left to path tracing for other reasons than missing records, their indices, and the arguments of a
// dispatch over them.
@group(0) @binding(5) var<storage, read_write> path_count: array<atomic<u32>, 1>;
@group(0) @binding(6) var<storage, read_write> path_points: array<u32>;
@group(0) @binding(7) var<storage, read_write> path_arguments: array<u32, 3>;
// The same of the points that no record covers.
@group(0) @binding(8) var<storage, read_write> uncovered_count: array<atomic<u32>, 1>;
@group(0) @binding(9) var<storage, read_write> uncovered_points: array<u32>;
@group(0) @binding(10) var<storage, read_write> uncovered_arguments: array<u32, 3>;

// The light that the records give at point i. A lane without a point passes false for `wants`.
fn interpolate_at(i: u32, surface: VisibleSurface, point: Point, wants: bool, lane: u32) -> Interpolated {
    @if(thin_lens) let film = clamp(film_position(point.position), vec2f(0.0), vec2f(1.0));
    @if(!thin_lens) let size = vec2f(f32(cache_pass.tile.width), f32(cache_pass.tile.height));
    @if(!thin_lens) let film = (vec2f(tile_pixel(cache_pass.tile, i)) + 0.5) / size;
    let last = vec2u(cache_pass.block_columns, cache_pass.block_rows) - 1u;
    let block = min(vec2u(film * cache_pass.blocks), last);
    let index = select(NO_BLOCK, block.y * cache_pass.block_columns + block.x, wants);
    let normal = oct_decode16(bitcast<u32>(surface.packed.base.w));
    return interpolate_records(index, point.position, normal, lane);
}

// Whether the camera sees the point through a specular chain. The blocks list records by where the camera sees them
// directly.
fn is_behind_chain(surface: VisibleSurface) -> bool {
    @if(specular_chains) {
        return bitcast<u32>(surface.chain.w) != INVALID_POINT;
    }
    @else { return false; }
}

fn reflects_diffusely(surface: VisibleSurface, point: Point) -> bool {
    return point.normal != INVALID_POINT && any(surface.packed.base.xyz > vec3f(0.0));
}

@compute @workgroup_size(64)
fn request(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let point = load_point(i);
    let surface = load_surface(i);
    let wants = i < cache_pass.tile.point_count && reflects_diffusely(surface, point) && !is_behind_chain(surface);
    let found = interpolate_at(i, surface, point, wants, lane);
    if wants && found.weight < RECORD_MIN_WEIGHT { wanted_points[atomicAdd(&wanted_count[0], 1u)] = i; }
}

// Whether the surface is not Lambertian: it also reflects specularly, or transmits light.
fn reflects_beyond(surface: VisibleSurface, point: Point) -> bool {
    @if(glossy) {
        return point.normal != INVALID_POINT && reflects_beyond_diffuse(surface.packed);
    }
    @else { return false; }
}

@compute @workgroup_size(64)
fn interpolate(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let point = load_point(i);
    let surface = load_surface(i);
    let behind_chain = point.normal != INVALID_POINT && is_behind_chain(surface);
    let wants = i < cache_pass.tile.point_count && reflects_diffusely(surface, point) && !behind_chain;
    let found = interpolate_at(i, surface, point, wants, lane);
    if i >= cache_pass.tile.point_count { return; }
    var light = vec4f(0.0, 0.0, 0.0, 1.0);
    let is_uncovered = wants && found.weight <= 0.0;
    if behind_chain || is_uncovered {
        light = vec4f(0.0);
    } else if wants {
        light = vec4f(bsdf_diffuse(visible_surface(surface, point)) * found.irradiance, 1.0);
    }
    if is_uncovered {
        uncovered_points[atomicAdd(&uncovered_count[0], 1u)] = i;
    } else if behind_chain || reflects_beyond(surface, point) {
        path_points[atomicAdd(&path_count[0], 1u)] = i;
    }
    radiance_indirect[i] = light;
}

// `interpolate` has written the light that the points have from other records. This replaces it by its difference from
// the light of these records, or by 0 where either of them leaves the light to a path.
@compute @workgroup_size(64)
fn change(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let point = load_point(i);
    let surface = load_surface(i);
    let before = radiance_indirect[i];
    let wants = i < cache_pass.tile.point_count && before.w > 0.0 && reflects_diffusely(surface, point);
    let found = interpolate_at(i, surface, point, wants, lane);
    if i >= cache_pass.tile.point_count { return; }
    let light = bsdf_diffuse(visible_surface(surface, point)) * found.irradiance;
    let changes = wants && found.weight > 0.0;
    radiance_indirect[i] = vec4f(select(vec3f(0.0), light - before.xyz, changes), 0.0);
}

@compute @workgroup_size(1)
fn arrange_paths() {
    let size = dispatch_groups(atomicLoad(&path_count[0]), PATH_GROUP);
    path_arguments = array(size.x, size.y, size.z);
    let of_uncovered = dispatch_groups(atomicLoad(&uncovered_count[0]), PATH_GROUP);
    uncovered_arguments = array(of_uncovered.x, of_uncovered.y, of_uncovered.z);
}
