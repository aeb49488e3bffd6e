// Sorts photons by light and cell (counting sort). Of the visibility map it judges each cell that holds some: is every
// point in it lit, is every one shadowed, do all see both?

import package::lib::dispatch::{dispatch_groups, group_index};
import package::lib::math::{oct_decode7, oct_within7, safe_sqrt};
import package::lib::photon::{CLASS_BOUNDARY, CLASS_DARK, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN, Photon, photon_is_shadow, photon_light, photon_normal};
import package::lib::grid::{ASKED_UNIT, ASKED_ZERO, AskedCell, COMPATIBLE_COSINE_SQUARED, COS_CLUSTER, FAR, GridShape, NORMAL_STRETCH, REACH_MAX, Verdict, asked_complement, cell_centre, cell_index, cell_of, decode_verdict, encode_verdict, load_cell_start, load_photon, nearest, reach_guess, row_photons, rows_about};

struct GridParameters {
    grid: GridShape,
    photon_count: u32,
    cell_count: u32,
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
@group(0) @binding(7) var<storage, read_write> judge_arguments: array<u32, 3>;
@group(0) @binding(8) var<storage, read_write> judged_cells: array<vec4u>;

// How many cells are asked about, how many of them are judged, and how many were before the last ones.
@group(0) @binding(9) var<storage, read_write> asked_lengths: array<atomic<u32>, 3>;
@group(0) @binding(12) var<storage, read_write> asked_arguments: array<u32, 3>;
@group(0) @binding(13) var<storage, read> asked_codes: array<u32>;
@group(0) @binding(14) var<storage, read_write> asked_cells: array<AskedCell>;

const GRID_GROUP = 64u;
// Cells that one invocation scans in turn: on lavapipe several times faster than a scan in shared memory.
const SCAN_SERIAL = 64u;
const SCAN_GROUP = 256u;

fn photon_cell(photon: Photon) -> u32 {
    return cell_index(grid_pass.grid, photon_light(photon.word), cell_of(grid_pass.grid, photon.position));
}

@compute @workgroup_size(64)
fn count(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * GRID_GROUP + lane;
    if i >= grid_pass.photon_count { return; }
    photon_ranks[i] = atomicAdd(&cell_counts[photon_cell(photons[i])], 1u);
}

@compute @workgroup_size(64)
fn sum(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
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

@compute @workgroup_size(64)
fn start(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
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

@compute @workgroup_size(64)
fn scatter(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * GRID_GROUP + lane;
    if i >= grid_pass.photon_count { return; }
    let photon = photons[i];
    sorted_photons[starts[photon_cell(photon)] + photon_ranks[i]] = photon;
}

@if(visibility_map)
@compute @workgroup_size(1)
fn arrange() {
    let size = dispatch_groups(atomicLoad(&occupied_cells[0]), GRID_GROUP);
    judge_arguments = array(size.x, size.y, size.z);
}

// Photons that a cell may hold to be judged: with the next limit well below the 65,535 iterations that lavapipe
// grants an invocation. Past either, queries do without a verdict.
const OWN_LIMIT = 2048u;
// Photons and rows of cells that one verdict may look at, as a multiple of k. On an even surface five times k are
// enough; where many are not of the surface (foliage), a verdict costs more than it saves.
const LOOKS_PER_NEAREST = 24u;
// At most, and for a cell that is asked about, whose answer many points share. Lavapipe's eight lanes share those iterations: of loops in
// loops that are long in turn, each lane waits for all others, and which cells are in its lanes depends on chance.
const MOST_LOOKS = 7168u;
const NO_CODE = 0xffffffffu;

@if(visibility_map)
@compute @workgroup_size(64)
fn judge(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * GRID_GROUP + lane;
    if i >= atomicLoad(&occupied_cells[0]) { return; }
    let cell = atomicLoad(&occupied_cells[1u + i]);
    let at = place_of_cell(cell);
    let light = light_of_cell(cell);
    let begin = load_cell_start(cell);
    let end = load_cell_start(cell + 1u);
    if end - begin > OWN_LIMIT { return; }

    // Two normals that do not depend on the order of the photons: that of the smallest code and the one farthest
    // from it. Most cells have photons of one surface, those at edges of two.
    var first = NO_CODE;
    for (var p = begin; p < end; p++) { first = min(first, load_photon(p).w & 0x3fffu); }
    let first_normal = oct_decode7(first);
    var second = NO_CODE;
    @if(!paper_counting) {
        var farthest = COS_CLUSTER;
        for (var p = begin; p < end; p++) {
            let code = load_photon(p).w & 0x3fffu;
            let cosine = dot(first_normal, oct_decode7(code));
            if cosine < farthest || (cosine == farthest && code < second) {
                farthest = cosine;
                second = code;
            }
        }
    }
    // A loop of data's own length: called twice, all of it would be in the kernel twice, and run for cells that have one surface.
    var words = vec4u(0u);
    let surfaces = select(2u, 1u, second == NO_CODE);
    for (var i = 0u; i < surfaces; i++) {
        let verdict = judge_photons(light, at, begin, end, select(second, first, i == 0u));
        words = select(vec4u(words.xy, verdict), vec4u(verdict, 0u, 0u), i == 0u);
    }
    judged_cells[cell] = words;
}

fn place_of_cell(cell: u32) -> vec3u {
    let size = grid_pass.grid.size;
    return vec3u(cell % size.x, (cell / size.x) % size.y, (cell / (size.x * size.y)) % size.z);
}

fn light_of_cell(cell: u32) -> u32 {
    @if(light_tags) {
        let size = grid_pass.grid.size;
        return cell / (size.x * size.y * size.z);
    }
    @else { return 0u; }
}

// The verdict for the surface of the cell's own photons whose normals are about that of the code.
fn judge_photons(light: u32, at: vec3u, begin: u32, end: u32, code: u32) -> vec2u {
    let cell = grid_pass.grid.cell;
    let normal = oct_decode7(code);
    let centre = cell_centre(grid_pass.grid, at);
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
    return judge_surface(light, at, code, low, high, cos_spread, min(LOOKS_PER_NEAREST * nearest, MOST_LOOKS));
}

// The asked cells to be judged: none where more are asked about than there is room for, since which of them have
// a place depends on chance.
@if(visibility_map)
@compute @workgroup_size(1)
fn arrange_asked() {
    let asked = atomicLoad(&asked_lengths[0]);
    let judged = atomicLoad(&asked_lengths[1]);
    let end = select(judged, asked, asked <= arrayLength(&asked_cells));
    atomicStore(&asked_lengths[1], end);
    atomicStore(&asked_lengths[2], judged);
    let size = dispatch_groups(end - judged, GRID_GROUP);
    asked_arguments = array(size.x, size.y, size.z);
}

@if(visibility_map)
@compute @workgroup_size(64)
fn judge_asked(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = atomicLoad(&asked_lengths[2]) + group_index(group, groups) * GRID_GROUP + lane;
    if i >= atomicLoad(&asked_lengths[1]) { return; }
    let cell = asked_cells[i].cell;
    let unit = ASKED_UNIT * grid_pass.grid.cell;
    let low = f32(i32(ASKED_ZERO) - i32(atomicLoad(&asked_cells[i].low))) * unit;
    let high = f32(i32(atomicLoad(&asked_cells[i].high)) - i32(ASKED_ZERO)) * unit;
    let cos_spread = 1.0 - f32(atomicLoad(&asked_cells[i].spread)) * ASKED_UNIT;
    let code = asked_complement(asked_codes[cell]);
    asked_cells[i].verdict = judge_surface(light_of_cell(cell), place_of_cell(cell), code, low, high, cos_spread, MOST_LOOKS);
}

// What holds for the points of a surface: those of the cell whose offsets along the code's normal are between `low` and
// `high`, or nearly, and whose normals are within the cone. No more than `most_looks` photons and rows are looked at.
fn judge_surface(light: u32, at: vec3u, code: u32, low: f32, high: f32, cosine: f32, most_looks: u32) -> vec2u {
    let cell = grid_pass.grid.cell;
    let normal = oct_decode7(code);
    // Rounding may put a point this far outside its cell.
    let half_size = 0.5005 * cell;
    let centre = cell_centre(grid_pass.grid, at);

    // A margin for the points between: the octahedral code's own error, 0.02 radians, and half of it more.
    let sine = safe_sqrt(1.0 - cosine * cosine);
    let cos_spread = cosine * 0.99955 - sine * 0.03;
    var verdict = Verdict(CLASS_DARK, normal, cos_spread, 0.5 * (low + high), 0.6 * (high - low) + 0.02 * cell, 0.0, 0.0);
    verdict = decode_verdict(encode_verdict(verdict, code, grid_pass.grid.inverse_cell), cell);

    // |n - normal| of any normal n in the cone.
    let tilt = safe_sqrt(2.0 - 2.0 * verdict.cos_spread) + 1e-4;
    let sin_spread = safe_sqrt(1.0 - verdict.cos_spread * verdict.cos_spread);
    // The 45 degrees less, and more, the spread: both below 90.
    let half_angle = sqrt(COMPATIBLE_COSINE_SQUARED);
    let cos_sure = min(half_angle * (verdict.cos_spread + sin_spread) + 1e-4, 1.0);
    let cos_maybe = half_angle * (verdict.cos_spread - sin_spread) - 1e-4;

    // Where in the cell the slab is.
    var box_low = vec3f(-half_size);
    var box_high = vec3f(half_size);
    @if(!paper_counting) {
        let others = half_size * (abs(normal.yzx) + abs(normal.zxy));
        let slab_low = (verdict.offset - verdict.thickness) - others;
        let slab_high = (verdict.offset + verdict.thickness) + others;
        let scale = 1.0 / max(abs(normal), vec3f(1e-6));
        let positive = normal >= vec3f(0.0);
        box_low = max(box_low, select(-slab_high, slab_low, positive) * scale);
        box_high = min(box_high, select(-slab_low, slab_high, positive) * scale);
    }
    let units_low = (centre + box_low - grid_pass.grid.origin) * grid_pass.grid.inverse_cell - 1e-3;
    let units_high = (centre + box_high - grid_pass.grid.origin) * grid_pass.grid.inverse_cell + 1e-3;

    // A guess at the reach from the photons here; wider until it holds enough of them.
    var reach = clamp(reach_guess(grid_pass.grid, light, at, 1.3) + 0.7, 1.0, REACH_MAX);
    // Eighths of the squared reach, about equal shares of a surface; counted only where both kinds are in reach.
    var marks_a = vec4f(0.0);
    var marks_b = vec4f(0.0);
    var counting = false;
    var looked_at = 0u;
    loop {
        let limit = reach * reach * cell * cell;
        var sure = 0u;
        var maybe = 0u;
        var sure_lit_count = 0u;
        var sure_a = vec4u(0u);
        var sure_b = vec4u(0u);
        var maybe_a = vec4u(0u);
        var maybe_b = vec4u(0u);
        // Squared distances: of the nearest photon that may count, and of the nearest that surely does, at most.
        var maybe_lit = FAR;
        var maybe_shadow = FAR;
        var sure_lit = FAR;
        var sure_shadow = FAR;
        let rows = rows_about(grid_pass.grid, units_low, units_high, reach + 2e-3, normal, tilt);
        for (var z = rows.y; z <= rows.w; z++) {
            for (var y = rows.x; y <= rows.z; y++) {
                let row = row_photons(grid_pass.grid, light, vec2i(y, z), units_low, units_high, reach + 2e-3, normal, tilt);
                looked_at += row.y - row.x + 1u;
                if looked_at > most_looks { return vec2u(0u); }
                for (var p = row.x; p < row.y; p++) {
                    let photon = load_photon(p);
                    var counts_surely = true;
                    var may_count = true;
                    @if(!paper_counting) {
                        counts_surely = oct_within7(photon.w, normal, cos_sure * cos_sure);
                        may_count = oct_within7(photon.w, normal, cos_maybe * cos_maybe);
                    }
                    let from_centre = bitcast<vec3f>(photon.xyz) - centre;
                    let least = max(max(from_centre - box_high, box_low - from_centre), vec3f(0.0));
                    let most = max(from_centre - box_low, box_high - from_centre);
                    let most_squared = dot(most, most);
                    let along = abs(dot(from_centre, normal) - verdict.offset);
                    let slack = verdict.thickness + tilt * sqrt(most_squared);
                    let along_least = max(along - slack, 0.0);
                    let along_most = along + slack;
                    // A hair of margin for the rounding of the query's own distance.
                    let lower = select(FAR, 0.9997 * (dot(least, least) + NORMAL_STRETCH * along_least * along_least), may_count);
                    let upper = select(FAR, 1.0003 * (most_squared + NORMAL_STRETCH * along_most * along_most), counts_surely);
                    let shadow = photon_is_shadow(photon.w);
                    let counts = upper <= limit;
                    sure += u32(counts);
                    maybe += u32(lower <= limit);
                    sure_lit_count += u32(counts && !shadow);
                    maybe_lit = min(maybe_lit, select(lower, FAR, shadow));
                    maybe_shadow = min(maybe_shadow, select(FAR, lower, shadow));
                    if counting {
                        sure_a += vec4u(vec4f(upper) <= marks_a);
                        sure_b += vec4u(vec4f(upper) <= marks_b);
                        maybe_a += vec4u(vec4f(lower) <= marks_a);
                        maybe_b += vec4u(vec4f(lower) <= marks_b);
                        sure_lit = min(sure_lit, select(upper, FAR, shadow));
                        sure_shadow = min(sure_shadow, select(FAR, upper, shadow));
                    }
                }
            }
        }
        if sure < nearest {
            if reach >= REACH_MAX {
                if maybe >= nearest { return vec2u(0u); }
                verdict.class_ = CLASS_UNKNOWN;
                verdict.reach = REACH_MAX * cell;
                return encode_verdict(verdict, code, grid_pass.grid.inverse_cell);
            }
            reach = min(reach * clamp(sqrt(f32(nearest) / f32(max(sure, 1u))) * 1.1, 1.25, 2.0), REACH_MAX);
            continue;
        }
        verdict.visibility = f32(sure_lit_count) / f32(sure);
        var bound = limit;
        if counting {
            // The first mark with enough photons below it.
            let below = vec4u(sure_a < vec4u(nearest)) + vec4u(sure_b < vec4u(nearest));
            bound = limit * 0.125 * f32(below.x + below.y + below.z + below.w + 1u);
        }
        verdict.reach = 1.0001 * sqrt(bound);
        if maybe_shadow > bound {
            verdict.class_ = CLASS_LIT;
        } else if maybe_lit > bound {
            verdict.class_ = CLASS_SHADOWED;
        } else if !counting {
            counting = true;
            marks_a = limit * vec4f(0.125, 0.25, 0.375, 0.5);
            marks_b = limit * vec4f(0.625, 0.75, 0.875, 1.0);
            continue;
        } else {
            let both = max(sure_lit, sure_shadow);
            if both <= limit {
                // Both kinds are among the nearest k if no more than k can be as near as the farther of the two.
                let closer = vec4u(marks_a < vec4f(both)) + vec4u(marks_b < vec4f(both));
                let mark = closer.x + closer.y + closer.z + closer.w;
                let rivals = select(maybe_b[mark & 3u], maybe_a[mark & 3u], mark < 4u);
                if rivals <= nearest { verdict.class_ = CLASS_BOUNDARY; }
            }
        }
        return encode_verdict(verdict, code, grid_pass.grid.inverse_cell);
    }
    return vec2u(0u);
}
