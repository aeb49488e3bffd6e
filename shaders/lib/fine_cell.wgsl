// Fine cells: areas of surface a few pixels wide, or narrower. The shadow rays of earlier samples are photons in them:
// a point with a ray that reached the light leaves an illumination photon, and one with a ray that did not leaves a
// shadow photon. A cell with both kinds about it is divided; its parts are cells of half the width.
// In and out: a hash table of cells by light and position. Positions are in normalised space.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::class_word::{AWAY, NEAR, SETTLED};
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

// Identifies a fine cell.
struct FineCellKey {
    // Index along each axis, in widths of a cell; along the dominant axis of the normal, in depths, which are
    // FINE_CELL_DEPTH widths.
    index: vec3i,
    // Bits 0-10 the light, 11 the side of the dominant axis, 12-13 that axis, 14-19 the binary exponent of the width,
    // 20-22 how often it was divided.
    kind: u32,
}

struct FineCell {
    index: vec3i,
    kind: u32,
    // Photons of both kinds.
    illumination: atomic<u32>,
    shadow: atomic<u32>,
    // Index i holds here the entry of the i-th cell that was added to the table.
    listed: u32,
    padding: u32,
}

@group(1) @binding(26) var<uniform> fine_cell_view: FineCellView;
@group(1) @binding(27) var<storage, read_write> fine_cells: array<FineCell>;
// For each entry, a hash of the key, with a code in CLASS_MASK; 0 if the entry is empty. The code is the class by the
// photons after an earlier batch of samples: lit, shadowed, boundary (divided) or unknown, or MOSTLY_LIT. The number of
// cells follows the entries.
@group(1) @binding(30) var<storage, read_write> fine_cell_tags: array<atomic<u32>>;
// The tags after that batch, four to a record. Cells that samples added since then have no class yet.
@if(texture_loads) @group(1) @binding(31) var fine_cell_tag_table: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(31) var<storage, read> fine_cell_tag_table: array<vec4u>;

// A divided cell with at least as many illumination photons as shadow photons.
const MOSTLY_LIT = 7u;
// A part of a divided cell with many photons, all of one kind: its code is the class plus MANY_PHOTONS.
const MANY_PHOTONS = 4u;
const UNDIVIDED = 0u;

fn is_divided(code: u32) -> bool {
    return code == CLASS_BOUNDARY || code == MOSTLY_LIT;
}

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
    // The lower bound leaves room for all divisions.
    let exponent = clamp(ceil_log2(f32(FINE_CELL_PIXELS) * pixel), LOWEST_EXPONENT + i32(FINE_CELL_LEVELS), 2);
    let size = abs(normal);
    let axis = select(select(0u, 1u, size.y > size.x), 2u, size.z > max(size.x, size.y));
    let side = u32(normal[axis] < 0.0);
    let kind = light | (side << SIDE_SHIFT) | (axis << AXIS_SHIFT);
    return cell_at(kind | (u32(exponent - LOWEST_EXPONENT) << EXPONENT_SHIFT), position);
}

// The exponent of the smallest power of two that is no less than a positive number. It is computed from bits, so that
// devices agree on it.
fn ceil_log2(x: f32) -> i32 {
    let bits = bitcast<u32>(x);
    return i32(bits >> 23u) - 127 + i32((bits & 0x7fffffu) != 0u);
}

// The cell of that kind at a position.
fn cell_at(kind: u32, position: vec3f) -> FineCellKey {
    let exponent = i32((kind >> EXPONENT_SHIFT) & 63u) + LOWEST_EXPONENT;
    var scale = vec3f(bitcast<f32>(u32(127 - exponent) << 23u));
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

// The entry of a cell, and its code.
struct FoundCell {
    // Or FINE_CELL_ABSENT.
    entry: u32,
    code: u32,
}

const FINE_CELL_ABSENT = 0xffffffffu;

// Where the table is searched for a cell.
struct CellHash {
    tag: u32,
    // Index of a bucket of four entries, which one record of the table holds.
    bucket: u32,
}

// Cells with equal hashes are taken for one cell: among a million cells, 0.01 on average.
fn hash_of(cell: FineCellKey) -> CellHash {
    let hash = hash_cell(vec4u(bitcast<vec3u>(cell.index), cell.kind));
    return CellHash(max(hash.x & ~CLASS_MASK, CLASS_MASK + 1u), hash.y & (fine_cell_view.mask >> 2u));
}

// pcg4d (Jarzynski and Olano 2020): one hash for a bucket and a tag costs a quarter of lib/rng's.
fn hash_cell(key: vec4u) -> vec4u {
    var v = key * 1664525u + 1013904223u;
    v += v.yzxy * v.wxyz;
    v ^= v >> vec4u(16u);
    v += v.yzxy * v.wxyz;
    return v;
}

fn load_tags(bucket: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(fine_cell_tag_table, table_texel(bucket)); }
    @else { return fine_cell_tag_table[bucket]; }
}

