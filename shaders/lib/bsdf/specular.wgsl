// The specular lobe: GGX microfacets of a metal or of the dielectric layer over the diffuse base (glTF 2.0, appendix B;
// KHR_materials_specular, KHR_materials_ior). src/scene/material/lobes/specular.rs reads its parameters.

@if(glossy) import package::lib::bsdf::microfacet::{
    LOWER_SCHLICK_VARIANCE, ONE_ANGLE_LESS, SQUARE_MORE, layer_rise, lobe_means, mean_kept, schlick, through_layer,
};
@if(glossy) import package::lib::constants::SPECULAR_TEXEL;
@if(glossy && textures) import package::lib::constants::{SPECULAR_COLOUR_TEXTURE, SPECULAR_TEXTURE};
@if(glossy) import package::lib::material::load_material_texel;

@if(glossy)
struct Specular {
    // Reflectance at normal and at grazing incidence, metal and dielectric mixed.
    f0: vec3f,
    f90: f32,
    // The same for the dielectric layer over the diffuse base, which receives only what the layer does not reflect.
    dielectric: vec2f,
    // Width of the GGX distribution, roughness squared; for an anisotropic surface, the width across the tangent.
    alpha: f32,
}

// KHR_materials_specular: colour and factor.
@if(glossy)
fn specular_factors(material: u32) -> vec4f {
    return bitcast<vec4f>(load_material_texel(material + SPECULAR_TEXEL));
}

// The product of the textures' factors so far, and the factors of one more texture.
@if(glossy && textures)
fn specular_texture(factors: vec4f, texel: vec4f, texture: u32) -> vec4f {
    return select(
        factors,
        texel,
        vec4<bool>(vec3<bool>(texture == SPECULAR_COLOUR_TEXTURE), texture == SPECULAR_TEXTURE),
    );
}

// The lobe for a base colour. `normal_reflectance` is that of the index of refraction at normal incidence.
@if(glossy)
fn specular_lobe(base: vec3f, metallic: f32, roughness: f32, normal_reflectance: f32, factors: vec4f) -> Specular {
    let dielectric = min(normal_reflectance * factors.xyz, vec3f(1.0)) * factors.w;
    var lobe: Specular;
    lobe.f0 = mix(dielectric, base, metallic);
    lobe.f90 = mix(factors.w, 1.0, metallic);
    lobe.dielectric = vec2f(max(dielectric.x, max(dielectric.y, dielectric.z)), factors.w);
    lobe.alpha = roughness * roughness;
    return lobe;
}

@if(glossy)
struct PackedSpecular {
    // f0 and f90.
    reflectance: vec4f,
    // Reflectance of the dielectric layer, and alpha.
    layer: vec4f,
}

@if(glossy)
fn pack_specular(lobe: Specular) -> PackedSpecular {
    return PackedSpecular(vec4f(lobe.f0, lobe.f90), vec4f(lobe.dielectric, lobe.alpha, 0.0));
}

@if(glossy)
fn unpack_specular(packed: PackedSpecular) -> Specular {
    var lobe: Specular;
    lobe.f0 = packed.reflectance.xyz;
    lobe.f90 = packed.reflectance.w;
    lobe.dielectric = packed.layer.xy;
    lobe.alpha = packed.layer.z;
    return lobe;
}

// Reflectance of the microfacets for light at the given cosine to their normal, on the side of the lower index of
// refraction.
@if(glossy)
fn specular_reflectance(lobe: Specular, cosine: f32) -> vec3f {
    return mix(lobe.f0, vec3f(lobe.f90), schlick(cosine));
}

// Whether the lobe reflects nothing in any direction.
@if(glossy)
fn is_black_specular(lobe: Specular) -> bool {
    return all(lobe.f0 == vec3f(0.0)) & (lobe.f90 == 0.0);
}

// Reflectance of the dielectric layer for light at the given cosine. What it reflects does not reach the layers below.
@if(glossy)
fn specular_kept(lobe: Specular, cosine: f32) -> f32 {
    return mix(lobe.dielectric.x, lobe.dielectric.y, schlick(cosine));
}

// The share of light that the dielectric layer transmits to the diffuse base and out again.
@if(glossy)
fn specular_through(lobe: Specular, light_z: f32, view_z: f32) -> f32 {
    return through_layer(lobe.dielectric, lobe.alpha, light_z, view_z);
}

// Maximum specular reflectance of a surface that counts as a dielectric where a path ends: glass has 0.04, diamond
// 0.17.
@if(glossy) const DIELECTRIC = 0.2;

// Whether the lobe reflects as a metal does, so that its reflection must be traced.
@if(glossy)
fn is_metallic(lobe: Specular) -> bool {
    return max(lobe.f0.x, max(lobe.f0.y, lobe.f0.z)) > DIELECTRIC;
}

// Albedo of a diffuse base and the lobe over it: means over all directions.
@if(glossy)
fn mean_with_specular(lobe: Specular, albedo: vec3f) -> vec3f {
    let means = lobe_means(lobe.alpha);
    let base = albedo * (1.0 - mean_kept(lobe.dielectric, lobe.alpha));
    return base + lobe.f0 * means.x + (vec3f(lobe.f90) - lobe.f0) * means.y;
}

// Under a layer, the albedo is that of `mean_with_specular` times the mean share that the layer transmits, plus this
// times its `layer_rise`. The lobe keeps light from the base at grazing angles, as the layer does, so the base loses
// less than the means tell. But the lobe also reflects most at these angles, so the viewer gets less. Exact for smooth
// lobes.
@if(glossy)
fn change_under_layer(lobe: Specular, albedo: vec3f) -> vec3f {
    let means = lobe_means(lobe.alpha);
    let base = albedo * layer_rise(lobe.dielectric, lobe.alpha) * LOWER_SCHLICK_VARIANCE;
    return base + lobe.f0 * means.x * ONE_ANGLE_LESS - (vec3f(lobe.f90) - lobe.f0) * means.y * SQUARE_MORE;
}
