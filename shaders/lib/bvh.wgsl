// Traversal of the bounding volume hierarchy that src/bvh builds: four children a node, boxes of 8 bits a plane.
// In: `bvh_nodes` and `bvh_triangles`; lengths in scene units after normalisation.
// Out: the first hit of a ray, or whether the ray is occluded.
//
// A node is BVH_NODE_TEXELS texels (src/bvh/node.rs has the table of its bits). A triangle is BVH_TRIANGLE_TEXELS
// texels: its corners, and in the first texel's w the primitive's word. The lanes of a software device run in lockstep
// and execute each other's branches. So there is one loop, and one iteration does both kinds of work, a node and a
// triangle, for the lanes that have it.
//
// A kernel that needs something else than trace_closest and trace_occluded runs the traversal itself:
//
//     var traversal = begin_traversal(ray);
//     while !traversal.done {
//         let primitive = next_triangle(&traversal, t_max);   // t_max may shrink from iteration to iteration
//         if primitive != NO_HIT {
//             let hit = intersect_primitive(&traversal, primitive);
//             if stops(hit, t_min, t_max, sample) { ... }
//         }
//     }

@if(texture_loads && !layered_texels) import package::lib::table::table_texel;
@if(layered_texels) import package::lib::table::{layer_texel, table_layer};
import package::lib::ray::{
    Ray, RaySample, Hit, NO_HIT, ShearedRay, nonzero_direction, shear_ray, intersect_triangle,
};
@if(alpha_test) import package::lib::alpha::alpha_blocks;
import package::lib::bvh_triangles::triangle_texel;
@if(instances) import package::lib::instance::{ray_in_mesh, placed_corners, stored_corners, stored_triangle};
@if(procedurals) import package::lib::procedural::{closest_procedural, is_procedural, procedural_normal};
@if(procedurals) import package::lib::procedural::{procedural_ray_iterations, procedurals_occlude};
import package::lib::constants::{BVH_INDEX_MASK, BVH_NODE_INDEX_MASK, BVH_NODE_TEXELS, BVH_TRIANGLE_TEXELS};
@if(!shallow_bvh) import package::lib::constants::BVH_STACK_SIZE;
@if(alpha_test) import package::lib::constants::TRIANGLE_ALPHA;

@if(layered_texels)
@group(1) @binding(0) var bvh_nodes: texture_storage_2d_array<rgba32uint, read>;
@if(texture_loads && !layered_texels)
@group(1) @binding(0) var bvh_nodes: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads && !layered_texels)
@group(1) @binding(0) var<storage, read> bvh_nodes: array<vec4u>;

// Iterations after which a traversal gives up and sets `traversal_overrun`. Software devices end all loops of an
// invocation without an error after 65,535 iterations in total. With alpha tests, an iteration may bring one of the
// outer loop, which is not counted.
@if(alpha_test) const MAX_ITERATIONS: u32 = 30000u;
@if(!alpha_test) const MAX_ITERATIONS: u32 = 60000u;

// Iterations of this invocation so far, over all its traversals. A kernel with other loops may add theirs.
var<private> traversal_iterations: u32;

// Whether a traversal of this invocation gave up. Its results are then wrong, and the kernel must count an error.
var<private> traversal_overrun: bool;

fn node_texel(i: u32) -> vec4u {
    @if(layered_texels) { return textureLoad(bvh_nodes, layer_texel(i), table_layer(i)); }
    @if(texture_loads && !layered_texels) { return textureLoad(bvh_nodes, table_texel(i)); }
    @if(!texture_loads && !layered_texels) { return bvh_nodes[i]; }
}

// The word that the host gave a primitive (Bvh::set_word).
fn triangle_word(primitive: u32) -> u32 {
    @if(instances) return bitcast<u32>(triangle_texel(BVH_TRIANGLE_TEXELS * stored_triangle(primitive)).w);
    @if(!instances) return bitcast<u32>(triangle_texel(BVH_TRIANGLE_TEXELS * primitive).w);
}

fn triangle_corners(primitive: u32) -> array<vec3f, 3> {
    @if(instances) return placed_corners(primitive);
    @if(!instances) let first = BVH_TRIANGLE_TEXELS * primitive;
    @if(!instances)
    return array(triangle_texel(first).xyz, triangle_texel(first + 1u).xyz, triangle_texel(first + 2u).xyz);
}

