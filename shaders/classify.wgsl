// Says of points, light by light, whether their nearest photons are all lit, all shadowed, or both.

import package::lib::dispatch::{dispatch_groups, group_index};
import package::lib::math::{oct_decode16, oct_decode7, oct_encode7};
import package::lib::photon::{CLASS_BOUNDARY, CLASS_DARK, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN, PHOTON_WEIGHT, class_of, class_word, photon_is_shadow, photon_weight_sixteenths, audit_chance, is_audited, is_near, near_word};
import package::lib::grid::{ASKED_UNIT, ASKED_ZERO, AskedCell, COS_CLUSTER, FAR, GridShape, REACH_MAX, Verdict, asked_complement, cell_centre, cell_index, cell_of, counted_distance, decode_verdict, load_cell_record, load_photon, nearest, no_verdict, reach_guess, row_photons, rows_about, verdict_holds};
@if(dark_points) import package::lib::light::light_dark;
@if(visibility_map && environment) import package::lib::light::environment::is_environment;
@if(visibility_estimate) import package::lib::photon::asks_shadow_rays;
import package::lib::sampled_light::slot_light;
@if(light_sampling) import package::lib::sampled_light::NO_LIGHT;
import package::lib::point::Point;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::constants::{INVALID_POINT, COUNTER_DARK, COUNTER_AUDITED, COUNTER_NEAR, COUNTER_NEAR_AUDITED};

// n_i and n_s of boundary points are the exact counts, not those about the middle of a cell.
override exact_counts: bool;

struct ClassifyParameters {
    grid: GridShape,
    tile: Tile,
    // (light, point) pairs: points of the chunk's first light, of its second, ...
    slot_count: u32,
    // Or turn, where lights are chosen; see lib/light_sampling.
    first_light: u32,
    dilate_radius: u32,
    audit_probability: f32,
    // Which of the queues `arrange_queue` makes arguments for, and for workgroups of how many.
    queue: u32,
    queue_group: u32,
    padding: vec2u,
}

var<immediate> classify_pass: ClassifyParameters;

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read_write> classes: array<u32>;
@group(0) @binding(2) var<storage, read_write> query_queue: array<u32>;
// Lengths of the queries', the boundary and the audit queue, and of that of pass `shade`.
@group(0) @binding(3) var<storage, read_write> queue_lengths: array<atomic<u32>, 4>;
// Of each queue three words and one unused.
@group(0) @binding(4) var<storage, read_write> queue_arguments: array<u32, 16>;
@group(0) @binding(5) var<storage, read_write> dilated_classes: array<u32>;
@group(0) @binding(6) var<storage, read_write> boundary_queue: array<u32>;
@group(0) @binding(7) var<storage, read_write> audit_queue: array<u32>;
@group(0) @binding(8) var<storage, read_write> counters: array<atomic<u32>>;

// Cells that are asked about: by cell the normal's code and the place in `asked_cells`, from 1; see lib/grid.wgsl.
@if(visibility_map) @group(0) @binding(9) var<storage, read_write> asked_codes: array<atomic<u32>>;
@if(visibility_map) @group(0) @binding(10) var<storage, read_write> asked_places: array<u32>;
@if(visibility_map) @group(0) @binding(11) var<storage, read_write> asked_cells: array<AskedCell>;
@if(visibility_map) @group(0) @binding(12) var<storage, read_write> asked_lengths: array<atomic<u32>, 3>;

// No class: the verdicts settle nothing.
const UNDECIDED = 0xffffffffu;
const QUERY_QUEUE = 0u;
const BOUNDARY_QUEUE = 1u;
const AUDIT_QUEUE = 2u;
const CLASSES = 5u;
const CLASSIFY_GROUP = 64u;

var<workgroup> group_length: atomic<u32>;
var<workgroup> group_base: u32;
var<workgroup> group_classes: atomic<u32>;
var<workgroup> group_unknown: atomic<u32>;
var<workgroup> group_audits: atomic<u32>;
// Decided points near boundaries; above 16 bits, those of them that are audited.
var<workgroup> group_near: atomic<u32>;
var<workgroup> audit_base: u32;
@if(visibility_estimate) var<workgroup> group_asked: atomic<u32>;

