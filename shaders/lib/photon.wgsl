// Photons of the visibility map, and the class words that come of them.

import package::lib::math::oct_decode7;
import package::lib::rng::{hash3, uniform_from_bits};
import package::lib::constants::{DIMENSION_AUDIT, FLUX_STEPS};

struct Photon {
    position: vec3f,
    // Bits 0-13 normal on the side that the photon came to, 31 shadow photon. In the visibility map 14-24 light, 25-30
    // weight exponent; in the global map 14-28 flux in red, green and blue, 29-30 its exponent.
    word: u32,
}

const PHOTON_SHADOW = 0x80000000u;
const PHOTON_WEIGHT = 0x7e000000u;

const CLASS_DARK = 0u;
const CLASS_LIT = 1u;
const CLASS_SHADOWED = 2u;
const CLASS_BOUNDARY = 3u;
const CLASS_UNKNOWN = 4u;

fn photon_normal(word: u32) -> vec3f {
    return oct_decode7(word & 0x3fffu);
}

fn photon_light(word: u32) -> u32 {
    @if(light_tags) { return (word >> 14u) & 0x7ffu; }
    @else { return 0u; }
}

fn photon_is_shadow(word: u32) -> bool {
    return (word & PHOTON_SHADOW) != 0u;
}

// How many hits the photon stands for, in sixteenths, rounded: 2^(w/4). Integers, so that sums do not depend on order.
fn photon_weight_sixteenths(word: u32) -> u32 {
    let w = word >> 25u;
    // 2^16 times 1, 2^(1/4), 2^(1/2), 2^(3/4): shifted by 15 at most, they fill 32 bits.
    let whole = select(select(65536u, 77936u, (w & 1u) != 0u), select(92682u, 110218u, (w & 1u) != 0u), (w & 2u) != 0u);
    return ((whole << ((w >> 2u) & 15u)) + 2048u) >> 12u;
}

// The word of a photon that stands for `weight` hits, to the nearest fourth root of two.
fn photon_word(normal: u32, light: u32, weight: f32, shadow: bool) -> u32 {
    let exponent = u32(clamp(round(4.0 * log2(weight)), 0.0, 63.0));
    let word = normal | (exponent << 25u) | select(0u, PHOTON_SHADOW, shadow);
    @if(light_tags) { return word | (light << 14u); }
    @else { return word; }
}

// Flux of the global map's photons, in 31sts of a unit that all photons share times 8 to the exponent. Rounded up by
// chance, so the mean is kept; a 31st is nothing against the noise of the few dozen photons that an estimate sums.
// The word of a photon that carries `flux` units, no channel above MAX_FLUX; `lot` is uniform.
fn flux_word(normal: u32, flux: vec3f, lot: f32, shadow: bool) -> u32 {
    let largest = max(flux.x, max(flux.y, flux.z));
    let exponent = select(select(select(3u, 2u, largest <= 64.0), 1u, largest <= 8.0), 0u, largest <= 1.0);
    let steps = flux * (f32(FLUX_STEPS) / f32(1u << (3u * exponent)));
    // One lot for all channels: white stays white.
    let q = vec3u(min(steps + lot, vec3f(f32(FLUX_STEPS))));
    return normal | (q.x << 14u) | (q.y << 19u) | (q.z << 24u) | (exponent << 29u) | select(0u, PHOTON_SHADOW, shadow);
}

// Flux in 31sts of the unit: integers, so that sums do not depend on order. Shadow photons take it away.
fn flux_of(word: u32) -> vec3i {
    let q = (vec3i(i32(word >> 14u), i32(word >> 19u), i32(word >> 24u)) & vec3i(31)) << vec3u(3u * ((word >> 29u) & 3u));
    return select(q, -q, photon_is_shadow(word));
}

// Bits 0-2 class, 3-11 illumination photons, 12-20 shadow photons, 21-31 visibility.
fn class_word(class_: u32, illumination: u32, shadow: u32, visibility: f32) -> u32 {
    return class_ | (illumination << 3u) | (shadow << 12u) | (u32(round(visibility * 2047.0)) << 21u);
}

fn class_of(word: u32) -> u32 {
    return word & 7u;
}

fn class_illumination(word: u32) -> u32 {
    return (word >> 3u) & 511u;
}

fn class_shadow(word: u32) -> u32 {
    return (word >> 12u) & 511u;
}

// n_i / (n_s + n_i), equation 1 of the paper, the shadow photons weighted.
fn class_visibility(word: u32) -> f32 {
    return f32(word >> 21u) / 2047.0;
}

// Whether shadow rays tell what the light point sees: where the photons do not decide or, where their own visibility is
// shown, where there are none.
fn asks_shadow_rays(word: u32) -> bool {
    @if(visibility_estimate) { return class_of(word) == CLASS_UNKNOWN && class_illumination(word) + class_shadow(word) == 0u; }
    @else { return class_of(word) == CLASS_BOUNDARY || class_of(word) == CLASS_UNKNOWN; }
}

// The word of a decided point in a cell that has photons of both kinds in reach. The visibility of a decided point says
// nothing that its class does not: one step off it marks these.
fn near_word(word: u32) -> u32 {
    let class_ = class_of(word);
    if class_ == CLASS_LIT { return word - (1u << 21u); }
    if class_ == CLASS_SHADOWED { return word + (1u << 21u); }
    return word;
}

fn is_near(word: u32) -> bool {
    let visibility = word >> 21u;
    return visibility != 0u && visibility != 2047u;
}

// Near boundaries a class is wrong far more often: audited as much more, its mistakes make no fireflies. 16 brings the
// default of 1/64 to 1/4, a weight of 4 where a visibility was wrong.
const NEAR_AUDITS = 16.0;

// Probability that a decided point is audited.
fn audit_chance(word: u32, probability: f32) -> f32 {
    return select(probability, min(NEAR_AUDITS * probability, 1.0), is_near(word));
}

// Whether a decided point traces a shadow ray all the same.
fn is_audited(seed: u32, sample_index: u32, light: u32, chance: f32) -> bool {
    return uniform_from_bits(hash3(seed, sample_index, DIMENSION_AUDIT + light)) < chance;
}