// An entry is what to visit next: a node by its index, or a run of triangles by its first primitive index and, in the
// bits above, the number of triangles.
const ONE_TRIANGLE: u32 = 1u << 29u;
const NO_ENTRY: u32 = 0xffffffffu;

// A group is a node with children that are still to be visited. Bits 0-23: index of the node. Bits 24-29: numbers of
// these children, the next one lowest. Bits 30-31: how many there are. Software devices write a private array lane by
// lane, so the stack holds one such word for a node instead of one for each child.
const ONE_PENDING: u32 = 1u << 30u;

// State of a traversal.
//
// The stack has an entry for each level that a balanced tree over the maximum number of triangles can have. Software
// devices clear it before every traversal and write it lane by lane, so it is as small as possible. The stack of
// a BVH of at most five levels is four registers: traversals of 36 triangles then take a tenth less time.
struct Traversal {
    sheared: ShearedRay,
    inverse_direction: vec3f,
    t_min: f32,
    entry: u32,
    group: u32,
    done: bool,
    // x is the group pushed last; 0 where there is none.
    @if(shallow_bvh) stack: vec4u,
    @if(!shallow_bvh) stack: array<u32, BVH_STACK_SIZE>,
    @if(!shallow_bvh) height: u32,
    // Within an instance: `sheared` and `inverse_direction` are those of the ray in its space, and the stack holds
    // nodes of the upper tree below this height.
    @if(instances) inside: bool,
    @if(instances) floor: u32,
    @if(instances) offset: u32,
    // The ray in the scene's space.
    @if(instances) ray: Ray,
    @if(instances) outside_sheared: ShearedRay,
    @if(instances) outside_inverse: vec3f,
}

// Keys sort a node's children by the distance at which the ray enters them. A key is the bits of the distance, with the
// last two replaced by the child's number. Distances are not negative, so their bits sort in the same order.
const NO_KEY: u32 = 0xffffffffu;

fn begin_traversal(ray: Ray) -> Traversal {
    var traversal: Traversal;
    traversal.sheared = shear_ray(ray);
    traversal.inverse_direction = 1.0 / nonzero_direction(ray.direction);
    traversal.t_min = ray.t_min;
    traversal.entry = 0u;
    traversal.group = 0u;
    traversal.done = false;
    @if(shallow_bvh) { traversal.stack = vec4u(0u); }
    @if(!shallow_bvh) { traversal.height = 0u; }
    @if(instances) {
        traversal.inside = false;
        traversal.ray = ray;
        traversal.outside_sheared = traversal.sheared;
        traversal.outside_inverse = traversal.inverse_direction;
    }
    // `next_triangle` notices that the budget is exceeded only if nodes are left on the stack. Traversals of a small
    // scene may leave none there, and exceed the budget all together.
    traversal_overrun |= traversal_iterations >= MAX_ITERATIONS;
    return traversal;
}

fn stack_is_empty(traversal: ptr<function, Traversal>) -> bool {
    @if(shallow_bvh) { return (*traversal).stack.x == 0u; }
    @if(!shallow_bvh) { return (*traversal).height == 0u; }
}

fn push_group(traversal: ptr<function, Traversal>) {
    @if(shallow_bvh) { (*traversal).stack = vec4u((*traversal).group, (*traversal).stack.xyz); }
    @if(!shallow_bvh) {
        (*traversal).stack[(*traversal).height] = (*traversal).group;
        (*traversal).height++;
    }
}

fn pop_group(traversal: ptr<function, Traversal>) {
    @if(shallow_bvh) {
        (*traversal).group = (*traversal).stack.x;
        (*traversal).stack = vec4u((*traversal).stack.yzw, 0u);
    }
    @if(!shallow_bvh) {
        (*traversal).height--;
        (*traversal).group = (*traversal).stack[(*traversal).height];
    }
}

// Continues the traversal in the mesh of an instance. A leaf of the upper tree is one instance.
@if(instances)
fn enter_instance(traversal: ptr<function, Traversal>, number: u32) {
    let entered = ray_in_mesh((*traversal).ray, number);
    (*traversal).sheared = shear_ray(entered.ray);
    (*traversal).inverse_direction = 1.0 / nonzero_direction(entered.ray.direction);
    if (*traversal).group >= ONE_PENDING { push_group(traversal); }
    (*traversal).group = 0u;
    (*traversal).entry = entered.root;
    (*traversal).offset = entered.offset;
    (*traversal).floor = (*traversal).height;
    (*traversal).inside = true;
}

