// film: sums the samples of the tile's pixels, compensated (Kahan 1965; Neumaier 1974), so that tens of thousands of
// samples lose nothing that shows. A sample that is not finite is left out and counted; so are pixels whose sum may come to
// overflow, and squares that do.
// In: `samples`, a vector a point. Out: in `sums` and `compensations`, a vector a pixel; compensations.w counts the
// samples that were left out.

import package::lib::dispatch::group_index;
import package::lib::math::is_finite4;
import package::lib::constants::{COUNTER_NOT_FINITE, COUNTER_NEAR_OVERFLOW};

struct FilmParameters {
    pixel_count: u32,
    // Points to sum, and the first of them in `samples`.
    point_count: u32,
    first_point: u32,
}

@group(0) @binding(0) var<storage, read> samples: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> sums: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> compensations: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> counters: array<atomic<u32>>;
// For the variance of the whole: the other part of the radiance, or one zero for all points.
@group(0) @binding(4) var<storage, read> other_samples: array<vec4f>;

var<immediate> film_parameters: FilmParameters;

// 2^104: a sum beyond may overflow (at 2^128) within the 2^24 samples that a render can take.
const NEAR_OVERFLOW = 2.028241e31;

struct Sum {
    value: vec4f,
    compensation: vec4f,
}

// Neumaier's step. The difference that was lost is computed from the operand that is larger. What is compensated goes back
// into the sum as far as it has room there (Dekker's sum of doubles): left to grow over many samples alike, it would round
// as the sum itself does. (Written as `rest - (value - total)`, drivers that cancel `(total + rest) - total` lose it all.)
fn compensated(sum: Sum, x: vec4f) -> Sum {
    let total = sum.value + x;
    let lost = select((x - total) + sum.value, (sum.value - total) + x, abs(sum.value) >= abs(x));
    let rest = sum.compensation.xyz + lost.xyz;
    let value = total.xyz + rest;
    return Sum(vec4f(value, total.w), vec4f(rest + (total.xyz - value), sum.compensation.w));
}

// Adds a sample to a pixel; false if it was left out.
fn add_sample(pixel: u32, x: vec4f) -> bool {
    var sum = Sum(sums[pixel], compensations[pixel]);
    let finite = is_finite4(x);
    if finite {
        sum = compensated(sum, x);
    } else {
        sum.compensation.w += 1.0;
    }
    sums[pixel] = sum.value;
    compensations[pixel] = sum.compensation;
    return finite;
}

@compute @workgroup_size(64)
fn accumulate(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = group_index(group, groups) * 64u + lane;
    if pixel >= film_parameters.pixel_count { return; }
    for (var i = pixel; i < film_parameters.point_count; i += film_parameters.pixel_count) {
        if !add_sample(pixel, samples[film_parameters.first_point + i]) { atomicAdd(&counters[COUNTER_NOT_FINITE], 1u); }
    }
    if any(abs(sums[pixel]) > vec4f(NEAR_OVERFLOW)) { atomicAdd(&counters[COUNTER_NEAR_OVERFLOW], 1u); }
}

// The squares of the sum of both parts of the radiance.
@compute @workgroup_size(64)
fn accumulate_squares(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = group_index(group, groups) * 64u + lane;
    if pixel >= film_parameters.pixel_count { return; }
    for (var i = pixel; i < film_parameters.point_count; i += film_parameters.pixel_count) {
        let x = samples[i] + other_samples[i % arrayLength(&other_samples)];
        // A sample that is not finite itself is counted by `accumulate`.
        if !add_sample(pixel, x * x) && is_finite4(x) { atomicAdd(&counters[COUNTER_NEAR_OVERFLOW], 1u); }
    }
}
