// Alpha masks and blending, for rays and photons alike (glTF 3.9.4): a masked texel is a hole, and a blended
// surface stops a ray with the probability alpha.

import package::lib::surface::alpha_at;
import package::lib::rng::{hash3, uniform_from_bits};
import package::lib::constants::{MATERIAL_MASK, MATERIAL_BLEND};

// Whether the triangle stops the ray whose random number is `seed`.
fn alpha_blocks(triangle: u32, u: f32, v: f32, seed: u32) -> bool {
    let alpha = alpha_at(triangle, u, v);
    if (alpha.flags & MATERIAL_MASK) != 0u { return alpha.value >= alpha.cutoff; }
    if (alpha.flags & MATERIAL_BLEND) != 0u {
        // Each triangle decides for itself, so that two layers stop a ray independently.
        return uniform_from_bits(hash3(seed, triangle, 0x616c7068u)) < alpha.value;
    }
    return true;
}
