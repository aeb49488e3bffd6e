// The visibility map: photons sorted by light and cell of a regular grid, and what is known of whole cells.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::constants::REACH_CELLS;
import package::lib::math::{PI, oct_decode7, oct_within7};
import package::lib::photon::{CLASS_BOUNDARY, CLASS_DARK, CLASS_UNKNOWN};

// Nearest photons asked for (k).
override nearest: u32;

// Each light has a grid of this shape; cells are cubes.
struct GridShape {
    origin: vec3f,
    cell: f32,
    size: vec3u,
    inverse_cell: f32,
}

@if(texture_loads) @group(1) @binding(10) var photon_table: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(10) var<storage, read> photon_table: array<vec4u>;
@if(texture_loads) @group(1) @binding(11) var cell_records: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(11) var<storage, read> cell_records: array<vec4u>;
// First photon of each cell, four cells to a record; the last cell's end follows.
@if(texture_loads) @group(1) @binding(14) var cell_starts: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(14) var<storage, read> cell_starts: array<vec4u>;

// Distances along the normal count this many times more than their square: four times the length.
@if(!paper_counting) const NORMAL_STRETCH = 15.0;
@if(paper_counting) const NORMAL_STRETCH = 0.0;
// Photons whose normals differ by more than 45 degrees are of another surface.
const COMPATIBLE_COSINE_SQUARED = 0.5;

// Squared, farther than any photon.
const FAR = 1e30;

// The largest search radius, in cells.
const REACH_MAX = f32(REACH_CELLS);

fn load_photon(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(photon_table, table_texel(i)); }
    @else { return photon_table[i]; }
}

fn load_cell_record(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(cell_records, table_texel(i)); }
    @else { return cell_records[i]; }
}

fn load_cell_start(i: u32) -> u32 {
    let record = i >> 2u;
    @if(texture_loads) { return textureLoad(cell_starts, table_texel(record))[i & 3u]; }
    @else { return cell_starts[record][i & 3u]; }
}

// Whether a photon counts for points of this normal.
fn compatible(word: u32, normal: vec3f) -> bool {
    @if(paper_counting) { return true; }
    @if(!paper_counting) { return oct_within7(word, normal, COMPATIBLE_COSINE_SQUARED); }
}

// The squared distance of a photon from a point, by which the nearest are counted; FAR for one that does not count.
fn counted_distance(photon: vec4u, position: vec3f, normal: vec3f) -> f32 {
    let v = bitcast<vec3f>(photon.xyz) - position;
    let along = dot(v, normal);
    return select(FAR, dot(v, v) + NORMAL_STRETCH * along * along, compatible(photon.w, normal));
}

fn cell_of(grid: GridShape, position: vec3f) -> vec3u {
    let cell = vec3i(floor((position - grid.origin) * grid.inverse_cell));
    return vec3u(clamp(cell, vec3i(0), vec3i(grid.size) - 1));
}

fn cell_centre(grid: GridShape, cell: vec3u) -> vec3f {
    return grid.origin + (vec3f(cell) + 0.5) * grid.cell;
}

fn cell_index(grid: GridShape, light: u32, cell: vec3u) -> u32 {
    let within = (cell.z * grid.size.y + cell.y) * grid.size.x + cell.x;
    @if(light_tags) { return light * (grid.size.x * grid.size.y * grid.size.z) + within; }
    @else { return within; }
}

// What holds for every point of a cell whose normal is within `cos_spread` of `normal` and whose offset from the
// cell's centre along `normal` is within `thickness` of `offset`.
struct Verdict {
    // Lit, shadowed or boundary; unknown: fewer than k are in reach; dark: nothing is certain but the reach.
    class_: u32,
    normal: vec3f,
    cos_spread: f32,
    offset: f32,
    thickness: f32,
    // The nearest k are within this distance; 0 if that is not known.
    reach: f32,
    // n_i / (n_i + n_s) about the middle of the cell.
    visibility: f32,
}

