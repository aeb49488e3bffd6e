// The lobes of a surface: reading them from a material and its textures, and packing them.

import package::lib::math::{oct_decode16, oct_encode16};
import package::lib::ray::Hit;
@if(textures) import package::lib::attributes::uv_at;
@if(textures) import package::lib::material::{material_flags, texture_info};
@if(textures) import package::lib::texture::texture_at;
@if(textures) import package::lib::constants::{BASE_COLOUR_TEXTURE, EMISSION_TEXTURE, MATERIAL_FLAG_BITS};
@if(normal_maps && textures) import package::lib::constants::NORMAL_TEXTURE;
@if(glossy && textures) import package::lib::constants::{METALLIC_ROUGHNESS_TEXTURE, SPECULAR_TEXTURES};
@if(glossy) import package::lib::constants::SURFACE_TEXEL;
@if(glossy) import package::lib::material::load_material_texel;
@if(glossy) import package::lib::bsdf::specular::{
    PackedSpecular, Specular, pack_specular, specular_factors, specular_lobe, unpack_specular,
};
@if(glossy && textures) import package::lib::bsdf::specular::specular_texture;
@if(transmission) import package::lib::bsdf::transmission::{
    Transmission, is_transmissive, pack_transmission, transmission_factor, transmission_lobe, unpack_transmission,
};
@if(transmission && textures) import package::lib::bsdf::transmission::transmission_texture;
@if(transmission && textures) import package::lib::constants::TRANSMISSION_TEXTURES;
@if(clearcoat) import package::lib::bsdf::clearcoat::{
    Clearcoat, clearcoat_lobe, is_coated, pack_clearcoat, unpack_clearcoat,
};
@if(clearcoat && textures) import package::lib::bsdf::clearcoat::{clearcoat_texture, clearcoat_textures};
@if(coat_normals) import package::lib::bsdf::clearcoat::coat_normal_at;
@if(coat_normals && textures) import package::lib::bsdf::clearcoat::coat_normal_texture;
@if(anisotropy) import package::lib::bsdf::anisotropy::{
    ANISOTROPY_UNTEXTURED, Anisotropy, anisotropy_lobe, pack_anisotropy, unpack_anisotropy,
};
@if(anisotropy && textures) import package::lib::bsdf::anisotropy::anisotropy_texture;
@if(anisotropy && textures) import package::lib::constants::ANISOTROPY_TEXTURES;
@if(sheen) import package::lib::bsdf::sheen::{Sheen, has_fibres, pack_sheen, sheen_lobe, unpack_sheen};
@if(sheen && textures) import package::lib::bsdf::sheen::sheen_texture;
@if(sheen && textures) import package::lib::constants::SHEEN_TEXTURES;

@if(iridescence) import package::lib::bsdf::iridescence::{
    has_film, iridescence_lobe, pack_iridescence, unpack_iridescence,
};
@if(iridescence && textures) import package::lib::bsdf::iridescence::iridescence_texture;
@if(iridescence && textures) import package::lib::constants::IRIDESCENCE_TEXTURES;

// A surface as a viewer sees it. The normals are on the viewer's side.
struct Surface {
    // Reflectance of the diffuse base: base colour times (1 - metallic) times (1 - transmission).
    albedo: vec3f,
    @if(glossy) specular: Specular,
    @if(anisotropy) anisotropy: Anisotropy,
    @if(transmission) transmission: Transmission,
    @if(clearcoat) clearcoat: Clearcoat,
    @if(sheen) sheen: Sheen,
    // The surface's own normal: the triangle's, or the corners' interpolated, where the triangle approximates a smooth
    // surface.
    geometric_normal: vec3f,
    shading_normal: vec3f,
    // Unit vector towards the viewer.
    view: vec3f,
}

// ---- Textures

// The factors by which textures multiply a material at a point; 1 without a texture.
@if(textures)
struct TextureFactors {
    base: vec3f,
    emission: vec3f,
    @if(normal_maps) normal: vec3f,
    @if(glossy) roughness_metallic: vec2f,
    @if(glossy) specular: vec4f,
    @if(transmission) transmission: f32,
    @if(clearcoat) clearcoat: vec2f,
    @if(coat_normals) coat_normal: vec3f,
    @if(anisotropy) anisotropy: vec3f,
    @if(sheen) sheen: vec4f,
    @if(iridescence) iridescence: vec2f,
}

