// Emitter triangles, the parts of mesh lights: how a position samples one of them, and with which probability.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::constants::{EMITTER_SAMPLING_TEXEL, EMITTER_TEXELS};
@if(many_emitters) import package::lib::constants::{
    FEW_EMITTERS, FEW_NEAR_EMITTERS, LIGHT_SPHERE_TEXEL, NEAR_LIGHT_SQUARED,
};
@if(emitter_pairs) import package::lib::constants::{LIGHT_CONTOUR_TEXEL, LIGHT_VIEWED};
@if(many_emitters) import package::lib::light::table::light_texel_f32;
@if(emitter_pairs) import package::lib::light::table::light_texel;
@if(emitter_pairs) import package::lib::math::oct_wrap;
import package::lib::constants::LIGHT_TWO_SIDED;
import package::lib::rng::BELOW_ONE;
import package::lib::sampling::{SphericalTriangle, spherical_triangle};

@if(texture_loads) @group(1) @binding(8) var emitter_texels: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(8) var<storage, read> emitter_texels: array<vec4u>;
@if(texture_loads) @group(1) @binding(9) var light_vertices: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(9) var<storage, read> light_vertices: array<vec4f>;

fn load_emitter_texel(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(emitter_texels, table_texel(i)); }
    @else { return emitter_texels[i]; }
}

fn load_light_vertex(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(light_vertices, table_texel(i)); }
    @else { return light_vertices[i]; }
}

// An emitter triangle.
struct EmitterTriangle {
    a: vec3f,
    e1: vec3f,
    e2: vec3f,
    // e1 x e2: along the normal, twice the area long.
    across: vec3f,
    // Density by area of points sampled by power; proportional to the triangle's radiance.
    density: f32,
    // Its primitive index.
    index: u32,
}

fn load_emitter(emitter: u32) -> EmitterTriangle {
    let r0 = load_emitter_texel(emitter * EMITTER_TEXELS);
    let r1 = load_emitter_texel(emitter * EMITTER_TEXELS + 1u);
    let r2 = load_emitter_texel(emitter * EMITTER_TEXELS + 2u);
    let a = bitcast<vec3f>(r0.xyz);
    let e1 = bitcast<vec3f>(r1.xyz) - a;
    let e2 = bitcast<vec3f>(r2.xyz) - a;
    return EmitterTriangle(a, e1, e2, cross(e1, e2), bitcast<f32>(r2.w), r0.w);
}

// The probability with which an emitter triangle is sampled by power.
@if(many_emitters)
fn emitter_power(emitter: u32) -> f32 {
    return bitcast<f32>(load_emitter_texel(emitter * EMITTER_TEXELS + EMITTER_SAMPLING_TEXEL).y);
}

// A sampled emitter triangle, and the remainder of the random number, which is uniform again.
struct SampledEmitter {
    emitter: u32,
    probability: f32,
    u: f32,
}

// The relative position of u, 0 to 1, within the interval of length `share` that ends at `cumulative`.
fn left_of(u: f32, cumulative: f32, share: f32) -> f32 {
    return clamp(1.0 - (cumulative - u) / share, 0.0, BELOW_ONE);
}

fn sample_emitter(header: vec4u, u: f32) -> SampledEmitter {
    // The first emitter triangle whose cumulative probability exceeds u.
    var first = header.y;
    var last = header.y + header.z - 1u;
    while first < last {
        let middle = (first + last) / 2u;
        let cumulative = bitcast<f32>(load_emitter_texel(middle * EMITTER_TEXELS + EMITTER_SAMPLING_TEXEL).z);
        if cumulative > u { last = middle; } else { first = middle + 1u; }
    }
    let found = bitcast<vec2f>(load_emitter_texel(first * EMITTER_TEXELS + EMITTER_SAMPLING_TEXEL).yz);
    return SampledEmitter(first, found.x, left_of(u, found.y, found.x));
}

fn emitter_faces(triangle: EmitterTriangle, position: vec3f) -> bool {
    return dot(triangle.across, position - triangle.a) > 0.0;
}

