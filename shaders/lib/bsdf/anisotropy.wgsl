// Anisotropy of the specular lobe: different widths along and across a tangent (KHR_materials_anisotropy).
// src/scene/material/anisotropy.rs reads its parameters.

@if(anisotropy) import package::lib::attributes::tangent_frame;
@if(anisotropy) import package::lib::constants::ANISOTROPY_TEXEL;
@if(anisotropy && textures) import package::lib::constants::ANISOTROPY_TEXTURE;
@if(anisotropy) import package::lib::material::load_material_texel;
@if(anisotropy) import package::lib::math::{basis, oct_decode16, oct_encode16};
@if(anisotropy) import package::lib::ray::Hit;

@if(anisotropy)
struct Anisotropy {
    // Unit vector, or 0 for an isotropic surface.
    tangent: vec3f,
    // The width of the GGX distribution along it.
    alpha_along: f32,
}

// The value without a texture: direction along the tangent, full strength.
@if(anisotropy) const ANISOTROPY_UNTEXTURED = vec3f(1.0, 0.5, 1.0);

@if(anisotropy && textures)
fn anisotropy_texture(factors: vec3f, texel: vec4f, texture: u32) -> vec3f {
    return select(factors, texel.xyz, texture == ANISOTROPY_TEXTURE);
}

@if(anisotropy)
fn anisotropy_lobe(
    material: u32,
    factors: vec3f,
    alpha: f32,
    hit: Hit,
    shading_normal: vec3f,
    front: bool,
) -> Anisotropy {
    var lobe: Anisotropy;
    lobe.alpha_along = alpha;
    let own = bitcast<vec4f>(load_material_texel(material + ANISOTROPY_TEXEL));
    if own.x != 0.0 {
        var strength = own.x;
        var axis = own.yz;
        @if(textures) {
            strength *= factors.z;
            let rotation = factors.xy * 2.0 - 1.0;
            axis = vec2f(axis.x * rotation.x - axis.y * rotation.y, axis.y * rotation.x + axis.x * rotation.y);
        }
        let frame = tangent_frame(hit.triangle, hit.u, hit.v, select(-shading_normal, shading_normal, front));
        let tangent = frame * axis;
        lobe.tangent = select(vec3f(0.0), tangent / max(length(tangent), 1e-6), dot(tangent, tangent) > 1e-12);
        lobe.alpha_along = mix(alpha, 1.0, strength * strength);
    }
    return lobe;
}

@if(anisotropy)
fn is_anisotropic(lobe: Anisotropy) -> bool {
    return any(lobe.tangent != vec3f(0.0));
}

// A tangent of length 0 has no code; a negative width marks it.
@if(anisotropy)
fn pack_anisotropy(lobe: Anisotropy) -> vec4f {
    let width = select(-1.0, lobe.alpha_along, is_anisotropic(lobe));
    return vec4f(width, bitcast<f32>(oct_encode16(lobe.tangent)), 0.0, 0.0);
}

@if(anisotropy)
fn unpack_anisotropy(packed: vec4f) -> Anisotropy {
    let tangent = select(vec3f(0.0), oct_decode16(bitcast<u32>(packed.y)), packed.x >= 0.0);
    return Anisotropy(tangent, packed.x);
}

// Axes about the shading normal, the first along the tangent where there is one.
@if(anisotropy)
fn anisotropy_frame(lobe: Anisotropy, shading_normal: vec3f) -> mat3x3f {
    let along = lobe.tangent - shading_normal * dot(lobe.tangent, shading_normal);
    if dot(along, along) > 1e-8 {
        let x = normalize(along);
        return mat3x3f(x, cross(shading_normal, x), shading_normal);
    }
    return basis(shading_normal);
}