@if(textures)
fn untextured() -> TextureFactors {
    var factors: TextureFactors;
    factors.base = vec3f(1.0);
    factors.emission = vec3f(1.0);
    @if(glossy) {
        factors.roughness_metallic = vec2f(1.0);
        factors.specular = vec4f(1.0);
    }
    @if(transmission) { factors.transmission = 1.0; }
    @if(clearcoat) { factors.clearcoat = vec2f(1.0); }
    @if(anisotropy) { factors.anisotropy = ANISOTROPY_UNTEXTURED; }
    @if(sheen) { factors.sheen = vec4f(1.0); }
    @if(iridescence) { factors.iridescence = vec2f(1.0); }
    return factors;
}

// A bit for each texture that may change the image.
@if(textures)
fn read_textures() -> u32 {
    var read = (1u << BASE_COLOUR_TEXTURE) | (1u << EMISSION_TEXTURE);
    @if(normal_maps) { read |= 1u << NORMAL_TEXTURE; }
    @if(glossy) { read |= (1u << METALLIC_ROUGHNESS_TEXTURE) | SPECULAR_TEXTURES; }
    @if(transmission) { read |= TRANSMISSION_TEXTURES; }
    @if(clearcoat) { read |= clearcoat_textures(); }
    @if(anisotropy) { read |= ANISOTROPY_TEXTURES; }
    @if(sheen) { read |= SHEEN_TEXTURES; }
    @if(iridescence) { read |= IRIDESCENCE_TEXTURES; }
    return read;
}

// Looks up the material's textures at a hit, one loop iteration for each texture. With an `if` per texture instead,
// software devices would do six look-ups for materials with one texture, as they run the body of an `if` for every
// lane.
@if(textures)
fn texture_factors(material: u32, hit: Hit) -> TextureFactors {
    let uv = uv_at(hit.triangle, hit.u, hit.v);
    var factors = untextured();
    var left = (material_flags(material) >> MATERIAL_FLAG_BITS) & read_textures();
    while left != 0u {
        let texture = firstTrailingBit(left);
        left &= left - 1u;
        let texel = texture_at(texture_info(material, texture), uv);
        factors.base = select(factors.base, texel.xyz, texture == BASE_COLOUR_TEXTURE);
        factors.emission = select(factors.emission, texel.xyz, texture == EMISSION_TEXTURE);
        @if(normal_maps) { factors.normal = select(factors.normal, texel.xyz, texture == NORMAL_TEXTURE); }
        @if(glossy) {
            let of_metal = texture == METALLIC_ROUGHNESS_TEXTURE;
            factors.roughness_metallic = select(factors.roughness_metallic, texel.yz, of_metal);
            factors.specular = specular_texture(factors.specular, texel, texture);
        }
        @if(transmission) { factors.transmission = transmission_texture(factors.transmission, texel, texture); }
        @if(clearcoat) { factors.clearcoat = clearcoat_texture(factors.clearcoat, texel, texture); }
        @if(coat_normals) { factors.coat_normal = coat_normal_texture(factors.coat_normal, texel, texture); }
        @if(anisotropy) { factors.anisotropy = anisotropy_texture(factors.anisotropy, texel, texture); }
        @if(sheen) { factors.sheen = sheen_texture(factors.sheen, texel, texture); }
        @if(iridescence) { factors.iridescence = iridescence_texture(factors.iridescence, texel, texture); }
    }
    return factors;
}

// ---- Lobes of a material

// The hit of a ray, and facts about the surface there.
struct HitContext {
    hit: Hit,
    // Whether the ray came from outside.
    front: bool,
    // The material's metallic factor, which the table stores beside its emission.
    @if(glossy) metallic: f32,
    // The shading normal without any map.
    @if(coat_normals) unmapped: vec3f,
    @if(textures) factors: TextureFactors,
}