// Positions nearer than this to the plane of a light count as in it, unless the plane is perpendicular to an axis. If a
// flat light also reflects, rounding puts its points on either side of its plane, up to 6e-7 away, since coordinates
// are at most 1. Seen from there the light would span a hemisphere, with points as near as rounding in any direction: a
// tilted lamp would light itself. In a plane perpendicular to an axis, all points share one coordinate exactly.
const IN_PLANE = 1e-6;

// Whether light of a triangle arrives at the position: from its front, or from both sides, but not within its plane.
fn emitter_shines(header: vec4u, triangle: EmitterTriangle, position: vec3f) -> bool {
    let height = dot(triangle.across, position - triangle.a);
    // The products whose differences are `across`. In narrow triangles they nearly cancel, but `across` keeps their
    // rounding errors.
    let products = abs(triangle.e1.yzx * triangle.e2.zxy) + abs(triangle.e1.zxy * triangle.e2.yzx);
    let rounded = (triangle.e1 != vec3f(0.0)) | (triangle.e2 != vec3f(0.0));
    let lowest = IN_PLANE * dot(select(vec3f(0.0), products, rounded), vec3f(1.0));
    return select(height, abs(height), (header.x & LIGHT_TWO_SIDED) != 0u) > lowest;
}

// Whether the position is so near to a light that the projected areas of its triangles depend on the position, not only
// on the direction.
@if(many_emitters)
fn is_near_light(light: u32, position: vec3f) -> bool {
    let sphere = light_texel_f32(light, LIGHT_SPHERE_TEXEL);
    let offset = position - sphere.xyz;
    return dot(offset, offset) < f32(NEAR_LIGHT_SQUARED) * sphere.w * sphere.w;
}

// From afar, the projected areas of a convex lamp's triangles depend only on the direction. A view holds, for one of a
// set of directions, cumulative probabilities by power times cosine, so that all samples contribute about the same.
@if(emitter_pairs) const NO_VIEW = 0xffffffffu;

// The first texel of the probabilities for a position, or NO_VIEW. With `far_emitters`, all lights of many triangles
// have views, and no surface that reflects is near one of them, so software devices need not execute both branches.
@if(emitter_pairs)
fn view_of(light: u32, header: vec4u, position: vec3f) -> u32 {
    @if(!far_emitters) if (header.x & LIGHT_VIEWED) == 0u || is_near_light(light, position) { return NO_VIEW; }
    let offset = position - light_texel_f32(light, LIGHT_SPHERE_TEXEL).xyz;
    let views = light_texel(light, LIGHT_CONTOUR_TEXEL);
    let place = vec2u((oct_wrap(offset) + 1.0) * (0.5 * f32(views.z)));
    let cell = min(place, vec2u(views.z - 1u));
    return views.y + (cell.y * views.z + cell.x) * ((header.z + 3u) / 4u);
}

// Cumulative probability up to and including a view's emitter triangle `i`.
@if(emitter_pairs)
fn view_cumulative(view: u32, i: u32) -> f32 {
    return load_light_vertex(view + i / 4u)[i & 3u];
}

// Probability of a view's emitter triangle `i`.
@if(emitter_pairs)
fn view_share(view: u32, i: u32) -> f32 {
    if i == 0u { return view_cumulative(view, 0u); }
    return view_cumulative(view, i) - view_cumulative(view, i - 1u);
}

@if(emitter_pairs)
fn sample_viewed_emitter(header: vec4u, view: u32, u: f32) -> SampledEmitter {
    // Finds the first texel with a cumulative probability above u, and the component in it.
    var first = 0u;
    var last = (header.z + 3u) / 4u - 1u;
    while first < last {
        let middle = (first + last) / 2u;
        if load_light_vertex(view + middle).w > u { last = middle; } else { first = middle + 1u; }
    }
    let below = vec3u(load_light_vertex(view + first).xyz <= vec3f(u));
    let i = 4u * first + below.x + below.y + below.z;
    let share = view_share(view, i);
    return SampledEmitter(header.y + i, share, left_of(u, view_cumulative(view, i), share));
}

