// Rays through the hierarchy that src/bvh builds: four children a node, boxes of 8 bits a plane.
//
// A node is three texels (src/bvh/node.rs has the table of its bits), and so is a triangle: its corners, and in the
// first texel's w the slot's word. Lanes of a software device walk in step and take each other's branches, so one turn
// of the one loop there is does both kinds of work, a node and a triangle, for whichever lanes have it.
//
// To do something else than trace_closest and trace_occluded, walk:
//
//     var walk = begin_walk(ray);
//     while !walk.done {
//         let slot = next_triangle(&walk, t_max);   // t_max may shrink from turn to turn
//         if slot != NO_HIT { let hit = intersect_slot(&walk, slot); if meets(ray, hit) { ... } }
//     }

@if(texture_loads) import package::lib::table::table_place;
import package::lib::ray::{Ray, Hit, NO_HIT, ShearedRay, shear_ray, intersect_triangle};
@if(alpha_test) import package::lib::alpha::alpha_blocks;
@if(procedurals) import package::lib::procedural::{closest_procedural, is_procedural, procedural_normal, procedural_spent, procedurals_occlude};

@if(texture_loads) @group(1) @binding(0) var bvh_nodes: texture_storage_2d<rgba32uint, read>;
@if(texture_loads) @group(1) @binding(1) var bvh_triangles: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(0) var<storage, read> bvh_nodes: array<vec4u>;
@if(!texture_loads) @group(1) @binding(1) var<storage, read> bvh_triangles: array<vec4f>;

// Entries of the stack: one for each of the 28 levels that a balanced tree over the most triangles can have. Software
// devices clear it before every traversal and write it lane by lane, so it is no larger than it must be, and that of a
// hierarchy of at most five levels is four registers (traversals of 36 triangles take a tenth less time).
const STACK_SIZE = 28;

// Turns of the loop after which a traversal gives up and says so: software devices end all loops of an invocation
// in silence after 65,535 turns in all. With alpha tests there may be one more for each.
@if(alpha_test) const MAX_TURNS: u32 = 30000u;
@if(!alpha_test) const MAX_TURNS: u32 = 60000u;

// Turns of this invocation so far, over all its traversals. A kernel of other loops may add theirs.
var<private> traversal_turns: u32;

// Whether a traversal of this invocation gave up. Its results are then wrong, and the kernel must count an error.
var<private> traversal_overrun: bool;

fn node_texel(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(bvh_nodes, table_place(i)); }
    @if(!texture_loads) { return bvh_nodes[i]; }
}

fn triangle_texel(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(bvh_triangles, table_place(i)); }
    @if(!texture_loads) { return bvh_triangles[i]; }
}

// The word that the host gave a slot.
fn triangle_word(slot: u32) -> u32 {
    return bitcast<u32>(triangle_texel(3u * slot).w);
}

// The corners of a slot.
fn triangle_corners(slot: u32) -> array<vec3f, 3> {
    return array(triangle_texel(3u * slot).xyz, triangle_texel(3u * slot + 1u).xyz, triangle_texel(3u * slot + 2u).xyz);
}

// What to visit next: a node by its index, or a run of triangles by the first slot and, above it, how many.
const ONE_TRIANGLE: u32 = 1u << 29u;
const NO_PLACE: u32 = 0xffffffffu;

// A node some of whose children are yet to be visited: its index in bits 0-23, their numbers in bits 24-29, the next
// one lowest, and how many they are in bits 30-31. A private array is written lane by lane on software devices, so the
// stack holds one such word for a node instead of one for each child.
const GROUP_NODE: u32 = 0x00ffffffu;
const ONE_WAITING: u32 = 1u << 30u;

// A traversal under way.
struct Walk {
    sheared: ShearedRay,
    inverse_direction: vec3f,
    t_min: f32,
    place: u32,
    group: u32,
    done: bool,
    // The last group put there is x; 0 where there is none.
    @if(shallow_bvh) stack: vec4u,
    @if(!shallow_bvh) stack: array<u32, STACK_SIZE>,
    @if(!shallow_bvh) height: u32,
}

// Keys that sort a node's children by where the ray enters: its bits, the last two of them replaced by the child's
// number. Distances are not negative, so their bits sort as they do.
const NO_KEY: u32 = 0xffffffffu;

