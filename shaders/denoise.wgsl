// denoise: removes noise by the estimated variance of each pixel (after Sakai et al. 2024, Rousselle et al. 2012 and
// 2013, Bitterli et al. 2016). Direct and indirect light are divided by the albedo and filtered separately:
// 1. Fireflies are drawn towards their neighbours.
// 2. A pixel averages the pixels of the same surface whose confidence intervals overlap its own: those of the means of
//    3 x 3 pixels.
// 3. It does so again with the intervals of that result, and fits a plane to the pixels.
// 4. The result is mixed with the pixel's own samples: the larger the filter's error compared with their variance, the
//    more of them.
// In: `pixels`, DENOISE_VECTORS vectors for each pixel: mean and variance of the mean of direct light, then of indirect
// light, albedo, normal (0 where no surface is), position. The unit of light is one in which light is about 1.
// Out: `light_out`. Between the steps it has two vectors for each pixel, direct and indirect light; at the end one
// vector: the colour, and in w 1, or 0 where the pixel must keep its own.

import package::kit::group_index;
import package::lib::constants::{DENOISE_BORDER, DENOISE_VECTORS};
import package::lib::math::is_finite3;
@if(texture_loads) import package::lib::table::table_texel;

struct DenoiseParameters {
    width: u32,
    height: u32,
    samples: u32,
}

var<immediate> denoise: DenoiseParameters;

// Weight of the neighbours' variance, in samples, next to the pixel's own: a variance of a few samples is itself mostly
// noise. Other weights were not compared.
const POOLED_SAMPLES = 4.0;
// Radii of windows in pixels. The first filter needs no more than 7 x 7, the second gained nothing beyond 11 x 11. The
// windows of `restrain`, `pool` and `combine` are 5 x 5, and written out. For `combine`, 3 x 3 leave fireflies, and
// larger ones lose detail with few samples (docs/experiments.md, "What the filter does").
const FIRST_RADIUS = 3;
const SECOND_RADIUS = 5;
// Light is a firefly if its squared distance from the neighbours' mean is more than FAR_FROM_NEIGHBOURS times their
// spread (three standard deviations), and less than WITHIN_OWN times its own variance (two). If one of n samples causes
// the distance, the variance of their mean is about the squared distance. With four standard deviations, box.glb has
// 1.03 times the error (docs/experiments.md, "What the filter does").
const FAR_FROM_NEIGHBOURS = 9.0;
const WITHIN_OWN = 4.0;
// Minimum number of neighbours from which a spread is computed. The brightest of them is left out.
const MIN_NEIGHBOURS = 5.0;
// Neighbours of less weight hardly contribute to a spread, and do not count.
const COUNTED_WEIGHT = 0.3;
// Squared half-widths of the confidence intervals that must overlap, over the variance: first and second filter. With
// intervals 1.5 times as narrow, errors are up to a quarter larger (docs/experiments.md, "What the filter does").
const FIRST_INTERVAL = 1.69;
const SECOND_INTERVAL = 4.0;
// Ridge of the fitted plane's slopes, in square pixels: a plane through few pixels is level. Other values were not
// compared.
const RIDGE = 0.5;
// Differences at which a weight falls to 1/e: of normals (1 - cosine), albedo, and the offset from the tangent plane,
// in distances of neighbouring pixels. Wider ones for pixels that few neighbours resemble were tried and not kept
// (docs/experiments.md, "What the filter does"); other values for all pixels were not compared.
const NORMAL_SCALE = 0.1;
const ALBEDO_SCALE = 0.1;
const PLANE_SCALE = 1.5;
// The tables have a border of texels of 0 around the image, whose kind matches no pixel's, so that windows need not end
// at the edge: DENOISE_BORDER rows above and below, and DENOISE_BORDER columns on the left, which also are the right
// border of the row before.
const_assert SECOND_RADIUS <= DENOISE_BORDER;
// Weights below exp(-3.91) = 0.02 and exp(-4.6) = 0.01 are set to 0, so that many small ones do not add up.
const MAX_SURFACE_DIFFERENCE = 3.912023;
const MAX_LIGHT_DIFFERENCE = 4.6051702;
// Minimum albedo by which light is divided, because black surfaces have highlights.
const MIN_ALBEDO = 0.01;
// Light and variance beyond these are ignored: their squares, and sums of squares, would overflow.
const MAX_LIGHT = 1e12;
const MAX_VARIANCE = 1e24;
// Variance added to all, far below what is visible.
const TINY = 1e-10;
// No neighbour on a surface.
const NO_SPACING = 1e30;
// The kind of a pixel, in the fourth byte of its packed word: its light is not valid, so it keeps its own colour; it
// shows no surface; it shows one. Kinds differ by so much that no weight remains between them, because they are
// compared like an albedo. Whatever else the word holds, it is then a normal float, which every load preserves. Texels
// of the border are 0.
const KIND_KEPT = 0x10u;
const KIND_EMPTY = 0x60u;
const KIND_SURFACE = 0xb0u;
// A value that differs from all kinds.
const NO_KIND = 1000.0;
// A difference that leaves no weight.
const BEYOND = 1e9;
// ALBEDO_SCALE for squared differences of bytes.
const PER_SQUARED_BYTE = 1.0 / (255.0 * 255.0 * ALBEDO_SCALE * ALBEDO_SCALE);

