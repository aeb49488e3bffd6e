// zones: the lights that reach each zone, a cell of a coarse grid, as photons tell. In: photons sorted by zone. Out: of each zone
// ZONE_LIGHTS words in the order of the lights, then zeros: bits 0-15 a light, 16-31 the root of the share of its photons,
// in the zone and those around it, that nothing had stopped. (A light that is seen from a share v of a zone's places is best
// chosen in proportion to the root of v.) Where more lights reach a zone than that, the strongest are listed.

import package::lib::dispatch::group_index;
import package::lib::grid::{GridShape, load_cell_start, load_photon};
import package::lib::constants::{MAX_LIGHTS, ZONE_LIGHTS};
import package::lib::photon::photon_is_shadow;

struct ZoneParameters {
    zones: GridShape,
    // Lights that photons are of.
    light_count: u32,
    // One more, that has none and reaches everywhere: 1 or 0.
    environment: u32,
    padding: vec2u,
}

var<immediate> zones_pass: ZoneParameters;

@group(0) @binding(0) var<storage, read> light_powers: array<f32>;
@group(0) @binding(1) var<storage, read_write> listed_lights: array<u32>;

const GROUP = 64u;
// Buckets of what lights send to a zone: by exponent and the first two bits behind it. The largest power is 1, and a tally
// below 2^16, so no exponent is above 127 + 15.
const BUCKETS = 143u * 4u;
const BUCKET_SHIFT = 21u;

// By light: illumination photons, above bit 16 shadow photons.
var<workgroup> tallies: array<atomic<u32>, MAX_LIGHTS>;
var<workgroup> buckets: array<atomic<u32>, BUCKETS>;
// By invocation lights above the last bucket that is listed, above bit 16 in it; then those listed before.
var<workgroup> lane_counts: array<u32, GROUP>;
var<workgroup> lane_firsts: array<u32, GROUP>;
var<workgroup> last_bucket: u32;
var<workgroup> room_in_last: u32;

// The bucket of what a light sends to the zone, as its photons tell; 0 where none arrived.
fn bucket_of(light: u32) -> u32 {
    if light >= zones_pass.light_count { return 0u; }
    let arrived = atomicLoad(&tallies[light]) & 0xffffu;
    if arrived == 0u { return 0u; }
    return max(bitcast<u32>(f32(arrived) * light_powers[light]) >> BUCKET_SHIFT, 1u);
}

fn zone_at(at: vec3u) -> u32 {
    let size = zones_pass.zones.size;
    return (at.z * size.y + at.y) * size.x + at.x;
}

@compute @workgroup_size(64)
fn list(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let size = zones_pass.zones.size;
    let zone = group_index(group, groups);
    let inside = zone < size.x * size.y * size.z;
    let at = vec3i(vec3u(zone % size.x, (zone / size.x) % size.y, zone / (size.x * size.y)));
    let low = max(at - 1, vec3i(0));
    let high = min(at + 1, vec3i(size) - 1);
    // Most zones of a large scene are empty, and nothing is there to be counted.
    let photons = load_cell_start(zone_at(vec3u(high)) + 1u) - load_cell_start(zone_at(vec3u(low)));
    let per_lane = (zones_pass.light_count + GROUP - 1u) / GROUP;
    let lights = select(0u, per_lane, photons > 0u);
    let first_light = lane * per_lane;
    // Where all lights fit, none need be weighed.
    let room = ZONE_LIGHTS - zones_pass.environment;
    let weighed = select(0u, lights, zones_pass.light_count > room);
    for (var l = 0u; l < lights; l++) { atomicStore(&tallies[first_light + l], 0u); }
    for (var b = lane; b < BUCKETS && weighed > 0u; b += GROUP) { atomicStore(&buckets[b], 0u); }
    workgroupBarrier();
    for (var z = low.z; inside && z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            let end = load_cell_start(zone_at(vec3u(vec3i(high.x, y, z))) + 1u);
            for (var p = load_cell_start(zone_at(vec3u(vec3i(low.x, y, z)))) + lane; p < end; p += GROUP) {
                let word = load_photon(p).w;
                atomicAdd(&tallies[(word >> 14u) & (MAX_LIGHTS - 1u)], select(1u, 65536u, photon_is_shadow(word)));
            }
        }
    }
    workgroupBarrier();
    for (var l = 0u; l < weighed; l++) {
        let bucket = bucket_of(first_light + l);
        if bucket > 0u { atomicAdd(&buckets[bucket], 1u); }
    }
    workgroupBarrier();
    if lane == 0u {
        var listed = 0u;
        var bucket = select(0u, BUCKETS - 1u, weighed > 0u);
        while bucket > 0u && listed + atomicLoad(&buckets[bucket]) <= room {
            listed += atomicLoad(&buckets[bucket]);
            bucket--;
        }
        last_bucket = bucket;
        // Bucket 0 is that of lights which do not reach the zone.
        room_in_last = select(room - listed, 0u, bucket == 0u);
    }
    workgroupBarrier();
    var counts = 0u;
    for (var l = 0u; l < lights; l++) {
        let bucket = bucket_of(first_light + l);
        counts += u32(bucket > last_bucket) + (u32(bucket == last_bucket && bucket > 0u) << 16u);
    }
    lane_counts[lane] = counts;
    workgroupBarrier();
    if lane == 0u {
        var before = 0u;
        for (var i = 0u; i * lights < zones_pass.light_count && lights > 0u; i++) {
            lane_firsts[i] = before;
            before += lane_counts[i];
        }
        let listed = (before & 0xffffu) + min(before >> 16u, room_in_last);
        if inside && zones_pass.environment != 0u {
            listed_lights[zone * ZONE_LIGHTS + listed] = zones_pass.light_count | 0xffff0000u;
        }
    }
    workgroupBarrier();
    if !inside { return; }
    var above = lane_firsts[lane] & 0xffffu;
    var last = lane_firsts[lane] >> 16u;
    for (var l = 0u; l < lights; l++) {
        let light = first_light + l;
        let bucket = bucket_of(light);
        let in_last = bucket == last_bucket && bucket > 0u;
        if bucket > last_bucket || (in_last && last < room_in_last) {
            let tally = atomicLoad(&tallies[light]);
            let arrived = f32(tally & 0xffffu);
            let share = u32(round(65535.0 * sqrt(arrived / (arrived + f32(tally >> 16u)))));
            listed_lights[zone * ZONE_LIGHTS + above + min(last, room_in_last)] = light | (max(share, 1u) << 16u);
        }
        above += u32(bucket > last_bucket);
        last += u32(in_last);
    }
}