// Classes by the verdicts on whole cells; the slots that have none are queued for `query`.
@compute @workgroup_size(64)
fn classify(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let slot = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if lane == 0u { atomicStore(&group_length, 0u); }
    workgroupBarrier();
    var rank = 0u;
    var queued = false;
    if slot < classify_pass.slot_count {
        let word = class_by_verdict(slot);
        queued = word == UNDECIDED;
        if queued { rank = atomicAdd(&group_length, 1u); } else { classes[slot] = word; }
    }
    workgroupBarrier();
    if lane == 0u {
        let length = atomicLoad(&group_length);
        if length > 0u { group_base = atomicAdd(&queue_lengths[QUERY_QUEUE], length); }
    }
    workgroupBarrier();
    if queued { query_queue[group_base + rank] = slot; }
}

fn light_of_slot(slot: u32) -> u32 {
    return slot_light(slot, classify_pass.first_light, classify_pass.tile.point_count);
}

fn class_by_verdict(slot: u32) -> u32 {
    let local_light = slot / classify_pass.tile.point_count;
    let point = points[slot - local_light * classify_pass.tile.point_count];
    if point.normal == INVALID_POINT { return class_word(CLASS_DARK, 0u, 0u, 0.0); }
    let normal = oct_decode16(point.normal);
    let light = light_of_slot(slot);
    @if(light_sampling) { if light == NO_LIGHT { return class_word(CLASS_DARK, 0u, 0u, 0.0); } }
    @if(dark_points) {
        if light_dark(light, point.position, normal) { return class_word(CLASS_DARK, 0u, 0u, 0.0); }
    }
    @if(!visibility_map) { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.0); }
    @if(visibility_map) {
        // There are no photons of it.
        @if(environment) { if is_environment(light) { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.0); } }
        let verdict = verdict_at(light, point.position, normal);
        if verdict.reach == 0.0 { ask_about_cell(light, point.position, normal); }
        return class_of_verdict(verdict);
    }
}

// The first to ask about a cell finds it a place.
@if(visibility_map)
fn ask_about_cell(light: u32, position: vec3f, normal: vec3f) {
    let at = cell_of(classify_pass.grid, position);
    if !in_cell(from_centre_of(at, position)) { return; }
    let cell = cell_index(classify_pass.grid, light, at);
    if atomicMax(&asked_codes[cell], asked_complement(oct_encode7(normal))) == 0u {
        let place = atomicAdd(&asked_lengths[0], 1u);
        if place < arrayLength(&asked_cells) {
            asked_cells[place].cell = cell;
            asked_places[cell] = place + 1u;
        }
    }
}

// The slab and the cone of the points that ask, cell by cell.
@if(visibility_map) @compute @workgroup_size(64)
fn ask(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if i >= atomicLoad(&queue_lengths[QUERY_QUEUE]) { return; }
    let slot = query_queue[i];
    let local_light = slot / classify_pass.tile.point_count;
    let point = points[slot - local_light * classify_pass.tile.point_count];
    let at = cell_of(classify_pass.grid, point.position);
    let from_centre = from_centre_of(at, point.position);
    let cell = cell_index(classify_pass.grid, light_of_slot(slot), at);
    let place = asked_places[cell];
    // Cells that are judged already stay as they are.
    if !in_cell(from_centre) || place <= atomicLoad(&asked_lengths[1]) { return; }
    let surface_normal = oct_decode7(asked_complement(atomicLoad(&asked_codes[cell])));
    let cosine = dot(oct_decode16(point.normal), surface_normal);
    if cosine < COS_CLUSTER { return; }
    let offset = dot(from_centre, surface_normal) * (classify_pass.grid.inverse_cell / ASKED_UNIT);
    atomicMax(&asked_cells[place - 1u].low, u32(i32(ASKED_ZERO) - i32(floor(offset))));
    atomicMax(&asked_cells[place - 1u].high, u32(i32(ASKED_ZERO) + i32(ceil(offset))));
    atomicMax(&asked_cells[place - 1u].spread, u32(ceil((1.0 - cosine) / ASKED_UNIT)));
}