@group(0) @binding(0) var<storage, read> pixels: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> surface_out: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> light_out: array<vec4f>;
// For each pixel position and spacing, then normal and the packed word.
@if(texture_loads) @group(0) @binding(3) var surface_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(0) @binding(3) var<storage, read> surface_table: array<vec4f>;
// Light of `pixels`, and its variance (sum of the channels) in w.
@if(texture_loads) @group(0) @binding(4) var light_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(0) @binding(4) var<storage, read> light_table: array<vec4f>;
// The light by which pixels are compared, with its variance in w; or filtered light, with the weight of the pixel's own
// in w.
@if(texture_loads) @group(0) @binding(5) var guide_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(0) @binding(5) var<storage, read> guide_table: array<vec4f>;
// The weights of each pixel's window of 5 x 5 by what pixels show, in bytes: without the middle column, rows -2, -1, 1
// and 2, then row 0; then the middle column without the pixel itself, and 1 or 0 for that.
@group(0) @binding(6) var<storage, read_write> weights_out: array<vec4u>;
@if(texture_loads) @group(0) @binding(7) var weight_table: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(0) @binding(7) var<storage, read> weight_table: array<vec4u>;

fn load_surface(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(surface_table, table_texel(i)); }
    @else { return surface_table[i]; }
}

fn load_light(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(light_table, table_texel(i)); }
    @else { return light_table[i]; }
}

fn load_guide(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(guide_table, table_texel(i)); }
    @else { return guide_table[i]; }
}

fn load_weights(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(weight_table, table_texel(i)); }
    @else { return weight_table[i]; }
}

// The surface of a pixel. `traits` are albedo and kind in bytes.
struct Surface {
    position: vec3f,
    normal: vec3f,
    traits: vec4f,
}

// A pixel that others are compared with. `normal` is divided by NORMAL_SCALE; `plane` is the normal divided by
// PLANE_SCALE times the spacing.
struct Centre {
    position: vec3f,
    normal: vec3f,
    plane: vec3f,
    traits: vec4f,
}

fn surface_of(first: vec4f, rest: vec4f) -> Surface {
    let word = bitcast<u32>(rest.w);
    let bytes = vec4u(word & 255u, (word >> 8u) & 255u, (word >> 16u) & 255u, word >> 24u);
    return Surface(first.xyz, rest.xyz, vec4f(vec4i(bytes)));
}

fn surface_at(index: u32) -> Surface {
    return surface_of(load_surface(2u * index), load_surface(2u * index + 1u));
}

fn is_kept(centre: Centre) -> bool {
    return centre.traits.w == NO_KIND;
}

fn centre_at(index: u32) -> Centre {
    let first = load_surface(2u * index);
    let own = surface_of(first, load_surface(2u * index + 1u));
    let kind = select(own.traits.w, NO_KIND, own.traits.w == f32(KIND_KEPT));
    let plane = own.normal / (PLANE_SCALE * first.w);
    return Centre(own.position, own.normal / NORMAL_SCALE, plane, vec4f(own.traits.xyz, kind));
}

// How much two pixels `d` apart differ by what they show: the exponent of a weight.
fn surface_difference(centre: Centre, other: Surface, d: vec2f) -> f32 {
    let traits = centre.traits - other.traits;
    let plane = dot(other.position - centre.position, centre.plane);
    let shape = 1.0 / NORMAL_SCALE - dot(centre.normal, other.normal);
    return PER_SQUARED_BYTE * dot(traits, traits) + shape + plane * plane / max(dot(d, d), 1.0);
}

fn surface_weight(centre: Centre, other: Surface, d: vec2f) -> f32 {
    let e = surface_difference(centre, other, d);
    return select(0.0, exp(-e), e <= MAX_SURFACE_DIFFERENCE);
}

// The smaller of two numbers that are not negative, by their bits: for floats, software devices take three steps,
// because of NaN.
fn lesser(a: f32, b: f32) -> f32 {
    return bitcast<f32>(min(bitcast<i32>(a), bitcast<i32>(b)));
}