fn begin_walk(ray: Ray) -> Walk {
    // A direction's component of 0 is taken for 2^-80 of the same sign, so nothing is infinite and nothing NaN; see
    // MIN_EXPONENT in src/bvh/node.rs for why no box is missed.
    let least = 8.2718061e-25;
    let d = ray.direction;
    let safe = select(d, select(vec3f(least), vec3f(-least), d < vec3f(0.0)), abs(d) < vec3f(least));
    var walk: Walk;
    walk.sheared = shear_ray(ray);
    walk.inverse_direction = 1.0 / safe;
    walk.t_min = ray.t_min;
    walk.place = 0u;
    walk.group = 0u;
    walk.done = false;
    @if(shallow_bvh) { walk.stack = vec4u(0u); }
    @if(!shallow_bvh) { walk.height = 0u; }
    // The traversals of a small scene end within their turns, and yet there may be too many of them.
    traversal_overrun |= traversal_turns >= MAX_TURNS;
    return walk;
}

fn nothing_waits(walk: ptr<function, Walk>) -> bool {
    @if(shallow_bvh) { return (*walk).stack.x == 0u; }
    @if(!shallow_bvh) { return (*walk).height == 0u; }
}

fn push_group(walk: ptr<function, Walk>) {
    @if(shallow_bvh) { (*walk).stack = vec4u((*walk).group, (*walk).stack.xyz); }
    @if(!shallow_bvh) {
        (*walk).stack[(*walk).height] = (*walk).group;
        (*walk).height++;
    }
}

fn pop_group(walk: ptr<function, Walk>) {
    @if(shallow_bvh) {
        (*walk).group = (*walk).stack.x;
        (*walk).stack = vec4u((*walk).stack.yzw, 0u);
    }
    @if(!shallow_bvh) {
        (*walk).height--;
        (*walk).group = (*walk).stack[(*walk).height];
    }
}

// Takes a turn: the slot of a triangle to be tested, or NO_HIT where this turn met none.
fn next_triangle(walk: ptr<function, Walk>, t_max: f32) -> u32 {
    if (*walk).place == NO_PLACE {
        if (*walk).group < ONE_WAITING {
            let ends = nothing_waits(walk);
            if ends || traversal_turns >= MAX_TURNS {
                traversal_overrun |= !ends;
                (*walk).done = true;
                return NO_HIT;
            }
            pop_group(walk);
        }
        let group = (*walk).group;
        let node = group & GROUP_NODE;
        (*walk).place = child_place(node_texel(3u * node + 2u), (group >> 24u) & 3u);
        (*walk).group = node | ((group >> 2u) & 0x0f000000u) | ((group - ONE_WAITING) & 0xc0000000u);
    }
    traversal_turns++;
    if (*walk).place < ONE_TRIANGLE {
        let node = (*walk).place;
        let tail = node_texel(3u * node + 2u);
        let keys = open_node(walk, node, tail, t_max);
        (*walk).place = NO_PLACE;
        if keys.x != NO_KEY {
            if (*walk).group >= ONE_WAITING { push_group(walk); }
            (*walk).place = child_place(tail, keys.x & 3u);
            // The nearest child is next, the others wait.
            let waiting = select(vec3u(0u), vec3u(1u), keys.yzw != vec3u(NO_KEY));
            let numbers = (keys.y & 3u) | ((keys.z & 3u) << 2u) | ((keys.w & 3u) << 4u);
            (*walk).group = node | (numbers << 24u) | ((waiting.x + waiting.y + waiting.z) * ONE_WAITING);
        }
    }
    let place = (*walk).place;
    if place < ONE_TRIANGLE || place == NO_PLACE { return NO_HIT; }
    let rest = place + 1u - ONE_TRIANGLE;
    (*walk).place = select(NO_PLACE, rest, rest >= ONE_TRIANGLE);
    return place & (ONE_TRIANGLE - 1u);
}

// The place of a child by its number, from the node's last texel.
fn child_place(tail: vec4u, child: u32) -> u32 {
    let counts = leaf_counts(tail) & ((8u << (3u * child)) - 1u);
    let count = counts >> (3u * child);
    // Triangles of the leaves before: their counts in three bits each, summed.
    let before = counts & ~(7u << (3u * child));
    let slot = (tail.w & 0x0fffffffu) + (before & 7u) + ((before >> 3u) & 7u) + ((before >> 6u) & 7u);
    return select(count * ONE_TRIANGLE + slot, (tail.z & 0x0fffffffu) + child, child < ((tail.y >> 24u) & 15u));
}

