// classify: the class of each candidate, a (light, point) pair of a tile and a chunk of lights, and the queues that
// shadow rays and audits are traced from. In: points (normalised space), fine cells, the visibility map and its cell
// classes. Out: class words (lib/class_word), queues of candidates, indirect arguments, counters. Paper,
// "Extending the photon map": the three cases.
//
// `classify` queries the fine cells and queues the candidates that they do not decide. For these `look_up` looks up the
// classes of the map's cells and requests those that are missing, `request_cells` notes the points that request them,
// and `query` looks up the requested classes. What the map decides is stored as a photon of the fine cells, so that the
// map is queried once for each area of surface. `classify` and `query` queue the candidates whose class is known for
// shadow rays and audits, and `dilate` widens boundaries. `compact` fills the queues if another pass has found the
// classes. A point that its cell does not decide is a boundary: a search for the nearest photons of one point costs as
// much as one to forty shadow rays. Only if n_i and n_s are shown (`exact_counts`) does `query` search for them.

import package::kit::{dispatch_groups, group_index};
import package::lib::math::{oct_decode16, oct_decode7, oct_encode7, remainder};
import package::lib::class_word::{
    AuditProbabilities, NEAR, SETTLED, audit_probability, class_of, class_word, is_audited, is_decided, nearness_of,
    traces_shadow_rays
};
@if(visibility_map || fine_cells) import package::lib::class_word::boundary_word;
@if(visibility_map || fine_cells) import package::lib::class_word::{AWAY, word_at};
import package::lib::cell_class::{
    COS_CLUSTER, CellClass, REQUEST_UNIT, REQUEST_ZERO, RequestedCell, decode_cell_class, holds_at, load_cell_classes,
    no_cell_class, request_complement
};
import package::lib::grid::{GridShape, cell_centre, cell_index, cell_of, nearest};
@if(exact_counts) import package::lib::photon_search::class_by_search;
@if(fine_cells) import package::lib::fine_cell::{fine_class, store_rays};
@if(fine_cells && shown_cells) import package::lib::fine_cell::{FINE_CELL_ABSENT, cell_level, hash_cell};
@if(visibility_map && shown_cells) import package::lib::rng::hash1;
import package::lib::light::is_dark;
@if((visibility_map || fine_cells) && environment) import package::lib::light::environment::is_environment;
import package::lib::sampled_light::candidate_light;
import package::lib::point::Point;
import package::lib::visible_point::load_point;
import package::lib::tile::{Tile, first_point_of, pixel_seed, tile_position, tile_sample};
@if(shown_cells) import package::lib::constants::{CELL_HASH_SHIFT, CELL_KIND_SHIFT, CELL_LEVEL_SHIFT};
@if(fine_cells && shown_cells) import package::lib::constants::CELL_FINE;
@if(visibility_map && shown_cells) import package::lib::constants::{CELL_MAP, CELL_REQUESTED};
import package::lib::constants::{
    CANDIDATE_QUEUES, CLASSIFY_CANDIDATES, CLASS_BOUNDARY, CLASS_DARK, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN,
    COUNTER_AUDITED, COUNTER_DARK, COUNTER_NEAR, COUNTER_NEAR_AUDITED, COUNTER_SETTLED, COUNTER_SETTLED_AUDITED,
    INVALID_POINT, NOT_SAMPLED, NO_SAMPLED_LIGHT, QUEUE_ARGUMENT_WORDS, QUEUE_AUDIT, QUEUE_BOUNDARY, QUEUE_COUNT,
    QUEUE_QUERY, QUEUE_UNDILATED
};

struct ClassifyParameters {
    grid: GridShape,
    tile: Tile,
    // Candidates: points of the chunk's first light, of its second, ...
    candidate_count: u32,
    // The chunk's first light, or where lights are sampled its first sampled light index; see lib/sampled_light.
    first_light: u32,
    // Members of AuditProbabilities: in a uniform buffer, a struct would have to begin at a multiple of 16 bytes.
    audit_away: f32,
    audit_near: f32,
    // The queue whose length `arrange_queue` makes into arguments, and the invocations of the consumer's workgroups.
    queue: u32,
    queue_group: u32,
    padding: vec2u,
}

var<immediate> classify_pass: ClassifyParameters;

