// The diffuse base: a Lambertian.

import package::lib::math::PI;

// The BSDF of a base of that albedo.
fn diffuse_value(albedo: vec3f) -> vec3f {
    return albedo / PI;
}

// The density of `sample_cosine`, by the cosine to the normal.
fn diffuse_density(cosine: f32) -> f32 {
    return cosine / PI;
}
