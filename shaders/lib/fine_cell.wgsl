// Fine cells: pieces of surface of a few pixels and less. The shadow rays of earlier samples are photons in them: a
// point with a ray that reached the light leaves an illumination photon, one with a ray that did not a shadow photon. A
// cell with both kinds about it is divided; its parts are cells of half the width.
// In and out: a hash table of cells by light and position. Positions are in normalised space.

import package::lib::rng::hash3;
import package::lib::constants::{
    CLASS_BOUNDARY, CLASS_MASK, CLASS_UNKNOWN, FINE_CELL_DEPTH, FINE_CELL_LEVELS, FINE_CELL_PIXELS, FINE_CELL_PROBES
};

struct FineCellView {
    // The width of a pixel at a distance d from the eye is `width + slope * d`.
    eye: vec3f,
    slope: f32,
    width: f32,
    // Entries of the table, a power of two, less one.
    mask: u32,
    // 1: the table takes no new cells.
    closed: u32,
    padding: u32,
}

// Which cell it is.
struct FineCellKey {
    // Index along each axis, in widths of a cell; along the dominant axis of the normal in FINE_CELL_DEPTH of them.
    index: vec3i,
    // Bits 0-10 the light, 11 the side of the dominant axis, 12-13 that axis, 14-19 the binary exponent of the width,
    // 20-22 how often it was divided.
    kind: u32,
}

struct FineCell {
    // A hash of the key, with the class in CLASS_MASK; 0 in an empty entry. The class is what the photons told after an
    // earlier batch of samples: lit, shadowed, boundary (divided) or unknown.
    tag: atomic<u32>,
    kind: u32,
    // Photons of both kinds.
    illumination: atomic<u32>,
    shadow: atomic<u32>,
    index: vec3i,
    padding: u32,
}

@group(1) @binding(26) var<storage, read> fine_cell_view: FineCellView;
@group(1) @binding(27) var<storage, read_write> fine_cells: array<FineCell>;
// Entries of the cells, and how many there are.
@group(1) @binding(28) var<storage, read_write> fine_cell_list: array<u32>;
@group(1) @binding(29) var<storage, read_write> fine_cell_count: atomic<u32>;

// Keeps surfaces at round coordinates, such as a floor at 0, off the faces of cells.
const POSITION_OFFSET = vec3f(0.3173, 0.2719, 0.4142);
// Exponents are stored from this one on: normalised space has a radius of 1, and f32 no finer positions.
const LOWEST_EXPONENT = -40;
const SIDE_SHIFT = 11u;
const AXIS_SHIFT = 12u;
const EXPONENT_SHIFT = 14u;
const LEVEL_SHIFT = 20u;

// The coarsest cell of a point.
fn coarsest_cell(light: u32, position: vec3f, normal: vec3f) -> FineCellKey {
    let pixel = fine_cell_view.width + fine_cell_view.slope * distance(position, fine_cell_view.eye);
    // Room for all divisions.
    let lowest = f32(LOWEST_EXPONENT + i32(FINE_CELL_LEVELS));
    let exponent = i32(clamp(ceil(log2(f32(FINE_CELL_PIXELS) * pixel)), lowest, 2.0));
    let size = abs(normal);
    let axis = select(select(0u, 1u, size.y > size.x), 2u, size.z > max(size.x, size.y));
    let side = u32(normal[axis] < 0.0);
    let kind = light | (side << SIDE_SHIFT) | (axis << AXIS_SHIFT);
    return cell_at(kind | (u32(exponent - LOWEST_EXPONENT) << EXPONENT_SHIFT), position);
}

// The cell of that kind at a position.
fn cell_at(kind: u32, position: vec3f) -> FineCellKey {
    let exponent = i32((kind >> EXPONENT_SHIFT) & 63u) + LOWEST_EXPONENT;
    var scale = vec3f(exp2(f32(-exponent)));
    scale[cell_axis(kind)] /= f32(FINE_CELL_DEPTH);
    return FineCellKey(vec3i(floor((position + POSITION_OFFSET) * scale)), kind);
}

// The part of a divided cell in which the position lies.
fn finer_cell(cell: FineCellKey, position: vec3f) -> FineCellKey {
    return cell_at(cell.kind + (1u << LEVEL_SHIFT) - (1u << EXPONENT_SHIFT), position);
}

