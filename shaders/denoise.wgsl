// denoise: filters an image by what is known of its noise (after Sakai et al. 2024, Rousselle et al. 2012 and 2013,
// Bitterli et al. 2016). Light over albedo is filtered, direct and indirect light apart. A pixel averages others of the
// same surface whose confidence intervals overlap its own, first by means of 3 x 3 pixels, then by the result, fitting
// a plane to them. Before, fireflies are drawn towards their neighbours. Last, a pixel returns to its own samples as
// far as the filter's error is more than their variance.
// In: `pixels`, PIXEL_VECTORS vectors for each pixel: mean and variance of the mean of direct light, then of indirect
// light, albedo, normal (0 where no surface is), position. Light is in any unit in which it is about 1.
// Out: `light_out`, two vectors for each pixel, direct and indirect light, from pass to pass; at last one vector: the
// colour, and in w 1, or 0 where the pixel must keep its own.

import package::kit::group_index;
import package::lib::math::is_finite3;
@if(texture_loads) import package::lib::table::table_texel;

struct DenoiseParameters {
    width: u32,
    height: u32,
    samples: u32,
}

var<immediate> denoise: DenoiseParameters;

const PIXEL_VECTORS = 7u;

// Samples that the neighbours' variance counts for beside the pixel's own.
const POOLED_SAMPLES = 4.0;
// Radii of windows in pixels. The first filter needs no more than 7 x 7, the second gained nothing beyond 11 x 11.
const POOL_RADIUS = 2;
const FIRST_RADIUS = 3;
const SECOND_RADIUS = 5;
const MIX_RADIUS = 2;
// Squared distance from the neighbours' mean, over their spread, beyond which light is a firefly if its own variance
// explains the distance: three standard deviations, and two of the pixel's own. A firefly of one sample in n has a
// variance of its squared distance.
const FAR_FROM_NEIGHBOURS = 9.0;
const WITHIN_OWN = 4.0;
// Neighbours that tell a spread.
const MIN_NEIGHBOURS = 5.0;
// Neighbours of less weight hardly contribute to a spread, and do not count.
const COUNTED_WEIGHT = 0.3;
// Squared half-widths of the confidence intervals that must overlap, over the variance: first and second filter.
const FIRST_INTERVAL = 1.69;
const SECOND_INTERVAL = 4.0;
// Ridge of the fitted plane's slopes, in square pixels: a plane through few pixels is level.
const RIDGE = 0.5;
// Differences at which a weight falls to 1/e: of normals (1 - cosine), albedo, and the offset from the tangent plane,
// in distances of neighbouring pixels.
const NORMAL_SCALE = 0.1;
const ALBEDO_SCALE = 0.1;
const PLANE_SCALE = 1.5;
// Weights below exp of minus these, 0.02 and 0.01, are 0, so that many small ones do not add up.
const MAX_SURFACE_DIFFERENCE = 3.912023;
const MAX_LIGHT_DIFFERENCE = 4.6051702;
// The difference of what is not of the same kind.
const DIFFERENT = 1e9;
// Albedo by which light is divided at the least.
const MIN_ALBEDO = 0.01;
// Light and variance beyond these take no part: their squares, and sums of these, would overflow.
const MAX_LIGHT = 1e12;
const MAX_VARIANCE = 1e24;
// Variance added to all, far below what is visible.
const TINY = 1e-10;
// No neighbour on a surface.
const NO_SPACING = 1e30;
// What a pixel is, in the fourth byte of its packed word.
const KIND_KEPT = 0u;
const KIND_EMPTY = 1u;
const KIND_SURFACE = 2u;
// Makes the packed word a normal float whatever it holds, which every load keeps.
const NORMAL_NUMBER = 0x40000000u;

@group(0) @binding(0) var<storage, read> pixels: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> surface_out: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> light_out: array<vec4f>;
// For each pixel position and spacing, then normal and the packed word.
@if(texture_loads) @group(0) @binding(3) var surface_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(0) @binding(3) var<storage, read> surface_table: array<vec4f>;
// Light of `pixels`, and its variance (sum of the channels) in w.
@if(texture_loads) @group(0) @binding(4) var light_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(0) @binding(4) var<storage, read> light_table: array<vec4f>;
// Light by whose difference pixels are compared, and its variance in w; or filtered light, and the pixel's own weight.
@if(texture_loads) @group(0) @binding(5) var guide_table: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(0) @binding(5) var<storage, read> guide_table: array<vec4f>;

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

