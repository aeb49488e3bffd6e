// Class words: the class of a candidate (a point and a light) by the photons, packed into 32 bits, and the decisions
// that follow from it: whether shadow rays are traced, and whether it is audited. src/kernels/numbers.rs has the bits.
// Paper, "Extending the photon map": the three cases and equation 1.

import package::lib::rng::{hash3, uniform_from_bits};
import package::lib::constants::{
    CLASS_BOUNDARY, CLASS_COUNT_MAX, CLASS_ILLUMINATION_SHIFT, CLASS_LIT, CLASS_MASK, CLASS_SHADOWED,
    CLASS_SHADOW_SHIFT, CLASS_UNKNOWN, CLASS_VISIBILITY_SHIFT, CLASS_VISIBILITY_STEPS, DIMENSION_AUDIT
};

// `visibility` is 0 to 1; the counts of illumination and shadow photons are at most CLASS_COUNT_MAX.
fn class_word(class_: u32, illumination: u32, shadow: u32, visibility: f32) -> u32 {
    let steps = u32(round(visibility * f32(CLASS_VISIBILITY_STEPS)));
    return class_ | (illumination << CLASS_ILLUMINATION_SHIFT) | (shadow << CLASS_SHADOW_SHIFT)
        | (steps << CLASS_VISIBILITY_SHIFT);
}

// The word of a boundary with the given visibility; its counts, of `nearest` photons, are derived from this.
fn boundary_word(visibility: f32, nearest: u32) -> u32 {
    // A boundary has photons of both kinds, if k is more than 1.
    let lit = max(min(u32(round(visibility * f32(nearest))), nearest - 1u), min(nearest - 1u, 1u));
    return class_word(CLASS_BOUNDARY, lit, nearest - lit, visibility);
}

fn class_of(word: u32) -> u32 {
    return word & CLASS_MASK;
}

fn class_illumination(word: u32) -> u32 {
    return (word >> CLASS_ILLUMINATION_SHIFT) & CLASS_COUNT_MAX;
}

fn class_shadow(word: u32) -> u32 {
    return (word >> CLASS_SHADOW_SHIFT) & CLASS_COUNT_MAX;
}

// n_i / (n_s + n_i), equation 1 of the paper, with weighted shadow photons.
fn class_visibility(word: u32) -> f32 {
    return f32(word >> CLASS_VISIBILITY_SHIFT) / f32(CLASS_VISIBILITY_STEPS);
}

// Lit or shadowed: the photons decide.
fn is_decided(class_: u32) -> bool {
    return class_ == CLASS_LIT || class_ == CLASS_SHADOWED;
}

// Whether shadow rays find the visibility: where the photons do not decide or, where their own visibility is shown,
// where there are no photons.
fn traces_shadow_rays(word: u32) -> bool {
    @if(visibility_estimate) {
        return class_of(word) == CLASS_UNKNOWN && class_illumination(word) + class_shadow(word) == 0u;
    }
    @else { return class_of(word) == CLASS_BOUNDARY || class_of(word) == CLASS_UNKNOWN; }
}

// Where the cell of a decided candidate lies: away from all boundaries; near one, or a part of a divided cell with few
// photons; a part of a divided cell with many photons.
const AWAY = 0u;
const NEAR = 1u;
const SETTLED = 2u;

// The word of a decided candidate with this `nearness` of its cell. Its visibility would only repeat its class, so a
// visibility one or two steps off marks the nearness instead.
fn word_at(word: u32, nearness: u32) -> u32 {
    let class_ = class_of(word);
    if class_ == CLASS_LIT { return word - (nearness << CLASS_VISIBILITY_SHIFT); }
    if class_ == CLASS_SHADOWED { return word + (nearness << CLASS_VISIBILITY_SHIFT); }
    return word;
}

fn nearness_of(word: u32) -> u32 {
    let visibility = word >> CLASS_VISIBILITY_SHIFT;
    return min(visibility, CLASS_VISIBILITY_STEPS - visibility);
}

// Probabilities that decided candidates are audited, certain from 1 on: away from boundaries, and near them.
struct AuditProbabilities {
    away: f32,
    near: f32,
}

// Classes of settled cells are wrong a quarter as often (MANY in fine_cells.wgsl): a quarter of the audits leaves as
// much noise. In scenes/crowd.glb, with 64 samples a pixel, half of the audits were saved, and relMSE stayed 1.22e-4.
const SETTLED_AUDITS = 0.25;

// Probability that a decided candidate is audited.
fn audit_probability(word: u32, probabilities: AuditProbabilities) -> f32 {
    let nearness = nearness_of(word);
    let near = probabilities.near * select(1.0, SETTLED_AUDITS, nearness == SETTLED);
    return min(select(near, probabilities.away, nearness == AWAY), 1.0);
}

// Whether a decided candidate traces a shadow ray nevertheless.
fn is_audited(seed: u32, sample_index: u32, light: u32, probability: f32) -> bool {
    return uniform_from_bits(hash3(seed, sample_index, DIMENSION_AUDIT + light)) < probability;
}
