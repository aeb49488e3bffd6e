// Irradiance records (Ward and Heckbert 1992), and interpolation between them.
// In: `head_table` and `value_table` with the records, and for each block of the image the records that reach it.
// Positions are in scene units after normalisation.
// Out: irradiance on the side of the normal, in units of radiance times steradian.
//
// Software devices whose subgroups have PACKET_LANES lanes interpolate at the points of a subgroup together. A load
// there takes as long for eight lanes with one address as for eight addresses, so each lane loads another record of
// the block, and shuffles hand the records round. Every lane of a subgroup must reach the interpolation at the same
// time. One without a point passes NO_BLOCK. `lane` is the invocation's index within the workgroup, as in lib/packet.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::constants::{RECORD_HEAD_TEXELS, RECORD_OFF_PLANE, RECORD_PER_NORMAL};
@if(packets) import package::lib::constants::PACKET_LANES;
@if(smooth_normals || normal_maps) import package::lib::constants::RECORD_VALUE_TEXELS_CURVED;
@if(!(smooth_normals || normal_maps)) import package::lib::constants::RECORD_VALUE_TEXELS_FLAT;

// A head has RECORD_HEAD_TEXELS texels: position and radius (in place of which pass `gather` writes the size of a pixel
// there); normal and harmonic mean distance. The values have a texel per channel for the translational gradient and the
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

struct Interpolated {
    irradiance: vec3f,
    // Sum of the records' weights: 0 where no record reaches the point.
    weight: f32,
}

// A record as points are interpolated from it.
struct Record {
    // Position and radius.
    centre: vec4f,
    normal: vec3f,
    // Translational gradient and irradiance of each channel.
    red: vec4f,
    green: vec4f,
    blue: vec4f,
    @if(smooth_normals || normal_maps) red_rotation: vec3f,
    @if(smooth_normals || normal_maps) green_rotation: vec3f,
    @if(smooth_normals || normal_maps) blue_rotation: vec3f,
}

fn load_record(id: u32) -> Record {
    var record: Record;
    record.centre = load_head(id * RECORD_HEAD_TEXELS);
    record.normal = load_head(id * RECORD_HEAD_TEXELS + 1u).xyz;
    let base = id * RECORD_VALUE_TEXELS;
    record.red = load_value(base);
    record.green = load_value(base + 1u);
    record.blue = load_value(base + 2u);
    @if(smooth_normals || normal_maps) {
        record.red_rotation = load_value(base + 3u).xyz;
        record.green_rotation = load_value(base + 4u).xyz;
        record.blue_rotation = load_value(base + 5u).xyz;
    }
    return record;
}

// The contribution of a record at a point: irradiance times weight, and the weight. It falls to 0 at the record's
// radius (Tabellion and Lamorlette 2004), so that no rim is visible.
fn weighted_irradiance(record: Record, position: vec3f, normal: vec3f) -> vec4f {
    let offset = position - record.centre.xyz;
    let off_plane = dot(offset, 0.5 * (normal + record.normal));
    let distance = sqrt(dot(offset, offset) + RECORD_OFF_PLANE * off_plane * off_plane) / record.centre.w;
    // Not by 1 minus the cosine: for normals that differ by 1e-3 it is 5e-7, a few roundings of the cosine.
    let normal_distance = length(normal - record.normal) * RECORD_PER_NORMAL;
    let w = max(1.0 - max(distance, normal_distance), 0.0);
    let irradiance = vec3f(record.red.w, record.green.w, record.blue.w);
    var change = vec3f(dot(record.red.xyz, offset), dot(record.green.xyz, offset), dot(record.blue.xyz, offset));
    @if(smooth_normals || normal_maps) {
        let axis = cross(record.normal, normal);
        change += vec3f(
            dot(record.red_rotation, axis),
            dot(record.green_rotation, axis),
            dot(record.blue_rotation, axis),
        );
    }
    // Where the first-order change exceeds the irradiance itself, the gradient is not valid.
    return vec4f(w * (irradiance + clamp(change, -irradiance, irradiance)), w);
}

// The block of a lane without a point.
const NO_BLOCK = 0xffffffffu;

// Interpolates the irradiance at a visible point from the records that reach its block of the image; 0 where none
// reaches the point.
fn interpolate_records(block: u32, position: vec3f, normal: vec3f, lane: u32) -> Interpolated {
    @if(!packets) let sum = sum_of_block(block, position, normal);
    @if(packets) let sum = sum_of_blocks(block, position, normal, lane % PACKET_LANES);
    return Interpolated(sum.xyz / max(sum.w, 1e-20), sum.w);
}

