// Photons sorted by light and cell of a regular grid: look-up of cells and photons, the distance that ranks the nearest
// photons, and the rows of cells that a query visits. Positions and distances are in normalised space unless noted as
// cells.

@if(texture_loads) import package::lib::table::table_texel;
@if(!paper_counting) import package::lib::constants::NORMAL_OFFSET_WEIGHT;
import package::lib::constants::REACH_CELLS;
import package::lib::math::{PI, oct_within7};

// Nearest photons that a query counts (k).
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
// Index of the first photon of each cell, four cells to a texel; the end of the last cell follows.
@if(texture_loads) @group(1) @binding(14) var cell_starts: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(14) var<storage, read> cell_starts: array<vec4u>;

// Weight of the squared offset along the normal in the distance that ranks photons. The paper's ranks them by their
// distance alone.
@if(!paper_counting) const OFFSET_WEIGHT = f32(NORMAL_OFFSET_WEIGHT);
@if(paper_counting) const OFFSET_WEIGHT = 0.0;
// Photons whose normals differ by more than 45 degrees belong to another surface.
const COMPATIBLE_COSINE_SQUARED = 0.5;

// A squared distance greater than that of any photon.
const FAR = 1e30;

// The largest search radius, in cells.
const MAX_REACH = f32(REACH_CELLS);

fn load_photon(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(photon_table, table_texel(i)); }
    @else { return photon_table[i]; }
}

fn load_cell_start(i: u32) -> u32 {
    let texel = i >> 2u;
    @if(texture_loads) { return textureLoad(cell_starts, table_texel(texel))[i & 3u]; }
    @else { return cell_starts[texel][i & 3u]; }
}

// Whether a photon counts for points of this normal.
fn compatible(word: u32, normal: vec3f) -> bool {
    @if(paper_counting) { return true; }
    @if(!paper_counting) { return oct_within7(word, normal, COMPATIBLE_COSINE_SQUARED); }
}

// The squared distance between photon and point that ranks the nearest photons; FAR for a photon that does not count.
fn counted_distance(photon: vec4u, position: vec3f, normal: vec3f) -> f32 {
    let v = bitcast<vec3f>(photon.xyz) - position;
    let along = dot(v, normal);
    return select(FAR, dot(v, v) + OFFSET_WEIGHT * along * along, compatible(photon.w, normal));
}

fn cell_of(grid: GridShape, position: vec3f) -> vec3u {
    let cell = vec3i(floor((position - grid.origin) * grid.inverse_cell));
    return vec3u(clamp(cell, vec3i(0), vec3i(grid.size) - 1));
}

fn cell_centre(grid: GridShape, cell: vec3u) -> vec3f {
    return grid.origin + (vec3f(cell) + 0.5) * grid.cell;
}

fn cells_of_a_light(grid: GridShape) -> u32 {
    return grid.size.x * grid.size.y * grid.size.z;
}

// Index of a cell in the grid of one light.
fn index_in_grid(grid: GridShape, cell: vec3u) -> u32 {
    return (cell.z * grid.size.y + cell.y) * grid.size.x + cell.x;
}

// The cell with an index in the grid of one light.
fn cell_in_grid(grid: GridShape, index: u32) -> vec3u {
    let size = grid.size;
    return vec3u(index % size.x, (index / size.x) % size.y, index / (size.x * size.y));
}

// Index of a cell among those of all lights.
fn cell_index(grid: GridShape, light: u32, cell: vec3u) -> u32 {
    let within = index_in_grid(grid, cell);
    @if(light_tags) { return light * cells_of_a_light(grid) + within; }
    @else { return within; }
}

// The volume that a set of queries searches, in units of cells: their centres lie between `low` and `high`, their
// radius is `reach`, and their normals n satisfy |n - normal| <= `tilt`.
struct SearchBall {
    low: vec3f,
    high: vec3f,
    reach: f32,
    normal: vec3f,
    tilt: f32,
}

// The volume of one point's query.
fn point_ball(centre: vec3f, reach: f32, normal: vec3f) -> SearchBall {
    return SearchBall(centre, centre, reach, normal, 0.0);
}