fn from_centre_of(cell: vec3u, position: vec3f) -> vec3f {
    return position - cell_centre(classify_pass.grid, cell);
}

// A point outside of the grid is in no cell.
fn in_cell(from_centre: vec3f) -> bool {
    return all(abs(from_centre) <= vec3f(0.5004 * classify_pass.grid.cell));
}

// The class word that a verdict stands for, or UNDECIDED.
@if(visibility_map)
fn class_of_verdict(verdict: Verdict) -> u32 {
    if verdict.class_ == CLASS_LIT { return class_word(CLASS_LIT, nearest, 0u, 1.0); }
    if verdict.class_ == CLASS_SHADOWED { return class_word(CLASS_SHADOWED, 0u, nearest, 0.0); }
    if verdict.class_ == CLASS_BOUNDARY && !exact_counts {
        let lit = clamp(u32(round(verdict.visibility * f32(nearest))), 1u, nearest - 1u);
        return class_word(CLASS_BOUNDARY, lit, nearest - lit, verdict.visibility);
    }
    if verdict.class_ == CLASS_UNKNOWN && !exact_counts { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.5); }
    return UNDECIDED;
}

// The verdict that holds at the point; one without class or reach where there is none.
fn verdict_at(light: u32, position: vec3f, normal: vec3f) -> Verdict {
    let cell = cell_of(classify_pass.grid, position);
    let record = load_cell_record(cell_index(classify_pass.grid, light, cell));
    let from_centre = from_centre_of(cell, position);
    if in_cell(from_centre) {
        for (var i = 0u; i < 2u; i++) {
            let verdict = decode_verdict(select(record.zw, record.xy, i == 0u), classify_pass.grid.cell);
            if verdict_holds(verdict, from_centre, normal) { return verdict; }
        }
    }
    return no_verdict();
}

// The same of the verdict on an asked cell.
@if(visibility_map)
fn asked_verdict_at(light: u32, position: vec3f, normal: vec3f) -> Verdict {
    let cell = cell_of(classify_pass.grid, position);
    let from_centre = from_centre_of(cell, position);
    let place = asked_places[cell_index(classify_pass.grid, light, cell)];
    if in_cell(from_centre) && place > 0u {
        let verdict = decode_verdict(asked_cells[place - 1u].verdict, classify_pass.grid.cell);
        if verdict_holds(verdict, from_centre, normal) { return verdict; }
    }
    return no_verdict();
}

// Photons of a search that lie within marks of squared distance: all, and illumination photons.
struct Tally {
    all_a: vec4u,
    all_b: vec4u,
    lit_a: vec4u,
    lit_b: vec4u,
    // Sixteenths of hits that shadow photons stand for beyond one each: within the last mark, within the floor.
    excess: u32,
    excess_below: u32,
    complete: bool,
}

// Photons and rows of cells that the searches of one query may look at, as a multiple of k, at least and at most; past it
// the point is unknown. Where so many are not of the surface (foliage), looking costs more than the shadow rays that it could
// save. Exact counts are given as much again, within the same limit.
const LOOKS_PER_NEAREST = 64u;
@if(!paper_counting) const LEAST_LOOKS = 3200u;
// Without the normals a search is a ball, and not flat; this counting is there to be compared, not for its speed.
@if(paper_counting) const LEAST_LOOKS = 24000u;
// The eight lanes of a vector share the 65,535 iterations that lavapipe grants, where their rows are long in turn and each waits for
// all others. Queries of the paper's counting are of neighbours, which look at the same rows, and keep to what one lane is granted.
@if(texture_loads && !paper_counting) const MOST_LOOKS = 8000u;
@if(!texture_loads || paper_counting) const MOST_LOOKS = 48000u;

var<private> looks_left: u32;

fn look_allowance() -> u32 {
    return clamp(LOOKS_PER_NEAREST * nearest, LEAST_LOOKS, select(MOST_LOOKS, MOST_LOOKS / 2u, exact_counts));
}