// Continues the traversal in the upper tree once all nodes of the mesh are visited.
@if(instances)
fn leave_instance(traversal: ptr<function, Traversal>) {
    let at_end = (*traversal).group < ONE_PENDING && (*traversal).height == (*traversal).floor;
    if (*traversal).inside && at_end {
        (*traversal).sheared = (*traversal).outside_sheared;
        (*traversal).inverse_direction = (*traversal).outside_inverse;
        (*traversal).inside = false;
    }
}

// Runs one iteration. Returns the primitive index of a triangle to be tested, or NO_HIT if this iteration found none.
fn next_triangle(traversal: ptr<function, Traversal>, t_max: f32) -> u32 {
    if (*traversal).entry == NO_ENTRY {
        @if(instances) leave_instance(traversal);
        if (*traversal).group < ONE_PENDING {
            let ends = stack_is_empty(traversal);
            if ends || traversal_iterations >= MAX_ITERATIONS {
                traversal_overrun |= !ends;
                (*traversal).done = true;
                return NO_HIT;
            }
            pop_group(traversal);
        }
        let group = (*traversal).group;
        let node = group & BVH_NODE_INDEX_MASK;
        (*traversal).entry = child_entry(node_texel(BVH_NODE_TEXELS * node + 2u), (group >> 24u) & 3u);
        (*traversal).group = node | ((group >> 2u) & 0x0f000000u) | ((group - ONE_PENDING) & 0xc0000000u);
    }
    traversal_iterations++;
    if (*traversal).entry < ONE_TRIANGLE {
        let node = (*traversal).entry;
        let tail = node_texel(BVH_NODE_TEXELS * node + 2u);
        let keys = open_node(traversal, node, tail, t_max);
        (*traversal).entry = NO_ENTRY;
        if keys.x != NO_KEY {
            if (*traversal).group >= ONE_PENDING { push_group(traversal); }
            (*traversal).entry = child_entry(tail, keys.x & 3u);
            // The nearest child is next, the others are pending.
            let pending = select(vec3u(0u), vec3u(1u), keys.yzw != vec3u(NO_KEY));
            let numbers = (keys.y & 3u) | ((keys.z & 3u) << 2u) | ((keys.w & 3u) << 4u);
            (*traversal).group = node | (numbers << 24u) | ((pending.x + pending.y + pending.z) * ONE_PENDING);
        }
    }
    let entry = (*traversal).entry;
    if entry < ONE_TRIANGLE || entry == NO_ENTRY { return NO_HIT; }
    @if(instances) {
        if !(*traversal).inside {
            enter_instance(traversal, entry & (ONE_TRIANGLE - 1u));
            return NO_HIT;
        }
    }
    let rest = entry + 1u - ONE_TRIANGLE;
    (*traversal).entry = select(NO_ENTRY, rest, rest >= ONE_TRIANGLE);
    @if(instances) return (entry & (ONE_TRIANGLE - 1u)) + (*traversal).offset;
    @if(!instances) return entry & (ONE_TRIANGLE - 1u);
}

// The entry of a child by its number, from the node's last texel.
fn child_entry(tail: vec4u, child: u32) -> u32 {
    let counts = leaf_counts(tail) & ((8u << (3u * child)) - 1u);
    let count = counts >> (3u * child);
    // Triangles of the leaves before: their counts in three bits each, summed.
    let before = counts & ~(7u << (3u * child));
    let first = (tail.w & BVH_INDEX_MASK) + (before & 7u) + ((before >> 3u) & 7u) + ((before >> 6u) & 7u);
    return select(count * ONE_TRIANGLE + first, (tail.z & BVH_INDEX_MASK) + child, child < ((tail.y >> 24u) & 15u));
}

// Number of triangles of each of the four children, three bits each; 0 for nodes and unused children.
fn leaf_counts(tail: vec4u) -> u32 {
    return (tail.y >> 28u) | ((tail.z >> 24u) & 0xf0u) | ((tail.w >> 20u) & 0xf00u);
}

// How far planes are moved outwards, as a share of the farthest coordinate: 2^-20.
const PLANE_MARGIN = 0.00000095367432;
// By how much far planes count as farther, for the rounding of 1 / direction: 2^-20 of t.
const FAR_PLANE_SCALE = 1.00000095367432;

