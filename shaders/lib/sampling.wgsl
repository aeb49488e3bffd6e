// Low-discrepancy points, and maps from the unit square that keep them stratified.

import package::lib::math::{PI, safe_sqrt};
import package::lib::rng::{hash1, hash2, uniform_from_bits};

// By bit of the index, the direction numbers of the first four dimensions.
@group(1) @binding(12) var<uniform> sobol_directions: array<vec4u, 32>;

// Permutes so that each bit depends on the lower ones only: an Owen scramble of the reversed bits (Laine and
// Karras 2011; the constants are Vegdahl's, of less bias).
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

// Point `index` of the Owen-scrambled Sobol sequence's first two dimensions. The order is shuffled by the seed
// too, so that points of different seeds can be paired (Burley 2020).
fn sobol2(index: u32, seed: u32) -> vec2f {
    let i = owen_scramble(index, hash1(seed));
    // The second dimension multiplies the index by Pascal's triangle modulo 2, which is its own square of squares.
    var y = i ^ (i >> 16u);
    y ^= (y & 0xff00ff00u) >> 8u;
    y ^= (y & 0xf0f0f0f0u) >> 4u;
    y ^= (y & 0xccccccccu) >> 2u;
    y ^= (y & 0xaaaaaaaau) >> 1u;
    let a = reverseBits(scramble_reversed(i, hash2(seed, 1u)));
    let b = reverseBits(scramble_reversed(y, hash2(seed, 2u)));
    return vec2f(uniform_from_bits(a), uniform_from_bits(b));
}

// As `sobol2`, of four dimensions.
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
    if abs(p.x) > abs(p.y) {
        let phi = (PI / 4.0) * (p.y / p.x);
        return p.x * vec2f(cos(phi), sin(phi));
    }
    let phi = PI / 2.0 - (PI / 4.0) * (p.x / p.y);
    return p.y * vec2f(cos(phi), sin(phi));
}

// About +z, of density z / pi.
fn sample_cosine(u: vec2f) -> vec3f {
    let p = sample_disc(u);
    return vec3f(p, safe_sqrt(1.0 - dot(p, p)));
}

// Uniform on the unit sphere.
fn sample_sphere(u: vec2f) -> vec3f {
    return sample_cone(u, -1.0);
}

// Uniform over the directions within the angle of cosine `cos_max` of +z.
fn sample_cone(u: vec2f, cos_max: f32) -> vec3f {
    let below = u.x * (1.0 - cos_max);
    let radius = safe_sqrt(below * (2.0 - below));
    let phi = 2.0 * PI * u.y;
    return vec3f(radius * cos(phi), radius * sin(phi), 1.0 - below);
}

// Barycentric coordinates of the second and third corner, uniform by area (Heitz 2019).
fn sample_triangle(u: vec2f) -> vec2f {
    if u.y > u.x { return vec2f(0.5 * u.x, u.y - 0.5 * u.x); }
    return vec2f(u.x - 0.5 * u.y, 0.5 * u.y);
}

// The weight of a way of sampling of density p against another of density q (Veach's power heuristic).
fn mis_weight(p: f32, q: f32) -> f32 {
    let r = q / p;
    return 1.0 / (1.0 + r * r);
}
