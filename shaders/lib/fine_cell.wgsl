// Fine cells: pieces of surface as large as a few pixels, for which the shadow rays of earlier samples are photons. A
// ray that reached the light is an illumination photon at its origin, one that did not is a shadow photon. In: the
// view, and a hash table of cells by light and place. Positions are in normalised space.

import package::lib::rng::hash3;
import package::lib::constants::{
    CLASS_BOUNDARY, CLASS_UNKNOWN, FINE_CELL_DEPTH, FINE_CELL_LEVELS, FINE_CELL_PIXELS, FINE_CELL_PROBES
};

// The width of a pixel at a distance d from the eye is `width + slope * d`.
struct FineCellView {
    eye: vec3f,
    slope: f32,
    width: f32,
    // Slots of the table, a power of two, less one.
    mask: u32,
    // 1: the table takes no new cells.
    closed: u32,
    padding: u32,
}

// Where a cell is.
struct FineCellKey {
    // In widths of a cell; along the dominant axis of the normal in FINE_CELL_DEPTH of them.
    place: vec3i,
    // Bits 0-10 the light, 11-13 the dominant axis and its side, 14-22 the binary exponent of the width.
    kind: u32,
}

struct FineCell {
    // Hash of the key, 0 in an empty slot.
    tag: atomic<u32>,
    kind: u32,
    // Photons: shadow rays that reached the light, and those that did not.
    illumination: atomic<u32>,
    shadow: atomic<u32>,
    place: vec3i,
    // The class that the photons told after an earlier batch of samples; boundary where they are of both kinds.
    class_: u32,
}

@group(1) @binding(26) var<storage, read> fine_cell_view: FineCellView;
@group(1) @binding(27) var<storage, read_write> fine_cells: array<FineCell>;
// Slots of the cells, and how many there are.
@group(1) @binding(29) var<storage, read_write> fine_cell_list: array<u32>;
@group(1) @binding(28) var<storage, read_write> fine_cell_count: atomic<u32>;

// Surfaces at round coordinates, such as a floor at 0, do not lie on the faces of cells.
const PLACE_OFFSET = vec3f(0.3183, 0.2718, 0.4142);
// Exponents are stored from this one on: normalised space ends at 2, and f32 has no finer positions.
const LOWEST_EXPONENT = -40;

// The coarsest cell of a point.
fn coarse_cell_key(light: u32, position: vec3f, normal: vec3f) -> FineCellKey {
    let pixel = fine_cell_view.width + fine_cell_view.slope * distance(position, fine_cell_view.eye);
    let exponent = clamp(ceil(log2(f32(FINE_CELL_PIXELS) * pixel)), f32(LOWEST_EXPONENT), 2.0);
    let size = abs(normal);
    let axis = select(select(0u, 1u, size.y > size.x), 2u, size.z > max(size.x, size.y));
    let code = axis * 2u + u32(normal[axis] < 0.0);
    return cell_key(light | (code << 11u) | (u32(i32(exponent) - LOWEST_EXPONENT) << 14u), position);
}

fn cell_key(kind: u32, position: vec3f) -> FineCellKey {
    let exponent = i32((kind >> 14u) & 63u) + LOWEST_EXPONENT;
    var scale = vec3f(exp2(f32(-exponent)));
    scale[(kind >> 12u) & 3u] /= f32(FINE_CELL_DEPTH);
    return FineCellKey(vec3i(floor((position + PLACE_OFFSET) * scale)), kind);
}

// The cell of half the width.
fn finer_cell_key(key: FineCellKey, position: vec3f) -> FineCellKey {
    return cell_key(key.kind + (1u << 20u) - (1u << 14u), position);
}

fn fine_cell_tag(key: FineCellKey) -> u32 {
    let place = bitcast<vec3u>(key.place);
    return max(hash3(hash3(place.x, place.y, place.z), key.kind, 1u), 1u);
}

fn first_slot(key: FineCellKey) -> u32 {
    let place = bitcast<vec3u>(key.place);
    return hash3(hash3(place.z, place.x, place.y), key.kind, 2u) & fine_cell_view.mask;
}

// Slot of the cell, or FINE_CELL_ABSENT. Cells whose tag and first slots agree are taken for one: with 2^20 cells the
// chance that there are any is below 2^-20.
const FINE_CELL_ABSENT = 0xffffffffu;
fn find_fine_cell(key: FineCellKey) -> u32 {
    let tag = fine_cell_tag(key);
    var slot = first_slot(key);
    for (var probe = 0u; probe < FINE_CELL_PROBES; probe++) {
        let found = atomicLoad(&fine_cells[slot].tag);
        if found == tag { return slot; }
        if found == 0u { break; }
        slot = (slot + 1u) & fine_cell_view.mask;
    }
    return FINE_CELL_ABSENT;
}

// Slot of the cell, which the first call allocates; FINE_CELL_ABSENT where there is no room.
fn allocate_fine_cell(key: FineCellKey) -> u32 {
    if fine_cell_view.closed != 0u { return find_fine_cell(key); }
    let tag = fine_cell_tag(key);
    var slot = first_slot(key);
    for (var probe = 0u; probe < FINE_CELL_PROBES; probe++) {
        var found = atomicLoad(&fine_cells[slot].tag);
        if found == 0u {
            let exchanged = atomicCompareExchangeWeak(&fine_cells[slot].tag, 0u, tag);
            if exchanged.exchanged {
                fine_cells[slot].kind = key.kind;
                fine_cells[slot].place = key.place;
                fine_cells[slot].class_ = CLASS_UNKNOWN;
                fine_cell_list[atomicAdd(&fine_cell_count, 1u)] = slot;
                return slot;
            }
            found = exchanged.old_value;
        }
        if found == tag { return slot; }
        slot = (slot + 1u) & fine_cell_view.mask;
    }
    return FINE_CELL_ABSENT;
}

// What the fine cells say of a point.
struct FineClass {
    class_: u32,
    // A divided cell is around it.
    near: bool,
}

// The class of the finest cell of the point that has one.
fn fine_cell_class(light: u32, position: vec3f, normal: vec3f) -> FineClass {
    var key = coarse_cell_key(light, position, normal);
    for (var level = 0u; level < FINE_CELL_LEVELS; level++) {
        let slot = find_fine_cell(key);
        if slot == FINE_CELL_ABSENT { break; }
        let class_ = fine_cells[slot].class_;
        if class_ != CLASS_BOUNDARY { return FineClass(class_, level > 0u); }
        key = finer_cell_key(key, position);
    }
    return FineClass(CLASS_UNKNOWN, true);
}

const FINE_CELL_AHEAD = 2u;
// Leaves the photons of a point's shadow rays in the coarsest of its cells that is not divided, and in the next finer
// one, so that this has some when it is asked.
fn store_rays(light: u32, position: vec3f, normal: vec3f, visible: u32, blocked: u32) {
    if visible + blocked == 0u { return; }
    var key = coarse_cell_key(light, position, normal);
    var stored = 0u;
    for (var level = 0u; level < FINE_CELL_LEVELS && stored < FINE_CELL_AHEAD; level++) {
        let slot = allocate_fine_cell(key);
        if slot == FINE_CELL_ABSENT { return; }
        if fine_cells[slot].class_ != CLASS_BOUNDARY {
            if visible > 0u { atomicAdd(&fine_cells[slot].illumination, 1u); }
            if blocked > 0u { atomicAdd(&fine_cells[slot].shadow, 1u); }
            stored++;
        }
        key = finer_cell_key(key, position);
    }
}
