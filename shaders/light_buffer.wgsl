// light_buffer: the class of every candidate (point and light) by the light buffers of Haines and Greenberg (1986); see
// src/gpu_scene/light_buffer.rs. In: points of a tile (normalised space), cells around each light, the surfaces that
// they list. Out: class words. A point is lit if none of the surfaces that its cell lists in front of it can hide a
// part of the light, shadowed if one triangle hides the whole light, unknown if the list ends before it, else boundary.
//
// All bounds are conservative: a point classified lit or shadowed is so, up to rounding.

import package::kit::group_index;
import package::lib::bvh::triangle_corners;
import package::lib::class_word::class_word;
import package::lib::visible_point::load_point;
import package::lib::constants::{
    CLASS_BOUNDARY, CLASS_DARK, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN, OCCLUDER_ANYTHING,
    OCCLUDER_COUNT_BITS, OCCLUDER_LIGHT_BEHIND, OCCLUDER_LIGHT_IN_FRONT, OCCLUDER_POROUS, OCCLUDER_TRIANGLE_MASK
};
import package::lib::light::{BEYOND_SCENE, is_dark};
import package::lib::math::oct_decode16;
import package::lib::ray::offset_origin;
@if(texture_loads) import package::lib::table::table_texel;
import package::lib::tile::Tile;

struct LightBufferParameters {
    tile: Tile,
    // The first light of the chunk, and its (light, point) pairs.
    first_light: u32,
    candidate_count: u32,
}

// A light and where its cells are.
struct BufferedLight {
    // Centre of the sphere around it; the unit vector towards a directional light.
    centre: vec3f,
    radius: f32,
    // Axes across a directional light.
    right: vec3f,
    // Cells along a side; 0 for the environment, which has no cells.
    side: u32,
    up: vec3f,
    first_cell: u32,
    // Coordinates where the cells of a directional light begin, and their edge; 0 of other lights.
    low: vec2f,
    cell: f32,
    padding: u32,
}

var<immediate> light_buffer_pass: LightBufferParameters;

@group(0) @binding(1) var<storage, read_write> classes: array<u32>;
@group(0) @binding(2) var<storage, read> buffered_lights: array<BufferedLight>;
// The first texel of each cell's list, above OCCLUDER_COUNT_BITS bits for the number of its texels.
@group(0) @binding(3) var<storage, read> buffer_cells: array<u32>;
// The entries of each list by depth: two words each, two entries per texel.
@if(texture_loads) @group(0) @binding(4) var occluder_lists: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(0) @binding(4) var<storage, read> occluder_lists: array<vec4u>;
// For each triangle, the unit normal, and the plane's distance from the origin along it.
@if(texture_loads) @group(0) @binding(5) var occluder_planes: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(0) @binding(5) var<storage, read> occluder_planes: array<vec4f>;

fn load_list(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(occluder_lists, table_texel(i)); }
    @else { return occluder_lists[i]; }
}

fn load_plane(triangle: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(occluder_planes, table_texel(triangle)); }
    @else { return occluder_planes[triangle]; }
}

// The cell of a light that a position is in, and its depth there.
struct CellDepth {
    cell: u32,
    depth: f32,
}

fn cell_and_depth(light: BufferedLight, position: vec3f) -> CellDepth {
    var face = 0u;
    var at: vec2f;
    var depth: f32;
    if light.cell > 0.0 {
        at = (vec2f(dot(light.right, position), dot(light.up, position)) - light.low) / light.cell;
        depth = -dot(light.centre, position);
    } else {
        let p = position - light.centre;
        let size = abs(p);
        let along_x = size.x >= max(size.y, size.z);
        let along_y = !along_x && size.y >= size.z;
        // Rotated, so that the largest coordinate is the first.
        let q = select(select(p.zxy, p.yzx, along_y), p, along_x);
        face = 2u * select(select(2u, 1u, along_y), 0u, along_x) + u32(q.x < 0.0);
        depth = abs(q.x);
        at = 0.5 * f32(light.side) * (q.yz / max(depth, 1e-30) + 1.0);
    }
    let last = f32(light.side - 1u);
    let cell = vec2u(clamp(floor(at), vec2f(0.0), vec2f(last)));
    return CellDepth(light.first_cell + (face * light.side + cell.y) * light.side + cell.x, depth);
}

// Effect of a surface on the light at a point.
const HIDES_NOTHING = 0u;
const MAY_HIDE = 1u;
const HIDES_ALL = 2u;

// Where rays from a point to a light begin and end.
struct Shaft {
    // Position and normal of the point, and the origin of the rays, which is offset along the normal to keep them clear
    // of the surface.
    position: vec3f,
    normal: vec3f,
    origin: vec3f,
    // From the origin to the sphere around the light.
    to_light: vec3f,
    radius: f32,
}