// Counts within `floor` + eighths of `span`, squared distances both.
fn tally(light: u32, position: vec3f, normal: vec3f, reach: f32, floor_: f32, span: f32) -> Tally {
    let grid = classify_pass.grid;
    let marks_a = floor_ + span * vec4f(0.125, 0.25, 0.375, 0.5);
    let marks_b = floor_ + span * vec4f(0.625, 0.75, 0.875, 1.0);
    var result = Tally(vec4u(0u), vec4u(0u), vec4u(0u), vec4u(0u), 0u, 0u, false);
    let units = (position - grid.origin) * grid.inverse_cell;
    // A margin for the rounding of cells' borders.
    let reach_units = reach * grid.inverse_cell * 1.0001 + 1e-3;
    let rows = rows_about(grid, units, units, reach_units, normal, 0.0);
    for (var z = rows.y; z <= rows.w; z++) {
        for (var y = rows.x; y <= rows.z; y++) {
            let row = row_photons(grid, light, vec2i(y, z), units, units, reach_units, normal, 0.0);
            let looks = row.y - row.x + 1u;
            if looks > looks_left { return result; }
            looks_left -= looks;
            for (var p = row.x; p < row.y; p++) {
                let photon = load_photon(p);
                let d = counted_distance(photon, position, normal);
                let shadow = photon_is_shadow(photon.w);
                let d_lit = select(d, FAR, shadow);
                result.all_a += vec4u(vec4f(d) <= marks_a);
                result.all_b += vec4u(vec4f(d) <= marks_b);
                result.lit_a += vec4u(vec4f(d_lit) <= marks_a);
                result.lit_b += vec4u(vec4f(d_lit) <= marks_b);
                if (photon.w & PHOTON_WEIGHT) != 0u && d <= marks_b.w {
                    let excess = photon_weight_sixteenths(photon.w) - 16u;
                    result.excess += excess;
                    result.excess_below += select(0u, excess, d <= floor_);
                }
            }
        }
    }
    result.complete = true;
    return result;
}

// The exact search for the slots that no verdict settled.
@if(visibility_map) @compute @workgroup_size(64)
fn query(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if i >= atomicLoad(&queue_lengths[QUERY_QUEUE]) { return; }
    let slot = query_queue[i];
    let local_light = slot / classify_pass.tile.point_count;
    let point = points[slot - local_light * classify_pass.tile.point_count];
    let light = light_of_slot(slot);
    let normal = oct_decode16(point.normal);
    var verdict = verdict_at(light, point.position, normal);
    if verdict.reach == 0.0 { verdict = asked_verdict_at(light, point.position, normal); }
    var word = class_of_verdict(verdict);
    if word == UNDECIDED { word = near_word(class_by_search(light, point.position, normal, verdict.reach)); }
    classes[slot] = word;
}

// What a search finds within a distance.
struct Found {
    // Photons, and illumination photons of them.
    all: u32,
    lit: u32,
    // Sixteenths of hits that the shadow photons stand for beyond one each.
    excess: u32,
    // Squared distances of the nearest of each kind.
    nearest_lit: f32,
    nearest_shadow: f32,
    complete: bool,
}

fn search(light: u32, position: vec3f, normal: vec3f, limit: f32) -> Found {
    let grid = classify_pass.grid;
    var result = Found(0u, 0u, 0u, FAR, FAR, false);
    let units = (position - grid.origin) * grid.inverse_cell;
    // A margin for the rounding of cells' borders.
    let reach = sqrt(limit) * grid.inverse_cell * 1.0001 + 1e-3;
    let rows = rows_about(grid, units, units, reach, normal, 0.0);
    for (var z = rows.y; z <= rows.w; z++) {
        for (var y = rows.x; y <= rows.z; y++) {
            let row = row_photons(grid, light, vec2i(y, z), units, units, reach, normal, 0.0);
            let looks = row.y - row.x + 1u;
            if looks > looks_left { return result; }
            looks_left -= looks;
            for (var p = row.x; p < row.y; p++) {
                let photon = load_photon(p);
                let d = counted_distance(photon, position, normal);
                let shadow = photon_is_shadow(photon.w);
                result.all += u32(d <= limit);
                result.lit += u32(d <= limit && !shadow);
                result.nearest_lit = min(result.nearest_lit, select(d, FAR, shadow));
                result.nearest_shadow = min(result.nearest_shadow, select(FAR, d, shadow));
                if (photon.w & PHOTON_WEIGHT) != 0u && d <= limit {
                    result.excess += photon_weight_sixteenths(photon.w) - 16u;
                }
            }
        }
    }
    result.complete = true;
    return result;
}

