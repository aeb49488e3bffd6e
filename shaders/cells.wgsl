// cells: before the first sample, traces shadow rays from the surfaces in each cell of a grid to each light; then
// classifies every candidate (a point and a light) by its cell. It serves the earlier methods that classify space, not
// points; see src/light_transport/cell_visibility.rs. In: surface points by cell (normalised space), the BVH, points of
// a tile. Out: counts of rays and a class word for each light and cell; class words of the candidates.

import package::lib::bvh::{traversal_overrun, triangle_normal};
import package::lib::packet::{no_ray, trace_occluded_together};
import package::lib::visible_point::load_point;
import package::lib::constants::{
    CLASS_BOUNDARY, CLASS_COUNT_MAX, CLASS_DARK, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN, COUNTER_OVERRUN,
    DIMENSION_CELL, DIMENSION_SHADOW_ALPHA
};
import package::lib::class_word::class_word;
import package::kit::group_index;
import package::lib::grid::{GridShape, cell_in_grid, cell_of, cells_of_a_light, index_in_grid};
import package::lib::light::{is_dark, light_sample, shadow_ray};
import package::lib::ray::RaySample;
import package::lib::rng::{hash2, hash3};
import package::lib::sampling::sobol2;
import package::lib::tile::Tile;

struct CellParameters {
    grid: GridShape,
    tile: Tile,
    // The light of `trace`, or the first light of the chunk of `classify_points`.
    light: u32,
    // Number of points to trace from, and of those in one cell.
    point_count: u32,
    rays: u32,
    // Number of (light, cell) pairs, and of (light, point) pairs of the chunk.
    cell_count: u32,
    candidate_count: u32,
    // Seed that samples the light points.
    seed: u32,
    padding: vec2u,
}

// A surface point in a cell, from which a shadow ray is traced.
struct CellPoint {
    position: vec3f,
    // Primitive index of its triangle.
    triangle: u32,
}

var<immediate> cells_pass: CellParameters;

@group(0) @binding(0) var<storage, read> cell_points: array<CellPoint>;
// For each light and cell: in the lower 16 bits the rays traced, above them those that reached the light.
@group(0) @binding(1) var<storage, read_write> cell_counts: array<atomic<u32>>;
// For each light and cell: the class word of the points in the cell.
@group(0) @binding(2) var<storage, read_write> cell_words: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> classes: array<u32>;

// Index of a cell among those of all lights.
fn index_of(light: u32, cell: vec3u) -> u32 {
    return light * cells_of_a_light(cells_pass.grid) + index_in_grid(cells_pass.grid, cell);
}

// Traces one ray from the side of the surface that faces the light point; on the other side the light is dark.
@compute @workgroup_size(64)
fn trace(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let point = cell_points[i];
    let light = cells_pass.light;
    let index = index_of(light, cell_of(cells_pass.grid, point.position));
    let seed = hash3(cells_pass.seed, DIMENSION_CELL, index);
    let sampled = light_sample(light, point.position, sobol2(i % cells_pass.rays, seed));
    let normal = normalize(triangle_normal(point.triangle));
    let cosine = dot(normal, sampled.direction);
    let faces = i < cells_pass.point_count && sampled.pdf > 0.0 && cosine != 0.0;
    var ray = no_ray();
    if faces { ray = shadow_ray(point.position, select(normal, -normal, cosine < 0.0), sampled); }
    let ray_sample = RaySample(hash2(seed, DIMENSION_SHADOW_ALPHA), i % cells_pass.rays);
    let visible = !trace_occluded_together(ray, ray_sample, lane);
    if !faces { return; }
    atomicAdd(&cell_counts[index], select(1u, 0x10001u, visible));
    if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }
}

// The class word of each cell for each light.
@compute @workgroup_size(64)
fn classify_cells(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = group_index(group, groups) * 64u + lane;
    if index < cells_pass.cell_count { cell_words[index] = word_of_cell(index); }
}

fn word_of_cell(index: u32) -> u32 {
    let count = atomicLoad(&cell_counts[index]);
    let traced = count & 0xffffu;
    let visible = count >> 16u;
    if traced == 0u { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.0); }
    let n_i = min(visible, CLASS_COUNT_MAX);
    let n_s = min(traced - visible, CLASS_COUNT_MAX);
    @if(voxel_tags) {
        // The rays of a voxel may miss a shadow boundary that crosses it; those of its neighbours then hit it.
        let around = kinds_around(index);
        if !around.blocked { return class_word(CLASS_LIT, n_i, 0u, 1.0); }
        if !around.visible { return class_word(CLASS_SHADOWED, 0u, n_s, 0.0); }
    }
    @if(!voxel_tags) {
        if visible == 0u { return class_word(CLASS_SHADOWED, 0u, n_s, 0.0); }
    }
    return class_word(CLASS_BOUNDARY, n_i, n_s, f32(visible) / f32(traced));
}

// Whether rays of a cell or of the 26 around it reached the light, and whether some did not.
@if(voxel_tags)
struct KindsOfRays {
    visible: bool,
    blocked: bool,
}

@if(voxel_tags)
fn kinds_around(index: u32) -> KindsOfRays {
    let size = cells_pass.grid.size;
    let light = index / cells_of_a_light(cells_pass.grid);
    let cell = cell_in_grid(cells_pass.grid, index % cells_of_a_light(cells_pass.grid));
    let low = max(cell, vec3u(1u)) - 1u;
    let high = min(cell + 1u, size - 1u);
    var kinds = KindsOfRays(false, false);
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            for (var x = low.x; x <= high.x; x++) {
                let count = atomicLoad(&cell_counts[index_of(light, vec3u(x, y, z))]);
                kinds.visible |= count >> 16u > 0u;
                kinds.blocked |= count >> 16u < (count & 0xffffu);
            }
        }
    }
    return kinds;
}

// The class word of each candidate, by its cell.
@compute @workgroup_size(64)
fn classify_points(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let candidate = group_index(group, groups) * 64u + lane;
    if candidate < cells_pass.candidate_count { classes[candidate] = word_of_candidate(candidate); }
}

fn word_of_candidate(candidate: u32) -> u32 {
    let local_light = candidate / cells_pass.tile.point_count;
    let point = load_point(candidate - local_light * cells_pass.tile.point_count);
    let light = cells_pass.light + local_light;
    if is_dark(light, point) { return class_word(CLASS_DARK, 0u, 0u, 0.0); }
    return cell_words[index_of(light, cell_of(cells_pass.grid, point.position))];
}
