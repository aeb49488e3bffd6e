// Procedural objects: where rays meet them, and what they are made of. docs/procedurals.md says what their functions are
// to give; `package::lib::procedural_functions` is made of those of the scene (src/procedural).
//
// A hit of one has in `triangle` the bit PROCEDURAL and the object's number, and in `u` and `v` the octahedral image of its
// normal, on the outer side.

@if(texture_loads) import package::lib::table::table_place;
import package::lib::math::{is_finite3, oct_unwrap, oct_wrap};
import package::lib::procedural_functions::{procedural_base, procedural_gradient, procedural_lost, procedural_next, procedural_turns};
import package::lib::ray::{Hit, NO_HIT, Ray};
import package::lib::constants::{PROCEDURAL, PROCEDURAL_RAY_TURNS, PROCEDURAL_RECORDS, PROCEDURAL_TURNS};

override procedural_count: u32;

@if(texture_loads) @group(1) @binding(24) var procedural_records: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(24) var<storage, read> procedural_records: array<vec4f>;

// Turns of loops that a ray has taken in all objects.
var<private> procedural_spent: u32;

fn load_procedural_record(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(procedural_records, table_place(i)); }
    @if(!texture_loads) { return procedural_records[i]; }
}

fn is_procedural(triangle: u32) -> bool {
    return (triangle & PROCEDURAL) != 0u && triangle != NO_HIT;
}

// An object's record from a hit's `triangle`.
fn object_record(triangle: u32, record: u32) -> vec4f {
    return load_procedural_record((triangle & 0xffu) * PROCEDURAL_RECORDS + record);
}

// A ray within an object's box, in the object's own space.
struct Inside {
    // Where it enters, so that functions have small numbers to work with however far off it began.
    origin: vec3f,
    // Unit.
    direction: vec3f,
    // Own length from the ray's origin to there, and to where it leaves from there.
    enter: f32,
    length: f32,
    // Own length of the ray's direction.
    scale: f32,
    parameters: vec4f,
    function: u32,
    // Own length below which places are the same.
    epsilon: f32,
}

fn to_object(object: u32, p: vec3f, w: f32) -> vec3f {
    let rows = mat3x4f(object_record(object, 0u), object_record(object, 1u), object_record(object, 2u));
    return vec4f(p, w) * rows;
}

fn enter_object(object: u32, ray: Ray, t_max: f32) -> Inside {
    var inside: Inside;
    let origin = to_object(object, ray.origin, 1.0);
    let direction = to_object(object, ray.direction, 0.0);
    let low = object_record(object, 3u);
    let high = object_record(object, 4u);
    inside.scale = length(direction);
    inside.direction = direction / inside.scale;
    inside.parameters = object_record(object, 5u);
    inside.function = bitcast<u32>(low.w);
    inside.epsilon = object_record(object, 7u).x;
    // As in `begin_walk`: nothing is infinite.
    let least = 8.2718061e-25;
    let safe = select(inside.direction, select(vec3f(least), vec3f(-least), inside.direction < vec3f(0.0)), abs(inside.direction) < vec3f(least));
    let a = (low.xyz - origin) / safe;
    let b = (high.xyz - origin) / safe;
    let near = min(a, b);
    let far = max(a, b);
    inside.enter = max(max(near.x, near.y), max(near.z, ray.t_min * inside.scale));
    inside.length = min(min(far.x, far.y), min(far.z, t_max * inside.scale)) - inside.enter;
    inside.origin = origin + inside.enter * inside.direction;
    return inside;
}

// Where a ray that has come so far into an object crosses its surface next: the normal, where the function gives it, and
// the length from where the ray entered the box; negative where it does not.
fn next_crossing(inside: Inside, so_far: f32) -> vec4f {
    procedural_turns = 0u;
    let met = procedural_next(inside.function, inside.origin, inside.direction, so_far, inside.length, inside.epsilon, inside.parameters);
    procedural_spent += procedural_turns + 1u;
    return met;
}

