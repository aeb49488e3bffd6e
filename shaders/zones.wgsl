// zones: lists, by the photons, the lights that reach each zone, a cell of a coarse grid (paper, "Results and
// discussion"). In: photons sorted by zone, and the lights' powers over the largest. Out: for each zone ZONE_LIGHTS
// words, sorted by light and padded with zeros. Bits 0-15 hold a light, bits 16-31 the square root of the share of
// illumination photons among its photons in the zone and its neighbours. (A light that is visible from a share v of a
// zone's points is best sampled in proportion to the square root of v.) Where more than ZONE_LIGHTS lights reach a
// zone, it lists the strongest.

import package::kit::group_index;
import package::lib::grid::{GridShape, cell_in_grid, cells_of_a_light, index_in_grid, load_cell_start, load_photon};
import package::lib::constants::{MAX_LIGHTS, PHOTON_LIGHT_SHIFT, ZONE_LIGHTS};
import package::lib::photon::photon_is_shadow;

struct ZoneParameters {
    zones: GridShape,
    // Number of lights that have photons.
    light_count: u32,
    // 1 where the environment is one more light, which has no photons and reaches every zone; else 0.
    environment: u32,
    padding: vec2u,
}

var<immediate> zones_pass: ZoneParameters;

@group(0) @binding(0) var<storage, read> light_powers: array<f32>;
@group(0) @binding(1) var<storage, read_write> listed_lights: array<u32>;

// As GATHER_GROUP in src/kernels/numbers.rs.
const GROUP = 64u;
// Buckets of a histogram of what lights send to a zone, by the float's exponent and the upper two bits of its mantissa.
// The largest power is 1 and tallies are below 2^16 (RAYS_PER_LIGHT in src/light_transport/light_sampler.rs), so no
// exponent exceeds 127 + 15.
const BUCKETS = 143u * 4u;
const BUCKET_SHIFT = 21u;

// For each light: illumination photons in bits 0-15, shadow photons above.
var<workgroup> tallies: array<atomic<u32>, MAX_LIGHTS>;
var<workgroup> buckets: array<atomic<u32>, BUCKETS>;
// For each invocation: in bits 0-15 its lights above the last bucket that is listed, from bit 16 those in that bucket.
// `lane_firsts` holds the sums of these over earlier invocations.
var<workgroup> lane_counts: array<u32, GROUP>;
var<workgroup> lane_firsts: array<u32, GROUP>;
var<workgroup> last_bucket: u32;
var<workgroup> room_in_last: u32;

// The bucket for the light that a light sends to the zone; 0 if none of its photons arrived.
fn bucket_of(light: u32) -> u32 {
    if light >= zones_pass.light_count { return 0u; }
    let arrived = atomicLoad(&tallies[light]) & 0xffffu;
    if arrived == 0u { return 0u; }
    return max(bitcast<u32>(f32(arrived) * light_powers[light]) >> BUCKET_SHIFT, 1u);
}

fn zone_index(zone: vec3i) -> u32 {
    return index_in_grid(zones_pass.zones, vec3u(zone));
}

// Adds the photons of the zones from `low` to `high` to the tallies. Each invocation of the workgroup takes every 64th
// photon.
fn tally_photons(low: vec3i, high: vec3i, lane: u32) {
    for (var z = low.z; z <= high.z; z++) {
        for (var y = low.y; y <= high.y; y++) {
            let end = load_cell_start(zone_index(vec3i(high.x, y, z)) + 1u);
            for (var p = load_cell_start(zone_index(vec3i(low.x, y, z))) + lane; p < end; p += GROUP) {
                let word = load_photon(p).w;
                let light = (word >> PHOTON_LIGHT_SHIFT) & (MAX_LIGHTS - 1u);
                atomicAdd(&tallies[light], select(1u, 65536u, photon_is_shadow(word)));
            }
        }
    }
}

// Finds the last bucket that is listed, from the strongest down, and how many of its lights still fit.
fn find_last_bucket(room: u32, weighed: bool) {
    var listed = 0u;
    var bucket = select(0u, BUCKETS - 1u, weighed);
    while bucket > 0u && listed + atomicLoad(&buckets[bucket]) <= room {
        listed += atomicLoad(&buckets[bucket]);
        bucket--;
    }
    last_bucket = bucket;
    // Bucket 0 holds the lights that do not reach the zone.
    room_in_last = select(room - listed, 0u, bucket == 0u);
}

// Finds where each invocation writes its lights, and puts the environment behind them all. `lights` is the number of
// lights per invocation.
fn find_firsts(zone: u32, inside: bool, lights: u32) {
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

// Writes an invocation's lights behind those of earlier invocations.
fn list_lights(zone: u32, first_light: u32, lights: u32, before: u32) {
    var above = before & 0xffffu;
    var last = before >> 16u;
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

// One workgroup per zone.
@compute @workgroup_size(64)
fn list(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let size = zones_pass.zones.size;
    let zone = group_index(group, groups);
    let inside = zone < cells_of_a_light(zones_pass.zones);
    let at = vec3i(cell_in_grid(zones_pass.zones, zone));
    let low = max(at - 1, vec3i(0));
    let high = min(at + 1, vec3i(size) - 1);
    // In a large scene nearly all zones are empty, and there is nothing to count.
    let photons = load_cell_start(zone_index(high) + 1u) - load_cell_start(zone_index(low));
    let per_lane = (zones_pass.light_count + GROUP - 1u) / GROUP;
    let lights = select(0u, per_lane, photons > 0u);
    let first_light = lane * per_lane;
    // If all lights fit, their order by strength does not matter.
    let room = ZONE_LIGHTS - zones_pass.environment;
    let weighed = select(0u, lights, zones_pass.light_count > room);
    for (var l = 0u; l < lights; l++) { atomicStore(&tallies[first_light + l], 0u); }
    for (var b = lane; b < BUCKETS && weighed > 0u; b += GROUP) { atomicStore(&buckets[b], 0u); }
    workgroupBarrier();
    if inside { tally_photons(low, high, lane); }
    workgroupBarrier();
    for (var l = 0u; l < weighed; l++) {
        let bucket = bucket_of(first_light + l);
        if bucket > 0u { atomicAdd(&buckets[bucket], 1u); }
    }
    workgroupBarrier();
    if lane == 0u { find_last_bucket(room, weighed > 0u); }
    workgroupBarrier();
    var counts = 0u;
    for (var l = 0u; l < lights; l++) {
        let bucket = bucket_of(first_light + l);
        counts += u32(bucket > last_bucket) + (u32(bucket == last_bucket && bucket > 0u) << 16u);
    }
    lane_counts[lane] = counts;
    workgroupBarrier();
    if lane == 0u { find_firsts(zone, inside, lights); }
    workgroupBarrier();
    if inside { list_lights(zone, first_light, lights, lane_firsts[lane]); }
}
