// Irradiance records (Ward and Heckbert 1992).

@if(texture_loads) import package::lib::table::table_place;

// Vectors that a record takes.
// Heads: position and radius (from pass `gather`: the size of a pixel there); normal and harmonic mean distance.
const RECORD_HEAD = 2u;
// Values: of each channel the translational gradient and the irradiance, then of each channel the rotational gradient.
@if(smooth_normals || normal_maps) const RECORD_VALUES = 6u;
@if(!(smooth_normals || normal_maps)) const RECORD_VALUES = 3u;

@if(texture_loads) @group(1) @binding(17) var head_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(17) var<storage, read> head_table: array<vec4f>;
@if(texture_loads) @group(1) @binding(18) var value_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(18) var<storage, read> value_table: array<vec4f>;
// By block of the image, four to a vector: the first of its records in `block_records`; the last one's end follows.
@if(texture_loads) @group(1) @binding(19) var block_starts: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(19) var<storage, read> block_starts: array<vec4u>;
@if(texture_loads) @group(1) @binding(20) var block_records: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(20) var<storage, read> block_records: array<vec4u>;

fn load_head(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(head_table, table_place(i)); }
    @else { return head_table[i]; }
}

fn load_value(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(value_table, table_place(i)); }
    @else { return value_table[i]; }
}

fn load_block_start(i: u32) -> u32 {
    @if(texture_loads) { return textureLoad(block_starts, table_place(i >> 2u))[i & 3u]; }
    @else { return block_starts[i >> 2u][i & 3u]; }
}

fn load_block_record(i: u32) -> u32 {
    @if(texture_loads) { return textureLoad(block_records, table_place(i >> 2u))[i & 3u]; }
    @else { return block_records[i >> 2u][i & 3u]; }
}

// Offsets along the normal count as ten times as long: no record speaks for a surface above or below its own.
const OFF_PLANE = 99.0;

// A record says nothing of normals more than 20 degrees off: the length of the difference of two such.
const PER_NORMAL = 1.0 / 0.34729636;

struct Interpolated {
    irradiance: vec3f,
    // Sum of the records' weights: 0 where none speaks for the point.
    weight: f32,
}

// The irradiance at a point seen in a block of the image, from the records that reach there. A record's weight falls to 0 at its
// radius (Tabellion and Lamorlette 2004), so that nothing shows where it ends.
fn interpolate_records(block: u32, position: vec3f, normal: vec3f) -> Interpolated {
    var sum = vec3f(0.0);
    var weight = 0.0;
    let end = load_block_start(block + 1u);
    for (var j = load_block_start(block); j < end; j++) {
        let id = load_block_record(j);
        let place = load_head(id * RECORD_HEAD);
        let side = load_head(id * RECORD_HEAD + 1u);
        let offset = position - place.xyz;
        let off_plane = dot(offset, 0.5 * (normal + side.xyz));
        let distance = sqrt(dot(offset, offset) + OFF_PLANE * off_plane * off_plane) / place.w;
        // One less the cosine would say the same, but keeps three digits of normals that are alike to 1e-3.
        let turned = length(normal - side.xyz) * PER_NORMAL;
        let w = max(1.0 - max(distance, turned), 0.0);
        let base = id * RECORD_VALUES;
        let r = load_value(base);
        let g = load_value(base + 1u);
        let b = load_value(base + 2u);
        let irradiance = vec3f(r.w, g.w, b.w);
        var change = vec3f(dot(r.xyz, offset), dot(g.xyz, offset), dot(b.xyz, offset));
        @if(smooth_normals || normal_maps) {
            let turn = cross(side.xyz, normal);
            change += vec3f(
                dot(load_value(base + 3u).xyz, turn),
                dot(load_value(base + 4u).xyz, turn),
                dot(load_value(base + 5u).xyz, turn),
            );
        }
        // A first-order change of more than all there is tells of a place that the record does not know.
        sum += w * (irradiance + clamp(change, -irradiance, irradiance));
        weight += w;
    }
    return Interpolated(sum / max(weight, 1e-20), weight);
}
