// Rays, hits, and the watertight test of a ray against one triangle (Woop, Benthin and Wald 2013).
// In and out: positions and lengths in scene units after normalisation. Nothing is bound here.

// The points origin + t direction with t_min < t <= t_max. The direction need not have unit length: that of a shadow
// ray reaches to its light, where t is 1. Lengths from 2^-20 to 2^20 keep the tests watertight.
struct Ray {
    origin: vec3f,
    t_min: f32,
    direction: vec3f,
    t_max: f32,
}

// `t_max` of rays from lights: directional lights emit from outside the scene.
const UNBOUNDED = 1e30;

// Which sample a ray is, for the random numbers by which it passes partly transparent surfaces. Samples that share a
// sequence are stratified: of n rays, n times the transmittance pass, give or take one.
struct RaySample {
    sequence: u32,
    index: u32,
}

struct Hit {
    t: f32,
    // Barycentric coordinates of the triangle's corners 1 and 2.
    u: f32,
    v: f32,
    // Primitive index in the BVH, or NO_HIT. For hits of procedural objects see lib/procedural.
    triangle: u32,
}

const NO_HIT: u32 = 0xffffffffu;

// The direction with each component of 0 replaced by 2^-80 of the same sign, so that no quotient is infinite or NaN.
// No box of the BVH is missed because of that: see MIN_EXPONENT in src/bvh/node.rs.
fn nonzero_direction(d: vec3f) -> vec3f {
    let smallest = 8.2718061e-25;
    return select(d, select(vec3f(smallest), vec3f(-smallest), d < vec3f(0.0)), abs(d) < vec3f(smallest));
}

// The origin of rays that leave a surface at p on the side of the normal n, offset so that they do not hit the surface
// itself (after Waechter and Binder 2019). Each coordinate moves by a number of ULPs, which is farther where floats are
// coarser. Near 0, where ULPs are smaller than the error of the point, it moves by a fixed distance. Positions are of
// unit size.
fn offset_origin(p: vec3f, n: vec3f) -> vec3f {
    let near_zero = 1.0 / 32.0;
    let steps = vec3i(256.0 * n);
    let towards_n = select(steps, -steps, p < vec3f(0.0));
    let by_steps = bitcast<vec3f>(bitcast<vec3i>(p) + towards_n);
    return select(by_steps, p + n * (1.0 / 65536.0), abs(p) < vec3f(near_zero));
}

// A ray with its shear to the frame in which it is the z axis (Woop, Benthin and Wald 2013).
struct ShearedRay {
    origin: vec3f,
    // The direction's largest component, which becomes z: x or y, else z.
    along_x: bool,
    along_y: bool,
    shear: vec3f,
}

fn shear_ray(ray: Ray) -> ShearedRay {
    let size = abs(ray.direction);
    let along_x = size.x >= max(size.y, size.z);
    let along_y = !along_x && size.y >= size.z;
    let d = permuted(ray.direction, along_x, along_y);
    return ShearedRay(ray.origin, along_x, along_y, vec3f(d.xy, 1.0) / d.z);
}

// The coordinates, rotated cyclically until the one named is the last.
fn permuted(p: vec3f, along_x: bool, along_y: bool) -> vec3f {
    return select(select(p, p.zxy, along_y), p.yzx, along_x);
}

fn to_ray_frame(ray: ShearedRay, p: vec3f) -> vec3f {
    let q = permuted(p - ray.origin, ray.along_x, ray.along_y);
    return vec3f(q.xy - ray.shear.xy * q.z, ray.shear.z * q.z);
}

// a * b - c * d with the right sign, or 0, whether or not the device fuses products and sums. Unfused, rounding is
// monotonic, so the difference of the rounded products has the sign of the exact difference or is 0. Fused, this is
// Kahan's algorithm, exact to 2 ULP. So two triangles agree on which side of their common edge a ray passes, and no ray
// slips between them.
fn difference_of_products(a: f32, b: f32, c: f32, d: f32) -> f32 {
    let product = c * d;
    return fma(a, b, -product) + fma(-c, d, product);
}

// Intersects the ray's line with both sides of a triangle: t, and the barycentric coordinates of corners 1 and 2. t is
// MISSED if there is no intersection, and never NaN.
fn intersect_triangle(ray: ShearedRay, corner_0: vec3f, corner_1: vec3f, corner_2: vec3f) -> vec3f {
    let a = to_ray_frame(ray, corner_0);
    let b = to_ray_frame(ray, corner_1);
    let c = to_ray_frame(ray, corner_2);
    let u = difference_of_products(c.x, b.y, c.y, b.x);
    let v = difference_of_products(a.x, c.y, a.y, c.x);
    let w = difference_of_products(b.x, a.y, b.y, a.x);
    let outside = min(u, min(v, w)) < 0.0 && max(u, max(v, w)) > 0.0;
    let determinant = u + v + w;
    let inverse = 1.0 / determinant;
    var t = (u * a.z + v * b.z + w * c.z) * inverse;
    @if(needles) { t = on_plane(a, b, c, vec3f(u, v, w) * inverse, t); }
    return select(vec3f(t, v * inverse, w * inverse), vec3f(MISSED, 0.0, 0.0), outside || determinant == 0.0);
}

// Corrects the distance t of a hit of a needle (a triangle far longer than wide); corners are in the ray's frame. Where
// products are not fused, the error of a needle's barycentric weights is proportional to its length over its width. The
// point of these weights then lies beside the ray, displaced along the needle; if the needle is inclined to the ray,
// its distance is wrong too. This moves the point within the needle's plane back to the ray. The plane's inclination
// has the same relative error, so the error that remains is of second order.
@if(needles)
fn on_plane(a: vec3f, b: vec3f, c: vec3f, weights: vec3f, t: f32) -> f32 {
    let offset = weights.x * a.xy + weights.y * b.xy + weights.z * c.xy;
    let normal = cross(b - a, c - a);
    let moved = t + dot(normal.xy, offset) / normal.z;
    // The inclination of a needle parallel to the ray is uncertain, but its points lie between its corners. (`moved` is
    // NaN if the ray lies in the plane, and comparisons with NaN are false.)
    let nearest_corner = min(a.z, min(b.z, c.z));
    let farthest_corner = max(a.z, max(b.z, c.z));
    return select(t, clamp(moved, nearest_corner, farthest_corner), abs(moved) < MISSED);
}

// Farther than any hit. WGSL has no infinite constant.
const MISSED: f32 = 3.4028234e38;
