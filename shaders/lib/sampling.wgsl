// Low-discrepancy points, and maps from the unit square that keep them stratified.

import package::lib::math::{PI, angle_of, circle_point, safe_sqrt};
import package::lib::rng::{hash1, hash2, uniform_from_bits};

// For each bit of the index, the direction numbers of the first four dimensions.
@group(1) @binding(12) var<uniform> sobol_directions: array<vec4u, 32>;

// An Owen scramble of the reversed bits: a permutation in which each bit depends only on lower bits (Laine and
// Karras 2011, with Vegdahl's constants, which have less bias).
fn scramble_reversed(bits: u32, seed: u32) -> u32 {
    var x = bits;
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return x;
}

fn owen_scramble(bits: u32, seed: u32) -> u32 {
    return reverseBits(scramble_reversed(reverseBits(bits), seed));
}

// Point `index` of the Owen-scrambled Sobol sequence's first two dimensions. The seed also shuffles the order,
// so that points of different seeds can be paired (Burley 2020).
fn sobol2(index: u32, seed: u32) -> vec2f {
    let i = owen_scramble(index, hash1(seed));
    // The generator matrix of the second dimension is Pascal's triangle modulo 2, applied in steps of powers of two.
    var y = i ^ (i >> 16u);
    y ^= (y & 0xff00ff00u) >> 8u;
    y ^= (y & 0xf0f0f0f0u) >> 4u;
    y ^= (y & 0xccccccccu) >> 2u;
    y ^= (y & 0xaaaaaaaau) >> 1u;
    let a = reverseBits(scramble_reversed(i, hash2(seed, 1u)));
    let b = reverseBits(scramble_reversed(y, hash2(seed, 2u)));
    return vec2f(uniform_from_bits(a), uniform_from_bits(b));
}

// The first dimension of `sobol2`.
fn sobol1(index: u32, seed: u32) -> f32 {
    let i = owen_scramble(index, hash1(seed));
    return uniform_from_bits(reverseBits(scramble_reversed(i, hash2(seed, 1u))));
}

// Like `sobol2`, in four dimensions.
fn sobol4(index: u32, seed: u32) -> vec4f {
    var left = owen_scramble(index, hash1(seed));
    var x = vec4u(0u);
    while left != 0u {
        x ^= sobol_directions[firstTrailingBit(left)];
        left &= left - 1u;
    }
    return vec4f(
        uniform_from_bits(owen_scramble(x.x, hash2(seed, 1u))),
        uniform_from_bits(owen_scramble(x.y, hash2(seed, 2u))),
        uniform_from_bits(owen_scramble(x.z, hash2(seed, 3u))),
        uniform_from_bits(owen_scramble(x.w, hash2(seed, 4u))),
    );
}

// Uniform in the unit disc, by concentric squares (Shirley and Chiu 1997).
fn sample_disc(u: vec2f) -> vec2f {
    let p = 2.0 * u - 1.0;
    if p.x == 0.0 && p.y == 0.0 { return vec2f(0.0); }
    // An angle of half a quadrant at most.
    if abs(p.x) > abs(p.y) { return p.x * circle_point(0.125 * (p.y / p.x)); }
    return p.y * circle_point(0.125 * (p.x / p.y)).yx;
}

// A direction about +z with density z / pi.
fn sample_cosine(u: vec2f) -> vec3f {
    let p = sample_disc(u);
    return vec3f(p, safe_sqrt(1.0 - dot(p, p)));
}

// Uniform over the spherical cap about +z of the given height, however small. Height 2 is the whole sphere.
fn sample_cap(u: vec2f, height: f32) -> vec3f {
    let below = u.x * height;
    let radius = safe_sqrt(below * (2.0 - below));
    return vec3f(radius * circle_point(u.y), 1.0 - below);
}

// Barycentric coordinates of the second and third corner, uniform by area (Heitz 2019).
fn sample_triangle(u: vec2f) -> vec2f {
    if u.y > u.x { return vec2f(0.5 * u.x, u.y - 0.5 * u.x); }
    return vec2f(u.x - 0.5 * u.y, 0.5 * u.y);
}