// Verdicts cover at most 35 degrees about a normal, so that 10 of the 45 are left for photons that surely count.
const SPREAD_UNIT = (1.0 - 0.81915204) / 255.0;
// In cells: fine enough not to be felt, with the range that cells need (diagonals; the largest search radius).
const OFFSET_UNIT = 1.0 / 2048.0;
const THICKNESS_UNIT = 1.0 / 128.0;
const REACH_UNIT = 1.0 / 16.0;
const VERDICT_UNKNOWN = 0x80000000u;

// Bits 0-13 normal, 14-15 class, 16-23 spread, 24-31 thickness; 0-11 offset, 12-19 reach, 20-30 visibility, 31 class
// unknown.
fn encode_verdict(verdict: Verdict, normal_code: u32, inverse_cell: f32) -> vec2u {
    let spread = u32(clamp(ceil((1.0 - verdict.cos_spread) / SPREAD_UNIT), 0.0, 255.0));
    let thickness = u32(clamp(ceil(verdict.thickness * inverse_cell / THICKNESS_UNIT), 0.0, 255.0));
    let offset = u32(clamp(round(verdict.offset * inverse_cell / OFFSET_UNIT) + 2048.0, 0.0, 4095.0));
    let reach = u32(clamp(ceil(verdict.reach * inverse_cell / REACH_UNIT), 0.0, 255.0));
    let visibility = u32(round(verdict.visibility * 2047.0));
    return vec2u(
        normal_code | ((verdict.class_ & 3u) << 14u) | (spread << 16u) | (thickness << 24u),
        offset | (reach << 12u) | (visibility << 20u) | select(0u, VERDICT_UNKNOWN, verdict.class_ == CLASS_UNKNOWN),
    );
}

fn decode_verdict(words: vec2u, cell: f32) -> Verdict {
    return Verdict(
        select((words.x >> 14u) & 3u, CLASS_UNKNOWN, (words.y & VERDICT_UNKNOWN) != 0u),
        oct_decode7(words.x & 0x3fffu),
        1.0 - f32((words.x >> 16u) & 255u) * SPREAD_UNIT,
        (f32(words.y & 4095u) - 2048.0) * OFFSET_UNIT * cell,
        f32(words.x >> 24u) * THICKNESS_UNIT * cell,
        f32((words.y >> 12u) & 255u) * REACH_UNIT * cell,
        f32((words.y >> 20u) & 2047u) / 2047.0,
    );
}

// Nothing is known.
fn no_verdict() -> Verdict {
    return Verdict(CLASS_DARK, vec3f(0.0, 0.0, 1.0), 1.0, 0.0, 0.0, 0.0, 0.0);
}

// Whether the verdict speaks of a point `from_centre` of the cell's centre.
fn verdict_holds(verdict: Verdict, from_centre: vec3f, normal: vec3f) -> bool {
    @if(paper_counting) { return verdict.reach > 0.0; }
    return verdict.reach > 0.0
        && dot(normal, verdict.normal) >= verdict.cos_spread
        && abs(dot(from_centre, verdict.normal) - verdict.offset) <= verdict.thickness;
}

// A cell that is asked about: points lie in it for which the photons' own verdicts do not hold, because its photons are
// of other surfaces or it has none. It is judged once, for the surface of the points.
struct AskedCell {
    // Its index, as `cell_index` gives it.
    cell: u32,
    // The slab and the cone of the points whose normals are about that of `asked_codes`: offsets from the cell's centre
    // along that normal and cosines to it, in units of ASKED_UNIT. The low ones are complements, so that each is
    // a maximum and 0 is nothing.
    low: atomic<u32>,
    high: atomic<u32>,
    spread: atomic<u32>,
    verdict: vec2u,
}

// Codes of normals as `asked_codes` has them, and back: the greatest word is the smallest code, and 0 is none.
fn asked_complement(code: u32) -> u32 {
    return 0x4000u - code;
}

// In cells; and for cosines.
const ASKED_UNIT = 1.0 / 16384.0;
const ASKED_ZERO = 32768u;
// Normals this near to that of a verdict are of its surface: 30 degrees.
const COS_CLUSTER = 0.8660254;