// The first look at a point whose reach is known: this share of the squared reach, which holds somewhat fewer than k.
const SHORT_SHARE = 0.35;

fn class_by_search(light: u32, position: vec3f, normal: vec3f, known_reach: f32) -> u32 {
    looks_left = look_allowance();
    let grid = classify_pass.grid;
    let farthest = REACH_MAX * grid.cell;
    let unknown = class_word(CLASS_UNKNOWN, 0u, 0u, 0.5);

    // The nearest k, and perhaps more, are within the reach.
    var reach = known_reach;
    if reach == 0.0 {
        reach = grid.cell * max(reach_guess(grid, light, cell_of(grid, position), 1.3), 0.1);
    }
    reach = min(reach, farthest);
    // Where it is sure that there are k, a few of both kinds nearby are enough to see a boundary.
    let short = known_reach > 0.0 && !exact_counts;
    var limit = reach * reach * select(1.0, SHORT_SHARE, short);
    var visibility = 0.0;
    var deciding = false;
    loop {
        let found = search(light, position, normal, limit);
        if !found.complete { return unknown; }
        if deciding {
            // Both kinds are among the nearest k where the nearest of the farther kind is.
            if found.all <= nearest { break; }
            if found.nearest_lit < found.nearest_shadow { return class_word(CLASS_LIT, nearest, 0u, 1.0); }
            return class_word(CLASS_SHADOWED, 0u, nearest, 0.0);
        }
        if short && found.all <= nearest && max(found.nearest_lit, found.nearest_shadow) <= limit {
            visibility = f32(found.lit) / (f32(found.all) + f32(found.excess) / 16.0);
            break;
        }
        if found.all < nearest {
            if limit < reach * reach {
                limit = reach * reach;
                continue;
            }
            if reach >= farthest { return class_word(CLASS_UNKNOWN, found.lit, found.all - found.lit, 0.5); }
            let more = 1.15 * sqrt(f32(nearest) / f32(max(found.all, 1u)));
            reach = min(reach * clamp(more, 1.25, 2.0), farthest);
            limit = reach * reach;
            continue;
        }
        if found.nearest_shadow > limit { return class_word(CLASS_LIT, nearest, 0u, 1.0); }
        if found.nearest_lit > limit { return class_word(CLASS_SHADOWED, 0u, nearest, 0.0); }
        visibility = f32(found.lit) / (f32(found.all) + f32(found.excess) / 16.0);
        limit = max(found.nearest_lit, found.nearest_shadow);
        deciding = true;
    }
    if exact_counts {
        looks_left += look_allowance();
        return class_by_counts(light, position, normal, reach);
    }
    let lit = clamp(u32(round(visibility * f32(nearest))), 1u, nearest - 1u);
    return class_word(CLASS_BOUNDARY, lit, nearest - lit, visibility);
}

