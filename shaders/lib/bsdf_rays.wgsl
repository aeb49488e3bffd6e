// Decides whether a ray sampled from the BSDF of a visible point counts where it hits a light. It then shares this
// light with the light points of pass `shade`, by multiple importance sampling (Veach 1997). The passes `shade` and
// `path` must decide alike, so that the weights of light points and of rays sum to 1.

import package::lib::light::light_max_solid_angle;

// Rays count if `hit_probability` is at least this. If it is less, light points have the weight 1 and rays that hit the
// light have the weight 0: no lobe is so narrow that light points would miss it.
// docs/experiments.md, "BSDF rays that may hit a light", has the measurements.
override min_hit_probability: f32;

// Upper bound of the probability that a ray sampled from a BSDF of the given maximum density hits the light: this
// density times the largest solid angle of the light.
fn hit_probability(max_density: f32, position: vec3f, light: u32) -> f32 {
    return max_density * light_max_solid_angle(light, position);
}

// Maximum probability for which one light point stands for all, if nothing hides the light. A GGX lobe of width alpha
// has the maximum density 1 / (4 pi alpha^2). At this probability, the half vector turns by 0.32 alpha from the middle
// of the light to its rim, and the lobe falls to 0.83 of its maximum.
const MAX_SINGLE_PROBABILITY = 0.1;

// Whether the BSDF hardly varies over the light, seen from the position.
fn one_light_point_suffices(max_density: f32, position: vec3f, light: u32) -> bool {
    return hit_probability(max_density, position, light) <= MAX_SINGLE_PROBABILITY;
}

// Whether rays from the position that hit the light count.
fn takes_bsdf_rays(max_density: f32, position: vec3f, light: u32) -> bool {
    return hit_probability(max_density, position, light) >= min_hit_probability;
}
