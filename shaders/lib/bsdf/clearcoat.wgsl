// The clear coat: a second GGX lobe, that of a dielectric layer over everything else (KHR_materials_clearcoat).
// src/scene/material/lobes/clearcoat.rs reads its parameters.

@if(clearcoat) import package::lib::bsdf::lobe::{LayerChance, LayerPair, LobeContext};
@if(clearcoat) import package::lib::bsdf::microfacet::{
    LOWER_SCHLICK, LocalPair, layer_rise, lobe_means, max_visible_density, microfacets, schlick, through_layer,
    with_alpha,
};
@if(coat_normals) import package::lib::bsdf::microfacet::{MIN_VIEW_COSINE, pair_in_frame};
@if(clearcoat) import package::lib::constants::CLEARCOAT_TEXEL;
@if(clearcoat && textures) import package::lib::constants::{
    CLEARCOAT_NORMAL_TEXTURE, CLEARCOAT_ROUGHNESS_TEXTURE, CLEARCOAT_TEXTURE, CLEARCOAT_TEXTURES,
};
@if(clearcoat) import package::lib::material::load_material_texel;
@if(coat_normals && textures) import package::lib::material::texture_info;
@if(coat_normals) import package::lib::math::{basis, oct_decode16, oct_encode16};
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

@if(clearcoat)
struct ClearcoatFactors {
    // For factor and roughness.
    coat: vec2f,
    @if(coat_normals) normal: vec3f,
}

@if(clearcoat)
fn clearcoat_untextured() -> ClearcoatFactors {
    var factors: ClearcoatFactors;
    factors.coat = vec2f(1.0);
    return factors;
}

@if(clearcoat && textures)
fn clearcoat_textures() -> u32 {
    @if(coat_normals) { return CLEARCOAT_TEXTURES; }
    @else { return CLEARCOAT_TEXTURES & ~(1u << CLEARCOAT_NORMAL_TEXTURE); }
}

@if(clearcoat && textures)
fn clearcoat_texture(before: ClearcoatFactors, texel: vec4f, texture: u32) -> ClearcoatFactors {
    var factors = before;
    factors.coat = select(
        factors.coat,
        texel.xy,
        vec2<bool>(texture == CLEARCOAT_TEXTURE, texture == CLEARCOAT_ROUGHNESS_TEXTURE),
    );
    @if(coat_normals) { factors.normal = select(factors.normal, texel.xyz, texture == CLEARCOAT_NORMAL_TEXTURE); }
    return factors;
}

@if(clearcoat)
fn clearcoat_lobe(material: u32, factors: ClearcoatFactors, context: LobeContext) -> Clearcoat {
    var coat = bitcast<vec4f>(load_material_texel(material + CLEARCOAT_TEXEL)).xy;
    @if(textures) { coat *= factors.coat; }
    var lobe: Clearcoat;
    lobe.factor = coat.x;
    lobe.alpha = coat.y * coat.y;
    @if(coat_normals) { lobe.normal = coat_normal_at(material, factors, context); }
    return lobe;
}

// The coat's normal. A coat without a normal map is smooth, whatever its base.
@if(coat_normals)
fn coat_normal_at(material: u32, factors: ClearcoatFactors, context: LobeContext) -> vec3f {
    var normal = context.unmapped_normal;
    @if(textures) {
        if texture_info(material, CLEARCOAT_NORMAL_TEXTURE) != 0u {
            let scale = bitcast<f32>(load_material_texel(material + CLEARCOAT_TEXEL).z);
            normal = mapped_normal(context.hit, factors.normal, scale, context.unmapped_normal, context.front);
        }
    }
    return bent_to(normal, context.view);
}

// The coat with its normal bent to a viewer.
@if(clearcoat)
fn clearcoat_seen_from(lobe: Clearcoat, view: vec3f) -> Clearcoat {
    var seen = lobe;
    @if(coat_normals) { seen.normal = bent_to(lobe.normal, view); }
    return seen;
}

// The coat from the other side.
@if(clearcoat)
fn clearcoat_turned(lobe: Clearcoat) -> Clearcoat {
    var turned = lobe;
    @if(coat_normals) { turned.normal = -lobe.normal; }
    return turned;
}