// The exact n_i and n_s of a point whose nearest k are within the reach.
fn class_by_counts(light: u32, position: vec3f, normal: vec3f, reach: f32) -> u32 {
    let unknown = class_word(CLASS_UNKNOWN, 0u, 0u, 0.5);
    var floor_ = 0.0;
    var span = reach * reach;
    var found = tally(light, position, normal, reach, floor_, span);
    if !found.complete { return unknown; }

    // The k-th is between two marks; look closer until they have none but it between them.
    var all_below = 0u;
    var lit_below = 0u;
    for (var pass_ = 0u; ; pass_++) {
        let below = vec4u(found.all_a < vec4u(nearest)) + vec4u(found.all_b < vec4u(nearest));
        let mark = below.x + below.y + below.z + below.w;
        let within = select(found.all_b[mark & 3u], found.all_a[mark & 3u], mark < 4u);
        let lit = select(found.lit_b[mark & 3u], found.lit_a[mark & 3u], mark < 4u);
        if lit == within { return class_word(CLASS_LIT, nearest, 0u, 1.0); }
        if lit == 0u { return class_word(CLASS_SHADOWED, 0u, nearest, 0.0); }
        if mark > 0u {
            let last = mark - 1u;
            all_below = select(found.all_b[last & 3u], found.all_a[last & 3u], last < 4u);
            lit_below = select(found.lit_b[last & 3u], found.lit_a[last & 3u], last < 4u);
        }
        let rest = nearest - all_below;
        let narrower = span * 0.125;
        let next_floor = floor_ + narrower * f32(mark);
        // Distances that no float lies between are ties: illumination photons first, whatever their order.
        let tied = pass_ > 12u || next_floor + narrower * 0.125 <= next_floor;
        if within == nearest || tied {
            var n_i = lit;
            if within > nearest {
                n_i = lit_below + min(lit - lit_below, rest);
            }
            let n_s = nearest - n_i;
            if n_s == 0u { return class_word(CLASS_LIT, nearest, 0u, 1.0); }
            if n_i == 0u { return class_word(CLASS_SHADOWED, 0u, nearest, 0.0); }
            var visibility = f32(n_i) / f32(nearest);
            // Shadow photons may stand for several hits each.
            if found.excess > 0u {
                let end = next_floor + narrower;
                let weighed = tally(light, position, normal, sqrt(end) * 1.0001, next_floor, end - next_floor);
                if !weighed.complete { return unknown; }
                let shadow_below = all_below - lit_below;
                let shadow_between = (within - lit) - shadow_below;
                let taken = f32(n_s - shadow_below) / f32(max(shadow_between, 1u));
                let excess = f32(weighed.excess_below) + taken * f32(weighed.excess - weighed.excess_below);
                visibility = f32(n_i) / (f32(nearest) + excess / 16.0);
            }
            return class_word(CLASS_BOUNDARY, n_i, n_s, visibility);
        }
        floor_ = next_floor;
        span = narrower;
        found = tally(light, position, normal, min(sqrt(floor_ + span) * 1.0001, reach), floor_, span);
        if !found.complete { return unknown; }
    }
    return unknown;
}

// How far the neighbour may lie from the point's plane, as a share of its distance: about 15 degrees.
const DILATE_SLOPE = 0.25;
// Normals of neighbours on one surface: 25 degrees.
const DILATE_COSINE = 0.9063;

// A lit or shadowed point becomes a boundary where a neighbour on the same surface is one, or is unknown. Few points
// are, so each of those looks for such neighbours and writes their words; the others are copied beforehand.
@compute @workgroup_size(64)
fn dilate(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let slot = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if slot >= classify_pass.slot_count { return; }
    let own = class_of(classes[slot]);
    if own != CLASS_BOUNDARY && own != CLASS_UNKNOWN { return; }
    let first = slot / classify_pass.tile.point_count * classify_pass.tile.point_count;
    let pixel = slot - first;
    // Neighbours are of the same sample: the tile's samples are layers of whole rows.
    let width = i32(classify_pass.tile.width);
    let rows = i32(classify_pass.tile.pixel_count) / width;
    let top = i32(pixel / classify_pass.tile.pixel_count) * rows;
    let at = vec2i(i32(pixel) % width, i32(pixel) / width);
    let radius = i32(classify_pass.dilate_radius);
    let low = max(at - radius, vec2i(0, top));
    let high = min(at + radius, vec2i(width, top + rows) - 1);
    for (var y = low.y; y <= high.y; y++) {
        for (var x = low.x; x <= high.x; x++) {
            let other = u32(y * width + x);
            let word = classes[first + other];
            let class_ = class_of(word);
            if (class_ == CLASS_LIT || class_ == CLASS_SHADOWED) && same_surface(points[other], points[pixel]) {
                dilated_classes[first + other] = (word & ~7u) | CLASS_BOUNDARY;
            }
        }
    }
}

fn same_surface(a: Point, b: Point) -> bool {
    let normal = oct_decode16(a.normal);
    let v = b.position - a.position;
    return dot(normal, oct_decode16(b.normal)) >= DILATE_COSINE && abs(dot(v, normal)) <= DILATE_SLOPE * length(v);
}

