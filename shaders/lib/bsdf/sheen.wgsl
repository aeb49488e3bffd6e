// Sheen: the light that fibres over the surface reflect (KHR_materials_sheen, after Estevez and Kulla 2017).
// src/scene/material/lobes/sheen.rs makes its parameters and the table of its albedo.

@if(sheen) import package::lib::bsdf::lobe::{LayerChance, LayerPair, LobeContext};
@if(sheen) import package::lib::bsdf::microfacet::LocalPair;
@if(sheen) import package::lib::constants::{SHEEN_COLUMNS, SHEEN_ROWS, SHEEN_TEXEL};
@if(sheen && textures) import package::lib::constants::{
    SHEEN_COLOUR_TEXTURE, SHEEN_ROUGHNESS_TEXTURE, SHEEN_TEXTURES,
};
@if(sheen) import package::lib::material::load_material_texel;
@if(sheen) import package::lib::math::PI;
@if(sheen) import package::lib::sampling::sample_cap;

// For each cell of a grid over the cube root of the cosine and the logarithm of the roughness, the entries at its four
// corners. An entry is the binary logarithm of albedo times 4 cosine (1 + lambda), which is smoother than the albedo.
@if(sheen) @group(1) @binding(22) var<uniform> sheen_albedos: array<vec4f, SHEEN_COLUMNS * SHEEN_ROWS>;
@if(sheen) override min_sheen_roughness: f32;

@if(sheen)
struct Sheen {
    colour: vec3f,
    roughness: f32,
}

// For colour and roughness.
@if(sheen) alias SheenFactors = vec4f;

@if(sheen)
fn sheen_untextured() -> SheenFactors {
    return vec4f(1.0);
}

@if(sheen && textures)
fn sheen_textures() -> u32 {
    return SHEEN_TEXTURES;
}

@if(sheen && textures)
fn sheen_texture(factors: SheenFactors, texel: vec4f, texture: u32) -> SheenFactors {
    let of_colour = texture == SHEEN_COLOUR_TEXTURE;
    return select(factors, texel, vec4<bool>(vec3<bool>(of_colour), texture == SHEEN_ROUGHNESS_TEXTURE));
}

@if(sheen)
fn sheen_lobe(material: u32, factors: SheenFactors, context: LobeContext) -> Sheen {
    var sheen = bitcast<vec4f>(load_material_texel(material + SHEEN_TEXEL));
    @if(textures) { sheen *= factors; }
    return unpack_sheen(sheen);
}

@if(sheen)
fn sheen_is_present(lobe: Sheen) -> bool {
    return any(lobe.colour != vec3f(0.0));
}

@if(sheen)
fn pack_sheen(lobe: Sheen) -> vec4f {
    return vec4f(lobe.colour, lobe.roughness);
}

@if(sheen)
fn unpack_sheen(packed: vec4f) -> Sheen {
    return Sheen(packed.xyz, packed.w);
}

@if(sheen)
fn sheen_roughness(lobe: Sheen) -> f32 {
    return clamp(lobe.roughness, min_sheen_roughness, 1.0);
}

// Properties of the fibres for one direction. `lambda` is their masking (Estevez and Kulla 2017, equation 3, in the
// form of KHR_materials_sheen). `albedo` is the directional albedo of white fibres. By the extension's formula it
// exceeds 1 at grazing angles if the roughness is below 0.3.
@if(sheen)
struct FibreSide {
    lambda: f32,
    albedo: f32,
}

@if(sheen)
fn fibre_side(roughness: f32, height: f32) -> FibreSide {
    let cosine = clamp(height, 1e-4, 1.0);
    let alpha = roughness * roughness;
    let smoothness = (1.0 - alpha) * (1.0 - alpha);
    let a = mix(21.5473, 25.3245, smoothness);
    let b = mix(3.82987, 3.32435, smoothness);
    let c = mix(0.19823, 0.16801, smoothness);
    let d = mix(-1.97760, -1.27393, smoothness);
    let e = mix(-4.32054, -4.85967, smoothness);
    let low = min(cosine, max(1.0 - cosine, 1e-6));
    let l = a / (1.0 + b * pow(low, c)) + d * low + e;
    let middle = a / (1.0 + b * pow(0.5, c)) + d * 0.5 + e;
    let lambda = exp(select(2.0 * middle - l, l, cosine < 0.5));

    let last = vec2u(SHEEN_COLUMNS, SHEEN_ROWS) - 1u;
    let at = vec2f(pow(cosine, 1.0 / 3.0), log2(roughness) / log2(min_sheen_roughness)) * vec2f(last + 1u);
    let cell = min(vec2u(at), last);
    let f = at - vec2f(cell);
    let corners = sheen_albedos[cell.y * SHEEN_COLUMNS + cell.x];
    let found = mix(mix(corners.x, corners.y, f.x), mix(corners.z, corners.w, f.x), f.y);
    return FibreSide(lambda, exp2(found) / (4.0 * cosine * (1.0 + lambda)));
}