// A triangle projected to the unit sphere about the origin.
struct SphericalTriangle {
    // Unit vectors to the corners, and one over their distances.
    a: vec3f,
    b: vec3f,
    c: vec3f,
    nearness: vec3f,
    // Half the solid angle that the triangle spans, and the length of the vector whose angle it is.
    half_angle: f32,
    radius: f32,
}

// Minimum distance of a corner, in a scene of unit size. Nearer corners count as at this distance, so that its cube and
// the inverse of that are finite and above 0.
const NEAREST_CORNER = 1e-12;

// The spherical triangle of corner `a`, edges `e1` and `e2` from `a`, and `across`, which is e1 x e2 (Van Oosterom and
// Strackee 1983). It computes the volume from the edges, not from the corners' positions, so that small triangles lose
// no precision.
fn spherical_triangle(a: vec3f, e1: vec3f, e2: vec3f, across: vec3f) -> SphericalTriangle {
    let b = a + e1;
    let c = a + e2;
    let squares = vec3f(dot(a, a), dot(b, b), dot(c, c));
    let nearness = inverseSqrt(max(squares, vec3f(NEAREST_CORNER * NEAREST_CORNER)));
    let to_a = a * nearness.x;
    let to_b = b * nearness.y;
    let to_c = c * nearness.z;
    // With the origin on an edge, `volume` and `rest` would both be 0, and the angle undefined.
    let volume = max(abs(dot(to_a, across)) * nearness.y * nearness.z, 1e-37);
    let rest = 1.0 + dot(to_a, to_b) + dot(to_a, to_c) + dot(to_b, to_c);
    return SphericalTriangle(to_a, to_b, to_c, nearness, angle_of(volume, rest), length(vec2f(volume, rest)));
}

// One plus the cosine between unit vectors, precise even for nearly opposite ones.
fn opening(a: vec3f, b: vec3f) -> f32 {
    let sum = a + b;
    return 0.5 * dot(sum, sum);
}

// Barycentric coordinates, of corners b and c, of a point sampled uniformly over the solid angle of the triangle.
//
// After Arvo (1995): u.x cuts off a sub-triangle of that share of the solid angle, by an arc from b to a point of the
// opposite edge; u.y samples a point of the arc. The end of the arc follows Peters (2021, section 4), who uses half
// vectors and needs no inverse cosine: it is the mirror image of a in the half vector p a + q c, where tan(half the
// angle) = q volume / (p (1 + ab) + q (ac + bc)). With p - q = radius sin((1 - u.x) half_angle) nothing cancels. So the
// sampling covers triangles of any size and shape; the only errors are roundings of the barycentric coordinates.
fn sample_spherical_triangle(triangle: SphericalTriangle, u: vec2f) -> vec2f {
    let turns = triangle.half_angle * (0.5 / PI);
    let ahead = triangle.radius * circle_point((1.0 - u.x) * turns).y;
    let behind = opening(triangle.a, triangle.b) * circle_point(u.x * turns).y;
    // q and p - q of that formula, both over p.
    let q = behind / (ahead + behind);
    let m = ahead / (ahead + behind);
    let wide = opening(triangle.a, triangle.c);
    // The end of the arc as weights of the unit vectors to a and c.
    let end = vec2f(m * (1.0 + q), 2.0 * q * (m + q * wide)) / max(m * m + 2.0 * q * wide, 1e-20);
    // One plus and one minus the cosine of the arc. From a position near the triangle's plane, arcs are almost half
    // circles.
    let back = max(opening(triangle.b, end.x * triangle.a + end.y * triangle.c), 1e-12);
    let arc = max(2.0 - back, 0.0);
    let along = sqrt(u.y * (2.0 - u.y * arc) / back);
    let uneven = vec3f(along * end.x, (1.0 - along) + arc * (along - u.y), along * end.y);
    let weights = max(uneven, vec3f(0.0)) * triangle.nearness;
    return weights.yz / (weights.x + weights.y + weights.z);
}

// The weight of a sampling strategy of density p against another of density q (Veach's power heuristic).
fn mis_weight(p: f32, q: f32) -> f32 {
    let r = q / p;
    return 1.0 / (1.0 + r * r);
}
