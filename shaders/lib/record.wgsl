// Irradiance records (Ward and Heckbert 1992), and interpolation between them.
// In: `head_table` and `value_table` with the records, and for each block of the image the records that reach it.
// Positions are in scene units after normalisation.
// Out: irradiance on the side of the normal, in units of radiance times steradian.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::constants::RECORD_HEAD_TEXELS;
@if(smooth_normals || normal_maps) import package::lib::constants::RECORD_VALUE_TEXELS_CURVED;
@if(!(smooth_normals || normal_maps)) import package::lib::constants::RECORD_VALUE_TEXELS_FLAT;

// A head has RECORD_HEAD_TEXELS texels: position and radius (as pass `gather` writes it, the size of a pixel there);
// normal and harmonic mean distance. The values have a texel per channel for the translational gradient and the
// irradiance, then a texel per channel for the rotational gradient.
@if(smooth_normals || normal_maps) const RECORD_VALUE_TEXELS = RECORD_VALUE_TEXELS_CURVED;
@if(!(smooth_normals || normal_maps)) const RECORD_VALUE_TEXELS = RECORD_VALUE_TEXELS_FLAT;

@if(texture_loads) @group(1) @binding(17) var head_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(17) var<storage, read> head_table: array<vec4f>;
@if(texture_loads) @group(1) @binding(18) var value_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(18) var<storage, read> value_table: array<vec4f>;
// For each block of the image, four to a vector, the index in `block_records` of its first record; the end of the last
// block follows.
@if(texture_loads) @group(1) @binding(19) var block_starts: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(19) var<storage, read> block_starts: array<vec4u>;
@if(texture_loads) @group(1) @binding(20) var block_records: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(20) var<storage, read> block_records: array<vec4u>;

fn load_head(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(head_table, table_texel(i)); }
    @else { return head_table[i]; }
}

fn load_value(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(value_table, table_texel(i)); }
    @else { return value_table[i]; }
}

fn load_block_start(i: u32) -> u32 {
    @if(texture_loads) { return textureLoad(block_starts, table_texel(i >> 2u))[i & 3u]; }
    @else { return block_starts[i >> 2u][i & 3u]; }
}

fn load_block_record(i: u32) -> u32 {
    @if(texture_loads) { return textureLoad(block_records, table_texel(i >> 2u))[i & 3u]; }
    @else { return block_records[i >> 2u][i & 3u]; }
}

// Weight of the squared offset along the normal, added to the squared distance. Such offsets count ten times (1 + 99 =
// 10 squared), so that a record is not used for a surface above or below its own.
const OFF_PLANE = 99.0;

// 1 over the length of the difference of unit normals 20 degrees apart: a record is not used for normals farther from
// its own.
const PER_NORMAL = 1.0 / 0.34729636;

struct Interpolated {
    irradiance: vec3f,
    // Sum of the records' weights: 0 where no record reaches the point.
    weight: f32,
}

// Interpolates the irradiance at a visible point from the records that reach its block of the image. The weight of a
// record falls to 0 at its radius (Tabellion and Lamorlette 2004), so that no rim is visible.
fn interpolate_records(block: u32, position: vec3f, normal: vec3f) -> Interpolated {
    var sum = vec3f(0.0);
    var weight = 0.0;
    let end = load_block_start(block + 1u);
    for (var j = load_block_start(block); j < end; j++) {
        let id = load_block_record(j);
        let centre = load_head(id * RECORD_HEAD_TEXELS);
        let side = load_head(id * RECORD_HEAD_TEXELS + 1u);
        let offset = position - centre.xyz;
        let off_plane = dot(offset, 0.5 * (normal + side.xyz));
        let distance = sqrt(dot(offset, offset) + OFF_PLANE * off_plane * off_plane) / centre.w;
        // Not by 1 minus the cosine, which keeps only three digits for normals that differ by 1e-3.
        let normal_distance = length(normal - side.xyz) * PER_NORMAL;
        let w = max(1.0 - max(distance, normal_distance), 0.0);
        let base = id * RECORD_VALUE_TEXELS;
        let r = load_value(base);
        let g = load_value(base + 1u);
        let b = load_value(base + 2u);
        let irradiance = vec3f(r.w, g.w, b.w);
        var change = vec3f(dot(r.xyz, offset), dot(g.xyz, offset), dot(b.xyz, offset));
        @if(smooth_normals || normal_maps) {
            let axis = cross(side.xyz, normal);
            change += vec3f(
                dot(load_value(base + 3u).xyz, axis),
                dot(load_value(base + 4u).xyz, axis),
                dot(load_value(base + 5u).xyz, axis),
            );
        }
        // Where the first-order change exceeds the irradiance itself, the gradient is not valid.
        sum += w * (irradiance + clamp(change, -irradiance, irradiance));
        weight += w;
    }
    return Interpolated(sum / max(weight, 1e-20), weight);
}
