// Look-up of precomputed irradiance (Christensen 1999). Pass `irradiance` estimates the irradiance of all light at
// irradiance points, which are photon positions. A surface point takes the value of the nearest irradiance point.
// In: the irradiance points, sorted by cell in `photon_table`, and `irradiance_table`.
// Out: irradiance in units of radiance times steradian, and the radius of the disc over which it is the mean, in scene
// units after normalisation. With `caustic_irradiance`, also the part of the irradiance that only focusing surfaces
// have scattered since it left the lights.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::bvh::traversal_iterations;
import package::lib::grid::{FAR, GridShape, cell_index, counted_distance, load_cell_start, load_photon};

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

// The irradiance at the nearest irradiance point of the same surface in the 2 x 2 x 2 cells nearest to the position.
// These hold all points within half a cell.
fn irradiance_near(position: vec3f, normal: vec3f) -> Irradiance {
    let size = vec3i(irradiance_grid.size);
    let corner = vec3i(floor((position - irradiance_grid.origin) * irradiance_grid.inverse_cell - 0.5));
    let low = max(corner, vec3i(0));
    let high = min(corner + 1, size - 1);
    var nearest_distance = FAR;
    var nearest_point = 0u;
    var known: Irradiance;
    known.radius = NO_ESTIMATE;
    if low.x <= high.x {
        for (var row = 0; row < 4; row++) {
            let y = corner.y + (row & 1);
            let z = corner.z + (row >> 1);
            if y < low.y || y > high.y || z < low.z || z > high.z { continue; }
            let base = cell_index(irradiance_grid, 0u, vec3u(0u, u32(y), u32(z)));
            let first = load_cell_start(base + u32(low.x));
            let end = load_cell_start(base + u32(high.x) + 1u);
            if end - first > MAX_VISITS - visits { return known; }
            visits += end - first;
            traversal_iterations += end - first + 1u;
            for (var p = first; p < end; p++) {
                let distance = counted_distance(load_photon(p), position, normal);
                if distance < nearest_distance {
                    nearest_distance = distance;
                    nearest_point = p;
                }
            }
        }
    }
    if nearest_distance >= FAR { return known; }
    let found = load_irradiance_texel(IRRADIANCE_TEXELS * nearest_point);
    known.value = found.xyz;
    // The value is not valid beyond an edge or a wall: the surface there may be unlit, and then has no irradiance
    // points of its own.
    let clear = found.w * f32(bitcast<u32>(found.w) & 255u) / 255.0;
    known.radius = select(NO_ESTIMATE, found.w, nearest_distance <= clear * clear);
    @if(caustic_irradiance) { known.point = nearest_point; }
    return known;
}