fn positive(a: f32) -> f32 {
    return bitcast<f32>(max(bitcast<i32>(a), 0));
}

// Weight of a pixel by its light, 1 where the difference is no more than noise explains (Rousselle et al. 2012), and by
// the `difference` of its surface.
fn joint_weight(difference: f32, centre: vec4f, other: vec4f, interval: f32) -> f32 {
    let d = other.xyz - centre.xyz;
    let excess = dot(d, d) - (centre.w + lesser(centre.w, other.w));
    let e = positive(excess) / ((TINY + centre.w + other.w) * interval);
    let counts = difference <= MAX_SURFACE_DIFFERENCE && e <= MAX_LIGHT_DIFFERENCE;
    return select(0.0, exp(-(difference + e)), counts);
}

fn column_and_row(pixel: u32) -> vec2i {
    return vec2i(vec2u(pixel % denoise.width, pixel / denoise.width));
}

fn stride() -> u32 {
    return denoise.width + DENOISE_BORDER;
}

// The index of the pixel of a column and row in the tables, which have two vectors for each.
fn index_at(at: vec2u) -> u32 {
    return (at.y + DENOISE_BORDER) * stride() + at.x + DENOISE_BORDER;
}

fn index_of(pixel: u32) -> u32 {
    return index_at(vec2u(column_and_row(pixel)));
}

// The index of the pixel `rows` below another.
fn below(index: u32, rows: i32) -> u32 {
    return u32(i32(index) + rows * i32(stride()));
}

fn pixel_of(group: vec3u, groups: vec3u, lane: u32) -> u32 {
    return group_index(group, groups) * 64u + lane;
}

fn outside(pixel: u32) -> bool {
    return pixel >= denoise.width * denoise.height;
}

fn albedo_of(pixel: u32) -> vec3f {
    let albedo = pixels[DENOISE_VECTORS * pixel + 4u].xyz;
    return max(select(vec3f(1.0), albedo, is_finite3(albedo)), vec3f(MIN_ALBEDO));
}

fn normal_of(pixel: u32) -> vec3f {
    let normal = pixels[DENOISE_VECTORS * pixel + 5u].xyz;
    let size = dot(normal, normal);
    return select(vec3f(0.0), normal * inverseSqrt(max(size, TINY)), is_finite3(normal) && size > TINY);
}

fn on_surface(pixel: u32) -> bool {
    return any(normal_of(pixel) != vec3f(0.0)) && is_finite3(pixels[DENOISE_VECTORS * pixel + 6u].xyz);
}

// Distance to a neighbour's position.
fn spacing_to(pixel: u32, at: vec2i, step: vec2i) -> f32 {
    let other = at + step;
    if any(other < vec2i(0)) || other.x >= i32(denoise.width) || other.y >= i32(denoise.height) { return NO_SPACING; }
    let neighbour = u32(other.y) * denoise.width + u32(other.x);
    if !on_surface(neighbour) { return NO_SPACING; }
    let apart = pixels[DENOISE_VECTORS * neighbour + 6u].xyz - pixels[DENOISE_VECTORS * pixel + 6u].xyz;
    return min(length(apart), NO_SPACING);
}

// The larger of the distances to the nearer neighbour in the row and in the column; above 0, because planes are divided
// by it.
fn spacing_of(pixel: u32) -> f32 {
    let at = column_and_row(pixel);
    let row = min(spacing_to(pixel, at, vec2i(-1, 0)), spacing_to(pixel, at, vec2i(1, 0)));
    let column = min(spacing_to(pixel, at, vec2i(0, -1)), spacing_to(pixel, at, vec2i(0, 1)));
    let larger = max(row, column);
    return max(select(larger, min(row, column), larger >= NO_SPACING), 1e-20);
}

// Light over albedo and its variance; not `valid` where it is too large to be squared, or not finite.
struct Light {
    value: vec4f,
    valid: bool,
}

fn demodulated(pixel: u32, component: u32) -> Light {
    let albedo = albedo_of(pixel);
    let mean = pixels[DENOISE_VECTORS * pixel + 2u * component].xyz / albedo;
    let variance = pixels[DENOISE_VECTORS * pixel + 2u * component + 1u].xyz / (albedo * albedo);
    let known = denoise.samples > 1u;
    let fits = is_finite3(mean) && all(abs(mean) <= vec3f(MAX_LIGHT));
    let fits_too = is_finite3(variance) && all(variance <= vec3f(MAX_VARIANCE));
    let sum = variance.x + variance.y + variance.z;
    return Light(vec4f(mean, select(0.0, max(sum, 0.0), known)), fits && (fits_too || !known));
}

