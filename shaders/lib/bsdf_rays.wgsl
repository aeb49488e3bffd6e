// Which lights the first ray of a path, sampled from the BSDF of a visible point, adds to the light points of pass
// `shade`. Where multiple importance sampling (Veach 1997) combines both, `shade` and `path` must decide alike: the
// weights of light points and of rays then sum to 1.

import package::lib::light::light_max_solid_angle;

// Minimum probability of hitting a light from which on such rays count: the upper bound of the density of the BSDF's
// samples times that of the light's solid angle. Below it, light points have the weight 1 and rays that hit the light
// have the weight 0: no lobe is so narrow that light points would miss it.
// docs/experiments.md, "BSDF rays that may hit a light", has the measurements.
override min_hit_probability: f32;

// Upper bound of the probability that a ray sampled from a BSDF of the given maximum density hits the light.
fn hit_probability(max_density: f32, position: vec3f, light: u32) -> f32 {
    return max_density * light_max_solid_angle(light, position);
}

// Maximum of that probability up to which one light point does for all, where nothing is in between. A GGX lobe of
// width alpha has the maximum density 1 / (4 pi alpha^2): from the middle of the light to its rim, the half vector then
// turns by 0.32 alpha, and the lobe falls to 0.83 of its value.
const MAX_SINGLE_PROBABILITY = 0.1;

// Whether lobes hardly vary over the light, seen from the position.
fn one_light_point_suffices(max_density: f32, position: vec3f, light: u32) -> bool {
    return hit_probability(max_density, position, light) <= MAX_SINGLE_PROBABILITY;
}

// Whether rays from the position that hit the light count.
fn takes_bsdf_rays(max_density: f32, position: vec3f, light: u32) -> bool {
    return hit_probability(max_density, position, light) >= min_hit_probability;
}
