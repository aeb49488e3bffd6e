// Look-up of precomputed irradiance (Christensen 1999). Pass `irradiance` estimates the irradiance of all light at
// irradiance points, which are photon positions. A surface point takes the value of the nearest irradiance point.
// In: the irradiance points, sorted by cell in `photon_table`, and `irradiance_table`.
// Out: irradiance in units of radiance times steradian, and the radius of the disc over which it is the mean, in scene
// units after normalisation. With `caustic_irradiance`, also the part of the irradiance that only focusing surfaces
// have scattered since it left the lights.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::bvh::traversal_iterations;
import package::lib::grid::{FAR, GridShape, cell_index, counted_distance, load_cell_start, load_photon, reach_box};

@if(texture_loads) @group(1) @binding(15) var irradiance_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(15) var<storage, read> irradiance_table: array<vec4f>;
// The grid of the irradiance points, which `photon_table` holds.
@group(1) @binding(16) var<uniform> irradiance_grid: GridShape;

// Texels of an irradiance point in the table.
@if(!caustic_irradiance) const IRRADIANCE_TEXELS = 1u;
@if(caustic_irradiance) const IRRADIANCE_TEXELS = 2u;

// Irradiance points that the look-ups of this invocation have visited, and their maximum number. Where light falls on a
// small part of a large scene, such as a model on a plain, one cell holds nearly all points: a look-up would cost more
// than the rays that it saves, and on a software device leave no loop iterations for these. The maximum is a quarter
// of the iterations of a path (lib/path_tracing), and a hundred look-ups where light falls everywhere.
const MAX_VISITS = 4096u;
var<private> visits: u32;

// The radius of a disc without an estimate. No footprint is as wide, so no path ends there.
const NO_ESTIMATE = 1e30;

struct Irradiance {
    // Irradiance on the side of the normal.
    value: vec3f,
    // Radius of the disc whose photons gave the value; NO_ESTIMATE where no irradiance point is near enough, or too
    // many are.
    radius: f32,
    // The irradiance point.
    @if(caustic_irradiance) point: u32,
}

fn load_irradiance_texel(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(irradiance_table, table_texel(i)); }
    @else { return irradiance_table[i]; }
}

// The part of an irradiance point's irradiance that only focusing surfaces have scattered.
@if(caustic_irradiance)
fn load_caustic_irradiance(point: u32) -> vec3f {
    return load_irradiance_texel(IRRADIANCE_TEXELS * point + 1u).xyz;
}

// Encodes the radius of an irradiance point's disc. The last eight bits hold the fraction of the radius within which
// there are no edges or walls.
fn encode_disc(radius: f32, clear: f32) -> f32 {
    return bitcast<f32>((bitcast<u32>(radius) & 0xffffff00u) | u32(clear * 255.0));
}

// Maximum distance of an irradiance point in the second search, in cells. Where photons are sparse, such as in a room
// that is lit through a door ajar, discs are up to four cells wide (MAX_REACH_WHERE_SPARSE in irradiance.wgsl). But
// most positions there have no irradiance point within half a cell, and paths would go on from them. In scenes/door.glb
// a distance of 2.5 cells found hardly more.
const SPARSE_REACH = 2.0;

// The nearest irradiance point so far.
struct Nearest {
    // FAR if there is none.
    distance: f32,
    point: u32,
    // There were too many irradiance points to visit.
    overrun: bool,
}

// The irradiance at the nearest irradiance point of the same surface. The first search is among the 2 x 2 x 2 cells
// nearest to the position, which hold all points within half a cell. If they hold none of this surface, the second one
// goes as far as SPARSE_REACH. A loop over both searches would take software devices a fifth longer.
fn irradiance_near(position: vec3f, normal: vec3f) -> Irradiance {
    let at = (position - irradiance_grid.origin) * irradiance_grid.inverse_cell;
    let last = vec3i(irradiance_grid.size) - 1;
    let corner = vec3i(floor(at - 0.5));
    let columns = clamp(vec2i(corner.x, corner.x + 1), vec2i(0), vec2i(last.x));
    var nearest = Nearest(FAR, 0u, false);
    for (var i = 0; i < 4; i++) {
        let row = corner.yz + vec2i(i & 1, i >> 1);
        if any(row != clamp(row, vec2i(0), last.yz)) { continue; }
        visit_row(&nearest, row, columns, position, normal);
    }
    if nearest.distance >= FAR {
        let half_size = reach_box(SPARSE_REACH, normal, 0.0);
        let low = clamp(vec3i(floor(at - half_size)), vec3i(0), last);
        let high = clamp(vec3i(floor(at + half_size)), vec3i(0), last);
        for (var z = low.z; z <= high.z; z++) {
            for (var y = low.y; y <= high.y; y++) {
                visit_row(&nearest, vec2i(y, z), vec2i(low.x, high.x), position, normal);
            }
        }
    }
    var known: Irradiance;
    known.radius = NO_ESTIMATE;
    if nearest.overrun || nearest.distance >= FAR { return known; }
    let found = load_irradiance_texel(IRRADIANCE_TEXELS * nearest.point);
    known.value = found.xyz;
    // The value is not valid beyond an edge or a wall: the surface there may be unlit, and then has no irradiance
    // points of its own.
    let clear = found.w * f32(bitcast<u32>(found.w) & 255u) / 255.0;
    known.radius = select(NO_ESTIMATE, found.w, nearest.distance <= clear * clear);
    @if(caustic_irradiance) { known.point = nearest.point; }
    return known;
}

// Visits the irradiance points in the cells of the row at (y, z) from the first to the last of the columns.
fn visit_row(nearest: ptr<function, Nearest>, row: vec2i, columns: vec2i, position: vec3f, normal: vec3f) {
    let base = cell_index(irradiance_grid, 0u, vec3u(0u, vec2u(row)));
    let first = load_cell_start(base + u32(columns.x));
    let end = load_cell_start(base + u32(columns.y) + 1u);
    (*nearest).overrun |= end - first > MAX_VISITS - visits;
    if (*nearest).overrun { return; }
    visits += end - first;
    traversal_iterations += end - first + 1u;
    for (var p = first; p < end; p++) {
        let distance = counted_distance(load_photon(p), position, normal);
        if distance < (*nearest).distance {
            (*nearest).distance = distance;
            (*nearest).point = p;
        }
    }
}