struct Surface {
    position: vec3f,
    // 1 over PLANE_SCALE spacings.
    per_plane: f32,
    normal: vec3f,
    albedo: vec3f,
    kind: u32,
}

fn surface_at(pixel: u32) -> Surface {
    let place = load_surface(2u * pixel);
    let rest = load_surface(2u * pixel + 1u);
    let word = bitcast<u32>(rest.w);
    return Surface(place.xyz, 1.0 / (PLANE_SCALE * place.w), rest.xyz, unpack4x8unorm(word).xyz, (word >> 24u) & 3u);
}

// How much two pixels `d` apart differ by what they show: the exponent of a weight.
fn surface_difference(centre: Surface, other: Surface, d: vec2f) -> f32 {
    let albedo = centre.albedo - other.albedo;
    let plane = dot(other.position - centre.position, centre.normal) * centre.per_plane;
    let off_plane = plane * plane / max(dot(d, d), 1.0);
    let shape = (1.0 - dot(centre.normal, other.normal)) / NORMAL_SCALE + off_plane;
    let e = dot(albedo, albedo) / (ALBEDO_SCALE * ALBEDO_SCALE) + select(0.0, shape, centre.kind == KIND_SURFACE);
    return select(DIFFERENT, e, centre.kind == other.kind && other.kind != KIND_KEPT);
}

fn surface_weight(centre: Surface, other: Surface, d: vec2f) -> f32 {
    let e = surface_difference(centre, other, d);
    return select(0.0, exp(-e), e <= MAX_SURFACE_DIFFERENCE);
}

// Weight of a pixel by its light, 1 where the difference is no more than noise explains (Rousselle et al. 2012), and by
// the `difference` of its surface.
fn joint_weight(difference: f32, centre: vec4f, other: vec4f, interval: f32) -> f32 {
    let d = other.xyz - centre.xyz;
    let excess = dot(d, d) - (centre.w + min(centre.w, other.w));
    let e = max(excess, 0.0) / ((TINY + centre.w + other.w) * interval);
    let counts = difference <= MAX_SURFACE_DIFFERENCE && e <= MAX_LIGHT_DIFFERENCE;
    return select(0.0, exp(-(difference + e)), counts);
}

fn column_and_row(pixel: u32) -> vec2i {
    return vec2i(vec2u(pixel % denoise.width, pixel / denoise.width));
}

// The part of a window around a pixel that lies in the image: first column and row, then the last ones.
fn window(pixel: u32, radius: i32) -> vec4i {
    let at = column_and_row(pixel);
    let last = vec2i(i32(denoise.width), i32(denoise.height)) - 1;
    return vec4i(max(at - radius, vec2i(0)), min(at + radius, last));
}

fn pixel_of(group: vec3u, groups: vec3u, lane: u32) -> u32 {
    return group_index(group, groups) * 64u + lane;
}

fn outside(pixel: u32) -> bool {
    return pixel >= denoise.width * denoise.height;
}

fn albedo_of(pixel: u32) -> vec3f {
    let albedo = pixels[PIXEL_VECTORS * pixel + 4u].xyz;
    return max(select(vec3f(1.0), albedo, is_finite3(albedo)), vec3f(MIN_ALBEDO));
}

fn normal_of(pixel: u32) -> vec3f {
    let normal = pixels[PIXEL_VECTORS * pixel + 5u].xyz;
    let size = dot(normal, normal);
    return select(vec3f(0.0), normal * inverseSqrt(max(size, TINY)), is_finite3(normal) && size > TINY);
}

fn on_surface(pixel: u32) -> bool {
    return any(normal_of(pixel) != vec3f(0.0)) && is_finite3(pixels[PIXEL_VECTORS * pixel + 6u].xyz);
}

// Distance to a neighbour's position.
fn spacing_to(pixel: u32, at: vec2i, step: vec2i) -> f32 {
    let other = at + step;
    if any(other < vec2i(0)) || other.x >= i32(denoise.width) || other.y >= i32(denoise.height) { return NO_SPACING; }
    let neighbour = u32(other.y) * denoise.width + u32(other.x);
    if !on_surface(neighbour) { return NO_SPACING; }
    let apart = pixels[PIXEL_VECTORS * neighbour + 6u].xyz - pixels[PIXEL_VECTORS * pixel + 6u].xyz;
    return min(length(apart), NO_SPACING);
}

// The larger of the distances to the nearer neighbour in the row and in the column.
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