@compute @workgroup_size(64)
fn prepare(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let direct = demodulated(pixel, 0u);
    let indirect = demodulated(pixel, 1u);
    let valid = direct.valid && indirect.valid;
    let index = index_of(pixel);
    light_out[2u * index] = select(vec4f(0.0), direct.value, valid);
    light_out[2u * index + 1u] = select(vec4f(0.0), indirect.value, valid);
    let has_surface = on_surface(pixel);
    let kind = select(KIND_KEPT, select(KIND_EMPTY, KIND_SURFACE, has_surface), valid);
    let position = select(vec3f(0.0), pixels[DENOISE_VECTORS * pixel + 6u].xyz, has_surface);
    // Any normal, the same for all.
    let normal = select(vec3f(1.0, 0.0, 0.0), normal_of(pixel), has_surface);
    let word = (pack4x8unorm(vec4f(albedo_of(pixel), 0.0)) & 0xffffffu) | (kind << 24u);
    surface_out[2u * index] = vec4f(position, spacing_of(pixel));
    surface_out[2u * index + 1u] = vec4f(normal, bitcast<f32>(word));
}

// The weighted mean of the light of some pixels, and the weighted sum of squared distances from it. The brightest pixel
// is left out and kept here with its weight: it may be another firefly, and two fireflies would hide each other.
struct Moments {
    weights: f32,
    squares: f32,
    mean: vec3f,
    brightest: vec4f,
}

// Adds the light and weight of one more pixel, by the method of West (1979), which loses no digits next to bright
// light.
fn moments_with(moments: Moments, more: vec4f) -> Moments {
    let is_brightest = more.w > COUNTED_WEIGHT && dot(more.xyz, vec3f(1.0)) > dot(moments.brightest.xyz, vec3f(1.0));
    let added = select(more, moments.brightest, is_brightest);
    let weights = moments.weights + added.w;
    let d = added.xyz - moments.mean;
    let mean = moments.mean + added.w / max(weights, TINY) * d;
    let squares = moments.squares + added.w * dot(d, added.xyz - mean);
    return Moments(weights, squares, mean, select(moments.brightest, more, is_brightest));
}

// The spread about the mean of the `count` pixels that are not left out.
fn spread_of(moments: Moments, count: f32) -> f32 {
    return moments.squares * count / (max(moments.weights, TINY) * max(count - 1.0, 1.0));
}

// Moments of direct and of indirect light, and the number of pixels that count.
struct Neighbours {
    count: f32,
    direct: Moments,
    indirect: Moments,
}

fn neighbours_with(sums: Neighbours, weight: f32, index: u32) -> Neighbours {
    return Neighbours(
        sums.count + select(0.0, 1.0, weight > COUNTED_WEIGHT),
        moments_with(sums.direct, vec4f(load_light(2u * index).xyz, weight)),
        moments_with(sums.indirect, vec4f(load_light(2u * index + 1u).xyz, weight)),
    );
}

// The sums after a row of the window, and the weights of that row: the four at the sides in bytes, the middle one as a
// float.
struct NeighboursOfRow {
    sums: Neighbours,
    sides: u32,
    middle: f32,
}

fn weight_at(centre: Centre, row: u32, x: i32, y: i32) -> f32 {
    return surface_weight(centre, surface_at(u32(i32(row) + x)), vec2f(f32(x), f32(y)));
}

// Adds the row `y` below a pixel, without the pixel itself.
fn neighbours_with_row(before: Neighbours, centre: Centre, index: u32, y: i32) -> NeighboursOfRow {
    let row = below(index, y);
    let a = weight_at(centre, row, -2, y);
    let b = weight_at(centre, row, -1, y);
    let middle = select(weight_at(centre, row, 0, y), 0.0, y == 0);
    let c = weight_at(centre, row, 1, y);
    let d = weight_at(centre, row, 2, y);
    var sums = neighbours_with(before, a, row - 2u);
    sums = neighbours_with(sums, b, row - 1u);
    sums = neighbours_with(sums, middle, row);
    sums = neighbours_with(sums, c, row + 1u);
    sums = neighbours_with(sums, d, row + 2u);
    return NeighboursOfRow(sums, pack4x8unorm(vec4f(a, b, c, d)), middle);
}

// If light differs from that of its `count` neighbours by more than their spread, and its own noise explains this, the
// light is drawn towards theirs until it no longer does, and its variance is reduced accordingly.
fn restrained(light: vec4f, neighbours: Moments, count: f32) -> vec4f {
    let d = light.xyz - neighbours.mean;
    let distance = dot(d, d);
    let limit = FAR_FROM_NEIGHBOURS * spread_of(neighbours, count - 1.0);
    let explained = denoise.samples < 2u || distance < WITHIN_OWN * light.w;
    let share = limit / max(distance, 1e-30);
    let drawn = vec4f(neighbours.mean + sqrt(share) * d, share * light.w);
    return select(light, drawn, distance > limit && explained && count >= MIN_NEIGHBOURS);
}