// Triangles of the four children, three bits each; 0 for nodes and for places not used.
fn leaf_counts(tail: vec4u) -> u32 {
    return (tail.y >> 28u) | ((tail.z >> 24u) & 0xf0u) | ((tail.w >> 20u) & 0xf00u);
}

// The keys of a node's children that the ray meets before t_max, sorted; `tail` is the node's last texel.
//
// With a = (origin - ray's origin) / direction and b = step / direction, a plane is met at a + q b; the roundings of
// b's terms are covered by the planes' margin (src/bvh/node.rs). Nothing may be missed that the test of a triangle
// would call a hit. That test works with points which are off, across the ray, by their coordinates relative to its
// origin times at most 9 * 2^-24: one rounding of the difference, three of the shear, its product, the sum and the edge
// function. So do three roundings of a. Planes are moved outwards by 2^-20 of the farthest coordinate for both. What is
// left is the rounding of 1 / direction, up to 2^-21 of t where division is inexact: a far plane may be met that much
// earlier than a near one (Ize 2013).
fn open_node(walk: ptr<function, Walk>, node: u32, tail: vec4u, t_max: f32) -> vec4u {
    let texel_0 = node_texel(3u * node);
    let texel_1 = node_texel(3u * node + 1u);
    let head = tail.y;

    let inverse = (*walk).inverse_direction;
    let step = bitcast<vec3f>((vec3u(head) << vec3u(23u, 15u, 7u)) & vec3u(0x7f800000u));
    let offset = bitcast<vec3f>(texel_0.xyz) - (*walk).sheared.origin;
    let reach = abs(offset) + 255.0 * step;
    let slack = 0.00000095367432 * max(reach.x, max(reach.y, reach.z)) * abs(inverse);
    let a = offset * inverse;
    let b = step * inverse;
    let a_near = a - slack;
    let a_far = a + slack;
    let lower = vec3u(texel_0.w, texel_1.xy);
    let upper = vec3u(texel_1.zw, tail.x);
    let forwards = inverse > vec3f(0.0);
    let near = select(upper, lower, forwards);
    let far = select(lower, upper, forwards);
    // Compared as integers, which takes one instruction where floats take three for the sake of NaN: the order of
    // positive floats is theirs, and among negative ones any will do, since all lie before t_min.
    let enter_xy = max(bits(bytes(near.x) * b.x + a_near.x), bits(bytes(near.y) * b.y + a_near.y));
    let enter = max(enter_xy, max(bits(bytes(near.z) * b.z + a_near.z), vec4i(bitcast<i32>((*walk).t_min))));
    let leave_xy = min(bits(bytes(far.x) * b.x + a_far.x), bits(bytes(far.y) * b.y + a_far.y));
    let leave = min(leave_xy, min(bits(bytes(far.z) * b.z + a_far.z), vec4i(bitcast<i32>(t_max))));

    let number = vec4u(0u, 1u, 2u, 3u);
    let used = (number < vec4u((head >> 24u) & 15u)) | (((vec4u(leaf_counts(tail)) >> (3u * number)) & vec4u(7u)) != vec4u(0u));
    let met = (bitcast<vec4f>(enter) <= bitcast<vec4f>(leave) * 1.00000095367432) & used;
    return sorted(select(vec4u(NO_KEY), (bitcast<vec4u>(enter) & vec4u(0xfffffffcu)) | number, met));
}

fn bits(v: vec4f) -> vec4i {
    return bitcast<vec4i>(v);
}

fn bytes(word: u32) -> vec4f {
    // Through i32, which converts in one instruction where u32 takes several.
    return vec4f(vec4i((vec4u(word) >> vec4u(0u, 8u, 16u, 24u)) & vec4u(255u)));
}

fn sorted(keys: vec4u) -> vec4u {
    let low = min(keys.xy, keys.zw);
    let high = max(keys.xy, keys.zw);
    let middle = vec2u(max(low.x, low.y), min(high.x, high.y));
    return vec4u(min(low.x, low.y), min(middle.x, middle.y), max(middle.x, middle.y), max(high.x, high.y));
}

// Where the ray's line meets the triangle in a slot; t is MISSED if nowhere.
fn intersect_slot(walk: ptr<function, Walk>, slot: u32) -> Hit {
    let corners = triangle_corners(slot);
    let found = intersect_triangle((*walk).sheared, corners[0], corners[1], corners[2]);
    return Hit(found.x, found.y, found.z, slot);
}