fn demodulated(pixel: u32, part: u32) -> Light {
    let albedo = albedo_of(pixel);
    let mean = pixels[PIXEL_VECTORS * pixel + 2u * part].xyz / albedo;
    let variance = pixels[PIXEL_VECTORS * pixel + 2u * part + 1u].xyz / (albedo * albedo);
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
    light_out[2u * pixel] = select(vec4f(0.0), direct.value, valid);
    light_out[2u * pixel + 1u] = select(vec4f(0.0), indirect.value, valid);
    let kind = select(KIND_KEPT, select(KIND_EMPTY, KIND_SURFACE, on_surface(pixel)), valid);
    let position = select(vec3f(0.0), pixels[PIXEL_VECTORS * pixel + 6u].xyz, on_surface(pixel));
    let word = (pack4x8unorm(vec4f(albedo_of(pixel), 0.0)) & 0xffffffu) | (kind << 24u) | NORMAL_NUMBER;
    surface_out[2u * pixel] = vec4f(position, spacing_of(pixel));
    surface_out[2u * pixel + 1u] = vec4f(normal_of(pixel), bitcast<f32>(word));
}

// Light that stands out from its neighbours (their mean, and their spread about it) by its own noise is drawn towards
// them, with its variance, to where it no longer does.
fn restrained(light: vec4f, mean: vec3f, spread: f32, count: f32) -> vec4f {
    let d = light.xyz - mean;
    let distance = dot(d, d);
    let far = distance > FAR_FROM_NEIGHBOURS * spread;
    let explained = denoise.samples < 2u || distance < WITHIN_OWN * light.w;
    let share = FAR_FROM_NEIGHBOURS * spread / max(distance, 1e-30);
    return select(light, vec4f(mean + sqrt(share) * d, share * light.w), far && explained && count >= MIN_NEIGHBOURS);
}

// Draws fireflies towards their neighbours: no confidence interval excludes them, as their own variance is so large.
@compute @workgroup_size(64)
fn restrain(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let surface = surface_at(pixel);
    var direct = vec3f(0.0);
    var indirect = vec3f(0.0);
    var weights = 0.0;
    var count = 0.0;
    let extent = window(pixel, POOL_RADIUS);
    let own = column_and_row(pixel);
    for (var y = extent.y; y <= extent.w; y++) {
        for (var x = extent.x; x <= extent.z; x++) {
            let other = u32(y) * denoise.width + u32(x);
            let same = surface_weight(surface, surface_at(other), vec2f(vec2i(x, y) - own));
            let weight = select(same, 0.0, other == pixel);
            weights += weight;
            count += select(0.0, 1.0, weight > COUNTED_WEIGHT);
            direct += weight * load_light(2u * other).xyz;
            indirect += weight * load_light(2u * other + 1u).xyz;
        }
    }
    let scale = 1.0 / max(weights, TINY);
    direct *= scale;
    indirect *= scale;
    // About the mean, as the difference of two sums would lose the spread beside bright light.
    var spread = vec2f(0.0);
    for (var y = extent.y; y <= extent.w; y++) {
        for (var x = extent.x; x <= extent.z; x++) {
            let other = u32(y) * denoise.width + u32(x);
            let same = surface_weight(surface, surface_at(other), vec2f(vec2i(x, y) - own));
            let a = load_light(2u * other).xyz - direct;
            let b = load_light(2u * other + 1u).xyz - indirect;
            spread += select(same, 0.0, other == pixel) * vec2f(dot(a, a), dot(b, b));
        }
    }
    spread *= scale * count / max(count - 1.0, 1.0);
    light_out[2u * pixel] = restrained(load_light(2u * pixel), direct, spread.x, count);
    light_out[2u * pixel + 1u] = restrained(load_light(2u * pixel + 1u), indirect, spread.y, count);
}

// The variance of a pixel, from its own and its neighbours' mean variance.
fn pooled(light: vec4f, neighbours: f32) -> vec4f {
    let more = f32(denoise.samples) - 1.0;
    return vec4f(light.xyz, (POOLED_SAMPLES * neighbours + more * light.w) / (POOLED_SAMPLES + more));
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
    let surface = surface_at(pixel);
    var variances = vec2f(0.0);
    var weights = TINY;
    let extent = window(pixel, POOL_RADIUS);
    let own = column_and_row(pixel);
    for (var y = extent.y; y <= extent.w; y++) {
        for (var x = extent.x; x <= extent.z; x++) {
            let other = u32(y) * denoise.width + u32(x);
            let weight = surface_weight(surface, surface_at(other), vec2f(vec2i(x, y) - own));
            weights += weight;
            variances += weight * vec2f(load_light(2u * other).w, load_light(2u * other + 1u).w);
        }
    }
    light_out[2u * pixel] = pooled(load_light(2u * pixel), variances.x / weights);
    light_out[2u * pixel + 1u] = pooled(load_light(2u * pixel + 1u), variances.y / weights);
}

