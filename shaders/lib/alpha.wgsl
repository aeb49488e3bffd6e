// Alpha masks and blending, for rays, photons and light points alike (glTF 3.9.4): a masked texel is a hole, and a
// blended surface stops a ray with the probability alpha.

import package::lib::material::alpha_at;
import package::lib::ray::{Hit, NO_HIT, RaySample};
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

// Random decisions for the rays of an invocation so far: the distance of the nearest blended surface that let a ray
// pass, and the last surface that stopped one.
@if(guides) var<private> nearest_passed: f32 = 3.4e38;
@if(guides) var<private> last_stopping: u32 = NO_HIT;

// Whether the surface that a ray met stops it.
fn alpha_blocks(hit: Hit, sample: RaySample) -> bool {
    // Each triangle has its own random number, so that two layers stop a ray independently.
    let random = sobol1(sample.index, hash3(sample.sequence, hit.triangle, 0x616c7068u));
    let coverage = alpha_coverage(hit.triangle, hit.u, hit.v);
    let stopped = random < coverage;
    @if(guides) {
        if stopped && coverage < 1.0 { last_stopping = hit.triangle; }
        if !stopped && coverage > 0.0 { nearest_passed = min(nearest_passed, hit.t); }
    }
    return stopped;
}