@group(0) @binding(1) var<storage, read_write> classes: array<atomic<u32>>;
// QUEUE_QUERY, QUEUE_BOUNDARY and QUEUE_AUDIT, of equal lengths: one binding, of which devices allow few.
@group(0) @binding(2) var<storage, read_write> queues: array<u32>;
// The length of each queue.
@group(0) @binding(3) var<storage, read_write> queue_lengths: array<atomic<u32>, QUEUE_COUNT>;
@group(0) @binding(4) var<storage, read_write> queue_arguments: array<u32, QUEUE_ARGUMENT_WORDS * QUEUE_COUNT>;
@group(0) @binding(8) var<storage, read_write> counters: array<atomic<u32>>;

// Requests by cell: the normal's code (see `request_complement`), and the index in `requested_cells`, counted from 1.
@if(visibility_map) @group(0) @binding(9) var<storage, read_write> requested_normals: array<atomic<u32>>;
@if(visibility_map) @group(0) @binding(10) var<storage, read_write> requested_indices: array<u32>;
@if(visibility_map) @group(0) @binding(11) var<storage, read_write> requested_cells: array<RequestedCell>;
// Numbers of requested cells: of all, of those classified, and of those classified before the last dispatch.
@if(visibility_map) @group(0) @binding(12) var<storage, read_write> request_counts: array<atomic<u32>, 3>;

// Index in `queues` of an item of a queue.
fn queue_item(queue: u32, item: u32) -> u32 {
    return queue * (arrayLength(&queues) / CANDIDATE_QUEUES) + item;
}

// The candidate has no class yet; `query` finds it.
const UNDECIDED = 0xffffffffu;
// As GATHER_GROUP in src/kernels/numbers.rs.
const CLASSIFY_GROUP = 64u;

// A workgroup counts its candidates by these indices; those below are the classes.
const COUNTED_AUDITED = 5u;
const COUNTED_NEAR = 6u;
const COUNTED_NEAR_AUDITED = 7u;
const COUNTED_SETTLED = 8u;
const COUNTED_SETTLED_AUDITED = 9u;
const COUNTED_UNDECIDED = 10u;
const COUNTED_TRACED = 11u;
// Indices below this one have a counter; the two others are only lengths of queues.
const WITH_COUNTER = 10u;
// The counts of the workgroup: half of a word for each index. A workgroup has at most 2,048 candidates.
var<workgroup> group_counts: array<atomic<u32>, COUNT_WORDS>;
const COUNT_WORDS = 6u;
// Where the workgroup's candidates begin in each queue.
var<workgroup> queue_bases: array<u32, CANDIDATE_QUEUES>;

// The classes that need no photons of the map; the other candidates are queued for them.
@compute @workgroup_size(64)
fn classify(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = (group_index(group, groups) * CLASSIFY_GROUP + lane) * CLASSIFY_CANDIDATES;
    var noted: Noted;
    for (var k = 0u; k < CLASSIFY_CANDIDATES; k++) {
        let candidate = first + k;
        if candidate < classify_pass.candidate_count {
            let word = class_without_map(candidate);
            atomicStore(&classes[candidate], word);
            if is_candidate(candidate) { note(&noted, k, candidate, word); }
        }
    }
    enqueue(noted, first, lane);
}

fn light_of(candidate: u32) -> u32 {
    return candidate_light(candidate, classify_pass.first_light, classify_pass.tile.point_count);
}

// Index of the candidate's point in the tile.
fn point_of(candidate: u32) -> u32 {
    return remainder(candidate, classify_pass.tile.point_count);
}

fn class_without_map(candidate: u32) -> u32 {
    let point = load_point(point_of(candidate));
    let light = light_of(candidate);
    @if(light_sampling) { if light == NO_SAMPLED_LIGHT { return class_word(CLASS_DARK, 0u, 0u, 0.0); } }
    if is_dark(light, point) { return class_word(CLASS_DARK, 0u, 0u, 0.0); }
    // The environment has no photons.
    @if((visibility_map || fine_cells) && environment) {
        if is_environment(light) { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.0); }
    }
    @if(fine_cells) {
        let fine = fine_class(light, point.position, oct_decode16(point.normal));
        if is_decided(fine.class_) { return decided_word(fine.class_, fine.nearness); }
        // For a divided cell, shadow rays give a better estimate than the map.
        if fine.nearness != AWAY { return boundary_word(fine.visibility, nearest); }
    }
    @if(visibility_map) { return UNDECIDED; }
    @else { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.0); }
}