// The cell as it was after the last batch that was classified.
fn find_cell(cell: FineCellKey) -> FoundCell {
    let hash = hash_of(cell);
    var bucket = hash.bucket;
    for (var probe = 0u; probe < FINE_CELL_PROBES; probe += 4u) {
        let tags = load_tags(bucket);
        let same = (tags & vec4u(~CLASS_MASK)) == vec4u(hash.tag);
        if any(same) {
            let tag = select(vec4u(0u), tags, same);
            let i = dot(vec4u(same), vec4u(0u, 1u, 2u, 3u));
            return FoundCell(4u * bucket + i, (tag.x | tag.y | tag.z | tag.w) & CLASS_MASK);
        }
        // Entries are taken in order.
        if tags.w == 0u { break; }
        bucket = (bucket + 1u) & (fine_cell_view.mask >> 2u);
    }
    return FoundCell(FINE_CELL_ABSENT, CLASS_UNKNOWN);
}

// The entry of a cell as it is now. A cell that is absent takes one if there is room; else FINE_CELL_ABSENT.
fn find_or_add_cell(cell: FineCellKey) -> u32 {
    let hash = hash_of(cell);
    var entry = 4u * hash.bucket;
    for (var probe = 0u; probe < FINE_CELL_PROBES; probe++) {
        var found = atomicLoad(&fine_cell_tags[entry]);
        if found == 0u {
            if fine_cell_view.closed != 0u { return FINE_CELL_ABSENT; }
            let exchanged = atomicCompareExchangeWeak(&fine_cell_tags[entry], 0u, hash.tag | CLASS_UNKNOWN);
            if exchanged.exchanged {
                fine_cells[entry].kind = cell.kind;
                fine_cells[entry].index = cell.index;
                fine_cells[atomicAdd(&fine_cell_tags[fine_cell_view.mask + 1u], 1u)].listed = entry;
                return entry;
            }
            found = exchanged.old_value;
        }
        if (found & ~CLASS_MASK) == hash.tag { return entry; }
        entry = (entry + 1u) & fine_cell_view.mask;
    }
    atomicAdd(&fine_cell_tags[fine_cell_view.mask + 2u], 1u);
    return FINE_CELL_ABSENT;
}

// The class of a point by the fine cells.
struct FineClass {
    cell: FineCellKey,
    // Entry of the cell, or FINE_CELL_ABSENT.
    entry: u32,
    class_: u32,
    // Nearness of its cell: AWAY, NEAR or SETTLED of lib/class_word.
    nearness: u32,
    // Rounded visibility of the smallest divided cell about the point.
    visibility: f32,
}

// The class of the point's undivided cell, or boundary if cells of all sizes are divided.
fn fine_class(light: u32, position: vec3f, normal: vec3f) -> FineClass {
    var cell = coarsest_cell(light, position, normal);
    var found: FoundCell;
    var divided = UNDIVIDED;
    // All searches in the loop: software devices run its body at least once.
    for (var level = 1u; ; level++) {
        found = find_cell(cell);
        if !is_divided(found.code) { break; }
        divided = found.code;
        if level == FINE_CELL_LEVELS {
            found.code = CLASS_BOUNDARY;
            break;
        }
        cell = finer_cell(cell, position);
    }
    let many = found.code > MANY_PHOTONS && found.code != MOSTLY_LIT;
    let nearness = select(select(NEAR, SETTLED, many), AWAY, divided == UNDIVIDED);
    let class_ = select(found.code, found.code - MANY_PHOTONS, many);
    return FineClass(cell, found.entry, class_, nearness, f32(divided == MOSTLY_LIT));
}

// Stores photons of a point in its undivided cell: one if any of its shadow rays reached the light, and one if any did
// not. Rays of one point are not counted one by one, because to a small light all of them have the same result.
fn store_rays(light: u32, position: vec3f, normal: vec3f, visible: u32, blocked: u32) {
    if visible + blocked == 0u { return; }
    let found = fine_class(light, position, normal);
    if found.class_ == CLASS_BOUNDARY { return; }
    var entry = found.entry;
    if entry == FINE_CELL_ABSENT { entry = find_or_add_cell(found.cell); }
    if entry == FINE_CELL_ABSENT { return; }
    if visible > 0u { atomicAdd(&fine_cells[entry].illumination, 1u); }
    if blocked > 0u { atomicAdd(&fine_cells[entry].shadow, 1u); }
}