// The emitter triangles that may be sampled for a position: a single one with its probability, or all of them, by the
// light that each sends to the position.
struct EmitterRange {
    first: u32,
    end: u32,
    all: bool,
    probability: f32,
    // The remainder of the random number.
    u: f32,
}

fn all_emitters(header: vec4u, u: f32) -> EmitterRange {
    return EmitterRange(header.y, header.y + header.z, true, 1.0, u);
}

// Whether a position evaluates all triangles of a light. It does for lights of few triangles, such as a square; for
// others only nearby, where the contributions of their triangles differ. With `far_emitters` no position is near.
fn uses_all_emitters(light: u32, header: vec4u, position: vec3f) -> bool {
    @if(far_emitters) { return header.z <= FEW_EMITTERS; }
    @if(many_emitters && !far_emitters) {
        return header.z <= FEW_EMITTERS || (header.z <= FEW_NEAR_EMITTERS && is_near_light(light, position));
    }
    @if(!many_emitters) { return true; }
}

// The probability with which `emitter_range` samples an emitter triangle, unless it evaluates all. In closed lights
// that are near or have few triangles, a sampled triangle that faces away is replaced by its partner, which faces
// nearly the opposite way. So the probability of a triangle that faces the position includes that of its partner if the
// partner faces away.
@if(many_emitters)
fn emitter_probability(light: u32, header: vec4u, emitter: u32, position: vec3f) -> f32 {
    @if(emitter_pairs) let view = view_of(light, header, position);
    @if(far_emitters) { return view_share(view, emitter - header.y); }
    @if(emitter_pairs && !far_emitters) { if view != NO_VIEW { return view_share(view, emitter - header.y); } }
    @if(!far_emitters) { return paired_power(emitter, position); }
}

@if(many_emitters && !far_emitters)
fn paired_power(emitter: u32, position: vec3f) -> f32 {
    var power = emitter_power(emitter);
    @if(emitter_pairs) {
        let partner = load_emitter_texel(emitter * EMITTER_TEXELS + EMITTER_SAMPLING_TEXEL).x;
        if partner != emitter && !emitter_faces(load_emitter(partner), position) { power += emitter_power(partner); }
    }
    return power;
}

@if(many_emitters)
fn emitter_range(light: u32, header: vec4u, position: vec3f, u: f32) -> EmitterRange {
    if uses_all_emitters(light, header, position) { return all_emitters(header, u); }
    var chosen: SampledEmitter;
    @if(emitter_pairs) {
        let view = view_of(light, header, position);
        @if(far_emitters) { chosen = sample_viewed_emitter(header, view, u); }
        @if(!far_emitters) {
            if view != NO_VIEW {
                chosen = sample_viewed_emitter(header, view, u);
            } else {
                chosen = sample_emitter(header, u);
                if !emitter_faces(load_emitter(chosen.emitter), position) {
                    chosen.emitter = load_emitter_texel(chosen.emitter * EMITTER_TEXELS + EMITTER_SAMPLING_TEXEL).x;
                }
                chosen.probability = paired_power(chosen.emitter, position);
            }
        }
    }
    @else { chosen = sample_emitter(header, u); }
    return EmitterRange(chosen.emitter, chosen.emitter + 1u, false, chosen.probability, chosen.u);
}

// The contribution of an emitter triangle to a position, in the same units for all triangles of the light: its solid
// angle, times its radiance if all triangles are evaluated; 0 if none of its light arrives.
fn emitter_sends(
    header: vec4u,
    triangle: EmitterTriangle,
    spherical: SphericalTriangle,
    position: vec3f,
    all: bool,
) -> f32 {
    let sent = 2.0 * spherical.half_angle * select(1.0, triangle.density, all);
    return select(0.0, sent, emitter_shines(header, triangle, position));
}

fn spherical_emitter(triangle: EmitterTriangle, position: vec3f) -> SphericalTriangle {
    return spherical_triangle(triangle.a - position, triangle.e1, triangle.e2, triangle.across);
}