// The word of a candidate in a lit or shadowed cell.
@if(visibility_map || fine_cells)
fn decided_word(class_: u32, nearness: u32) -> u32 {
    var word = class_word(CLASS_LIT, nearest, 0u, 1.0);
    if class_ == CLASS_SHADOWED { word = class_word(CLASS_SHADOWED, 0u, nearest, 0.0); }
    return word_at(word, nearness);
}

// Writes the classes of the queued candidates whose cell has a class that holds for the point, and requests a class for
// the others.
@if(visibility_map)
@compute @workgroup_size(64)
fn look_up(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if i >= atomicLoad(&queue_lengths[QUEUE_QUERY]) { return; }
    let candidate = queues[queue_item(QUEUE_QUERY, i)];
    let point = load_point(point_of(candidate));
    let normal = oct_decode16(point.normal);
    let light = light_of(candidate);
    let cell = cell_class_at(light, point.position, normal);
    if cell.reach == 0.0 {
        request_cell(light, point.position, normal);
        atomicStore(&classes[candidate], UNDECIDED);
        return;
    }
    atomicStore(&classes[candidate], word_of_cell_class(cell));
    @if(fine_cells) { store_class_in_fine_cell(cell, light, point.position, normal); }
}

// Where the map decides a point away from boundaries, its class is stored as a photon of the point's fine cell.
@if(visibility_map && fine_cells)
fn store_class_in_fine_cell(cell: CellClass, light: u32, position: vec3f, normal: vec3f) {
    let lit = cell.class_ == CLASS_LIT;
    if is_decided(cell.class_) && cell.visibility == f32(lit) {
        store_rays(light, position, normal, u32(lit), u32(!lit));
    }
}

// The first request of a cell allocates its entry.
@if(visibility_map)
fn request_cell(light: u32, position: vec3f, normal: vec3f) {
    let cell = cell_of(classify_pass.grid, position);
    if !in_cell(from_centre_of(cell, position)) { return; }
    let index = cell_index(classify_pass.grid, light, cell);
    if atomicMax(&requested_normals[index], request_complement(oct_encode7(normal))) == 0u {
        let entry = atomicAdd(&request_counts[0], 1u);
        if entry < arrayLength(&requested_cells) {
            requested_cells[entry].cell = index;
            requested_indices[index] = entry + 1u;
        }
    }
}

// The slab and the cone of the points of each requested cell.
@if(visibility_map)
@compute @workgroup_size(64)
fn request_cells(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if i >= atomicLoad(&queue_lengths[QUEUE_QUERY]) { return; }
    let candidate = queues[queue_item(QUEUE_QUERY, i)];
    if atomicLoad(&classes[candidate]) != UNDECIDED { return; }
    let point = load_point(point_of(candidate));
    let cell = cell_of(classify_pass.grid, point.position);
    let from_centre = from_centre_of(cell, point.position);
    let index = cell_index(classify_pass.grid, light_of(candidate), cell);
    let entry = requested_indices[index];
    // Cells that are classified already stay as they are.
    if !in_cell(from_centre) || entry <= atomicLoad(&request_counts[1]) { return; }
    let surface_normal = oct_decode7(request_complement(atomicLoad(&requested_normals[index])));
    let cosine = dot(oct_decode16(point.normal), surface_normal);
    if cosine < COS_CLUSTER { return; }
    let offset = dot(from_centre, surface_normal) * (classify_pass.grid.inverse_cell / REQUEST_UNIT);
    atomicMax(&requested_cells[entry - 1u].low, u32(i32(REQUEST_ZERO) - i32(floor(offset))));
    atomicMax(&requested_cells[entry - 1u].high, u32(i32(REQUEST_ZERO) + i32(ceil(offset))));
    atomicMax(&requested_cells[entry - 1u].spread, u32(ceil((1.0 - cosine) / REQUEST_UNIT)));
}

fn from_centre_of(cell: vec3u, position: vec3f) -> vec3f {
    return position - cell_centre(classify_pass.grid, cell);
}