// Draws fireflies towards their neighbours: no confidence interval excludes them, as their own variance is so large.
// Out too: the weights of the window for the passes that follow.
@compute @workgroup_size(64)
fn restrain(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let index = index_of(pixel);
    let centre = centre_at(index);
    let a = neighbours_with_row(Neighbours(), centre, index, -2);
    let b = neighbours_with_row(a.sums, centre, index, -1);
    let c = neighbours_with_row(b.sums, centre, index, 0);
    let d = neighbours_with_row(c.sums, centre, index, 1);
    let e = neighbours_with_row(d.sums, centre, index, 2);
    let middle = pack4x8unorm(vec4f(a.middle, b.middle, d.middle, e.middle));
    weights_out[2u * index] = vec4u(a.sides, b.sides, d.sides, e.sides);
    weights_out[2u * index + 1u] = vec4u(c.sides, middle, select(1u, 0u, is_kept(centre)), 0u);
    let sums = e.sums;
    light_out[2u * index] = restrained(load_light(2u * index), sums.direct, sums.count);
    light_out[2u * index + 1u] = restrained(load_light(2u * index + 1u), sums.indirect, sums.count);
}

// The weights that `restrain` kept: of the columns -2, -1, 1 and 2, and of the middle column, for the rows -2 to 2.
struct Window {
    sides: array<vec4f, 5>,
    middle: array<f32, 5>,
}

fn window_at(index: u32) -> Window {
    let rows = load_weights(2u * index);
    let rest = load_weights(2u * index + 1u);
    let column = unpack4x8unorm(rest.y);
    return Window(
        array<vec4f, 5>(
            unpack4x8unorm(rows.x),
            unpack4x8unorm(rows.y),
            unpack4x8unorm(rest.x),
            unpack4x8unorm(rows.z),
            unpack4x8unorm(rows.w),
        ),
        array<f32, 5>(column.x, column.y, f32(rest.z), column.z, column.w),
    );
}

// The variance of a pixel, from its own and its neighbours' mean variance.
fn pooled(light: vec4f, neighbours: f32) -> vec4f {
    let more = f32(denoise.samples) - 1.0;
    return vec4f(light.xyz, (POOLED_SAMPLES * neighbours + more * light.w) / (POOLED_SAMPLES + more));
}

// Variances of direct and of indirect light, and 1.
fn variances_at(index: u32) -> vec3f {
    return vec3f(load_light(2u * index).w, load_light(2u * index + 1u).w, 1.0);
}

// Their sum over a row, times weight.
fn variances_of_row(sides: vec4f, middle: f32, row: u32) -> vec3f {
    let inner = sides.y * variances_at(row - 1u) + middle * variances_at(row) + sides.z * variances_at(row + 1u);
    return inner + sides.x * variances_at(row - 2u) + sides.w * variances_at(row + 2u);
}

// Pools the variance of each pixel with its neighbours': that of few samples is itself noise.
@compute @workgroup_size(64)
fn pool(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let index = index_of(pixel);
    let window = window_at(index);
    var sums = vec3f(0.0, 0.0, TINY);
    sums += variances_of_row(window.sides[0], window.middle[0], below(index, -2));
    sums += variances_of_row(window.sides[1], window.middle[1], below(index, -1));
    sums += variances_of_row(window.sides[2], window.middle[2], index);
    sums += variances_of_row(window.sides[3], window.middle[3], below(index, 1));
    sums += variances_of_row(window.sides[4], window.middle[4], below(index, 2));
    light_out[2u * index] = pooled(load_light(2u * index), sums.x / sums.z);
    light_out[2u * index + 1u] = pooled(load_light(2u * index + 1u), sums.y / sums.z);
}

// Light of a pixel near another, and its weight.
struct Member {
    weight: f32,
    direct: vec3f,
    indirect: vec3f,
}

fn member(weight: f32, index: u32) -> Member {
    return Member(weight, load_light(2u * index).xyz, load_light(2u * index + 1u).xyz);
}

fn members(sides: vec4f, middle: f32, row: u32) -> array<Member, 5> {
    return array<Member, 5>(
        member(sides.x, row - 2u),
        member(sides.y, row - 1u),
        member(middle, row),
        member(sides.z, row + 1u),
        member(sides.w, row + 2u),
    );
}

// The squared differences of direct and of indirect light between two pixels, and 1, all times the weights of both.
fn squared(a: Member, b: Member) -> vec3f {
    let direct = a.direct - b.direct;
    let indirect = a.indirect - b.indirect;
    return (a.weight * b.weight) * vec3f(dot(direct, direct), dot(indirect, indirect), 1.0);
}

