// Anisotropy of the specular lobe: different widths along and across a tangent (KHR_materials_anisotropy).
// src/scene/material/lobes/anisotropy.rs reads its parameters.

@if(anisotropy) import package::lib::attributes::tangent_frame;
@if(anisotropy) import package::lib::bsdf::lobe::LobeContext;
@if(anisotropy) import package::lib::constants::ANISOTROPY_TEXEL;
@if(anisotropy && textures) import package::lib::constants::{ANISOTROPY_TEXTURE, ANISOTROPY_TEXTURES};
@if(anisotropy) import package::lib::material::load_material_texel;
@if(anisotropy) import package::lib::math::{oct_decode16, oct_encode16};

@if(anisotropy)
struct Anisotropy {
    // Unit vector, or 0 for an isotropic surface.
    tangent: vec3f,
    // The width of the GGX distribution along it.
    alpha_along: f32,
}

// Direction, from 0 to 1 for -1 to 1, and strength.
@if(anisotropy) alias AnisotropyFactors = vec3f;

// Along the tangent, with full strength.
@if(anisotropy)
fn anisotropy_untextured() -> AnisotropyFactors {
    return vec3f(1.0, 0.5, 1.0);
}

@if(anisotropy && textures)
fn anisotropy_textures() -> u32 {
    return ANISOTROPY_TEXTURES;
}

@if(anisotropy && textures)
fn anisotropy_texture(factors: AnisotropyFactors, texel: vec4f, texture: u32) -> AnisotropyFactors {
    return select(factors, texel.xyz, texture == ANISOTROPY_TEXTURE);
}

@if(anisotropy)
fn anisotropy_lobe(material: u32, factors: AnisotropyFactors, context: LobeContext) -> Anisotropy {
    var lobe: Anisotropy;
    lobe.alpha_along = context.alpha;
    let own = bitcast<vec4f>(load_material_texel(material + ANISOTROPY_TEXEL));
    if own.x != 0.0 {
        var strength = own.x;
        var axis = own.yz;
        @if(textures) {
            strength *= factors.z;
            let rotation = factors.xy * 2.0 - 1.0;
            axis = vec2f(axis.x * rotation.x - axis.y * rotation.y, axis.y * rotation.x + axis.x * rotation.y);
        }
        let hit = context.hit;
        let outward = select(-context.shading_normal, context.shading_normal, context.front);
        let frame = tangent_frame(hit.triangle, hit.u, hit.v, outward);
        let tangent = frame * axis;
        lobe.tangent = select(vec3f(0.0), tangent / max(length(tangent), 1e-6), dot(tangent, tangent) > 1e-12);
        lobe.alpha_along = mix(context.alpha, 1.0, strength * strength);
    }
    return lobe;
}

@if(anisotropy)
fn anisotropy_is_present(lobe: Anisotropy) -> bool {
    return any(lobe.tangent != vec3f(0.0));
}

// A tangent of length 0 has no code; a negative width marks it.
@if(anisotropy)
fn pack_anisotropy(lobe: Anisotropy) -> vec4f {
    let width = select(-1.0, lobe.alpha_along, anisotropy_is_present(lobe));
    return vec4f(width, bitcast<f32>(oct_encode16(lobe.tangent)), 0.0, 0.0);
}

@if(anisotropy)
fn unpack_anisotropy(packed: vec4f) -> Anisotropy {
    let tangent = select(vec3f(0.0), oct_decode16(bitcast<u32>(packed.y)), packed.x >= 0.0);
    return Anisotropy(tangent, packed.x);
}

// Axes about the shading normal, the first along the tangent where there is one. `frame` has any about it. A tangent of
// less than 1e-4 across the normal is rounding: the octahedral code is within 7e-5 of its vector.
@if(anisotropy)
fn anisotropy_frame(lobe: Anisotropy, frame: mat3x3f) -> mat3x3f {
    let shading_normal = frame[2];
    let along = lobe.tangent - shading_normal * dot(lobe.tangent, shading_normal);
    if dot(along, along) > 1e-8 {
        let x = normalize(along);
        return mat3x3f(x, cross(shading_normal, x), shading_normal);
    }
    return frame;
}

// Widths of the distribution along the axes. `alpha` has those of an isotropic surface.
@if(anisotropy)
fn anisotropy_alpha(lobe: Anisotropy, alpha: vec2f) -> vec2f {
    return select(alpha, vec2f(lobe.alpha_along, alpha.y), anisotropy_is_present(lobe));
}
