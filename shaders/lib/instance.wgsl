// Instances: copies of meshes that are stored once (src/bvh/instanced.rs). Rays are moved to the mesh's space, and what
// they hit is moved back.
// In: primitive indices; each triangle of each instance has its own (`InstanceTable` in src/bvh/instance_table.rs).
// Triangles below `unshared_count` belong to no shared mesh, and are stored as they are.

import package::lib::bvh_triangles::triangle_texel;
import package::lib::constants::{BVH_TRIANGLE_TEXELS, INSTANCE_TEXELS};
import package::lib::ray::Ray;

@if(instances) override instance_base: u32;
@if(instances) override unshared_count: u32;
@if(instances) override instance_shift: u32;

// The first texel of the instance of a triangle.
@if(instances)
fn instance_texel_of(primitive: u32) -> u32 {
    let number = select(0u, (primitive - unshared_count) >> instance_shift, primitive >= unshared_count);
    return instance_base + INSTANCE_TEXELS * number;
}

// Where a triangle is stored.
@if(instances)
fn stored_triangle(primitive: u32) -> u32 {
    let offset = bitcast<u32>(triangle_texel(instance_texel_of(primitive) + 3u).y);
    return select(primitive, primitive - offset, primitive >= unshared_count);
}

// An instance that a ray enters.
@if(instances)
struct Entered {
    // The ray in the mesh's space, with the same distances.
    ray: Ray,
    // Index of the root of the mesh's nodes.
    root: u32,
    // Number to add to the index of a stored triangle to get a primitive index.
    offset: u32,
}

// A ray in the space of instance `number`.
//
// Rounding moves a point of this ray, as seen in the scene's space, by at most 141 * 2^-24 of the largest coordinate of
// its offset from the ray's origin. A term of the origin is rounded 5 times (difference, matrix, product, two sums), a
// term of the direction 4 times (no difference): 9 in all. The norms of the matrix and of its inverse scale these
// errors by at most 3 MAX_STRETCH = 9 (src/scene/instance.rs), and an offset is at most sqrt(3) times as long as its
// largest coordinate: 9 * 9 * sqrt(3) < 141.
// For the triangles of no shared mesh the matrix is the identity, and the ray keeps its bits.
@if(instances)
fn ray_in_mesh(ray: Ray, number: u32) -> Entered {
    let at = instance_base + INSTANCE_TEXELS * number;
    let rows = array(triangle_texel(at), triangle_texel(at + 1u), triangle_texel(at + 2u));
    let tree = triangle_texel(at + 3u);
    let relative = ray.origin - vec3f(rows[0].w, rows[1].w, rows[2].w);
    let origin = vec3f(dot(rows[0].xyz, relative), dot(rows[1].xyz, relative), dot(rows[2].xyz, relative));
    let d = ray.direction;
    let direction = vec3f(dot(rows[0].xyz, d), dot(rows[1].xyz, d), dot(rows[2].xyz, d));
    return Entered(Ray(origin, ray.t_min, direction, ray.t_max), bitcast<u32>(tree.x), bitcast<u32>(tree.y));
}

// The corners of a stored triangle in its mesh's space.
@if(instances)
fn stored_corners(stored: u32) -> array<vec3f, 3> {
    let first = BVH_TRIANGLE_TEXELS * stored;
    return array(triangle_texel(first).xyz, triangle_texel(first + 1u).xyz, triangle_texel(first + 2u).xyz);
}

// The corners of a triangle in the scene.
@if(instances)
fn placed_corners(primitive: u32) -> array<vec3f, 3> {
    var corners = stored_corners(stored_triangle(primitive));
    if primitive >= unshared_count {
        let at = instance_texel_of(primitive) + 4u;
        let rows = array(triangle_texel(at), triangle_texel(at + 1u), triangle_texel(at + 2u));
        for (var i = 0u; i < 3u; i++) {
            let p = corners[i];
            corners[i] = vec3f(dot(rows[0].xyz, p), dot(rows[1].xyz, p), dot(rows[2].xyz, p))
                + vec3f(rows[0].w, rows[1].w, rows[2].w);
        }
    }
    return corners;
}

// The unit normal in the scene of a normal of the triangle's mesh.
@if(instances)
fn placed_normal(primitive: u32, normal: vec3f) -> vec3f {
    let at = instance_texel_of(primitive);
    // The transpose of the inverse.
    let across = normal.x * triangle_texel(at).xyz + normal.y * triangle_texel(at + 1u).xyz
        + normal.z * triangle_texel(at + 2u).xyz;
    return select(normal, normalize(across), primitive >= unshared_count);
}

// The unit tangent in the scene of a tangent of the triangle's mesh.
@if(instances)
fn placed_tangent(primitive: u32, tangent: vec3f) -> vec3f {
    let at = instance_texel_of(primitive) + 4u;
    let rows = array(triangle_texel(at).xyz, triangle_texel(at + 1u).xyz, triangle_texel(at + 2u).xyz);
    let along = vec3f(dot(rows[0], tangent), dot(rows[1], tangent), dot(rows[2], tangent));
    return select(tangent, normalize(along), primitive >= unshared_count);
}