// Half the size of the box around |v|^2 + 15 (v . n)^2 <= reach^2, for all n within `tilt` of `normal`: the ellipsoid's
// matrix is I + 15 n n^T, its inverse I - 15/16 n n^T.
fn reach_box(reach: f32, normal: vec3f, tilt: f32) -> vec3f {
    @if(paper_counting) { return vec3f(reach); }
    let along = max(abs(normal) - tilt, vec3f(0.0));
    return reach * sqrt(vec3f(1.0) - 0.9375 * along * along);
}

// The rows of cells that a ball of `reach` cells may touch, first and last by (y, z). `low` and `high` bound the ball's
// centre, in cells; `normal` is the queries', within `tilt` of it.
fn rows_about(grid: GridShape, low: vec3f, high: vec3f, reach: f32, normal: vec3f, tilt: f32) -> vec4i {
    let half_size = reach_box(reach, normal, tilt).yz;
    return vec4i(
        max(vec2i(floor(low.yz - half_size)), vec2i(0)),
        min(vec2i(floor(high.yz + half_size)), vec2i(grid.size.yz) - 1),
    );
}

// A row of cells along x, from those that a ball of `reach` cells may touch: (first photon, end).
// `low` and `high` bound the ball's centre, in cells; `normal` is the queries', within `tilt` of it.
fn row_photons(grid: GridShape, light: u32, row: vec2i, low: vec3f, high: vec3f, reach: f32, normal: vec3f, tilt: f32) -> vec2u {
    let row_low = vec2f(row);
    let gap = max(max(low.yz - (row_low + 1.0), row_low - high.yz), vec2f(0.0));
    let rest = reach * reach - dot(gap, gap);
    if rest < 0.0 { return vec2u(0u); }
    let half_width = sqrt(rest);
    var ends = vec2f(low.x - half_width, high.x + half_width);
    @if(!paper_counting) {
        // A photon off the plane by more than a quarter of the reach is too far, whatever else. Both ends of the offset
        // lie in boxes; across the row it has this middle and half its range, which leaves this part of the row.
        let middle = dot(row_low + 0.5 - 0.5 * (low.yz + high.yz), normal.yz);
        let range = 0.5 * dot(vec2f(1.0) + high.yz - low.yz, abs(normal.yz)) + (0.25 + tilt) * reach;
        // Where the row lies in the plane, the ends are beyond any grid.
        let inverse = 1.0 / select(max(normal.x, 1e-6), min(normal.x, -1e-6), normal.x < 0.0);
        let crossings = (-middle + vec2f(-range, range)) * inverse;
        ends = vec2f(max(ends.x, low.x + min(crossings.x, crossings.y)), min(ends.y, high.x + max(crossings.x, crossings.y)));
    }
    let first = clamp(i32(floor(ends.x)), 0, i32(grid.size.x) - 1);
    let last = clamp(i32(floor(ends.y)), 0, i32(grid.size.x) - 1);
    if ends.x > ends.y { return vec2u(0u); }
    let base = cell_index(grid, light, vec3u(0u, vec2u(row)));
    return vec2u(load_cell_start(base + u32(first)), load_cell_start(base + u32(last) + 1u));
}

// A guess at how many cells away the k-th nearest is, from the photons in the cell and those around it: `spare` times
// the radius that holds k at their density. Three by three cells of the 27 are on an even surface.
fn reach_guess(grid: GridShape, light: u32, cell: vec3u, spare: f32) -> f32 {
    let low = vec3i(max(cell, vec3u(1u)) - 1u);
    let high = vec3i(min(cell + 1u, grid.size - 1u));
    var photons = 0u;
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            let base = cell_index(grid, light, vec3u(0u, u32(y), u32(z)));
            photons += load_cell_start(base + u32(high.x) + 1u) - load_cell_start(base + u32(low.x));
        }
    }
    return spare * sqrt(f32(nearest) * 9.0 / (PI * f32(max(photons, 1u))));
}