// Height over a triangle's plane above which a position is certainly in front: coordinates are below 1, so a dot
// product of three is off by less, and rays begin at four times that height.
const CERTAIN_HEIGHT = 1.0 / 4194304.0;
// Height over the point's own horizon below which no ray passes: rays begin twice as high, and what reaches a light as
// low as this brings less than a millionth of its light.
const CERTAIN_HORIZON = 1.0 / 2097152.0;
// Rounding of the triple product of three vectors, as a share of the product of their lengths.
const TRIPLE_ERROR = 1e-6;

fn effect_of(entry: u32, shaft: Shaft) -> u32 {
    if entry == OCCLUDER_ANYTHING { return MAY_HIDE; }
    let triangle = entry & OCCLUDER_TRIANGLE_MASK;
    let plane = load_plane(triangle);
    let height = dot(plane.xyz, shaft.origin) - plane.w;
    let in_front = height > CERTAIN_HEIGHT;
    let behind = height < -CERTAIN_HEIGHT;
    let light_in_front = (entry & OCCLUDER_LIGHT_IN_FRONT) != 0u;
    let light_behind = (entry & OCCLUDER_LIGHT_BEHIND) != 0u;
    if (in_front && light_in_front) || (behind && light_behind) { return HIDES_NOTHING; }
    let corners = triangle_corners(triangle);
    let heights = vec3f(
        dot(corners[0] - shaft.position, shaft.normal),
        dot(corners[1] - shaft.position, shaft.normal),
        dot(corners[2] - shaft.position, shaft.normal),
    );
    if max(heights.x, max(heights.y, heights.z)) <= CERTAIN_HORIZON { return HIDES_NOTHING; }

    // The planes through the origin and each edge: all rays pass outside of one, or all inside of all three.
    let a = corners[0] - shaft.origin;
    let b = corners[1] - shaft.origin;
    let c = corners[2] - shaft.origin;
    let ab = cross(a, b);
    let bc = cross(b, c);
    let ca = cross(c, a);
    let inwards = select(-1.0, 1.0, dot(ab, c) >= 0.0);
    let inside = inwards * vec3f(dot(ab, shaft.to_light), dot(bc, shaft.to_light), dot(ca, shaft.to_light));
    let lengths = vec3f(length(a), length(b), length(c));
    let error = TRIPLE_ERROR * length(shaft.to_light) * lengths * lengths.yzx;
    let limit = shaft.radius * vec3f(length(ab), length(bc), length(ca)) + error;
    if any(inside < -limit) { return HIDES_NOTHING; }
    let separates = (in_front && light_behind) || (behind && light_in_front);
    let in_plane = light_in_front && light_behind;
    let hides = separates && !in_plane && all(inside > limit) && (entry & OCCLUDER_POROUS) == 0u;
    return select(MAY_HIDE, HIDES_ALL, hides);
}

fn class_by_buffer(light_index: u32, position: vec3f, normal: vec3f) -> u32 {
    let light = buffered_lights[light_index];
    if light.side == 0u { return CLASS_UNKNOWN; }
    let origin = offset_origin(position, normal);
    var to_light = light.centre - origin;
    if light.cell > 0.0 { to_light = BEYOND_SCENE * light.centre; }
    let shaft = Shaft(position, normal, origin, to_light, light.radius);
    let at = cell_and_depth(light, origin);
    let word = buffer_cells[at.cell];
    let first = word >> OCCLUDER_COUNT_BITS;
    let entries = 2u * (word & ((1u << OCCLUDER_COUNT_BITS) - 1u));
    var class_ = CLASS_LIT;
    for (var i = 0u; i < entries; i++) {
        let texel = load_list(first + (i >> 1u));
        let entry = select(texel.xy, texel.zw, (i & 1u) != 0u);
        if bitcast<f32>(entry.y) > at.depth { break; }
        let effect = effect_of(entry.x, shaft);
        if effect == HIDES_ALL { return CLASS_SHADOWED; }
        if effect == MAY_HIDE { class_ = select(CLASS_BOUNDARY, CLASS_UNKNOWN, entry.x == OCCLUDER_ANYTHING); }
    }
    return class_;
}

// The class word of each candidate.
@compute @workgroup_size(64)
fn classify_by_buffer(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let candidate = group_index(group, groups) * 64u + lane;
    if candidate < light_buffer_pass.candidate_count { classes[candidate] = word_of_candidate(candidate); }
}

fn word_of_candidate(candidate: u32) -> u32 {
    let local_light = candidate / light_buffer_pass.tile.point_count;
    let point = load_point(candidate - local_light * light_buffer_pass.tile.point_count);
    let light = light_buffer_pass.first_light + local_light;
    if is_dark(light, point) { return class_word(CLASS_DARK, 0u, 0u, 0.0); }
    let class_ = class_by_buffer(light, point.position, oct_decode16(point.normal));
    return class_word(class_, 0u, 0u, select(0.0, 1.0, class_ == CLASS_LIT));
}