// The unit normal in the scene at a crossing that `next_crossing` found.
fn crossing_normal(object: u32, inside: Inside, crossing: vec4f) -> vec3f {
    let place = inside.origin + crossing.w * inside.direction;
    procedural_turns = 0u;
    let own = procedural_gradient(inside.function, place, crossing.xyz, inside.epsilon, inside.parameters);
    procedural_spent += procedural_turns;
    // By the transpose of the inverse of the way to the scene.
    let normal = own.x * object_record(object, 0u).xyz + own.y * object_record(object, 1u).xyz + own.z * object_record(object, 2u).xyz;
    let size = max(abs(normal.x), max(abs(normal.y), abs(normal.z)));
    // Of a field that is level there any will do.
    if !(size > 0.0 && is_finite3(normal)) { return vec3f(0.0, 0.0, 1.0); }
    return normalize(normal / size);
}

// Where along the ray a crossing lies.
fn crossing_t(inside: Inside, crossing: vec4f) -> f32 {
    return (inside.enter + crossing.w) / inside.scale;
}

// Where a ray meets a procedural object.
struct Meeting {
    // As in a hit: NO_HIT where it meets none.
    triangle: u32,
    t: f32,
    inside: Inside,
    crossing: vec4f,
}

// The first of the objects that a ray meets before `t_max`, or the first that is found.
fn meet_objects(ray: Ray, t_max: f32, any_will_do: bool) -> Meeting {
    var first: Meeting;
    first.triangle = NO_HIT;
    first.t = t_max;
    procedural_spent = 0u;
    for (var i = 0u; i < procedural_count && procedural_spent < PROCEDURAL_RAY_TURNS; i++) {
        let inside = enter_object(i, ray, first.t);
        if inside.length <= 0.0 { continue; }
        let met = next_crossing(inside, 0.0);
        let t = crossing_t(inside, met);
        if met.w > 0.0 && t > ray.t_min && t <= first.t {
            first = Meeting(PROCEDURAL | i, t, inside, met);
            if any_will_do { return first; }
        }
    }
    if procedural_spent >= PROCEDURAL_RAY_TURNS { _ = procedural_lost(false); }
    return first;
}

// The nearer of a hit and the first one of the procedural objects.
fn closest_procedural(ray: Ray, so_far: Hit) -> Hit {
    let first = meet_objects(ray, so_far.t, false);
    if first.triangle == NO_HIT { return so_far; }
    let code = oct_wrap(crossing_normal(first.triangle, first.inside, first.crossing));
    return Hit(first.t, code.x, code.y, first.triangle);
}

fn procedurals_occlude(ray: Ray) -> bool {
    return meet_objects(ray, ray.t_max, true).triangle != NO_HIT;
}

// The outer normal of a procedural hit.
fn procedural_normal(hit: Hit) -> vec3f {
    return oct_unwrap(vec2f(hit.u, hit.v));
}

fn procedural_material(triangle: u32) -> u32 {
    return bitcast<u32>(object_record(triangle, 4u).w);
}

fn procedural_double_sided(triangle: u32) -> bool {
    return object_record(triangle, 7u).w != 0.0;
}

// How far from a hit rays leave, so that the error of its place is no matter.
fn procedural_clearance(triangle: u32) -> f32 {
    return object_record(triangle, 7u).y;
}

// Base colour at a point of an object, of that base colour of its material.
fn procedural_colour(triangle: u32, base: vec3f, position: vec3f) -> vec3f {
    let function = bitcast<u32>(object_record(triangle, 7u).z);
    procedural_turns = 0u;
    let colour = procedural_base(function, base, to_object(triangle, position, 1.0), object_record(triangle, 6u));
    if procedural_turns >= PROCEDURAL_TURNS || !is_finite3(colour) {
        _ = procedural_lost(procedural_turns < PROCEDURAL_TURNS);
        return vec3f(0.0);
    }
    // Nothing reflects more than it gets.
    return clamp(colour, vec3f(0.0), vec3f(1.0));
}
