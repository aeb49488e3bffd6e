// Transmission: light that passes through a thin wall, or is refracted into a volume (KHR_materials_transmission,
// KHR_materials_volume). src/scene/material/lobes/transmission.rs and volume.rs read its parameters.

@if(transmission) import package::lib::bsdf::lobe::LobeContext;
@if(transmission) import package::lib::bsdf::microfacet::{LocalPair, microfacets, visible_density};
@if(transmission) import package::lib::constants::{TRANSMISSION_TEXEL, VOLUME_TEXEL};
@if(transmission && textures) import package::lib::constants::{TRANSMISSION_TEXTURE, TRANSMISSION_TEXTURES};
@if(transmission) import package::lib::material::load_material_texel;
@if(transmission) import package::lib::math::safe_sqrt;
@if(dispersion) import package::lib::constants::DISPERSION_TEXEL;
@if(transmission && immersed) import package::lib::constants::MEDIUM_TEXEL;
@if(dispersion) import package::lib::wavelength::refracted_wavelength;

@if(transmission)
struct Transmission {
    // The share of light transmitted, of that which the dielectric layer does not reflect: base colour times (1 -
    // metallic) times factor.
    tint: vec3f,
    // Index of refraction on the viewer's side over that on the other; 1 for a thin wall, which light crosses straight
    // on.
    eta: f32,
}

@if(transmission) alias TransmissionFactors = f32;

// Indices of refraction nearer to 1 than this count as 1. The half vector would be the difference of nearly equal
// vectors, with too few correct digits.
@if(dispersion) const MIN_BENDING = 1e-3;

@if(transmission)
fn transmission_untextured() -> TransmissionFactors {
    return 1.0;
}

@if(transmission && textures)
fn transmission_textures() -> u32 {
    return TRANSMISSION_TEXTURES;
}

@if(transmission && textures)
fn transmission_texture(factor: TransmissionFactors, texel: vec4f, texture: u32) -> TransmissionFactors {
    return select(factor, texel.x, texture == TRANSMISSION_TEXTURE);
}

@if(transmission)
fn transmission_factor(material: u32, factor: TransmissionFactors) -> f32 {
    return bitcast<f32>(load_material_texel(material + TRANSMISSION_TEXEL).x) * factor;
}

// The volume lies behind the surface's back face.
@if(transmission)
fn transmission_lobe(material: u32, factor: TransmissionFactors, context: LobeContext) -> Transmission {
    var index = bitcast<f32>(load_material_texel(material + VOLUME_TEXEL).w);
    var tint = context.albedo * transmission_factor(material, factor);
    @if(dispersion) {
        let spread = bitcast<f32>(load_material_texel(material + DISPERSION_TEXEL).x);
        if spread > 0.0 && index != 1.0 {
            let refracted = refracted_wavelength(tint);
            index += spread * (f32(refracted.wavelength) - 1.0);
            if abs(index - 1.0) < MIN_BENDING { index = 1.0; }
            tint *= refracted.share;
        }
    }
    return Transmission(tint, select(index, 1.0 / index, context.front));
}

// The albedo of the diffuse base, of the albedo without transmission.
@if(transmission)
fn transmission_base(material: u32, factor: TransmissionFactors, albedo: vec3f) -> vec3f {
    return albedo * (1.0 - transmission_factor(material, factor));
}

// The lobe where nothing is transmitted.
@if(transmission)
fn transmission_blocked(lobe: Transmission) -> Transmission {
    return Transmission(vec3f(0.0), lobe.eta);
}

// The lobe from the other side.
@if(transmission)
fn transmission_turned(lobe: Transmission) -> Transmission {
    return Transmission(lobe.tint, 1.0 / lobe.eta);
}

// Transmittance of the volume over a distance.
@if(transmission)
fn volume_transmittance(material: u32, path_length: f32) -> vec3f {
    return exp(-bitcast<vec3f>(load_material_texel(material + VOLUME_TEXEL).xyz) * path_length);
}

// Transmittance of the volume that the surface lies in.
@if(transmission && immersed)
fn medium_transmittance(material: u32, path_length: f32) -> vec3f {
    return exp(-bitcast<vec3f>(load_material_texel(material + MEDIUM_TEXEL).xyz) * path_length);
}

@if(transmission)
fn transmission_is_present(lobe: Transmission) -> bool {
    return any(lobe.tint > vec3f(0.0));
}

@if(transmission)
fn pack_transmission(lobe: Transmission) -> vec4f {
    return vec4f(lobe.tint, lobe.eta);
}

@if(transmission)
fn unpack_transmission(packed: vec4f) -> Transmission {
    return Transmission(packed.xyz, packed.w);
}

// The cosine for Schlick's term, which is on the side of the lower index of refraction; -1 for total internal
// reflection. `eta` is the index of refraction on the side of `cosine` over that on the other side.
@if(transmission)
fn fresnel_cosine(eta: f32, cosine: f32) -> f32 {
    let sine_squared = eta * eta * (1.0 - cosine * cosine);
    let outer = select(safe_sqrt(1.0 - sine_squared), -1.0, sine_squared >= 1.0);
    return select(outer, cosine, eta <= 1.0);
}

// The microfacet normal that transmits light from `pair.light`, below the surface, towards the viewer; and the Jacobian
// by which the normal's density becomes the direction's (Walter et al. 2007, equations 16 and 17). 0 if there is no
// such normal. A thin wall does not refract: it spreads light as the mirror image of reflection.
@if(transmission)
struct Passing {
    normal: vec3f,
    jacobian: f32,
}

@if(transmission)
fn passing(lobe: Transmission, pair: LocalPair) -> Passing {
    let thin = lobe.eta == 1.0;
    let mirrored = vec3f(pair.light.xy, -pair.light.z);
    let bent = -(pair.light + lobe.eta * pair.view);
    let h = normalize(select(select(bent, -bent, bent.z < 0.0), pair.view + mirrored, thin));
    let view_h = dot(pair.view, h);
    let light_h = dot(pair.light, h);
    let root = light_h + lobe.eta * view_h;
    let refracted = select(-light_h / (root * root), 0.0, (view_h <= 0.0) | (light_h >= 0.0));
    return Passing(h, select(refracted, 0.25 / max(view_h, 1e-6), thin));
}

// The BSDF for light transmitted from the other side by microfacets that transmit everything. Radiance is higher where
// the index of refraction is higher.
@if(transmission)
fn passing_value(lobe: Transmission, found: Passing, pair: LocalPair) -> f32 {
    let view_h = dot(pair.view, found.normal);
    return 4.0 * view_h * found.jacobian * lobe.eta * lobe.eta * microfacets(pair, found.normal);
}

// The density of transmitted directions by the visible normals, over the probability that a normal transmits.
@if(transmission)
fn passing_density(found: Passing, pair: LocalPair) -> f32 {
    return 4.0 * dot(pair.view, found.normal) * found.jacobian * visible_density(pair, found.normal);
}

// The direction of light transmitted by a sampled microfacet normal. `reflected` is the direction reflected by it.
@if(transmission)
fn passed_direction(lobe: Transmission, view: vec3f, h: vec3f, reflected: vec3f) -> vec3f {
    return select(refract(-view, h, lobe.eta), vec3f(reflected.xy, -reflected.z), lobe.eta == 1.0);
}