// A point outside of the grid is in no cell. Rounding may put a point on a cell's face 0.0004 cells outside; classes of
// cells hold for 0.0005 (`extent_of` in lib/cell_classification).
fn in_cell(from_centre: vec3f) -> bool {
    return all(abs(from_centre) <= vec3f(0.5004 * classify_pass.grid.cell));
}

// The class word of a cell class; UNDECIDED where the exact counts are to be found.
@if(visibility_map)
fn word_of_cell_class(cell: CellClass) -> u32 {
    if is_decided(cell.class_) {
        return decided_word(cell.class_, select(AWAY, NEAR, cell.visibility != f32(cell.class_ == CLASS_LIT)));
    }
    @if(exact_counts) { return UNDECIDED; }
    @if(!exact_counts) {
        // Too few photons, or more than the visit budget is for.
        if cell.class_ == CLASS_UNKNOWN || cell.reach == 0.0 { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.5); }
        return boundary_word(cell.visibility, nearest);
    }
}

// The class of the cell's own photons that holds at the point, or `no_cell_class`.
fn cell_class_at(light: u32, position: vec3f, normal: vec3f) -> CellClass {
    let cell = cell_of(classify_pass.grid, position);
    let words = load_cell_classes(cell_index(classify_pass.grid, light, cell));
    let from_centre = from_centre_of(cell, position);
    if in_cell(from_centre) {
        for (var i = 0u; i < 2u; i++) {
            let found = decode_cell_class(select(words.zw, words.xy, i == 0u), classify_pass.grid.cell);
            if holds_at(found, from_centre, normal) { return found; }
        }
    }
    return no_cell_class();
}

// The class of the requested cell that holds at the point, or `no_cell_class`.
@if(visibility_map)
fn requested_class_at(light: u32, position: vec3f, normal: vec3f) -> CellClass {
    let cell = cell_of(classify_pass.grid, position);
    let from_centre = from_centre_of(cell, position);
    let entry = requested_indices[cell_index(classify_pass.grid, light, cell)];
    if in_cell(from_centre) && entry > 0u {
        let found = decode_cell_class(requested_cells[entry - 1u].class_words, classify_pass.grid.cell);
        if holds_at(found, from_centre, normal) { return found; }
    }
    return no_cell_class();
}

// Writes the classes of the candidates that `look_up` left undecided, and queues all that it looked up.
@if(visibility_map)
@compute @workgroup_size(64)
fn query(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * CLASSIFY_GROUP + lane;
    var candidate = 0u;
    var noted: Noted;
    if i < atomicLoad(&queue_lengths[QUEUE_QUERY]) {
        candidate = queues[queue_item(QUEUE_QUERY, i)];
        var word = atomicLoad(&classes[candidate]);
        if word == UNDECIDED {
            word = class_by_requested_cell(candidate);
            atomicStore(&classes[candidate], word);
        }
        note(&noted, 0u, candidate, word);
    }
    enqueue(noted, candidate, lane);
}

@if(visibility_map)
fn class_by_requested_cell(candidate: u32) -> u32 {
    let point = load_point(point_of(candidate));
    let light = light_of(candidate);
    let normal = oct_decode16(point.normal);
    @if(!exact_counts) let cell = requested_class_at(light, point.position, normal);
    @if(exact_counts) var cell = cell_class_at(light, point.position, normal);
    @if(exact_counts) { if cell.reach == 0.0 { cell = requested_class_at(light, point.position, normal); } }
    @if(fine_cells) { store_class_in_fine_cell(cell, light, point.position, normal); }
    let word = word_of_cell_class(cell);
    @if(exact_counts) {
        if word == UNDECIDED {
            return word_at(class_by_search(classify_pass.grid, light, point.position, normal, cell.reach), NEAR);
        }
    }
    return word;
}

// Maximum distance of a neighbour from the point's plane, as a share of the neighbour's distance: about 15 degrees. On
// a sphere, neighbours whose normals differ by the 25 degrees below are at 12.5 degrees from the plane.
const DILATE_SLOPE = 0.25;
// Normals of neighbours on one surface: 25 degrees, well within the 45 at which photons count for each other's surface.
// Other angles were not compared.
const DILATE_COSINE = 0.9063;