// Sum of `squared` over each pixel of a row and the pixel below it.
fn across(a: array<Member, 5>, b: array<Member, 5>) -> vec3f {
    return squared(a[0], b[0]) + squared(a[1], b[1]) + squared(a[2], b[2]) + squared(a[3], b[3]) + squared(a[4], b[4]);
}

// Sums of `squared` over the pixels of a row that are one apart, and that are two apart.
fn along(a: array<Member, 5>) -> vec3f {
    return squared(a[0], a[1]) + squared(a[1], a[2]) + squared(a[2], a[3]) + squared(a[3], a[4]);
}

fn along_two(a: array<Member, 5>) -> vec3f {
    return squared(a[0], a[2]) + squared(a[1], a[3]) + squared(a[2], a[4]);
}

// `pool` of single samples, which have no variance: what neighbours one and two pixels apart differ by. Differences due
// to noise are the same at both distances; those due to edges or slopes are at least twice as large at the second. So
// what is left at distance 0 is noise (the nugget of a linear variogram; Matheron 1963).
@compute @workgroup_size(64)
fn pool_single(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let index = index_of(pixel);
    let window = window_at(index);
    let a = members(window.sides[0], window.middle[0], below(index, -2));
    let b = members(window.sides[1], window.middle[1], below(index, -1));
    let c = members(window.sides[2], window.middle[2], index);
    let d = members(window.sides[3], window.middle[3], below(index, 1));
    let e = members(window.sides[4], window.middle[4], below(index, 2));
    let rows = along(a) + along(b) + along(c) + along(d) + along(e);
    let near = rows + across(a, b) + across(b, c) + across(c, d) + across(d, e);
    let rows_two = along_two(a) + along_two(b) + along_two(c) + along_two(d) + along_two(e);
    let far = rows_two + across(a, c) + across(b, d) + across(c, e);
    // Half of a mean squared difference is a variance.
    let one = 0.5 * near.xy / max(near.z, TINY);
    let two = 0.5 * far.xy / max(far.z, TINY);
    let variance = clamp(2.0 * one - two, vec2f(0.0), one);
    light_out[2u * index] = vec4f(load_light(2u * index).xyz, variance.x);
    light_out[2u * index + 1u] = vec4f(load_light(2u * index + 1u).xyz, variance.y);
}

// Sums of light times weight, of variance times its square, and of weights.
struct Sums {
    direct: vec4f,
    indirect: vec4f,
    weights: vec2f,
}

fn sums_of(sums: Sums, weights: vec2f, direct: vec4f, indirect: vec4f) -> Sums {
    return Sums(
        sums.direct + vec4f(vec3f(weights.x), weights.x * weights.x) * direct,
        sums.indirect + vec4f(vec3f(weights.y), weights.y * weights.y) * indirect,
        sums.weights + weights,
    );
}

fn sums_with(sums: Sums, weights: vec2f, index: u32) -> Sums {
    return sums_of(sums, weights, load_light(2u * index), load_light(2u * index + 1u));
}

// The mean and its variance.
fn mean_of(sum: vec4f, weights: f32) -> vec4f {
    let scale = 1.0 / max(weights, TINY);
    return vec4f(vec3f(scale), scale * scale) * sum;
}

fn write_means(sums: Sums, index: u32) {
    light_out[2u * index] = mean_of(sums.direct, sums.weights.x);
    light_out[2u * index + 1u] = mean_of(sums.indirect, sums.weights.y);
}

fn sums_with_row(sums: Sums, left: f32, middle: f32, right: f32, row: u32) -> Sums {
    let outer = sums_with(sums_with(sums, vec2f(left), row - 1u), vec2f(right), row + 1u);
    return sums_with(outer, vec2f(middle), row);
}

// Means of 3 x 3 pixels of the same surface, and their variance.
@compute @workgroup_size(64)
fn smooth_light(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let index = index_of(pixel);
    let window = window_at(index);
    let sides = window.sides;
    var sums = Sums();
    sums = sums_with_row(sums, sides[1].y, window.middle[1], sides[1].z, below(index, -1));
    sums = sums_with_row(sums, sides[2].y, window.middle[2], sides[2].z, index);
    sums = sums_with_row(sums, sides[3].y, window.middle[3], sides[3].z, below(index, 1));
    write_means(sums, index);
}

// A pixel and its guides, for direct and for indirect light.
struct Guided {
    surface: Centre,
    direct: vec4f,
    indirect: vec4f,
}

fn guided_at(index: u32) -> Guided {
    return Guided(centre_at(index), load_guide(2u * index), load_guide(2u * index + 1u));
}

