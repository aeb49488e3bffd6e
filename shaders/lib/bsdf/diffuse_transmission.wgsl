// Diffuse transmission: a Lambertian lobe on the other side, as of leaves and paper
// (KHR_materials_diffuse_transmission). src/scene/material/lobes/diffuse_transmission.rs reads its parameters.

@if(diffuse_transmission) import package::lib::bsdf::lobe::LobeContext;
@if(diffuse_transmission) import package::lib::bsdf::transmission::transmission_factor;
@if(diffuse_transmission) import package::lib::constants::DIFFUSE_TRANSMISSION_TEXEL;
@if(diffuse_transmission && textures) import package::lib::constants::{
    DIFFUSE_TRANSMISSION_COLOUR_TEXTURE, DIFFUSE_TRANSMISSION_TEXTURE, DIFFUSE_TRANSMISSION_TEXTURES,
    TRANSMISSION_TEXTURE,
};
@if(diffuse_transmission) import package::lib::material::load_material_texel;

@if(diffuse_transmission)
struct DiffuseTransmission {
    // Transmittance of the base: colour times factor, of what neither metal nor KHR_materials_transmission takes.
    tint: vec3f,
}

@if(diffuse_transmission)
struct DiffuseTransmissionFactors {
    // Colour and factor.
    own: vec4f,
    // The factor of KHR_materials_transmission, which takes its share first.
    transmission: f32,
}

@if(diffuse_transmission)
fn diffuse_transmission_untextured() -> DiffuseTransmissionFactors {
    return DiffuseTransmissionFactors(vec4f(1.0), 1.0);
}

@if(diffuse_transmission && textures)
fn diffuse_transmission_textures() -> u32 {
    return DIFFUSE_TRANSMISSION_TEXTURES;
}

@if(diffuse_transmission && textures)
fn diffuse_transmission_texture(
    factors: DiffuseTransmissionFactors,
    texel: vec4f,
    texture: u32,
) -> DiffuseTransmissionFactors {
    let of_colour = texture == DIFFUSE_TRANSMISSION_COLOUR_TEXTURE;
    let own = vec4<bool>(vec3<bool>(of_colour), texture == DIFFUSE_TRANSMISSION_TEXTURE);
    return DiffuseTransmissionFactors(
        select(factors.own, texel, own),
        select(factors.transmission, texel.x, texture == TRANSMISSION_TEXTURE),
    );
}

// Colour and factor of a material.
@if(diffuse_transmission)
fn diffuse_transmission_factors(material: u32, factors: DiffuseTransmissionFactors) -> vec4f {
    return bitcast<vec4f>(load_material_texel(material + DIFFUSE_TRANSMISSION_TEXEL)) * factors.own;
}

@if(diffuse_transmission)
fn diffuse_transmission_lobe(
    material: u32,
    factors: DiffuseTransmissionFactors,
    context: LobeContext,
) -> DiffuseTransmission {
    let own = diffuse_transmission_factors(material, factors);
    let left = context.dielectric * (1.0 - transmission_factor(material, factors.transmission));
    return DiffuseTransmission(own.xyz * own.w * left);
}

// The albedo of the diffuse base, of the albedo without diffuse transmission.
@if(diffuse_transmission)
fn diffuse_transmission_base(material: u32, factors: DiffuseTransmissionFactors, albedo: vec3f) -> vec3f {
    return albedo * (1.0 - diffuse_transmission_factors(material, factors).w);
}

// The lobe where nothing is transmitted.
@if(diffuse_transmission)
fn diffuse_transmission_blocked(lobe: DiffuseTransmission) -> DiffuseTransmission {
    return DiffuseTransmission(vec3f(0.0));
}

// The lobe is the same from both sides.
@if(diffuse_transmission)
fn diffuse_transmission_turned(lobe: DiffuseTransmission) -> DiffuseTransmission {
    return lobe;
}

@if(diffuse_transmission)
fn diffuse_transmission_is_present(lobe: DiffuseTransmission) -> bool {
    return any(lobe.tint > vec3f(0.0));
}

@if(diffuse_transmission)
fn pack_diffuse_transmission(lobe: DiffuseTransmission) -> vec4f {
    return vec4f(lobe.tint, 0.0);
}

@if(diffuse_transmission)
fn unpack_diffuse_transmission(packed: vec4f) -> DiffuseTransmission {
    return DiffuseTransmission(packed.xyz);
}

// The share of the diffuse base's samples that pass through, if the base has the given albedo; 0 if it is black from
// both sides.
@if(diffuse_transmission)
fn diffusely_passing_share(lobe: DiffuseTransmission, albedo: vec3f) -> f32 {
    let passes = dot(lobe.tint, vec3f(1.0));
    return passes / max(passes + dot(albedo, vec3f(1.0)), 1e-30);
}
