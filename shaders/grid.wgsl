// grid: sorts photons by light and cell (counting sort). For the visibility map it also classifies each cell that holds
// photons, and each cell that points request: is every point of its surface lit, is every one shadowed, do all have
// both kinds among their nearest k? In: photons (normalised space). Out: sorted photons, the first photon of each cell,
// two cell classes a cell (lib/cell_class). Paper, "Extending the photon map": the three cases.

import package::kit::{dispatch_groups, group_index};
import package::lib::math::oct_decode7;
import package::lib::cell_class::{COS_CLUSTER, REQUEST_UNIT, REQUEST_ZERO, RequestedCell, request_complement};
import package::lib::cell_classification::{Cluster, MAX_VISITS, VISITS_PER_NEAREST, classify_cluster};
import package::lib::photon::{Photon, photon_light, photon_normal};
import package::lib::grid::{
    GridShape, cell_centre, cell_in_grid, cell_index, cell_of, cells_of_a_light, load_cell_start, load_photon, nearest
};
import package::lib::constants::{PHOTON_NORMAL_MASK, SCAN_SERIAL};

struct GridParameters {
    grid: GridShape,
    photon_count: u32,
    // Cells of all lights.
    cell_count: u32,
    // Blocks of SCAN_SERIAL cells.
    scan_blocks: u32,
    padding: u32,
}

var<immediate> grid_pass: GridParameters;

@group(0) @binding(0) var<storage, read> photons: array<Photon>;
@group(0) @binding(1) var<storage, read_write> cell_counts: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read_write> photon_ranks: array<u32>;
@group(0) @binding(3) var<storage, read_write> block_sums: array<u32>;
@group(0) @binding(4) var<storage, read_write> starts: array<u32>;
@group(0) @binding(5) var<storage, read_write> sorted_photons: array<Photon>;
// The number of cells that hold photons, then those cells.
@group(0) @binding(6) var<storage, read_write> occupied_cells: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> classify_arguments: array<u32, 3>;
@group(0) @binding(8) var<storage, read_write> cell_class_words: array<vec4u>;

// Numbers of requested cells: of all, of those classified, and of those classified before the present dispatch.
@group(0) @binding(9) var<storage, read_write> request_counts: array<atomic<u32>, 3>;
@group(0) @binding(12) var<storage, read_write> request_arguments: array<u32, 3>;
@group(0) @binding(13) var<storage, read> requested_normals: array<u32>;
@group(0) @binding(14) var<storage, read_write> requested_cells: array<RequestedCell>;

// As GATHER_GROUP in src/kernels/numbers.rs; and as many as WebGPU promises, because one workgroup scans all blocks.
const GRID_GROUP = 64u;
const SCAN_GROUP = 256u;

fn photon_cell(photon: Photon) -> u32 {
    return cell_index(grid_pass.grid, photon_light(photon.word), cell_of(grid_pass.grid, photon.position));
}

// Counts the photons of each cell; the count so far is a photon's rank in its cell.
@compute @workgroup_size(64)
fn count(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * GRID_GROUP + lane;
    if i >= grid_pass.photon_count { return; }
    photon_ranks[i] = atomicAdd(&cell_counts[photon_cell(photons[i])], 1u);
}

// Sums the counts of each block of cells. One invocation scans a block: on lavapipe several times faster than a scan in
// shared memory.
@compute @workgroup_size(64)
fn sum(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = group_index(group, groups) * GRID_GROUP + lane;
    if block >= grid_pass.scan_blocks { return; }
    let end = min((block + 1u) * SCAN_SERIAL, grid_pass.cell_count);
    var total = 0u;
    for (var cell = block * SCAN_SERIAL; cell < end; cell++) {
        total += atomicLoad(&cell_counts[cell]);
    }
    block_sums[block] = total;
}

var<workgroup> scan_totals: array<u32, SCAN_GROUP>;