// A lit or shadowed candidate becomes a boundary if a neighbour on the same surface is a boundary or unknown.
// Boundaries are few and queued, so each of them visits its neighbours.
@if(visibility_map)
@compute @workgroup_size(64)
fn dilate(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if i >= atomicLoad(&queue_lengths[QUEUE_UNDILATED]) { return; }
    let candidate = queues[queue_item(QUEUE_BOUNDARY, i)];
    // No neighbour is decided: the environment has no photons.
    @if((visibility_map || fine_cells) && environment) { if is_environment(light_of(candidate)) { return; } }
    let point_index = point_of(candidate);
    let point = load_point(point_index);
    let first = candidate - point_index;
    // Neighbours are of the same sample.
    let sample = remainder(point_index, classify_pass.tile.samples_per_pixel);
    let at = vec2i(tile_position(classify_pass.tile, point_index));
    // Few neighbours are decided, because most neighbours of a boundary are boundaries. Software devices load the
    // points of the decided ones only.
    var decided = 0u;
    for (var k = 0u; k < NEIGHBOURS; k++) {
        let neighbour = first_point_of_neighbour(at, k);
        if neighbour != NOT_SAMPLED && is_decided(class_of(atomicLoad(&classes[first + sample + neighbour]))) {
            decided |= 1u << k;
        }
    }
    for (; decided != 0u; decided &= decided - 1u) {
        let other = sample + first_point_of_neighbour(at, firstTrailingBit(decided));
        if same_surface(load_point(other), point) { widen_to(first + other); }
    }
}

// The pixel itself and the eight around it.
const NEIGHBOURS = 9u;

// The first point of a pixel's neighbour k, or NOT_SAMPLED, also where it is not in the tile.
fn first_point_of_neighbour(at: vec2i, k: u32) -> u32 {
    let tile = classify_pass.tile;
    let position = at + vec2i(vec2u(k % 3u, k / 3u)) - 1;
    let size = vec2i(i32(tile.columns), i32(tile.rows));
    if any(position < vec2i(0)) || any(position >= size) { return NOT_SAMPLED; }
    return first_point_of(tile, u32(position.y) * tile.columns + u32(position.x));
}

// Makes a decided candidate a boundary.
fn widen_to(candidate: u32) {
    // CLASS_BOUNDARY has the bits of both CLASS_LIT and CLASS_SHADOWED. Only the first of several neighbours finds the
    // previous class.
    let word = atomicOr(&classes[candidate], CLASS_BOUNDARY);
    if !is_decided(class_of(word)) { return; }
    queues[queue_item(QUEUE_BOUNDARY, atomicAdd(&queue_lengths[QUEUE_BOUNDARY], 1u))] = candidate;
    atomicSub(&counters[COUNTER_DARK + class_of(word)], 1u);
    atomicAdd(&counters[COUNTER_DARK + CLASS_BOUNDARY], 1u);
    // It stays in the queue of audits; entry point `audit` of pass `shadow` skips boundaries.
    let audited = u32(audits(candidate, word));
    atomicSub(&counters[COUNTER_AUDITED], audited);
    let nearness = nearness_of(word);
    if nearness == NEAR {
        atomicSub(&counters[COUNTER_NEAR], 1u);
        atomicSub(&counters[COUNTER_NEAR_AUDITED], audited);
    }
    if nearness == SETTLED {
        atomicSub(&counters[COUNTER_SETTLED], 1u);
        atomicSub(&counters[COUNTER_SETTLED_AUDITED], audited);
    }
}

// Whether a decided candidate is audited.
fn audits(candidate: u32, word: u32) -> bool {
    let pixel = point_of(candidate);
    let sample_index = tile_sample(classify_pass.tile, pixel);
    let probabilities = AuditProbabilities(classify_pass.audit_away, classify_pass.audit_near);
    let probability = audit_probability(word, probabilities);
    return is_audited(pixel_seed(classify_pass.tile, pixel), sample_index, light_of(candidate), probability);
}

fn same_surface(a: Point, b: Point) -> bool {
    let normal = oct_decode16(a.normal);
    let v = b.position - a.position;
    return dot(normal, oct_decode16(b.normal)) >= DILATE_COSINE && abs(dot(v, normal)) <= DILATE_SLOPE * length(v);
}