// The squared differences of direct and of indirect light between two pixels, and 1, by `weight` and that of the other
// pixel `to`; 0 if it is outside of the window that ends at `last`.
fn step_to(surface: Surface, own: vec2i, last: vec2i, weight: f32, other: u32, to: vec2i) -> vec3f {
    if any(to > last) { return vec3f(0.0); }
    let next = u32(to.y) * denoise.width + u32(to.x);
    let both = weight * surface_weight(surface, surface_at(next), vec2f(to - own));
    let a = load_light(2u * next).xyz - load_light(2u * other).xyz;
    let b = load_light(2u * next + 1u).xyz - load_light(2u * other + 1u).xyz;
    return both * vec3f(dot(a, a), dot(b, b), 1.0);
}

// `pool` of single samples, which have no variance: what neighbours one and two pixels apart differ by. Noise differs
// the same at both distances, and edges or slopes twice as much at the second or more. So what is left at distance 0 is
// noise (the nugget of a linear variogram; Matheron 1963).
@compute @workgroup_size(64)
fn pool_single(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let surface = surface_at(pixel);
    var near = vec3f(0.0);
    var far = vec3f(0.0);
    let extent = window(pixel, POOL_RADIUS);
    let own = column_and_row(pixel);
    let last = extent.zw;
    for (var y = extent.y; y <= extent.w; y++) {
        for (var x = extent.x; x <= extent.z; x++) {
            let at = vec2i(x, y);
            let other = u32(y) * denoise.width + u32(x);
            let weight = surface_weight(surface, surface_at(other), vec2f(at - own));
            near += step_to(surface, own, last, weight, other, at + vec2i(1, 0));
            near += step_to(surface, own, last, weight, other, at + vec2i(0, 1));
            far += step_to(surface, own, last, weight, other, at + vec2i(2, 0));
            far += step_to(surface, own, last, weight, other, at + vec2i(0, 2));
        }
    }
    // Half of a mean squared difference is a variance.
    let one = 0.5 * near.xy / max(near.z, TINY);
    let two = 0.5 * far.xy / max(far.z, TINY);
    let variance = clamp(2.0 * one - two, vec2f(0.0), one);
    light_out[2u * pixel] = vec4f(load_light(2u * pixel).xyz, variance.x);
    light_out[2u * pixel + 1u] = vec4f(load_light(2u * pixel + 1u).xyz, variance.y);
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
    let surface = surface_at(pixel);
    var direct = vec4f(0.0);
    var indirect = vec4f(0.0);
    var weights = 0.0;
    let extent = window(pixel, 1);
    let own = column_and_row(pixel);
    for (var y = extent.y; y <= extent.w; y++) {
        for (var x = extent.x; x <= extent.z; x++) {
            let other = u32(y) * denoise.width + u32(x);
            let weight = surface_weight(surface, surface_at(other), vec2f(vec2i(x, y) - own));
            let factor = vec4f(vec3f(weight), weight * weight);
            weights += weight;
            direct += factor * load_light(2u * other);
            indirect += factor * load_light(2u * other + 1u);
        }
    }
    let scale = 1.0 / max(weights, TINY);
    let factor = vec4f(vec3f(scale), scale * scale);
    light_out[2u * pixel] = factor * direct;
    light_out[2u * pixel + 1u] = factor * indirect;
}

// Averages the pixels whose guides differ by no more than noise. Out: the mean and its variance.
@compute @workgroup_size(64)
fn average(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let surface = surface_at(pixel);
    let direct_guide = load_guide(2u * pixel);
    let indirect_guide = load_guide(2u * pixel + 1u);
    var direct = vec4f(0.0);
    var indirect = vec4f(0.0);
    var weights = vec2f(0.0);
    let extent = window(pixel, FIRST_RADIUS);
    let own = column_and_row(pixel);
    for (var y = extent.y; y <= extent.w; y++) {
        for (var x = extent.x; x <= extent.z; x++) {
            let other = u32(y) * denoise.width + u32(x);
            let difference = surface_difference(surface, surface_at(other), vec2f(vec2i(x, y) - own));
            let a = joint_weight(difference, direct_guide, load_guide(2u * other), FIRST_INTERVAL);
            let b = joint_weight(difference, indirect_guide, load_guide(2u * other + 1u), FIRST_INTERVAL);
            weights += vec2f(a, b);
            direct += vec4f(vec3f(a), a * a) * load_light(2u * other);
            indirect += vec4f(vec3f(b), b * b) * load_light(2u * other + 1u);
        }
    }
    let scale = 1.0 / max(weights, vec2f(TINY));
    light_out[2u * pixel] = vec4f(vec3f(scale.x), scale.x * scale.x) * direct;
    light_out[2u * pixel + 1u] = vec4f(vec3f(scale.y), scale.y * scale.y) * indirect;
}