// The keys of the children that the ray meets before t_max, sorted; `tail` is the node's last texel.
//
// With a = (origin - ray's origin) / direction and b = step / direction, the ray meets a plane at t = a + q b. The
// margin of the planes covers the rounding of b's terms (src/bvh/node.rs). A child must not be missed if the triangle
// test could report a hit in it. Across the ray, that test uses points that are off by at most 9 * 2^-24 times their
// coordinates relative to the ray's origin: one rounding of the difference, three of the shear, its product, the sum
// and the edge function. Computing a takes three roundings too. PLANE_MARGIN covers both. What remains is the rounding
// of 1 / direction, up to 2^-21 of t where division is inexact: the ray may meet a far plane that much earlier than a
// near one (Ize 2013).
fn open_node(traversal: ptr<function, Traversal>, node: u32, tail: vec4u, t_max: f32) -> vec4u {
    let texel_0 = node_texel(BVH_NODE_TEXELS * node);
    let texel_1 = node_texel(BVH_NODE_TEXELS * node + 1u);
    let head = tail.y;

    let inverse = (*traversal).inverse_direction;
    let step = bitcast<vec3f>((vec3u(head) << vec3u(23u, 15u, 7u)) & vec3u(0x7f800000u));
    let offset = bitcast<vec3f>(texel_0.xyz) - (*traversal).sheared.origin;
    let reach = abs(offset) + 255.0 * step;
    @if(!instances) let slack = PLANE_MARGIN * max(reach.x, max(reach.y, reach.z)) * abs(inverse);
    // In the upper tree the margin is 160 * 2^-24. It covers the 12 * 2^-24 above, and the 141 * 2^-24 by which a ray
    // may be off in a mesh's space (ray_in_mesh).
    @if(instances) let margin = select(10.0 * PLANE_MARGIN, PLANE_MARGIN, (*traversal).inside);
    @if(instances) let slack = margin * max(reach.x, max(reach.y, reach.z)) * abs(inverse);
    let a = offset * inverse;
    let b = step * inverse;
    let a_near = a - slack;
    let a_far = a + slack;
    let lower = vec3u(texel_0.w, texel_1.xy);
    let upper = vec3u(texel_1.zw, tail.x);
    let forwards = inverse > vec3f(0.0);
    let near = select(upper, lower, forwards);
    let far = select(lower, upper, forwards);
    // Compared as integers: one instruction, where floats take three because of NaN. Positive floats sort as their bits
    // do; the order of negative ones does not matter, since all lie before t_min.
    let enter_xy = max(bits(bytes(near.x) * b.x + a_near.x), bits(bytes(near.y) * b.y + a_near.y));
    let enter = max(enter_xy, max(bits(bytes(near.z) * b.z + a_near.z), vec4i(bitcast<i32>((*traversal).t_min))));
    let leave_xy = min(bits(bytes(far.x) * b.x + a_far.x), bits(bytes(far.y) * b.y + a_far.y));
    let leave = min(leave_xy, min(bits(bytes(far.z) * b.z + a_far.z), vec4i(bitcast<i32>(t_max))));

    let number = vec4u(0u, 1u, 2u, 3u);
    let triangles = (vec4u(leaf_counts(tail)) >> (3u * number)) & vec4u(7u);
    let used = (number < vec4u((head >> 24u) & 15u)) | (triangles != vec4u(0u));
    let met = (bitcast<vec4f>(enter) <= bitcast<vec4f>(leave) * FAR_PLANE_SCALE) & used;
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

// Where the ray's line meets a triangle that next_triangle has just found; t is MISSED if nowhere.
fn intersect_primitive(traversal: ptr<function, Traversal>, primitive: u32) -> Hit {
    @if(!instances) let corners = triangle_corners(primitive);
    @if(instances) let corners = stored_corners(primitive - (*traversal).offset);
    let found = intersect_triangle((*traversal).sheared, corners[0], corners[1], corners[2]);
    return Hit(found.x, found.y, found.z, primitive);
}

fn within(hit: Hit, t_min: f32, t_max: f32) -> bool {
    return hit.t > t_min && hit.t <= t_max;
}

// Whether `alpha_blocks` decides if the surface at a hit stops a ray.
fn has_alpha_test(hit: Hit) -> bool {
    @if(alpha_test) { return (triangle_word(hit.triangle) & TRIANGLE_ALPHA) != 0u; }
    @if(!alpha_test) { return false; }
}

// Whether a hit lies within the ray and its surface stops the ray.
fn stops(hit: Hit, t_min: f32, t_max: f32, sample: RaySample) -> bool {
    var stopped = within(hit, t_min, t_max);
    @if(alpha_test) {
        if stopped && has_alpha_test(hit) { stopped = alpha_blocks(hit, sample); }
    }
    return stopped;
}

// A vector along the outer normal of a triangle; its length is twice the triangle's area.
fn triangle_normal(primitive: u32) -> vec3f {
    let corners = triangle_corners(primitive);
    return cross(corners[1] - corners[0], corners[2] - corners[0]);
}

// A vector along the outer normal of the surface that was hit; not of unit length.
fn hit_normal(hit: Hit) -> vec3f {
    @if(procedurals) { if is_procedural(hit.triangle) { return procedural_normal(hit); } }
    return triangle_normal(hit.triangle);
}

// Whether a hit that is no farther than another comes before it: the nearer one does, or at the same distance the one
// of the lower primitive index. Callers compare the distances too (`within`).
fn precedes(hit: Hit, other: Hit) -> bool {
    return hit.t < other.t || hit.triangle < other.triangle;
}

// The first surface that the ray meets; of several at the same distance the one of the lowest primitive index, so that
// coplanar surfaces do not flicker. `sample` is for partly transparent surfaces (alpha blending).
fn trace_closest(ray: Ray, sample: RaySample) -> Hit {
    var traversal = begin_traversal(ray);
    var closest = Hit(ray.t_max, 0.0, 0.0, NO_HIT);
    @if(!alpha_test) {
        while !traversal.done {
            let primitive = next_triangle(&traversal, closest.t);
            if primitive != NO_HIT {
                let hit = intersect_primitive(&traversal, primitive);
                if precedes(hit, closest) && within(hit, ray.t_min, closest.t) { closest = hit; }
            }
        }
    }
    @if(alpha_test) {
        // Software devices run the body of an `if` for every lane, whatever its condition. So the alpha test, with its
        // textures, is outside the loop over triangles. (Without alpha tests these two loops were 5 to 10 % slower than
        // the single one above.)
        while !traversal.done {
            var undecided = Hit(0.0, 0.0, 0.0, NO_HIT);
            while !traversal.done && undecided.triangle == NO_HIT {
                let primitive = next_triangle(&traversal, closest.t);
                if primitive != NO_HIT {
                    let hit = intersect_primitive(&traversal, primitive);
                    if precedes(hit, closest) && within(hit, ray.t_min, closest.t) {
                        if has_alpha_test(hit) { undecided = hit; } else { closest = hit; }
                    }
                }
            }
            if undecided.triangle != NO_HIT && alpha_blocks(undecided, sample) {
                closest = undecided;
            }
        }
    }
    @if(procedurals) {
        closest = closest_procedural(ray, closest);
        traversal_iterations += procedural_ray_iterations;
    }
    return closest;
}

// Whether any surface stops the ray; `sample` as in trace_closest.
fn trace_occluded(ray: Ray, sample: RaySample) -> bool {
    var traversal = begin_traversal(ray);
    @if(!alpha_test) {
        while !traversal.done {
            let primitive = next_triangle(&traversal, ray.t_max);
            if primitive != NO_HIT && within(intersect_primitive(&traversal, primitive), ray.t_min, ray.t_max) {
                return true;
            }
        }
    }
    @if(alpha_test) {
        while !traversal.done {
            var undecided = Hit(0.0, 0.0, 0.0, NO_HIT);
            while !traversal.done && undecided.triangle == NO_HIT {
                let primitive = next_triangle(&traversal, ray.t_max);
                if primitive != NO_HIT {
                    let hit = intersect_primitive(&traversal, primitive);
                    if within(hit, ray.t_min, ray.t_max) {
                        if !has_alpha_test(hit) { return true; }
                        undecided = hit;
                    }
                }
            }
            if undecided.triangle != NO_HIT && alpha_blocks(undecided, sample) {
                return true;
            }
        }
    }
    @if(procedurals) {
        let occluded = procedurals_occlude(ray);
        traversal_iterations += procedural_ray_iterations;
        return occluded;
    }
    @else { return false; }
}