@if(clearcoat)
fn clearcoat_is_present(lobe: Clearcoat) -> bool {
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

// Whether the coat may have another normal than the base.
@if(clearcoat)
fn clearcoat_has_normal() -> bool {
    @if(coat_normals) { return true; }
    @else { return false; }
}

// Axes about the coat's normal. `frame` has those about the shading normal.
@if(clearcoat)
fn clearcoat_axes(lobe: Clearcoat, frame: mat3x3f) -> mat3x3f {
    @if(coat_normals) { return basis(lobe.normal); }
    @else { return frame; }
}

// Light and view in the frame of the coat's normal.
@if(clearcoat)
fn clearcoat_pair(lobe: Clearcoat, pair: LayerPair) -> LocalPair {
    @if(coat_normals) { return pair_in_frame(basis(lobe.normal), pair.view, pair.light, vec2f(lobe.alpha)); }
    @else { return with_alpha(pair.local, vec2f(lobe.alpha)); }
}

// Whether both the surface itself and the coat's normal face the direction. `faced` is whether the surface itself and
// the shading normal do.
@if(clearcoat)
fn clearcoat_faces(lobe: Clearcoat, geometric_normal: vec3f, direction: vec3f, faced: bool) -> bool {
    @if(coat_normals) { return (dot(direction, geometric_normal) > 0.0) & (dot(direction, lobe.normal) > 0.0); }
    @else { return faced; }
}

// Cosines of light and view to the coat's normal, for light that reaches the base from outside or leaves it on the
// inside.
@if(clearcoat)
fn coat_heights(lobe: Clearcoat, pair: LayerPair) -> vec2f {
    @if(coat_normals) {
        let light = dot(pair.light, lobe.normal) * sign(pair.local.light.z);
        return vec2f(light, coat_view_height(lobe, pair));
    }
    @else { return vec2f(abs(pair.local.light.z), pair.local.view.z); }
}

@if(clearcoat)
fn coat_view_height(lobe: Clearcoat, pair: LayerPair) -> f32 {
    @if(coat_normals) { return max(dot(pair.view, lobe.normal), MIN_VIEW_COSINE); }
    @else { return pair.local.view.z; }
}

// The share of light that the coat transmits to the layers below, by the cosines of light and view to its normal.
@if(clearcoat)
fn through_coat(lobe: Clearcoat, heights: vec2f) -> f32 {
    return 1.0 - lobe.factor * (1.0 - through_layer(COAT_REFLECTANCES, lobe.alpha, heights.x, heights.y));
}

@if(clearcoat)
fn clearcoat_through(lobe: Clearcoat, pair: LayerPair) -> f32 {
    return through_coat(lobe, coat_heights(lobe, pair));
}

// The BSDF of the coat; `pair` is in the frame of its own normal.
@if(clearcoat)
fn clearcoat_value(lobe: Clearcoat, pair: LocalPair) -> vec3f {
    let h = normalize(pair.view + pair.light);
    let fresnel = mix(COAT_REFLECTANCES.x, COAT_REFLECTANCES.y, schlick(dot(pair.view, h)));
    return vec3f(lobe.factor * fresnel * microfacets(pair, h));
}

// Upper bound of the density of directions sampled from the coat, for a view at the given cosine to the base's normal;
// 0 without a coat.
@if(clearcoat)
fn clearcoat_max_density(lobe: Clearcoat, view: vec3f, view_z: f32) -> f32 {
    @if(coat_normals) let height = max(dot(view, lobe.normal), MIN_VIEW_COSINE);
    @if(!coat_normals) let height = view_z;
    return select(0.0, max_visible_density(height, vec2f(lobe.alpha)), clearcoat_is_present(lobe));
}

// The probability of sampling the coat, if the layers below reflect `below` straight back; bounded as in
// `lobe_chances`.
@if(clearcoat)
fn clearcoat_chance(lobe: Clearcoat, pair: LayerPair, below: f32) -> LayerChance {
    let through = through_coat(lobe, vec2f(coat_view_height(lobe, pair)));
    let coat = 3.0 * (1.0 - through);
    let all = coat + through * below;
    return LayerChance(select(0.0, clamp(coat / all, 0.1, 0.9), lobe.factor > 0.0), all);
}

// Means over all directions: the shares of light that the coat reflects and that reach the layers below, and by how
// much more it keeps at grazing than at normal incidence. A coat whose normal differs from the surface's by an angle is
// seen at grazing angles more often, and loses what it reflects below the surface's horizon. The fits are those of
// integrals over views to which the normal is bent, for angles up to 45 degrees: the errors are at most 0.005.
@if(clearcoat)
fn clearcoat_seen_afar(lobe: Clearcoat, geometric_normal: vec3f) -> vec3f {
    let means = lobe_means(lobe.alpha);
    var parts = vec2f(COAT_REFLECTANCES.x, COAT_REFLECTANCES.y - COAT_REFLECTANCES.x) * means;
    var grazing = LOWER_SCHLICK;
    @if(coat_normals) {
        let away = 1.0 - min(dot(lobe.normal, geometric_normal), 1.0);
        parts.x *= 1.0 - 1.6 * pow(1.0 - lobe.alpha, 1.6) * away;
        parts.y /= 1.0 + 17.0 * away / (1.0 + 31.0 * lobe.alpha);
        grazing += 1.8 * away / (1.0 + 1.2 * sqrt(away));
    }
    let rise = layer_rise(COAT_REFLECTANCES, lobe.alpha);
    let through = 1.0 - lobe.factor * (COAT_REFLECTANCES.x + rise * grazing);
    return vec3f(lobe.factor * max(parts.x + parts.y, 0.0), max(through, 0.0), lobe.factor * rise);
}
