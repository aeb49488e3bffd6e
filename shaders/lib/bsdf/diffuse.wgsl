// The diffuse base, which is Lambertian.

import package::lib::math::PI;

// The BSDF of a base with the given albedo.
fn diffuse_value(albedo: vec3f) -> vec3f {
    return albedo / PI;
}

// The density of `sample_cosine` at the given cosine to the normal.
fn diffuse_density(cosine: f32) -> f32 {
    return cosine / PI;
}
