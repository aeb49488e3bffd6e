// film: sums the samples of each pixel of a tile with compensation (Kahan 1965; Neumaier 1974), so that tens of
// thousands of samples lose no visible precision. A sample that is not finite is left out and counted. The pass also
// counts pixels whose sum may soon overflow, and squares that overflow.
// `correct` and `correct_squares` add a change to the samples so far, the same one to all samples of a pixel.
// In: `samples`, a vector for each point, in the units of radiance.
// Out: `sums` and `compensations`, a vector for each pixel; compensations.w is the number of samples that were left
// out.

import package::kit::group_index;
import package::lib::math::is_finite4;
import package::lib::constants::{COUNTER_NOT_FINITE, COUNTER_NEAR_OVERFLOW};

struct FilmParameters {
    // Number of pixels that get samples.
    pixel_count: u32,
    // Samples of each pixel to sum, and the index of the first of all in `samples`.
    samples_per_pixel: u32,
    first_point: u32,
    // For `correct` and `correct_squares`: the number of samples to change.
    earlier_samples: u32,
}

@group(0) @binding(0) var<storage, read> samples: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> sums: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> compensations: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> counters: array<atomic<u32>>;
// For `accumulate_squares`: the other component of the radiance, or one zero vector for all points. For
// `take_snapshot`: the compensations of the sums that `samples` are. For `correct_squares`: sums of the samples, or of
// one of their components.
@group(0) @binding(4) var<storage, read> other_samples: array<vec4f>;
// See lib/tile.
@if(adaptive_sampling) @group(0) @binding(5) var<storage, read> sampled_pixels: array<u32>;

var<immediate> film_parameters: FilmParameters;

// 2^104: a larger sum may overflow (at 2^128) within the 2^24 samples that a render can take.
const NEAR_OVERFLOW = 2.028241e31;

// The pixel with this index among those that get samples.
fn pixel_of(i: u32) -> u32 {
    @if(adaptive_sampling) { return sampled_pixels[i]; }
    @else { return i; }
}

struct Sum {
    value: vec4f,
    compensation: vec4f,
}

// Returns x itself, because no pixel has 2^31 samples, but the compiler cannot infer this. One that sees that `total`
// is `value + x` may take `(total - value) - x` for 0. On an H200 (driver 580.159) all compensations were lost.
fn opaque(x: vec4f) -> vec4f {
    return bitcast<vec4f>(bitcast<vec4u>(x) | vec4u(film_parameters.earlier_samples >> 31u));
}

// Neumaier's step: computes the rounding error of the sum from the larger operand. Then moves as much of the
// compensation as fits back into the sum (Dekker's sum of doubles). Otherwise the compensation would grow over many
// similar samples, and round as an uncompensated sum does.
fn compensated(sum: Sum, x: vec4f) -> Sum {
    let total = opaque(sum.value + x);
    let lost = select((x - total) + sum.value, (sum.value - total) + x, abs(sum.value) >= abs(x));
    let rest = sum.compensation.xyz + lost.xyz;
    let value = opaque(vec4f(total.xyz + rest, total.w));
    return Sum(value, vec4f(rest + (total.xyz - value.xyz), sum.compensation.w));
}

// The sum with another sample, which is left out if it is not finite.
fn with_sample(sum: Sum, x: vec4f) -> Sum {
    if is_finite4(x) { return compensated(sum, x); }
    return Sum(sum.value, sum.compensation + vec4f(0.0, 0.0, 0.0, 1.0));
}

fn load_sum(pixel: u32) -> Sum {
    return Sum(sums[pixel], compensations[pixel]);
}

fn store_sum(pixel: u32, sum: Sum) {
    sums[pixel] = sum.value;
    compensations[pixel] = sum.compensation;
}

@compute @workgroup_size(64)
fn accumulate(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = group_index(group, groups) * 64u + lane;
    if index >= film_parameters.pixel_count { return; }
    let pixel = pixel_of(index);
    let first = index * film_parameters.samples_per_pixel;
    var sum = load_sum(pixel);
    let left_out = sum.compensation.w;
    for (var i = first; i < first + film_parameters.samples_per_pixel; i++) {
        sum = with_sample(sum, samples[film_parameters.first_point + i]);
    }
    store_sum(pixel, sum);
    if sum.compensation.w > left_out { atomicAdd(&counters[COUNTER_NOT_FINITE], u32(sum.compensation.w - left_out)); }
    if any(abs(sum.value) > vec4f(NEAR_OVERFLOW)) { atomicAdd(&counters[COUNTER_NEAR_OVERFLOW], 1u); }
}

// Sums the squares of the whole radiance, the sum of its two components, for the variance. Squares beyond the largest
// number, and those with which the sum would exceed it, are left out and counted.
@compute @workgroup_size(64)
fn accumulate_squares(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = group_index(group, groups) * 64u + lane;
    if index >= film_parameters.pixel_count { return; }
    let pixel = pixel_of(index);
    let first = index * film_parameters.samples_per_pixel;
    var sum = load_sum(pixel);
    for (var i = first; i < first + film_parameters.samples_per_pixel; i++) {
        let x = samples[i] + other_samples[i % arrayLength(&other_samples)];
        let left_out = sum.compensation.w;
        let next = with_sample(sum, x * x);
        if is_finite4(next.value) { sum = next; } else { sum.compensation.w += 1.0; }
        // `accumulate` counts samples that are not finite themselves.
        if sum.compensation.w > left_out && is_finite4(x) { atomicAdd(&counters[COUNTER_NEAR_OVERFLOW], 1u); }
    }
    store_sum(pixel, sum);
}

// Copies the sums of another plane.
@compute @workgroup_size(64)
fn take_snapshot(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= film_parameters.pixel_count { return; }
    let pixel = pixel_of(i);
    sums[pixel] = samples[pixel];
    compensations[pixel] = other_samples[pixel];
}

// Adds `samples`, one for each pixel, to each sample that the pixel has. A change that is not finite is left out.
@compute @workgroup_size(64)
fn correct(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= film_parameters.pixel_count { return; }
    let pixel = pixel_of(i);
    let sum = load_sum(pixel);
    let change = max(f32(film_parameters.earlier_samples) - sum.compensation.w, 0.0) * samples[i];
    if is_finite4(change) { store_sum(pixel, compensated(sum, change)); }
}

// Does the same for a sum of squares, before the samples change: (x + c)^2 is x^2 + 2 c x + c^2. If x is a sum of two
// components, it runs once for each, once of these with `earlier_samples` = 0.
@compute @workgroup_size(64)
fn correct_squares(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= film_parameters.pixel_count { return; }
    let pixel = pixel_of(i);
    let sum = load_sum(pixel);
    let count = max(f32(film_parameters.earlier_samples) - sum.compensation.w, 0.0);
    let change = samples[i] * (2.0 * other_samples[pixel] + count * samples[i]);
    let next = compensated(sum, change);
    if is_finite4(change) && is_finite4(next.value) { store_sum(pixel, next); }
}