// Whether the candidate has a point and a light.
fn is_candidate(candidate: u32) -> bool {
    let is_point = load_point(point_of(candidate)).normal != INVALID_POINT;
    @if(light_sampling) { return is_point && light_of(candidate) != NO_SAMPLED_LIGHT; }
    @else { return is_point; }
}

// Notes of an invocation about its consecutive candidates: a bit for each, by its position among them.
struct Noted {
    undecided: u32,
    // Queued for shadow rays, and for audits.
    traced: u32,
    audited: u32,
    // Counts by the indices that have a counter, in halves of words as in `group_counts`: those below COUNTED_SETTLED,
    // and the two others.
    counts: vec4u,
    settled: u32,
}

// Notes the word of the invocation's candidate k.
fn note(noted: ptr<function, Noted>, k: u32, candidate: u32, word: u32) {
    let bit = 1u << k;
    if word == UNDECIDED {
        (*noted).undecided |= bit;
        return;
    }
    let class_ = class_of(word);
    (*noted).counts += one_of(class_);
    if traces_shadow_rays(word) { (*noted).traced |= bit; }
    if is_decided(class_) {
        let audited = audits(candidate, word);
        let nearness = nearness_of(word);
        if nearness == NEAR {
            (*noted).counts += one_of(COUNTED_NEAR);
            if audited { (*noted).counts += one_of(COUNTED_NEAR_AUDITED); }
        }
        if nearness == SETTLED { (*noted).settled += select(1u, 0x10001u, audited); }
        if audited {
            (*noted).counts += one_of(COUNTED_AUDITED);
            (*noted).audited |= bit;
        }
    }
}

// A count of one for an index below COUNTED_SETTLED, and of zero for the others.
fn one_of(index: u32) -> vec4u {
    let is_its_word = vec4u(0u, 1u, 2u, 3u) == vec4u(index >> 1u);
    return select(vec4u(0u), vec4u(1u << (16u * (index & 1u))), is_its_word);
}

// The counter of an index below WITH_COUNTER.
fn counter_of(index: u32) -> u32 {
    switch index {
        case COUNTED_AUDITED: { return COUNTER_AUDITED; }
        case COUNTED_NEAR: { return COUNTER_NEAR; }
        case COUNTED_NEAR_AUDITED: { return COUNTER_NEAR_AUDITED; }
        case COUNTED_SETTLED: { return COUNTER_SETTLED; }
        case COUNTED_SETTLED_AUDITED: { return COUNTER_SETTLED_AUDITED; }
        default: { return COUNTER_DARK + index; }
    }
}

// The count of an index, from the word that holds it.
fn count_in(word: u32, index: u32) -> u32 {
    return (word >> (16u * (index & 1u))) & 0xffffu;
}

fn group_count(index: u32) -> u32 {
    return count_in(atomicLoad(&group_counts[index >> 1u]), index);
}

// Counts the classes of a workgroup's candidates, and queues those that are traced, audited or still undecided. All of
// its invocations call it at the same time. `first` is the first of the invocation's candidates.
fn enqueue(noted: Noted, first: u32, lane: u32) {
    if lane < COUNT_WORDS { atomicStore(&group_counts[lane], 0u); }
    workgroupBarrier();
    var before: vec4u;
    for (var i = 0u; i < 4u; i++) { before[i] = atomicAdd(&group_counts[i], noted.counts[i]); }
    atomicAdd(&group_counts[COUNTED_SETTLED >> 1u], noted.settled);
    let queued = countOneBits(noted.undecided) | (countOneBits(noted.traced) << 16u);
    let queued_before = atomicAdd(&group_counts[COUNTED_UNDECIDED >> 1u], queued);
    workgroupBarrier();
    if lane < WITH_COUNTER {
        // A lane for each counter and each queue.
        let counted = group_count(lane);
        if counted > 0u { atomicAdd(&counters[counter_of(lane)], counted); }
        var length = select(0u, group_count(COUNTED_UNDECIDED), lane == QUEUE_QUERY);
        length = select(length, group_count(COUNTED_TRACED), lane == QUEUE_BOUNDARY);
        length = select(length, group_count(COUNTED_AUDITED), lane == QUEUE_AUDIT);
        if length > 0u { queue_bases[lane] = atomicAdd(&queue_lengths[lane], length); }
    }
    workgroupBarrier();
    let audited_before = count_in(before[COUNTED_AUDITED >> 1u], COUNTED_AUDITED);
    queue_each(QUEUE_QUERY, count_in(queued_before, COUNTED_UNDECIDED), noted.undecided, first);
    queue_each(QUEUE_BOUNDARY, count_in(queued_before, COUNTED_TRACED), noted.traced, first);
    queue_each(QUEUE_AUDIT, audited_before, noted.audited, first);
}