// Half the size of the box around the ellipsoid |v|^2 + w (v . n)^2 <= reach^2, for all n within `tilt` of `normal`,
// where w is OFFSET_WEIGHT. The ellipsoid's matrix is I + w n n^T, its inverse I - w / (1 + w) n n^T.
fn reach_box(reach: f32, normal: vec3f, tilt: f32) -> vec3f {
    @if(paper_counting) { return vec3f(reach); }
    let along = max(abs(normal) - tilt, vec3f(0.0));
    return reach * sqrt(vec3f(1.0) - OFFSET_WEIGHT / (1.0 + OFFSET_WEIGHT) * along * along);
}

// The rows of cells along x that the volume may touch: first and last (y, z).
fn rows_about(grid: GridShape, ball: SearchBall) -> vec4i {
    let half_size = reach_box(ball.reach, ball.normal, ball.tilt).yz;
    return vec4i(
        max(vec2i(floor(ball.low.yz - half_size)), vec2i(0)),
        min(vec2i(floor(ball.high.yz + half_size)), vec2i(grid.size.yz) - 1),
    );
}

// The photons in the cells of the row at (y, z) that the volume may touch: first photon and end.
fn row_photons(grid: GridShape, light: u32, row: vec2i, ball: SearchBall) -> vec2u {
    let row_low = vec2f(row);
    let gap = max(max(ball.low.yz - (row_low + 1.0), row_low - ball.high.yz), vec2f(0.0));
    let rest = ball.reach * ball.reach - dot(gap, gap);
    if rest < 0.0 { return vec2u(0u); }
    let half_width = sqrt(rest);
    var ends = vec2f(ball.low.x - half_width, ball.high.x + half_width);
    @if(!paper_counting) { ends = clip_to_plane(ends, row_low, ball); }
    let first = clamp(i32(floor(ends.x)), 0, i32(grid.size.x) - 1);
    let last = clamp(i32(floor(ends.y)), 0, i32(grid.size.x) - 1);
    if ends.x > ends.y { return vec2u(0u); }
    let base = cell_index(grid, light, vec3u(0u, vec2u(row)));
    return vec2u(load_cell_start(base + u32(first)), load_cell_start(base + u32(last) + 1u));
}

// The part of a row near the tangent plane of the query: a photon farther from it than this share of the reach cannot
// count.
@if(!paper_counting) const MAX_OFFSET = 1.0 / sqrt(1.0 + OFFSET_WEIGHT);
@if(!paper_counting)
fn clip_to_plane(ends: vec2f, row_low: vec2f, ball: SearchBall) -> vec2f {
    // Photon and query both lie in boxes. The part of their offset along the normal that comes from y and z has this
    // middle and half range.
    let normal = ball.normal;
    let middle = dot(row_low + 0.5 - 0.5 * (ball.low.yz + ball.high.yz), normal.yz);
    let boxes = 0.5 * dot(vec2f(1.0) + ball.high.yz - ball.low.yz, abs(normal.yz));
    let range = boxes + (MAX_OFFSET + ball.tilt) * ball.reach;
    // Where the row is parallel to the plane, the ends lie beyond any grid.
    let inverse = 1.0 / select(max(normal.x, 1e-6), min(normal.x, -1e-6), normal.x < 0.0);
    let crossings = (-middle + vec2f(-range, range)) * inverse;
    return vec2f(
        max(ends.x, ball.low.x + min(crossings.x, crossings.y)),
        min(ends.y, ball.high.x + max(crossings.x, crossings.y)),
    );
}

// A search begins with the expected reach times this. On average the disc then holds 1.69 k photons; of random photons,
// one disc in 1,500 holds fewer than k = 30. So where photons are even, hardly any search is widened.
const FIRST_REACH = 1.3;

// The expected distance to the k-th nearest photon, in cells: the radius that holds k photons at the mean density of
// the cell and its 26 neighbours. On a flat surface 3 x 3 of the 27 cells hold photons. `factor` scales it.
fn expected_reach(grid: GridShape, light: u32, cell: vec3u, factor: f32) -> f32 {
    let low = vec3i(max(cell, vec3u(1u)) - 1u);
    let high = vec3i(min(cell + 1u, grid.size - 1u));
    var photons = 0u;
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            let base = cell_index(grid, light, vec3u(0u, u32(y), u32(z)));
            photons += load_cell_start(base + u32(high.x) + 1u) - load_cell_start(base + u32(low.x));
        }
    }
    return factor * sqrt(f32(nearest) * 9.0 / (PI * f32(max(photons, 1u))));
}
