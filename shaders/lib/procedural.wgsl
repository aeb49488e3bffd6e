// Procedural objects: intersection with rays, and surface attributes. docs/procedurals.md specifies their functions;
// the host composes those of the scene into `package::lib::procedural_functions` (src/procedural). In:
// `procedural_texels`, PROCEDURAL_TEXELS for each object, at the offsets from PROCEDURAL_TO_OBJECT to
// PROCEDURAL_TRAITS. Out: hits, in scene units after normalisation. `procedural_misses` counts the rays that missed an
// object because of an error.
//
// A hit of an object has in `triangle` the bit PROCEDURAL and the object's number, and in `u` and `v` the octahedral
// code of its outer normal.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::math::{is_finite3, oct_unwrap, oct_wrap};
import package::lib::procedural_functions::{procedural_base, procedural_gradient, procedural_next};
import package::lib::procedural_functions::{procedural_iterations, procedural_lost};
import package::lib::ray::{Hit, NO_HIT, Ray, nonzero_direction};
import package::lib::constants::{PROCEDURAL, PROCEDURAL_INDEX_MASK, PROCEDURAL_ITERATIONS, PROCEDURAL_RAY_ITERATIONS};
import package::lib::constants::{PROCEDURAL_TEXELS, PROCEDURAL_TO_OBJECT, PROCEDURAL_LOW, PROCEDURAL_HIGH};
import package::lib::constants::{PROCEDURAL_PARAMETERS, PROCEDURAL_COLOUR_PARAMETERS, PROCEDURAL_TRAITS};

override procedural_count: u32;

@if(texture_loads) @group(1) @binding(24) var procedural_texels: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(24) var<storage, read> procedural_texels: array<vec4f>;

// Loop iterations of the present ray, over all objects.
var<private> procedural_ray_iterations: u32;

fn load_procedural_texel(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(procedural_texels, table_texel(i)); }
    @if(!texture_loads) { return procedural_texels[i]; }
}

fn is_procedural(triangle: u32) -> bool {
    return (triangle & PROCEDURAL) != 0u && triangle != NO_HIT;
}

// A texel of an object; `triangle` is that of a hit, or the object's number.
fn object_texel(triangle: u32, texel: u32) -> vec4f {
    return load_procedural_texel((triangle & PROCEDURAL_INDEX_MASK) * PROCEDURAL_TEXELS + texel);
}

// The part of a ray within an object's box, in the object's space.
struct Inside {
    // The point where the ray enters the box. Functions then compute with small numbers, however far away the ray
    // began.
    origin: vec3f,
    // Unit vector.
    direction: vec3f,
    // Length from the ray's origin to `origin`, and from `origin` to the point where the ray leaves the box.
    enter: f32,
    length: f32,
    // Length of the ray's direction in the object's space.
    scale: f32,
    parameters: vec4f,
    function: u32,
    // Positions closer to each other than this length count as the same.
    epsilon: f32,
}

// A position (w = 1) or a direction (w = 0) in the object's space.
fn to_object(object: u32, p: vec3f, w: f32) -> vec3f {
    let rows = mat3x4f(
        object_texel(object, PROCEDURAL_TO_OBJECT),
        object_texel(object, PROCEDURAL_TO_OBJECT + 1u),
        object_texel(object, PROCEDURAL_TO_OBJECT + 2u),
    );
    return vec4f(p, w) * rows;
}

fn enter_object(object: u32, ray: Ray, t_max: f32) -> Inside {
    var inside: Inside;
    let origin = to_object(object, ray.origin, 1.0);
    let direction = to_object(object, ray.direction, 0.0);
    let low = object_texel(object, PROCEDURAL_LOW);
    let high = object_texel(object, PROCEDURAL_HIGH);
    inside.scale = length(direction);
    inside.direction = direction / inside.scale;
    inside.parameters = object_texel(object, PROCEDURAL_PARAMETERS);
    inside.function = bitcast<u32>(low.w);
    inside.epsilon = object_texel(object, PROCEDURAL_TRAITS).x;
    let safe = nonzero_direction(inside.direction);
    let a = (low.xyz - origin) / safe;
    let b = (high.xyz - origin) / safe;
    let near = min(a, b);
    let far = max(a, b);
    inside.enter = max(max(near.x, near.y), max(near.z, ray.t_min * inside.scale));
    inside.length = min(min(far.x, far.y), min(far.z, t_max * inside.scale)) - inside.enter;
    inside.origin = origin + inside.enter * inside.direction;
    return inside;
}

// The next crossing of an object's surface beyond the length `so_far`: in xyz the normal, if the function gives it, in
// w the length from where the ray enters the box; negative where there is no crossing.
fn next_crossing(inside: Inside, so_far: f32) -> vec4f {
    procedural_iterations = 0u;
    let crossing = procedural_next(
        inside.function,
        inside.origin,
        inside.direction,
        so_far,
        inside.length,
        inside.epsilon,
        inside.parameters,
    );
    procedural_ray_iterations += procedural_iterations + 1u;
    return crossing;
}