// Queues the candidates of an invocation whose bit is set, after `before` others of the workgroup.
fn queue_each(queue: u32, before: u32, bits: u32, first: u32) {
    var item = queue_item(queue, queue_bases[queue] + before);
    for (var rest = bits; rest != 0u; rest &= rest - 1u) {
        queues[item] = first + firstTrailingBit(rest);
        item++;
    }
}

// Fills the queues from classes that another pass found.
@if(cells || light_buffer || ward)
@compute @workgroup_size(64)
fn compact(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = (group_index(group, groups) * CLASSIFY_GROUP + lane) * CLASSIFY_CANDIDATES;
    var noted: Noted;
    for (var k = 0u; k < CLASSIFY_CANDIDATES; k++) {
        let candidate = first + k;
        if candidate < classify_pass.candidate_count && is_candidate(candidate) {
            note(&noted, k, candidate, atomicLoad(&classes[candidate]));
        }
    }
    enqueue(noted, first, lane);
}

// For each point of a tile, the cell that decides it for the light `first_light`, in the format of the host's
// `ShownCell`. This is for displaying the cells, and does not change them.
@if(shown_cells)
@compute @workgroup_size(64)
fn show_cells(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * CLASSIFY_GROUP + lane;
    if i >= classify_pass.candidate_count { return; }
    let point = load_point(i);
    var word = CLASS_DARK;
    if point.normal != INVALID_POINT {
        word = cell_word_at(classify_pass.first_light, point.position, oct_decode16(point.normal));
    }
    atomicStore(&classes[i], word);
}

@if(shown_cells)
fn cell_word_at(light: u32, position: vec3f, normal: vec3f) -> u32 {
    // The word if no cell decides the point.
    var word = CLASS_UNKNOWN;
    @if(fine_cells) {
        let fine = fine_class(light, position, normal);
        let level = cell_level(fine.cell.kind);
        let hash = hash_cell(vec4u(bitcast<vec3u>(fine.cell.index), fine.cell.kind)).x;
        let fine_word = cell_word(fine.class_, CELL_FINE, level, hash);
        if is_decided(fine.class_) || fine.nearness != AWAY { return fine_word; }
        if fine.entry != FINE_CELL_ABSENT { word = fine_word; }
    }
    @if(visibility_map) {
        var cell = cell_class_at(light, position, normal);
        var kind = CELL_MAP;
        if cell.reach == 0.0 {
            cell = requested_class_at(light, position, normal);
            kind = CELL_REQUESTED;
        }
        if cell.reach > 0.0 {
            // Where nothing but the reach is certain, points are boundaries.
            let class_ = select(cell.class_, CLASS_BOUNDARY, cell.class_ == CLASS_DARK);
            let index = cell_index(classify_pass.grid, light, cell_of(classify_pass.grid, position));
            word = cell_word(class_, kind, 0u, hash1(index));
        }
    }
    return word;
}

@if(shown_cells)
fn cell_word(class_: u32, kind: u32, level: u32, hash: u32) -> u32 {
    return class_ | (kind << CELL_KIND_SHIFT) | (level << CELL_LEVEL_SHIFT) | (hash << CELL_HASH_SHIFT);
}

// Makes a queue's length into the arguments of an indirect dispatch.
@compute @workgroup_size(1)
fn arrange_queue() {
    let items = atomicLoad(&queue_lengths[classify_pass.queue]);
    if classify_pass.queue == QUEUE_BOUNDARY { atomicStore(&queue_lengths[QUEUE_UNDILATED], items); }
    let size = dispatch_groups(items, classify_pass.queue_group);
    for (var axis = 0u; axis < 3u; axis++) {
        queue_arguments[QUEUE_ARGUMENT_WORDS * classify_pass.queue + axis] = size[axis];
    }
}