// Adds the lobes of a material with a base colour to a surface that has its normals and view.
fn add_lobes(bare: Surface, material: u32, base: vec3f, context: HitContext) -> Surface {
    var s = bare;
    s.albedo = base;
    @if(glossy) {
        let own = bitcast<vec4f>(load_material_texel(material + SURFACE_TEXEL));
        var roughness = own.x;
        var metallic = context.metallic;
        var specular = specular_factors(material);
        @if(textures) {
            roughness *= context.factors.roughness_metallic.x;
            metallic *= context.factors.roughness_metallic.y;
            specular *= context.factors.specular;
        }
        s.albedo = base * (1.0 - metallic);
        s.specular = specular_lobe(base, metallic, roughness, own.y, specular);
    }
    @if(transmission) {
        var passing = transmission_factor(material);
        @if(textures) { passing *= context.factors.transmission; }
        s.transmission = transmission_lobe(material, s.albedo * passing, context.front);
        s.albedo *= 1.0 - passing;
    }
    @if(clearcoat && textures) { s.clearcoat = clearcoat_lobe(material, context.factors.clearcoat); }
    @if(clearcoat && !textures) { s.clearcoat = clearcoat_lobe(material, vec2f(1.0)); }
    @if(coat_normals) {
        var texel = vec3f(0.0);
        @if(textures) { texel = context.factors.coat_normal; }
        s.clearcoat.normal = coat_normal_at(material, texel, context.hit, context.unmapped, context.front, s.view);
    }
    @if(anisotropy) {
        var factors = ANISOTROPY_UNTEXTURED;
        @if(textures) { factors = context.factors.anisotropy; }
        let alpha = s.specular.alpha;
        s.anisotropy = anisotropy_lobe(material, factors, alpha, context.hit, s.shading_normal, context.front);
    }
    @if(sheen && textures) { s.sheen = sheen_lobe(material, context.factors.sheen); }
    @if(sheen && !textures) { s.sheen = sheen_lobe(material, vec4f(1.0)); }
    @if(iridescence && textures) { s.specular.film = iridescence_lobe(material, context.factors.iridescence); }
    @if(iridescence && !textures) { s.specular.film = iridescence_lobe(material, vec2f(1.0)); }
    return s;
}

// The surface without diffuse reflection and transmission, for unlit materials.
fn without_light(lit: Surface) -> Surface {
    var s = lit;
    s.albedo = vec3f(0.0);
    @if(transmission) { s.transmission.tint = vec3f(0.0); }
    return s;
}

// ---- Packing

struct PackedSurface {
    // Albedo, and the shading normal (oct_encode16).
    base: vec4f,
    @if(glossy) specular: PackedSpecular,
    @if(transmission) transmission: vec4f,
    @if(clearcoat) clearcoat: vec4f,
    @if(anisotropy) anisotropy: vec4f,
    @if(sheen) sheen: vec4f,
    @if(iridescence) iridescence: vec4f,
}

fn pack_surface(s: Surface) -> PackedSurface {
    var p: PackedSurface;
    p.base = vec4f(s.albedo, bitcast<f32>(oct_encode16(s.shading_normal)));
    @if(glossy) { p.specular = pack_specular(s.specular); }
    @if(transmission) { p.transmission = pack_transmission(s.transmission); }
    @if(clearcoat) { p.clearcoat = pack_clearcoat(s.clearcoat); }
    @if(anisotropy) { p.anisotropy = pack_anisotropy(s.anisotropy); }
    @if(sheen) { p.sheen = pack_sheen(s.sheen); }
    @if(iridescence) { p.iridescence = pack_iridescence(s.specular.film); }
    return p;
}

fn unpack_surface(p: PackedSurface, geometric_normal: vec3f, view: vec3f) -> Surface {
    var s: Surface;
    s.albedo = p.base.xyz;
    s.shading_normal = oct_decode16(bitcast<u32>(p.base.w));
    s.geometric_normal = geometric_normal;
    s.view = view;
    @if(glossy) { s.specular = unpack_specular(p.specular); }
    @if(transmission) { s.transmission = unpack_transmission(p.transmission); }
    @if(clearcoat) { s.clearcoat = unpack_clearcoat(p.clearcoat); }
    @if(anisotropy) { s.anisotropy = unpack_anisotropy(p.anisotropy); }
    @if(sheen) { s.sheen = unpack_sheen(p.sheen); }
    @if(iridescence) { s.specular.film = unpack_iridescence(p.iridescence); }
    return s;
}

// Whether the surface has a lobe besides its diffuse base.
@if(glossy)
fn reflects_beyond_diffuse(p: PackedSurface) -> bool {
    var beyond = any(p.specular.reflectance != vec4f(0.0));
    @if(transmission) { beyond = beyond || is_transmissive(unpack_transmission(p.transmission)); }
    @if(clearcoat) { beyond = beyond || is_coated(unpack_clearcoat(p.clearcoat)); }
    @if(sheen) { beyond = beyond || has_fibres(unpack_sheen(p.sheen)); }
    @if(iridescence) { beyond = beyond || has_film(unpack_iridescence(p.iridescence)); }
    return beyond;
}
