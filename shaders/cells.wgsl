// cells: what rays from the surfaces in each cell of a grid to each light see, before the first sample; then the class of
// every point by its cell. The earlier methods that judge space and not points; src/techniques/cells.rs says which.

import package::lib::bvh::{trace_occluded, traversal_overrun, triangle_corners};
import package::lib::constants::{COUNTER_OVERRUN, DIMENSION_CELL, DIMENSION_SHADOW_ALPHA, INVALID_POINT};
import package::lib::dispatch::group_index;
import package::lib::grid::{GridShape, cell_of};
@if(dark_points) import package::lib::light::light_dark;
import package::lib::light::{light_sample, shadow_ray};
import package::lib::math::oct_decode16;
import package::lib::photon::{CLASS_BOUNDARY, CLASS_DARK, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN, class_word};
import package::lib::point::Point;
import package::lib::rng::hash3;
import package::lib::sampling::sobol2;
import package::lib::tile::Tile;

struct CellParameters {
    grid: GridShape,
    tile: Tile,
    // Of `trace` the light, of `look` the first one of the chunk.
    light: u32,
    // Points to trace from, and those of one cell.
    point_count: u32,
    rays: u32,
    // (light, cell) pairs, and (light, point) pairs of the chunk.
    cell_count: u32,
    slot_count: u32,
    // Of the light points.
    seed: u32,
    padding: vec2u,
}

// A point of a surface that a cell traces a ray from.
struct CellPoint {
    position: vec3f,
    // BVH slot of its triangle.
    triangle: u32,
}

var<immediate> cells_pass: CellParameters;

@group(0) @binding(0) var<storage, read> cell_points: array<CellPoint>;
// By light and cell: rays that were traced, and above 16 bits those that saw the light.
@group(0) @binding(1) var<storage, read_write> cell_counts: array<atomic<u32>>;
// By light and cell: the class word of its points.
@group(0) @binding(2) var<storage, read_write> cell_words: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read> points: array<Point>;
@group(0) @binding(5) var<storage, read_write> classes: array<u32>;

fn cells_of_a_light() -> u32 {
    return cells_pass.grid.size.x * cells_pass.grid.size.y * cells_pass.grid.size.z;
}

fn place_of(light: u32, cell: vec3u) -> u32 {
    let size = cells_pass.grid.size;
    return light * cells_of_a_light() + (cell.z * size.y + cell.y) * size.x + cell.x;
}

// One ray, from the side of the surface that faces the light point: from the other the light is dark.
@compute @workgroup_size(64)
fn trace(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= cells_pass.point_count { return; }
    let point = cell_points[i];
    let light = cells_pass.light;
    let place = place_of(light, cell_of(cells_pass.grid, point.position));
    let seed = hash3(cells_pass.seed, DIMENSION_CELL, place);
    let chosen = light_sample(light, point.position, sobol2(i % cells_pass.rays, seed));
    let corners = triangle_corners(point.triangle);
    let across = normalize(cross(corners[1] - corners[0], corners[2] - corners[0]));
    let cosine = dot(across, chosen.direction);
    if chosen.pdf <= 0.0 || cosine == 0.0 { return; }
    let ray = shadow_ray(point.position, select(across, -across, cosine < 0.0), chosen);
    let seen = !trace_occluded(ray, hash3(seed, DIMENSION_SHADOW_ALPHA, i % cells_pass.rays));
    atomicAdd(&cell_counts[place], select(1u, 0x10001u, seen));
    if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
}

// The class word of each cell for each light.
@compute @workgroup_size(64)
fn judge(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let place = group_index(group, groups) * 64u + lane;
    if place < cells_pass.cell_count { cell_words[place] = word_of_cell(place); }
}

fn word_of_cell(place: u32) -> u32 {
    let count = atomicLoad(&cell_counts[place]);
    let traced = count & 0xffffu;
    let seen = count >> 16u;
    // No ray, no answer.
    if traced == 0u { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.0); }
    let n_i = min(seen, 511u);
    let n_s = min(traced - seen, 511u);
    @if(voxel_tags) {
        // A boundary that passes a voxel between its rays is met by those next door.
        let range = shares_around(place);
        if range.x == 1.0 { return class_word(CLASS_LIT, n_i, 0u, 1.0); }
        if range.y == 0.0 { return class_word(CLASS_SHADOWED, 0u, n_s, 0.0); }
    }
    @if(!voxel_tags) {
        if seen == 0u { return class_word(CLASS_SHADOWED, 0u, n_s, 0.0); }
    }
    return class_word(CLASS_BOUNDARY, n_i, n_s, f32(seen) / f32(traced));
}

// The least and the greatest share of seen rays, of the cell and the 26 around it.
@if(voxel_tags)
fn shares_around(place: u32) -> vec2f {
    let size = cells_pass.grid.size;
    let light = place / cells_of_a_light();
    let within = place % cells_of_a_light();
    let cell = vec3u(within % size.x, within / size.x % size.y, within / (size.x * size.y));
    let low = max(cell, vec3u(1u)) - 1u;
    let high = min(cell + 1u, size - 1u);
    var range = vec2f(1.0, 0.0);
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            for (var x = low.x; x <= high.x; x++) {
                let count = atomicLoad(&cell_counts[place_of(light, vec3u(x, y, z))]);
                if (count & 0xffffu) == 0u { continue; }
                let share = f32(count >> 16u) / f32(count & 0xffffu);
                range = vec2f(min(range.x, share), max(range.y, share));
            }
        }
    }
    return range;
}

@compute @workgroup_size(64)
fn look(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let slot = group_index(group, groups) * 64u + lane;
    if slot < cells_pass.slot_count { classes[slot] = word_of_slot(slot); }
}

fn word_of_slot(slot: u32) -> u32 {
    let local_light = slot / cells_pass.tile.point_count;
    let point = points[slot - local_light * cells_pass.tile.point_count];
    if point.normal == INVALID_POINT { return class_word(CLASS_DARK, 0u, 0u, 0.0); }
    let light = cells_pass.light + local_light;
    @if(dark_points) {
        if light_dark(light, point.position, oct_decode16(point.normal)) { return class_word(CLASS_DARK, 0u, 0u, 0.0); }
    }
    return cell_words[place_of(light, cell_of(cells_pass.grid, point.position))];
}
