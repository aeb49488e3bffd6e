// Cell classes: the class of all points of a surface in a cell by the photons, packed into two words, and requests for
// cells that their own photons do not classify. Distances are in normalised space; packed ones are in cells.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::math::oct_decode7;
import package::lib::constants::{CLASS_DARK, CLASS_UNKNOWN, PHOTON_NORMAL_MASK};

// Two cell classes a cell, two words each: cells at edges have photons of two surfaces.
@if(texture_loads) @group(1) @binding(11) var cell_classes: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(11) var<storage, read> cell_classes: array<vec4u>;

fn load_cell_classes(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(cell_classes, table_texel(i)); }
    @else { return cell_classes[i]; }
}

// A class that holds for every point of a cell whose normal is within `cos_spread` of `normal` and whose offset from
// the cell's centre along `normal` is within `thickness` of `offset`.
struct CellClass {
    // Lit, shadowed or boundary. Unknown: fewer than k photons are in reach. Dark: nothing but the reach is certain.
    class_: u32,
    normal: vec3f,
    cos_spread: f32,
    offset: f32,
    thickness: f32,
    // The nearest k are within this distance; 0 if that is not known.
    reach: f32,
    // n_i / (n_i + n_s) about the middle of the cell. In a lit or shadowed cell it is a step off 1 or 0 if a boundary
    // is near.
    visibility: f32,
}

// A cell class covers at most 35 degrees about a normal. That leaves 10 of the 45 for photons that surely count.
const SPREAD_UNIT = (1.0 - 0.81915204) / 255.0;
// Units of packed lengths, in cells: too fine to matter. Offsets reach 1, more than half a diagonal; thicknesses 2,
// more than a diagonal; reaches 16, more than the largest search radius.
const OFFSET_UNIT = 1.0 / 2048.0;
const OFFSET_ZERO = 2048.0;
const THICKNESS_UNIT = 1.0 / 128.0;
const REACH_UNIT = 1.0 / 16.0;
const VISIBILITY_STEPS = 2047.0;
const CELL_UNKNOWN = 0x80000000u;

// First word: bits 0-13 normal, 14-15 class, 16-23 spread, 24-31 thickness. Second word: bits 0-11 offset, 12-19 reach,
// 20-30 visibility, 31 class unknown.
fn encode_cell_class(cell: CellClass, normal_code: u32, inverse_cell: f32) -> vec2u {
    let spread = u32(clamp(ceil((1.0 - cell.cos_spread) / SPREAD_UNIT), 0.0, 255.0));
    let thickness = u32(clamp(ceil(cell.thickness * inverse_cell / THICKNESS_UNIT), 0.0, 255.0));
    let offset = u32(clamp(round(cell.offset * inverse_cell / OFFSET_UNIT) + OFFSET_ZERO, 0.0, 4095.0));
    let reach = u32(clamp(ceil(cell.reach * inverse_cell / REACH_UNIT), 0.0, 255.0));
    let visibility = u32(round(cell.visibility * VISIBILITY_STEPS));
    return vec2u(
        normal_code | ((cell.class_ & 3u) << 14u) | (spread << 16u) | (thickness << 24u),
        offset | (reach << 12u) | (visibility << 20u) | select(0u, CELL_UNKNOWN, cell.class_ == CLASS_UNKNOWN),
    );
}

fn decode_cell_class(words: vec2u, cell: f32) -> CellClass {
    return CellClass(
        select((words.x >> 14u) & 3u, CLASS_UNKNOWN, (words.y & CELL_UNKNOWN) != 0u),
        oct_decode7(words.x & PHOTON_NORMAL_MASK),
        1.0 - f32((words.x >> 16u) & 255u) * SPREAD_UNIT,
        (f32(words.y & 4095u) - OFFSET_ZERO) * OFFSET_UNIT * cell,
        f32(words.x >> 24u) * THICKNESS_UNIT * cell,
        f32((words.y >> 12u) & 255u) * REACH_UNIT * cell,
        f32((words.y >> 20u) & 2047u) / VISIBILITY_STEPS,
    );
}

// A class if nothing is known.
fn no_cell_class() -> CellClass {
    return CellClass(CLASS_DARK, vec3f(0.0, 0.0, 1.0), 1.0, 0.0, 0.0, 0.0, 0.0);
}

// Whether the cell class holds for a point `from_centre` of the cell's centre.
fn holds_at(cell: CellClass, from_centre: vec3f, normal: vec3f) -> bool {
    @if(paper_counting) { return cell.reach > 0.0; }
    return cell.reach > 0.0
        && dot(normal, cell.normal) >= cell.cos_spread
        && abs(dot(from_centre, cell.normal) - cell.offset) <= cell.thickness;
}

// A requested cell. The classes by its own photons do not hold for its points, because these photons lie on other
// surfaces or because it has none. It is classified once, for the surface of the points.
struct RequestedCell {
    // Its index, as `cell_index` gives it.
    cell: u32,
    // The slab and the cone of the points whose normals are near the normal in `requested_normals`: the lowest and the
    // highest offset from the cell's centre along that normal, and 1 minus the smallest cosine to it, in units of
    // REQUEST_UNIT. All three grow by `atomicMax`, so `low` holds the negative offset. 0 stands for no value.
    low: atomic<u32>,
    high: atomic<u32>,
    spread: atomic<u32>,
    class_words: vec2u,
}

// Converts the code of a normal to a word of `requested_normals`, and back. The greatest word is that of the smallest
// code, and 0 stands for no normal.
fn request_complement(code: u32) -> u32 {
    return PHOTON_NORMAL_MASK + 1u - code;
}

// Unit of a request's offsets, in cells, and of its cosines. An offset of 0 is stored as REQUEST_ZERO.
const REQUEST_UNIT = 1.0 / 16384.0;
const REQUEST_ZERO = 32768u;
// Normals this near to that of a cell class are of its surface: 30 degrees, so that their cone is within the 35 degrees
// of SPREAD_UNIT whatever rounding adds.
const COS_CLUSTER = 0.8660254;