fn within(hit: Hit, t_min: f32, t_max: f32) -> bool {
    return hit.t > t_min && hit.t <= t_max;
}

// Whether the surface at a hit asks `alpha_blocks` if it stops a ray.
fn asks_alpha(hit: Hit) -> bool {
    @if(alpha_test) { return (triangle_word(hit.triangle) & 1u) != 0u; }
    @if(!alpha_test) { return false; }
}

// Whether a hit lies within the ray, and its surface stops this one.
fn stops(hit: Hit, t_min: f32, t_max: f32, seed: u32) -> bool {
    var stopped = within(hit, t_min, t_max);
    @if(alpha_test) {
        if stopped && asks_alpha(hit) { stopped = alpha_blocks(hit.triangle, hit.u, hit.v, seed); }
    }
    return stopped;
}

// A vector along the normal of what was hit, on the outer side.
fn hit_normal(hit: Hit) -> vec3f {
    @if(procedurals) { if is_procedural(hit.triangle) { return procedural_normal(hit); } }
    let corners = triangle_corners(hit.triangle);
    return cross(corners[1] - corners[0], corners[2] - corners[0]);
}

// Before which hit another one comes: the nearer, and of several at the same distance the one in the lowest slot.
fn before(hit: Hit, other: Hit) -> bool {
    return hit.t < other.t || hit.triangle < other.triangle;
}

// The first surface that the ray meets; of several at the same distance the one in the lowest slot, so that
// coplanar surfaces do not flicker. `seed` decides by chance at surfaces that are partly let through.
fn trace_closest(ray: Ray, seed: u32) -> Hit {
    var walk = begin_walk(ray);
    var closest = Hit(ray.t_max, 0.0, 0.0, NO_HIT);
    @if(!alpha_test) {
        while !walk.done {
            let slot = next_triangle(&walk, closest.t);
            if slot != NO_HIT {
                let hit = intersect_slot(&walk, slot);
                if before(hit, closest) && within(hit, ray.t_min, closest.t) { closest = hit; }
            }
        }
    }
    @if(alpha_test) {
        // Software devices run the body of an if for every lane, whatever its condition: the alpha test, with its
        // textures, stands outside the loop over triangles. (Used without alpha tests too, the two loops were 5 to 10 %
        // slower than the one above.)
        while !walk.done {
            var asking = Hit(0.0, 0.0, 0.0, NO_HIT);
            while !walk.done && asking.triangle == NO_HIT {
                let slot = next_triangle(&walk, closest.t);
                if slot != NO_HIT {
                    let hit = intersect_slot(&walk, slot);
                    if before(hit, closest) && within(hit, ray.t_min, closest.t) {
                        if asks_alpha(hit) { asking = hit; } else { closest = hit; }
                    }
                }
            }
            if asking.triangle != NO_HIT && alpha_blocks(asking.triangle, asking.u, asking.v, seed) { closest = asking; }
        }
    }
    @if(procedurals) {
        closest = closest_procedural(ray, closest);
        traversal_turns += procedural_spent;
    }
    return closest;
}

// Whether any surface stops the ray.
fn trace_occluded(ray: Ray, seed: u32) -> bool {
    var walk = begin_walk(ray);
    @if(!alpha_test) {
        while !walk.done {
            let slot = next_triangle(&walk, ray.t_max);
            if slot != NO_HIT && within(intersect_slot(&walk, slot), ray.t_min, ray.t_max) { return true; }
        }
    }
    @if(alpha_test) {
        while !walk.done {
            var asking = Hit(0.0, 0.0, 0.0, NO_HIT);
            while !walk.done && asking.triangle == NO_HIT {
                let slot = next_triangle(&walk, ray.t_max);
                if slot != NO_HIT {
                    let hit = intersect_slot(&walk, slot);
                    if within(hit, ray.t_min, ray.t_max) {
                        if !asks_alpha(hit) { return true; }
                        asking = hit;
                    }
                }
            }
            if asking.triangle != NO_HIT && alpha_blocks(asking.triangle, asking.u, asking.v, seed) { return true; }
        }
    }
    @if(procedurals) {
        let occluded = procedurals_occlude(ray);
        traversal_turns += procedural_spent;
        return occluded;
    }
    @else { return false; }
}