// The share of light that fibres of the given albedo transmit to the layers below.
@if(sheen)
fn through_fibres(lobe: Sheen, albedo: f32) -> f32 {
    return 1.0 - max(lobe.colour.x, max(lobe.colour.y, lobe.colour.z)) * min(albedo, 1.0);
}

// The share that they transmit from one direction to another: the smaller of the shares at the two angles, as in the
// extension's albedo scaling.
@if(sheen)
fn sheen_through(lobe: Sheen, pair: LayerPair) -> f32 {
    let roughness = sheen_roughness(lobe);
    let light = fibre_side(roughness, abs(pair.local.light.z)).albedo;
    return through_fibres(lobe, max(light, fibre_side(roughness, pair.local.view.z).albedo));
}

// The BSDF of the fibres: the extension's formula, divided by the larger of the two directional albedos if that exceeds
// 1. This conserves energy, stays reciprocal, and leaves the formula unchanged where it conserves energy already.
@if(sheen)
fn sheen_value(lobe: Sheen, pair: LocalPair) -> vec3f {
    let roughness = sheen_roughness(lobe);
    let light = fibre_side(roughness, pair.light.z);
    let view = fibre_side(roughness, pair.view.z);
    let across = cross(normalize(pair.view + pair.light), vec3f(0.0, 0.0, 1.0));
    let inverse_alpha = 1.0 / (roughness * roughness);
    // sin^(1 / alpha), computed from the squared sine.
    let distribution = (2.0 + inverse_alpha) / (2.0 * PI) * pow(max(dot(across, across), 1e-30), 0.5 * inverse_alpha);
    let masked = (1.0 + light.lambda + view.lambda) * 4.0 * max(pair.light.z, 1e-4) * pair.view.z;
    return lobe.colour * (distribution / (masked * max(max(light.albedo, view.albedo), 1.0)));
}

// The probability of sampling the fibres, if the layers below reflect `below` straight back; bounded as in
// `lobe_chances`.
@if(sheen)
fn sheen_chance(lobe: Sheen, pair: LayerPair, below: f32) -> LayerChance {
    let albedo = fibre_side(sheen_roughness(lobe), pair.local.view.z).albedo;
    let reflected = dot(lobe.colour, vec3f(1.0)) * min(albedo, 1.0);
    let through = below * through_fibres(lobe, albedo);
    let chance = clamp(reflected / max(reflected + through, 1e-30), 0.1, 0.9);
    return LayerChance(select(0.0, chance, any(lobe.colour > vec3f(0.0))), through + reflected);
}

// Fibres are sampled uniformly over the hemisphere, as Estevez and Kulla (2017) found best for such wide lobes.
@if(sheen)
fn sheen_sample(u: vec2f) -> vec3f {
    return sample_cap(u, 1.0);
}

@if(sheen)
fn sheen_density(chance: f32, pair: LocalPair) -> f32 {
    return chance / (2.0 * PI);
}

// Upper bound of that density for any view; 0 without fibres.
@if(sheen)
fn sheen_max_density(lobe: Sheen, view: vec3f, view_z: f32) -> f32 {
    return select(0.0, 0.5 / PI, sheen_is_present(lobe));
}

// Albedo of fibres over a base of albedo `base`. It uses fits of two means over the cosine-weighted hemisphere: of the
// fibres' albedo (error at most 0.001), and of the larger of two such albedos (0.003).
@if(sheen)
fn sheen_mean(lobe: Sheen, base: vec3f) -> vec3f {
    let r = sheen_roughness(lobe);
    let mean = r * (0.197 + r * (0.059 + r * (0.430 - 0.387 * r)));
    let larger = r * (0.439 + r * (-0.299 + r * (0.708 - 0.483 * r)));
    return base * through_fibres(lobe, larger) + lobe.colour * mean;
}