// One workgroup: the sums of the blocks become the sums of all blocks before them.
@compute @workgroup_size(256)
fn scan(@builtin(local_invocation_index) lane: u32) {
    let serial = (grid_pass.scan_blocks + SCAN_GROUP - 1u) / SCAN_GROUP;
    let begin = min(lane * serial, grid_pass.scan_blocks);
    let end = min(begin + serial, grid_pass.scan_blocks);
    var total = 0u;
    for (var i = begin; i < end; i++) { total += block_sums[i]; }
    scan_totals[lane] = total;
    workgroupBarrier();
    if lane == 0u {
        var before = 0u;
        for (var i = 0u; i < SCAN_GROUP; i++) {
            let here = scan_totals[i];
            scan_totals[i] = before;
            before += here;
        }
    }
    workgroupBarrier();
    var before = scan_totals[lane];
    for (var i = begin; i < end; i++) {
        let here = block_sums[i];
        block_sums[i] = before;
        before += here;
    }
}

// The index of each cell's first photon, from the counts of its block and the sum of the blocks before; and the list of
// the cells that hold photons.
@compute @workgroup_size(64)
fn start(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = group_index(group, groups) * GRID_GROUP + lane;
    if block >= grid_pass.scan_blocks { return; }
    let end = min((block + 1u) * SCAN_SERIAL, grid_pass.cell_count);
    var before = block_sums[block];
    for (var cell = block * SCAN_SERIAL; cell < end; cell++) {
        let here = atomicLoad(&cell_counts[cell]);
        starts[cell] = before;
        before += here;
        if here > 0u { atomicStore(&occupied_cells[1u + atomicAdd(&occupied_cells[0], 1u)], cell); }
    }
    if end == grid_pass.cell_count { starts[end] = before; }
}

// Writes each photon behind those of lower rank in its cell.
@compute @workgroup_size(64)
fn scatter(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * GRID_GROUP + lane;
    if i >= grid_pass.photon_count { return; }
    let photon = photons[i];
    sorted_photons[starts[photon_cell(photon)] + photon_ranks[i]] = photon;
}

@if(visibility_map)
@compute @workgroup_size(1)
fn arrange() {
    let size = dispatch_groups(atomicLoad(&occupied_cells[0]), GRID_GROUP);
    classify_arguments = array(size.x, size.y, size.z);
}

// Maximum number of photons of a cell that is classified; other cells have no class. Up to four loops over them take
// seven of the eight thousand iterations that eight lanes of MAX_VISITS (lib/cell_classification) leave of lavapipe's
// 65,535. The last thousand are for the loops around the rows: a reach that grows by quarters from one cell to eight
// passes a hundred layers of rows, in each of eight lanes.
const MAX_OWN_PHOTONS = 1792u;
const NO_CODE = 0xffffffffu;

// The classes of the cells that hold photons.
@if(visibility_map)
@compute @workgroup_size(64)
fn classify_cells(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * GRID_GROUP + lane;
    if i >= atomicLoad(&occupied_cells[0]) { return; }
    let cell = atomicLoad(&occupied_cells[1u + i]);
    let begin = load_cell_start(cell);
    let end = load_cell_start(cell + 1u);
    if end - begin > MAX_OWN_PHOTONS { return; }
    let codes = surface_normals(begin, end);
    // A loop, because two calls would be in the kernel twice, and software devices would run both for cells of one
    // surface too.
    var words = vec4u(0u);
    let surfaces = select(2u, 1u, codes.y == NO_CODE);
    for (var i = 0u; i < surfaces; i++) {
        let cluster = cluster_of_photons(cell, begin, end, select(codes.y, codes.x, i == 0u));
        // Two surfaces share the iterations that lavapipe grants.
        let visits = min(VISITS_PER_NEAREST * nearest, MAX_VISITS / surfaces);
        let class_words = classify_cluster(grid_pass.grid, cluster, visits);
        words = select(vec4u(words.xy, class_words), vec4u(class_words, 0u, 0u), i == 0u);
    }
    cell_class_words[cell] = words;
}