// What a pixel needs of another one to compare it with itself, and to average it.
struct Other {
    surface: Surface,
    direct_guide: vec4f,
    indirect_guide: vec4f,
    direct: vec4f,
    indirect: vec4f,
}

fn other_at(index: u32) -> Other {
    return Other(
        surface_at(index),
        load_guide(2u * index),
        load_guide(2u * index + 1u),
        load_light(2u * index),
        load_light(2u * index + 1u),
    );
}

// The weights of a pixel `d` away from another one for direct and for indirect light; 0 outside of `radius`.
fn joint_weights(centre: Guided, other: Other, d: vec2f, radius: i32, interval: f32) -> vec2f {
    let beyond = select(0.0, BEYOND, abs(d.x) > f32(radius));
    let difference = surface_difference(centre.surface, other.surface, d) + beyond;
    return vec2f(
        joint_weight(difference, centre.direct, other.direct_guide, interval),
        joint_weight(difference, centre.indirect, other.indirect_guide, interval),
    );
}

// Column and row of the first one of two pixels side by side, which share what their windows load: loads are half of
// the time on software devices.
fn pair_of(item: u32) -> vec2u {
    let pairs = (denoise.width + 1u) / 2u;
    return vec2u(item % pairs * 2u, item / pairs);
}

fn averaged_with(sums: Sums, centre: Guided, other: Other, x: i32, y: i32) -> Sums {
    let d = vec2f(f32(x), f32(y));
    let weights = joint_weights(centre, other, d, FIRST_RADIUS, FIRST_INTERVAL);
    return sums_of(sums, weights, other.direct, other.indirect);
}

// Averages the pixels whose guides differ by no more than noise. Out: the mean and its variance.
@compute @workgroup_size(64)
fn average(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pair = pair_of(pixel_of(group, groups, lane));
    if pair.y >= denoise.height { return; }
    let index = index_at(pair);
    let left = guided_at(index);
    let right = guided_at(index + 1u);
    var left_sums = Sums();
    var right_sums = Sums();
    for (var y = -FIRST_RADIUS; y <= FIRST_RADIUS; y++) {
        let row = below(index, y);
        for (var x = -FIRST_RADIUS; x <= FIRST_RADIUS; x += 2) {
            let even = other_at(u32(i32(row) + x));
            let odd = other_at(u32(i32(row) + x + 1));
            left_sums = averaged_with(left_sums, left, even, x, y);
            left_sums = averaged_with(left_sums, left, odd, x + 1, y);
            right_sums = averaged_with(right_sums, right, even, x - 1, y);
            right_sums = averaged_with(right_sums, right, odd, x, y);
        }
    }
    write_means(left_sums, index);
    if pair.x + 1u < denoise.width { write_means(right_sums, index + 1u); }
}

// Sums of weights, and of light times weight, each by 1, x and y.
struct Fit {
    one: f32,
    first: vec2f,
    // Sums of weight times x x, x y and y y.
    second: vec3f,
    light: vec3f,
    light_x: vec3f,
    light_y: vec3f,
}

// The sums of Fit over one row, without those that have the factor y.
struct Row {
    one: f32,
    x: f32,
    xx: f32,
    light: vec3f,
    light_x: vec3f,
}

// Rows of direct and of indirect light.
struct Rows {
    direct: Row,
    indirect: Row,
}

fn row_with(row: Row, weight: f32, x: f32, light: vec3f) -> Row {
    let weighted = weight * light;
    let light_x = row.light_x + x * weighted;
    return Row(row.one + weight, row.x + x * weight, row.xx + x * x * weight, row.light + weighted, light_x);
}

fn rows_with(rows: Rows, centre: Guided, other: Other, x: i32, y: i32) -> Rows {
    let d = vec2f(f32(x), f32(y));
    let weights = joint_weights(centre, other, d, SECOND_RADIUS, SECOND_INTERVAL);
    return Rows(
        row_with(rows.direct, weights.x, d.x, other.direct.xyz),
        row_with(rows.indirect, weights.y, d.x, other.indirect.xyz),
    );
}

fn fit_with(fit: Fit, row: Row, y: f32) -> Fit {
    return Fit(
        fit.one + row.one,
        fit.first + vec2f(row.x, y * row.one),
        fit.second + vec3f(row.xx, y * row.x, y * y * row.one),
        fit.light + row.light,
        fit.light_x + row.light_x,
        fit.light_y + y * row.light,
    );
}

// Fits of direct and of indirect light.
struct Fits {
    direct: Fit,
    indirect: Fit,
}

fn fits_with(fits: Fits, rows: Rows, y: i32) -> Fits {
    return Fits(fit_with(fits.direct, rows.direct, f32(y)), fit_with(fits.indirect, rows.indirect, f32(y)));
}