// Counts the classes, and queues the slots that shadow rays are for: those that ask them, and audits.
@compute @workgroup_size(64)
fn compact(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let slot = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if lane == 0u {
        atomicStore(&group_classes, 0u);
        atomicStore(&group_unknown, 0u);
        atomicStore(&group_audits, 0u);
        atomicStore(&group_near, 0u);
        @if(visibility_estimate) { atomicStore(&group_asked, 0u); }
    }
    workgroupBarrier();
    var rank = 0u;
    var class_ = CLASS_DARK;
    var audited = false;
    @if(visibility_estimate) var asked = false;
    if slot < classify_pass.slot_count {
        let local_light = slot / classify_pass.tile.point_count;
        let pixel = slot - local_light * classify_pass.tile.point_count;
        var is_point = points[pixel].normal != INVALID_POINT;
        @if(light_sampling) { is_point = is_point && light_of_slot(slot) != NO_LIGHT; }
        if is_point {
            let word = dilated_classes[slot];
            class_ = class_of(word);
            if class_ == CLASS_UNKNOWN {
                rank = atomicAdd(&group_unknown, 1u);
            } else {
                // A byte for each of the other classes: one atomic counts them all, and ranks the boundary points.
                rank = atomicAdd(&group_classes, 1u << (8u * class_)) >> 24u;
            }
            if class_ == CLASS_LIT || class_ == CLASS_SHADOWED {
                let light = light_of_slot(slot);
                let sample_index = tile_sample(classify_pass.tile, pixel);
                let chance = audit_chance(word, classify_pass.audit_probability);
                audited = is_audited(pixel_seed(classify_pass.tile, pixel), sample_index, light, chance);
                if is_near(word) { atomicAdd(&group_near, 1u + (u32(audited) << 16u)); }
            }
            if audited { rank = atomicAdd(&group_audits, 1u); }
            @if(visibility_estimate) {
                asked = asks_shadow_rays(word);
                if asked { rank = atomicAdd(&group_asked, 1u); }
            }
        }
    }
    workgroupBarrier();
    let classes_here = atomicLoad(&group_classes);
    let unknown_here = atomicLoad(&group_unknown);
    let boundaries = classes_here >> 24u;
    if lane == 0u {
        @if(visibility_estimate) let length = atomicLoad(&group_asked);
        @if(!visibility_estimate) let length = boundaries + unknown_here;
        if length > 0u { group_base = atomicAdd(&queue_lengths[BOUNDARY_QUEUE], length); }
        let audits = atomicLoad(&group_audits);
        if audits > 0u {
            audit_base = atomicAdd(&queue_lengths[AUDIT_QUEUE], audits);
            atomicAdd(&counters[COUNTER_AUDITED], audits);
        }
        let near = atomicLoad(&group_near);
        if near > 0u {
            atomicAdd(&counters[COUNTER_NEAR], near & 0xffffu);
            atomicAdd(&counters[COUNTER_NEAR_AUDITED], near >> 16u);
        }
    }
    if lane < CLASSES {
        let counted = select(unknown_here, (classes_here >> (8u * lane)) & 255u, lane < CLASS_UNKNOWN);
        if counted > 0u { atomicAdd(&counters[COUNTER_DARK + lane], counted); }
    }
    workgroupBarrier();
    @if(visibility_estimate) { if asked { boundary_queue[group_base + rank] = slot; } }
    @if(!visibility_estimate) {
        if class_ == CLASS_BOUNDARY { boundary_queue[group_base + rank] = slot; }
        if class_ == CLASS_UNKNOWN { boundary_queue[group_base + boundaries + rank] = slot; }
    }
    if audited { audit_queue[audit_base + rank] = slot; }
}

// Makes a queue's length into the arguments of an indirect dispatch.
@compute @workgroup_size(1)
fn arrange_queue() {
    let items = atomicLoad(&queue_lengths[classify_pass.queue]);
    let size = dispatch_groups(items, classify_pass.queue_group);
    for (var axis = 0u; axis < 3u; axis++) { queue_arguments[4u * classify_pass.queue + axis] = size[axis]; }
}
