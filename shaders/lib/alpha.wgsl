// Alpha masks and blending, for rays, photons and light points alike (glTF 3.9.4): a masked texel is a hole, and a
// blended surface stops a ray with the probability alpha.

import package::lib::material::alpha_at;
import package::lib::ray::RaySample;
import package::lib::rng::hash3;
import package::lib::sampling::sobol1;
import package::lib::constants::{MATERIAL_MASK, MATERIAL_BLEND};

// Alpha at a point of a triangle: the share of rays that the surface stops there.
fn alpha_coverage(triangle: u32, u: f32, v: f32) -> f32 {
    let alpha = alpha_at(triangle, u, v);
    if (alpha.flags & MATERIAL_MASK) != 0u { return select(0.0, 1.0, alpha.value >= alpha.cutoff); }
    if (alpha.flags & MATERIAL_BLEND) != 0u { return clamp(alpha.value, 0.0, 1.0); }
    return 1.0;
}

// Whether the triangle stops the ray.
fn alpha_blocks(triangle: u32, u: f32, v: f32, sample: RaySample) -> bool {
    // Each triangle has its own random number, so that two layers stop a ray independently.
    return sobol1(sample.index, hash3(sample.sequence, triangle, 0x616c7068u)) < alpha_coverage(triangle, u, v);
}