// Sums of weights, and of light times weight, each by 1, x and y.
struct Fit {
    one: f32,
    first: vec2f,
    // Of x x, x y and y y.
    second: vec3f,
    light: vec3f,
    light_x: vec3f,
    light_y: vec3f,
}

fn fit_with(fit: Fit, weight: f32, d: vec2f, light: vec3f) -> Fit {
    return Fit(
        fit.one + weight,
        fit.first + weight * d,
        fit.second + weight * vec3f(d.x * d.x, d.x * d.y, d.y * d.y),
        fit.light + weight * light,
        fit.light_x + (weight * d.x) * light,
        fit.light_y + (weight * d.y) * light,
    );
}

// The fitted plane at the pixel, and in w the weight of the pixel's own light in it, whose weight in the sums is 1.
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

// As `average`, with a plane fitted to the pixels in place of their mean. Out: the light, and the weight of the pixel's
// own light in it.
@compute @workgroup_size(64)
fn regress(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = pixel_of(group, groups, lane);
    if outside(pixel) { return; }
    let surface = surface_at(pixel);
    let direct_guide = load_guide(2u * pixel);
    let indirect_guide = load_guide(2u * pixel + 1u);
    var direct = Fit();
    var indirect = Fit();
    let extent = window(pixel, SECOND_RADIUS);
    let own = column_and_row(pixel);
    for (var y = extent.y; y <= extent.w; y++) {
        for (var x = extent.x; x <= extent.z; x++) {
            let other = u32(y) * denoise.width + u32(x);
            let d = vec2f(vec2i(x, y) - own);
            let difference = surface_difference(surface, surface_at(other), d);
            let a = joint_weight(difference, direct_guide, load_guide(2u * other), SECOND_INTERVAL);
            let b = joint_weight(difference, indirect_guide, load_guide(2u * other + 1u), SECOND_INTERVAL);
            direct = fit_with(direct, a, d, load_light(2u * other).xyz);
            indirect = fit_with(indirect, b, d, load_light(2u * other + 1u).xyz);
        }
    }
    light_out[2u * pixel] = fitted(direct);
    light_out[2u * pixel + 1u] = fitted(indirect);
}

// Variance that the filter may have removed, and the squared change that it made, of a pixel.
fn change(light: vec4f, result: vec4f) -> vec2f {
    let d = result.xyz - light.xyz;
    return vec2f(light.w * max(1.0 - result.w, 0.0), dot(d, d));
}

// The mixture of filtered light and the pixel's own that has the least expected error (James and Stein 1961; Stein's
// estimate of the error of the filter is its squared change, without the variance that noise explains).
fn mixed(light: vec4f, result: vec4f, sums: vec2f) -> vec3f {
    let trust = clamp(sums.x / max(sums.y, 1e-30), 0.0, 1.0);
    return mix(light.xyz, result.xyz, trust);
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
    let surface = surface_at(pixel);
    var direct = vec2f(0.0);
    var indirect = vec2f(0.0);
    let extent = window(pixel, MIX_RADIUS);
    let own = column_and_row(pixel);
    for (var y = extent.y; y <= extent.w; y++) {
        for (var x = extent.x; x <= extent.z; x++) {
            let other = u32(y) * denoise.width + u32(x);
            let weight = surface_weight(surface, surface_at(other), vec2f(vec2i(x, y) - own));
            direct += weight * change(load_light(2u * other), load_guide(2u * other));
            indirect += weight * change(load_light(2u * other + 1u), load_guide(2u * other + 1u));
        }
    }
    let a = mixed(load_light(2u * pixel), load_guide(2u * pixel), direct);
    let b = mixed(load_light(2u * pixel + 1u), load_guide(2u * pixel + 1u), indirect);
    light_out[pixel] = vec4f((a + b) * albedo_of(pixel), select(1.0, 0.0, surface.kind == KIND_KEPT));
}