// The unit normal, in scene space, at a crossing that `next_crossing` found.
fn crossing_normal(object: u32, inside: Inside, crossing: vec4f) -> vec3f {
    let position = inside.origin + crossing.w * inside.direction;
    procedural_iterations = 0u;
    let own = procedural_gradient(inside.function, position, crossing.xyz, inside.epsilon, inside.parameters);
    procedural_ray_iterations += procedural_iterations;
    // Normals transform by the transposed inverse of the object-to-scene matrix, that is by the transpose of to_object.
    let normal = own.x * object_texel(object, PROCEDURAL_TO_OBJECT).xyz
        + own.y * object_texel(object, PROCEDURAL_TO_OBJECT + 1u).xyz
        + own.z * object_texel(object, PROCEDURAL_TO_OBJECT + 2u).xyz;
    let size = max(abs(normal.x), max(abs(normal.y), abs(normal.z)));
    // Where the gradient is zero the normal is arbitrary.
    if !(size > 0.0 && is_finite3(normal)) { return vec3f(0.0, 0.0, 1.0); }
    return normalize(normal / size);
}

// The ray's t at a crossing.
fn crossing_t(inside: Inside, crossing: vec4f) -> f32 {
    return (inside.enter + crossing.w) / inside.scale;
}

// The hit of a ray with a procedural object.
struct ObjectHit {
    // As in `Hit`.
    triangle: u32,
    t: f32,
    inside: Inside,
    crossing: vec4f,
}

// The first hit of the ray with any object before `t_max`; with `any_hit` the search ends at the first one found.
fn intersect_objects(ray: Ray, t_max: f32, any_hit: bool) -> ObjectHit {
    var first: ObjectHit;
    first.triangle = NO_HIT;
    first.t = t_max;
    procedural_ray_iterations = 0u;
    for (var i = 0u; i < procedural_count && procedural_ray_iterations < PROCEDURAL_RAY_ITERATIONS; i++) {
        let inside = enter_object(i, ray, first.t);
        if inside.length <= 0.0 { continue; }
        let crossing = next_crossing(inside, 0.0);
        let t = crossing_t(inside, crossing);
        if crossing.w > 0.0 && t > ray.t_min && t <= first.t {
            first = ObjectHit(PROCEDURAL | i, t, inside, crossing);
            if any_hit { return first; }
        }
    }
    if procedural_ray_iterations >= PROCEDURAL_RAY_ITERATIONS { _ = procedural_lost(false); }
    return first;
}

// The nearer of the hit `so_far` and the first hit of the procedural objects.
fn closest_procedural(ray: Ray, so_far: Hit) -> Hit {
    let first = intersect_objects(ray, so_far.t, false);
    if first.triangle == NO_HIT { return so_far; }
    let code = oct_wrap(crossing_normal(first.triangle, first.inside, first.crossing));
    return Hit(first.t, code.x, code.y, first.triangle);
}

fn procedurals_occlude(ray: Ray) -> bool {
    return intersect_objects(ray, ray.t_max, true).triangle != NO_HIT;
}

// The outer unit normal of a hit of a procedural object.
fn procedural_normal(hit: Hit) -> vec3f {
    return oct_unwrap(vec2f(hit.u, hit.v));
}

fn procedural_material(triangle: u32) -> u32 {
    return bitcast<u32>(object_texel(triangle, PROCEDURAL_HIGH).w);
}

fn procedural_double_sided(triangle: u32) -> bool {
    return object_texel(triangle, PROCEDURAL_TRAITS).w != 0.0;
}

// Offset along the normal of the origin of rays that leave the hit: more than the error of the hit's position.
fn procedural_clearance(triangle: u32) -> f32 {
    return object_texel(triangle, PROCEDURAL_TRAITS).y;
}

// Base colour at a position in scene space; `base` is the material's base colour.
fn procedural_colour(triangle: u32, base: vec3f, position: vec3f) -> vec3f {
    let function = bitcast<u32>(object_texel(triangle, PROCEDURAL_TRAITS).z);
    procedural_iterations = 0u;
    let parameters = object_texel(triangle, PROCEDURAL_COLOUR_PARAMETERS);
    let colour = procedural_base(function, base, to_object(triangle, position, 1.0), parameters);
    if procedural_iterations >= PROCEDURAL_ITERATIONS || !is_finite3(colour) {
        _ = procedural_lost(procedural_iterations < PROCEDURAL_ITERATIONS);
        return vec3f(0.0);
    }
    // No surface reflects more light than it receives.
    return clamp(colour, vec3f(0.0), vec3f(1.0));
}