// The value of the fitted plane at the pixel; w is the weight of the pixel's own light in it, which has a weight of 1
// in the sums.
fn fitted(fit: Fit) -> vec4f {
    let scale = 1.0 / max(fit.one, TINY);
    let first = fit.first * scale;
    let second = fit.second * scale + RIDGE * vec3f(1.0, 0.0, 1.0);
    // The slopes are eliminated from the normal equations; the ridge keeps their determinant above 0.
    let determinant = second.x * second.z - second.y * second.y;
    let slope = vec2f(second.z * first.x - second.y * first.y, second.x * first.y - second.y * first.x) / determinant;
    let rest = max(1.0 - dot(first, slope), TINY);
    let light = (fit.light - slope.x * fit.light_x - slope.y * fit.light_y) * scale / rest;
    return vec4f(light, scale / rest);
}

fn write_fits(fits: Fits, index: u32) {
    light_out[2u * index] = fitted(fits.direct);
    light_out[2u * index + 1u] = fitted(fits.indirect);
}

// As `average`, with a plane fitted to the pixels in place of their mean. Out: the light, and the weight of the pixel's
// own light in it.
@compute @workgroup_size(64)
fn regress(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pair = pair_of(pixel_of(group, groups, lane));
    if pair.y >= denoise.height { return; }
    let index = index_at(pair);
    let left = guided_at(index);
    let right = guided_at(index + 1u);
    var left_fits = Fits();
    var right_fits = Fits();
    for (var y = -SECOND_RADIUS; y <= SECOND_RADIUS; y++) {
        let row = below(index, y);
        var left_rows = Rows();
        var right_rows = Rows();
        for (var x = -SECOND_RADIUS; x <= SECOND_RADIUS; x += 2) {
            let even = other_at(u32(i32(row) + x));
            let odd = other_at(u32(i32(row) + x + 1));
            left_rows = rows_with(left_rows, left, even, x, y);
            left_rows = rows_with(left_rows, left, odd, x + 1, y);
            right_rows = rows_with(right_rows, right, even, x - 1, y);
            right_rows = rows_with(right_rows, right, odd, x, y);
        }
        left_fits = fits_with(left_fits, left_rows, y);
        right_fits = fits_with(right_fits, right_rows, y);
    }
    write_fits(left_fits, index);
    if pair.x + 1u < denoise.width { write_fits(right_fits, index + 1u); }
}

// Variance that the filter may have removed, and the squared change that it made, of a pixel.
fn change(light: vec4f, result: vec4f) -> vec2f {
    let d = result.xyz - light.xyz;
    return vec2f(light.w * max(1.0 - result.w, 0.0), dot(d, d));
}

// The mixture of the filtered light and the pixel's own with the least expected error (James and Stein 1961). Stein's
// estimate of the filter's error is its squared change, less the variance that noise explains.
fn mixed(light: vec4f, result: vec4f, sums: vec2f) -> vec3f {
    let trust = clamp(sums.x / max(sums.y, 1e-30), 0.0, 1.0);
    return mix(light.xyz, result.xyz, trust);
}

// The change that the filter made to direct light, then to indirect light.
fn changes_at(index: u32) -> vec4f {
    let direct = change(load_light(2u * index), load_guide(2u * index));
    return vec4f(direct, change(load_light(2u * index + 1u), load_guide(2u * index + 1u)));
}

// Their sum over a row, times weight.
fn changes_of_row(sides: vec4f, middle: f32, row: u32) -> vec4f {
    let inner = sides.y * changes_at(row - 1u) + middle * changes_at(row) + sides.z * changes_at(row + 1u);
    return inner + sides.x * changes_at(row - 2u) + sides.w * changes_at(row + 2u);
}

// Mixes filtered light and the pixel's own, by what the filter changed around it, and adds the parts.
@compute @workgroup_size(64)
fn combine(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let index = index_of(pixel);
    let window = window_at(index);
    var sums = vec4f(0.0);
    sums += changes_of_row(window.sides[0], window.middle[0], below(index, -2));
    sums += changes_of_row(window.sides[1], window.middle[1], below(index, -1));
    sums += changes_of_row(window.sides[2], window.middle[2], index);
    sums += changes_of_row(window.sides[3], window.middle[3], below(index, 1));
    sums += changes_of_row(window.sides[4], window.middle[4], below(index, 2));
    let a = mixed(load_light(2u * index), load_guide(2u * index), sums.xy);
    let b = mixed(load_light(2u * index + 1u), load_guide(2u * index + 1u), sums.zw);
    light_out[pixel] = vec4f((a + b) * albedo_of(pixel), window.middle[2]);
}