@if(!packets)
fn sum_of_block(block: u32, position: vec3f, normal: vec3f) -> vec4f {
    var sum = vec4f(0.0);
    if block == NO_BLOCK { return sum; }
    let end = load_block_start(block + 1u);
    for (var j = load_block_start(block); j < end; j++) {
        sum += weighted_irradiance(load_record(load_block_record(j)), position, normal);
    }
    return sum;
}

// The sum over each lane's block, with the same bits as without packets: a lane adds its records in the same order, and
// those that are left out would add 0. Most subgroups lie in one block; if not, their blocks are processed one after
// the other.
@if(packets)
fn sum_of_blocks(block: u32, position: vec3f, normal: vec3f, lane: u32) -> vec4f {
    var sum = vec4f(0.0);
    var waiting = block;
    var current = min_of_lanes(waiting, lane);
    loop {
        let here = waiting == current;
        let low = min3_of_lanes(select(vec3f(3e38), position, here), lane);
        let high = -min3_of_lanes(select(vec3f(3e38), -position, here), lane);
        let end = select(load_block_start(current + 1u), 0u, current == NO_BLOCK);
        var first = load_block_start(current);
        loop {
            let held = load_record(load_block_record(first + lane));
            // No more than the distance to any of the points, up to the roundings of its square and of the weight.
            let gap = max(max(low - held.centre.xyz, held.centre.xyz - high), vec3f(0.0));
            let reaches = dot(gap, gap) <= held.centre.w * held.centre.w * 1.00001;
            var left = bits_of_lanes(select(0u, 1u << lane, reaches && first + lane < end), lane);
            loop {
                let record = record_of_lane(held, firstTrailingBit(left) & (PACKET_LANES - 1u));
                let added = weighted_irradiance(record, position, normal);
                sum += select(vec4f(0.0), added, here && left != 0u);
                left &= left - 1u;
                if left == 0u { break; }
            }
            first += PACKET_LANES;
            if first >= end { break; }
        }
        waiting = select(waiting, NO_BLOCK, here);
        current = min_of_lanes(waiting, lane);
        if current == NO_BLOCK { break; }
    }
    return sum;
}

@if(packets)
fn record_of_lane(held: Record, lane: u32) -> Record {
    var record: Record;
    record.centre = shuffle4(held.centre, lane);
    record.normal = shuffle3(held.normal, lane);
    record.red = shuffle4(held.red, lane);
    record.green = shuffle4(held.green, lane);
    record.blue = shuffle4(held.blue, lane);
    @if(smooth_normals || normal_maps) {
        record.red_rotation = shuffle3(held.red_rotation, lane);
        record.green_rotation = shuffle3(held.green_rotation, lane);
        record.blue_rotation = shuffle3(held.blue_rotation, lane);
    }
    return record;
}

@if(packets)
fn shuffle3(value: vec3f, lane: u32) -> vec3f {
    return vec3f(subgroupShuffle(value.x, lane), subgroupShuffle(value.y, lane), subgroupShuffle(value.z, lane));
}

@if(packets)
fn shuffle4(value: vec4f, lane: u32) -> vec4f {
    return vec4f(shuffle3(value.xyz, lane), subgroupShuffle(value.w, lane));
}

@if(packets)
fn min_of_lanes(value: u32, lane: u32) -> u32 {
    var lowest = min(value, subgroupShuffle(value, lane ^ 4u));
    lowest = min(lowest, subgroupShuffle(lowest, lane ^ 2u));
    lowest = min(lowest, subgroupShuffle(lowest, lane ^ 1u));
    return subgroupBroadcast(lowest, 0u);
}

@if(packets)
fn min3_of_lanes(value: vec3f, lane: u32) -> vec3f {
    var lowest = min(value, shuffle3(value, lane ^ 4u));
    lowest = min(lowest, shuffle3(lowest, lane ^ 2u));
    return min(lowest, shuffle3(lowest, lane ^ 1u));
}

// The bits that are set in any lane.
@if(packets)
fn bits_of_lanes(value: u32, lane: u32) -> u32 {
    var bits = value | subgroupShuffle(value, lane ^ 4u);
    bits |= subgroupShuffle(bits, lane ^ 2u);
    bits |= subgroupShuffle(bits, lane ^ 1u);
    return subgroupBroadcast(bits, 0u);
}
