// The clear coat: a second GGX lobe, that of a dielectric layer over everything else (KHR_materials_clearcoat).
// src/scene/material/clearcoat.rs reads its parameters.

@if(clearcoat) import package::lib::bsdf::microfacet::{
    LocalPair, lobe_means, max_visible_density, mean_kept, microfacets, schlick, through_layer, visible_density,
};
@if(clearcoat) import package::lib::constants::CLEARCOAT_TEXEL;
@if(clearcoat && textures) import package::lib::constants::{
    CLEARCOAT_NORMAL_TEXTURE, CLEARCOAT_ROUGHNESS_TEXTURE, CLEARCOAT_TEXTURE, CLEARCOAT_TEXTURES,
};
@if(clearcoat) import package::lib::material::load_material_texel;
@if(coat_normals && textures) import package::lib::material::texture_info;
@if(coat_normals) import package::lib::math::{oct_decode16, oct_encode16};
@if(coat_normals) import package::lib::ray::Hit;
@if(coat_normals) import package::lib::shading_normal::{bent_to, mapped_normal};

@if(clearcoat)
struct Clearcoat {
    factor: f32,
    // Width of its GGX distribution.
    alpha: f32,
    // The coat's own shading normal. Without it, the coat has the base's.
    @if(coat_normals) normal: vec3f,
}

// Reflectances at normal and at grazing incidence: the coat's index of refraction is 1.5.
@if(clearcoat) const COAT_REFLECTANCES = vec2f(0.04, 1.0);

// A bit for each texture that may change what is rendered.
@if(clearcoat && textures)
fn clearcoat_textures() -> u32 {
    @if(coat_normals) { return CLEARCOAT_TEXTURES; }
    @else { return CLEARCOAT_TEXTURES & ~(1u << CLEARCOAT_NORMAL_TEXTURE); }
}

@if(clearcoat && textures)
fn clearcoat_texture(factors: vec2f, texel: vec4f, texture: u32) -> vec2f {
    return select(
        factors,
        texel.xy,
        vec2<bool>(texture == CLEARCOAT_TEXTURE, texture == CLEARCOAT_ROUGHNESS_TEXTURE),
    );
}

@if(coat_normals && textures)
fn coat_normal_texture(normal: vec3f, texel: vec4f, texture: u32) -> vec3f {
    return select(normal, texel.xyz, texture == CLEARCOAT_NORMAL_TEXTURE);
}

@if(clearcoat)
fn clearcoat_lobe(material: u32, factors: vec2f) -> Clearcoat {
    var coat = bitcast<vec4f>(load_material_texel(material + CLEARCOAT_TEXEL)).xy;
    @if(textures) { coat *= factors; }
    var lobe: Clearcoat;
    lobe.factor = coat.x;
    lobe.alpha = coat.y * coat.y;
    return lobe;
}

// The coat's normal over a surface whose normal without any map is `unmapped`. A coat without a normal map is smooth,
// whatever its base.
@if(coat_normals)
fn coat_normal_at(material: u32, texel: vec3f, hit: Hit, unmapped: vec3f, front: bool, view: vec3f) -> vec3f {
    var normal = unmapped;
    @if(textures) {
        if texture_info(material, CLEARCOAT_NORMAL_TEXTURE) != 0u {
            let scale = bitcast<f32>(load_material_texel(material + CLEARCOAT_TEXEL).z);
            normal = mapped_normal(hit, texel, scale, unmapped, front);
        }
    }
    return bent_to(normal, view);
}

@if(clearcoat)
fn is_coated(lobe: Clearcoat) -> bool {
    return lobe.factor != 0.0;
}

@if(clearcoat)
fn pack_clearcoat(lobe: Clearcoat) -> vec4f {
    @if(coat_normals) { return vec4f(lobe.factor, lobe.alpha, bitcast<f32>(oct_encode16(lobe.normal)), 0.0); }
    @else { return vec4f(lobe.factor, lobe.alpha, 0.0, 0.0); }
}

@if(clearcoat)
fn unpack_clearcoat(packed: vec4f) -> Clearcoat {
    @if(coat_normals) { return Clearcoat(packed.x, packed.y, oct_decode16(bitcast<u32>(packed.z))); }
    @else { return Clearcoat(packed.x, packed.y); }
}

// Cosines of light and view to the coat's normal, for light that reaches the base from outside or leaves it on the
// inside. `pair` is in the frame of the base's normal; `direction` and `view` are the same in scene space.
@if(clearcoat)
fn coat_heights(lobe: Clearcoat, pair: LocalPair, direction: vec3f, view: vec3f) -> vec2f {
    @if(coat_normals) {
        let light = dot(direction, lobe.normal) * sign(pair.light.z);
        return vec2f(light, coat_view_height(lobe, pair, view));
    }
    @else { return vec2f(abs(pair.light.z), pair.view.z); }
}

@if(clearcoat)
fn coat_view_height(lobe: Clearcoat, pair: LocalPair, view: vec3f) -> f32 {
    @if(coat_normals) { return max(dot(view, lobe.normal), 1e-4); }
    @else { return pair.view.z; }
}

// The share of light that the coat transmits to the layers below, by the cosines of light and view to its normal.
@if(clearcoat)
fn through_coat(lobe: Clearcoat, heights: vec2f) -> f32 {
    return 1.0 - lobe.factor * (1.0 - through_layer(COAT_REFLECTANCES, lobe.alpha, heights.x, heights.y));
}

// The BSDF of the coat; `pair` is in the frame of its own normal.
@if(clearcoat)
fn clearcoat_value(lobe: Clearcoat, pair: LocalPair) -> f32 {
    let h = normalize(pair.view + pair.light);
    let fresnel = mix(COAT_REFLECTANCES.x, COAT_REFLECTANCES.y, schlick(dot(pair.view, h)));
    return lobe.factor * fresnel * microfacets(pair, h);
}

// The density of directions sampled from the coat.
@if(clearcoat)
fn clearcoat_density(pair: LocalPair) -> f32 {
    return visible_density(pair, normalize(pair.view + pair.light));
}

// Upper bound of that density for a view at the given cosine to the base's normal; 0 without a coat.
@if(clearcoat)
fn max_clearcoat_density(lobe: Clearcoat, view: vec3f, view_z: f32) -> f32 {
    @if(coat_normals) let height = max(dot(view, lobe.normal), 1e-4);
    @if(!coat_normals) let height = view_z;
    return select(0.0, max_visible_density(height, vec2f(lobe.alpha)), is_coated(lobe));
}

// The probability of sampling the coat, if the layers below reflect `below` straight back. `through` is the share that
// the coat transmits there.
@if(clearcoat)
fn clearcoat_chance(lobe: Clearcoat, through: f32, below: f32) -> f32 {
    let coat = 3.0 * (1.0 - through);
    return select(0.0, clamp(coat / (coat + through * below), 0.1, 0.9), lobe.factor > 0.0);
}

// Means over all directions of the coat's reflectance, over its factor, and of its transmittance.
@if(clearcoat)
fn clearcoat_means(lobe: Clearcoat) -> vec2f {
    let means = lobe_means(lobe.alpha);
    let reflected = dot(vec2f(COAT_REFLECTANCES.x, COAT_REFLECTANCES.y - COAT_REFLECTANCES.x), means);
    return vec2f(reflected, 1.0 - lobe.factor * mean_kept(COAT_REFLECTANCES, lobe.alpha));
}