// The dominant axis of the cell's surface.
fn cell_axis(kind: u32) -> u32 {
    return (kind >> AXIS_SHIFT) & 3u;
}

// How often it was divided.
fn cell_level(kind: u32) -> u32 {
    return kind >> LEVEL_SHIFT;
}

// The entry of a cell and its class.
struct FoundCell {
    // Or FINE_CELL_ABSENT.
    entry: u32,
    class_: u32,
}

const FINE_CELL_ABSENT = 0xffffffffu;

// Cells whose tags agree and whose entries follow one another are taken for one: of a million cells, 0.003 on average.
fn tag_of(cell: FineCellKey) -> u32 {
    let index = bitcast<vec3u>(cell.index);
    return max(hash3(hash3(index.x, index.y, index.z), cell.kind, 1u) & ~CLASS_MASK, CLASS_MASK + 1u);
}

fn first_entry(cell: FineCellKey) -> u32 {
    let index = bitcast<vec3u>(cell.index);
    return hash3(hash3(index.z, index.x, index.y), cell.kind, 2u) & fine_cell_view.mask;
}

fn find_cell(cell: FineCellKey) -> FoundCell {
    let tag = tag_of(cell);
    var entry = first_entry(cell);
    for (var probe = 0u; probe < FINE_CELL_PROBES; probe++) {
        let found = atomicLoad(&fine_cells[entry].tag);
        if found == 0u { break; }
        if (found & ~CLASS_MASK) == tag { return FoundCell(entry, found & CLASS_MASK); }
        entry = (entry + 1u) & fine_cell_view.mask;
    }
    return FoundCell(FINE_CELL_ABSENT, CLASS_UNKNOWN);
}

// As `find_cell`, but a cell that is absent takes an entry if there is room.
fn find_or_add_cell(cell: FineCellKey) -> FoundCell {
    if fine_cell_view.closed != 0u { return find_cell(cell); }
    let tag = tag_of(cell);
    var entry = first_entry(cell);
    for (var probe = 0u; probe < FINE_CELL_PROBES; probe++) {
        var found = atomicLoad(&fine_cells[entry].tag);
        if found == 0u {
            let exchanged = atomicCompareExchangeWeak(&fine_cells[entry].tag, 0u, tag | CLASS_UNKNOWN);
            if exchanged.exchanged {
                fine_cells[entry].kind = cell.kind;
                fine_cells[entry].index = cell.index;
                fine_cell_list[atomicAdd(&fine_cell_count, 1u)] = entry;
                return FoundCell(entry, CLASS_UNKNOWN);
            }
            found = exchanged.old_value;
        }
        if (found & ~CLASS_MASK) == tag { return FoundCell(entry, found & CLASS_MASK); }
        entry = (entry + 1u) & fine_cell_view.mask;
    }
    return FoundCell(FINE_CELL_ABSENT, CLASS_UNKNOWN);
}

// What the fine cells tell of a point.
struct FineClass {
    class_: u32,
    // Its cell is part of a divided one: a boundary is near.
    near: bool,
}

// The class of the point's cell that is not divided.
fn fine_class(light: u32, position: vec3f, normal: vec3f) -> FineClass {
    var cell = coarsest_cell(light, position, normal);
    for (var level = 0u; level < FINE_CELL_LEVELS; level++) {
        let found = find_cell(cell);
        if found.class_ != CLASS_BOUNDARY { return FineClass(found.class_, level > 0u); }
        cell = finer_cell(cell, position);
    }
    return FineClass(CLASS_BOUNDARY, true);
}

// Leaves the photons of a point, by its shadow rays that reached the light and those that did not, in its cell that is
// not divided. Rays of one point are not counted one by one: to a small light, all of them go the same way.
fn store_rays(light: u32, position: vec3f, normal: vec3f, visible: u32, blocked: u32) {
    if visible + blocked == 0u { return; }
    var cell = coarsest_cell(light, position, normal);
    for (var level = 0u; level < FINE_CELL_LEVELS; level++) {
        let found = find_or_add_cell(cell);
        if found.entry == FINE_CELL_ABSENT { return; }
        if found.class_ != CLASS_BOUNDARY {
            if visible > 0u { atomicAdd(&fine_cells[found.entry].illumination, 1u); }
            if blocked > 0u { atomicAdd(&fine_cells[found.entry].shadow, 1u); }
            return;
        }
        cell = finer_cell(cell, position);
    }
}
