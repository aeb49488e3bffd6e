// Photons: a position in normalised space and a word with normal, light or flux, and kind. The visibility map holds
// illumination and shadow photons of each light; the global and the caustic map hold photons that carry flux (paper,
// "Extending the photon map").

import package::lib::math::oct_decode7;
@if(caustic_irradiance) import package::lib::constants::PHOTON_CAUSTIC;
import package::lib::constants::{
    FLUX_STEPS, MAX_LIGHTS, PHOTON_LIGHT_SHIFT, PHOTON_MAX_WEIGHT_EXPONENT, PHOTON_NORMAL_MASK, PHOTON_SHADOW,
    PHOTON_WEIGHT_SHIFT
};

struct Photon {
    position: vec3f,
    // Bits 0-13: normal on the side that the photon hit; bit 31: shadow photon. In the visibility map, bits 14-24:
    // light, 25-30: weight exponent. In the global map, bits 14-28: flux in red, green and blue, 29-30: exponent of the
    // flux; with `caustic_irradiance`, bit 31: caustic photon.
    word: u32,
}

const PHOTON_WEIGHT_MASK = PHOTON_MAX_WEIGHT_EXPONENT << PHOTON_WEIGHT_SHIFT;

fn photon_normal(word: u32) -> vec3f {
    return oct_decode7(word & PHOTON_NORMAL_MASK);
}

fn photon_light(word: u32) -> u32 {
    @if(light_tags) { return (word >> PHOTON_LIGHT_SHIFT) & (MAX_LIGHTS - 1u); }
    @else { return 0u; }
}

fn photon_is_shadow(word: u32) -> bool {
    return (word & PHOTON_SHADOW) != 0u;
}

// Whether only focusing surfaces have scattered the photon since it left the light.
@if(caustic_irradiance)
fn photon_is_caustic(word: u32) -> bool {
    return (word & PHOTON_CAUSTIC) != 0u;
}

// Whether the photon represents more than one hit.
fn photon_has_weight(word: u32) -> bool {
    return (word & PHOTON_WEIGHT_MASK) != 0u;
}

// Number of hits that the photon represents, 2^(w/4), in sixteenths. Sums of integers do not depend on order.
fn photon_weight_sixteenths(word: u32) -> u32 {
    let w = word >> PHOTON_WEIGHT_SHIFT;
    // 2^16 times 1, 2^(1/4), 2^(1/2), 2^(3/4). Shifted by 15 at most, they fit in 32 bits.
    let odd = (w & 1u) != 0u;
    let whole = select(select(65536u, 77936u, odd), select(92682u, 110218u, odd), (w & 2u) != 0u);
    return ((whole << ((w >> 2u) & 15u)) + 2048u) >> 12u;
}

// The word of a photon that represents `weight` hits, rounded to the nearest power of 2^(1/4).
fn photon_word(normal: u32, light: u32, weight: f32, shadow: bool) -> u32 {
    let exponent = u32(clamp(round(4.0 * log2(weight)), 0.0, f32(PHOTON_MAX_WEIGHT_EXPONENT)));
    let word = normal | (exponent << PHOTON_WEIGHT_SHIFT) | select(0u, PHOTON_SHADOW, shadow);
    @if(light_tags) { return word | (light << PHOTON_LIGHT_SHIFT); }
    @else { return word; }
}

// The word of a photon that carries `flux` units, no channel above MAX_FLUX. `kind` is 0, PHOTON_SHADOW or
// PHOTON_CAUSTIC. Channels are stored in steps of 1/31 units times 8 to the exponent. The uniform `xi` rounds them at
// random, which keeps the mean; a step is small against the noise of the few dozen photons that an estimate sums.
fn flux_word(normal: u32, flux: vec3f, xi: f32, kind: u32) -> u32 {
    let largest = max(flux.x, max(flux.y, flux.z));
    let exponent = select(select(select(3u, 2u, largest <= 64.0), 1u, largest <= 8.0), 0u, largest <= 1.0);
    let steps = flux * (f32(FLUX_STEPS) / f32(1u << (3u * exponent)));
    // One random number for all channels keeps white white.
    let q = vec3u(min(steps + xi, vec3f(f32(FLUX_STEPS))));
    let rgb = (q.x << 14u) | (q.y << 19u) | (q.z << 24u);
    return normal | rgb | (exponent << 29u) | kind;
}

// Flux in 31sts of the unit: integers, so that sums do not depend on order. Shadow photons subtract theirs.
fn flux_of(word: u32) -> vec3i {
    let channels = vec3i(i32(word >> 14u), i32(word >> 19u), i32(word >> 24u)) & vec3i(31);
    let q = channels << vec3u(3u * ((word >> 29u) & 3u));
    @if(caustic_irradiance) { return q; }
    @else { return select(q, -q, photon_is_shadow(word)); }
}