// Two normals of the photons from `begin` to `end`: the one with the smallest code, so that the choice does not depend
// on their order, and the one farthest from it, or NO_CODE. Most cells have photons of one surface, cells at edges have
// two.
fn surface_normals(begin: u32, end: u32) -> vec2u {
    var first = NO_CODE;
    for (var p = begin; p < end; p++) { first = min(first, load_photon(p).w & PHOTON_NORMAL_MASK); }
    var second = NO_CODE;
    @if(!paper_counting) {
        let first_normal = oct_decode7(first);
        var farthest = COS_CLUSTER;
        for (var p = begin; p < end; p++) {
            let code = load_photon(p).w & PHOTON_NORMAL_MASK;
            let cosine = dot(first_normal, oct_decode7(code));
            if cosine < farthest || (cosine == farthest && code < second) {
                farthest = cosine;
                second = code;
            }
        }
    }
    return vec2u(first, second);
}

fn cell_of_index(index: u32) -> vec3u {
    return cell_in_grid(grid_pass.grid, index % cells_of_a_light(grid_pass.grid));
}

fn light_of_index(index: u32) -> u32 {
    @if(light_tags) { return index / cells_of_a_light(grid_pass.grid); }
    @else { return 0u; }
}

// The surface of a cell's own photons whose normals are near that of the code.
fn cluster_of_photons(index: u32, begin: u32, end: u32, code: u32) -> Cluster {
    let cell = grid_pass.grid.cell;
    let normal = oct_decode7(code);
    let centre = cell_centre(grid_pass.grid, cell_of_index(index));
    var low = 4.0 * cell;
    var high = -4.0 * cell;
    var cos_spread = 1.0;
    for (var p = begin; p < end; p++) {
        let photon = load_photon(p);
        let cosine = dot(normal, photon_normal(photon.w));
        if cosine >= COS_CLUSTER {
            let offset = dot(bitcast<vec3f>(photon.xyz) - centre, normal);
            low = min(low, offset);
            high = max(high, offset);
            cos_spread = min(cos_spread, cosine);
        }
    }
    return Cluster(light_of_index(index), cell_of_index(index), code, low, high, cos_spread);
}

// The requested cells to classify. If there are more requests than entries, none are classified, because which cells
// have an entry then depends on the order of invocations.
@if(visibility_map)
@compute @workgroup_size(1)
fn arrange_requests() {
    let requested = atomicLoad(&request_counts[0]);
    let classified = atomicLoad(&request_counts[1]);
    let end = select(classified, requested, requested <= arrayLength(&requested_cells));
    atomicStore(&request_counts[1], end);
    atomicStore(&request_counts[2], classified);
    let size = dispatch_groups(end - classified, GRID_GROUP);
    request_arguments = array(size.x, size.y, size.z);
}

// The classes of the requested cells, for the surface of the points that requested them.
@if(visibility_map)
@compute @workgroup_size(64)
fn classify_requested_cells(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = atomicLoad(&request_counts[2]) + group_index(group, groups) * GRID_GROUP + lane;
    if i >= atomicLoad(&request_counts[1]) { return; }
    let cell = requested_cells[i].cell;
    let unit = REQUEST_UNIT * grid_pass.grid.cell;
    let low = f32(i32(REQUEST_ZERO) - i32(atomicLoad(&requested_cells[i].low))) * unit;
    let high = f32(i32(atomicLoad(&requested_cells[i].high)) - i32(REQUEST_ZERO)) * unit;
    let cos_spread = 1.0 - f32(atomicLoad(&requested_cells[i].spread)) * REQUEST_UNIT;
    let code = request_complement(requested_normals[cell]);
    let cluster = Cluster(light_of_index(cell), cell_of_index(cell), code, low, high, cos_spread);
    requested_cells[i].class_words = classify_cluster(grid_pass.grid, cluster, MAX_VISITS);
}
