// Irradiance of all light at places that photons have reached, precomputed (Christensen 1999): the nearest such place
// stands for a point.

@if(texture_loads) import package::lib::table::table_place;
import package::lib::grid::{FAR, GridShape, cell_index, counted_distance, load_cell_start, load_photon};

@if(texture_loads) @group(1) @binding(15) var irradiance_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(15) var<storage, read> irradiance_table: array<vec4f>;
// The grid of the places, which `photon_table` holds.
@group(1) @binding(16) var<uniform> irradiance_grid: GridShape;

struct Irradiance {
    // On the side of the normal.
    value: vec3f,
    // Of the disc whose photons it is the mean of; FAR where there is none near enough to stand for the point.
    radius: f32,
}

fn load_irradiance(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(irradiance_table, table_place(i)); }
    @else { return irradiance_table[i]; }
}

// Radius of a place's disc, and which part of it is clear of edges and walls: in the radius's eight last bits.
fn encode_disc(radius: f32, clear: f32) -> f32 {
    return bitcast<f32>((bitcast<u32>(radius) & 0xffffff00u) | u32(clear * 255.0));
}

// The place nearest to the point among those of its surface in the eight cells about it: of all within half a cell none is
// missed.
fn irradiance_near(position: vec3f, normal: vec3f) -> Irradiance {
    let size = vec3i(irradiance_grid.size);
    let corner = vec3i(floor((position - irradiance_grid.origin) * irradiance_grid.inverse_cell - 0.5));
    let low = max(corner, vec3i(0));
    let high = min(corner + 1, size - 1);
    var nearest_distance = FAR;
    var nearest_place = 0u;
    if low.x <= high.x {
        for (var row = 0; row < 4; row++) {
            let y = corner.y + (row & 1);
            let z = corner.z + (row >> 1);
            if y < low.y || y > high.y || z < low.z || z > high.z { continue; }
            let base = cell_index(irradiance_grid, 0u, vec3u(0u, u32(y), u32(z)));
            let end = load_cell_start(base + u32(high.x) + 1u);
            for (var p = load_cell_start(base + u32(low.x)); p < end; p++) {
                let distance = counted_distance(load_photon(p), position, normal);
                if distance < nearest_distance {
                    nearest_distance = distance;
                    nearest_place = p;
                }
            }
        }
    }
    if nearest_distance >= FAR { return Irradiance(vec3f(0.0), FAR); }
    let found = load_irradiance(nearest_place);
    // Beyond an edge or a wall the place says nothing: behind a wall there may be no light, and so no place that is nearer.
    let clear = found.w * f32(bitcast<u32>(found.w) & 255u) / 255.0;
    return Irradiance(found.xyz, select(FAR, found.w, nearest_distance <= clear * clear));
}
