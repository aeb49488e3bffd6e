// The lobes of a surface: reading them from a material and its textures, and packing them. `@each` repeats a line for
// every lobe that src/specialisation/lobes.rs lists, `NAME` and `Name` stand for its name and type: see
// src/kernels/each.rs.

import package::lib::math::{oct_decode16, oct_encode16};
import package::lib::ray::Hit;
import package::lib::shading_normal::bent_to;
@if(textures) import package::lib::attributes::uv_at;
@if(textures) import package::lib::material::{material_flags, texture_info};
@if(textures) import package::lib::texture::texture_at;
@if(textures) import package::lib::constants::{BASE_COLOUR_TEXTURE, EMISSION_TEXTURE, MATERIAL_FLAG_BITS};
@if(normal_maps && textures) import package::lib::constants::NORMAL_TEXTURE;
@if(glossy && textures) import package::lib::constants::{METALLIC_ROUGHNESS_TEXTURE, SPECULAR_TEXTURES};
@if(glossy) import package::lib::constants::SURFACE_TEXEL;
@if(glossy) import package::lib::material::load_material_texel;
@if(glossy) import package::lib::bsdf::lobe::LobeContext;
@if(glossy) import package::lib::bsdf::specular::{
    PackedSpecular, Specular, pack_specular, specular_factors, specular_lobe, unpack_specular,
};
@if(glossy && textures) import package::lib::bsdf::specular::specular_texture;
@each(lobe) import package::lib::bsdf::NAME::{
    Name, NameFactors, NAME_is_present, NAME_lobe, NAME_untextured, pack_NAME, unpack_NAME,
};
@each(lobe && textures) import package::lib::bsdf::NAME::{NAME_texture, NAME_textures};
@each(base) import package::lib::bsdf::NAME::{NAME_base, NAME_blocked, NAME_turned};
@each(glossy_layer) import package::lib::bsdf::NAME::{NAME_seen_from, NAME_turned};

// A surface as a viewer sees it. The normals are on the viewer's side.
struct Surface {
    // Reflectance of the diffuse base: base colour times (1 - metallic) times (1 - transmission).
    albedo: vec3f,
    @if(glossy) specular: Specular,
    @each(lobe) NAME: Name,
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
    @each(lobe) NAME: NameFactors,
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
    @each(lobe) { factors.NAME = NAME_untextured(); }
    return factors;
}

// A bit for each texture that may change the image.
@if(textures)
fn read_textures() -> u32 {
    var read = (1u << BASE_COLOUR_TEXTURE) | (1u << EMISSION_TEXTURE);
    @if(normal_maps) { read |= 1u << NORMAL_TEXTURE; }
    @if(glossy) { read |= (1u << METALLIC_ROUGHNESS_TEXTURE) | SPECULAR_TEXTURES; }
    @each(lobe) { read |= NAME_textures(); }
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
        @each(lobe) { factors.NAME = NAME_texture(factors.NAME, texel, texture); }
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
    unmapped_normal: vec3f,
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
        let around = LobeContext(
            context.hit,
            context.front,
            s.albedo,
            1.0 - metallic,
            s.specular.alpha,
            s.shading_normal,
            context.unmapped_normal,
            s.view,
        );
        @each(lobe) {
            var factors = NAME_untextured();
            @if(textures) { factors = context.factors.NAME; }
            s.NAME = NAME_lobe(material, factors, around);
        }
        @each(base && textures) { s.albedo = NAME_base(material, context.factors.NAME, s.albedo); }
        @each(base && !textures) { s.albedo = NAME_base(material, NAME_untextured(), s.albedo); }
    }
    return s;
}

// The surface as a viewer in another direction on the same side sees it: with normals bent towards this viewer. Normals
// that are bent already, to a viewer behind the unbent ones, stay so: light from that viewer's direction counts next to
// nothing.
fn seen_from(s: Surface, view: vec3f) -> Surface {
    var seen = s;
    seen.view = view;
    seen.shading_normal = bent_to(s.shading_normal, view);
    @each(glossy_layer) { seen.NAME = NAME_seen_from(s.NAME, view); }
    return seen;
}

// The surface as a viewer on the other side sees it.
@if(transmission)
fn seen_through(s: Surface, view: vec3f) -> Surface {
    var turned = s;
    turned.geometric_normal = -s.geometric_normal;
    turned.shading_normal = -s.shading_normal;
    @each(base) { turned.NAME = NAME_turned(s.NAME); }
    @each(glossy_layer) { turned.NAME = NAME_turned(s.NAME); }
    return seen_from(turned, view);
}

// The surface without diffuse reflection and transmission, for unlit materials.
fn without_light(lit: Surface) -> Surface {
    var s = lit;
    s.albedo = vec3f(0.0);
    @each(base) { s.NAME = NAME_blocked(s.NAME); }
    return s;
}

// Whether light passes through the surface.
@if(transmission)
fn passes_light(s: Surface) -> bool {
    var passes = false;
    @each(base) { passes |= NAME_is_present(s.NAME); }
    return passes;
}

// ---- Packing

struct PackedSurface {
    // Albedo, and the shading normal (oct_encode16).
    base: vec4f,
    @if(glossy) specular: PackedSpecular,
    @each(lobe) NAME: vec4f,
}

fn pack_surface(s: Surface) -> PackedSurface {
    var p: PackedSurface;
    p.base = vec4f(s.albedo, bitcast<f32>(oct_encode16(s.shading_normal)));
    @if(glossy) { p.specular = pack_specular(s.specular); }
    @each(lobe) { p.NAME = pack_NAME(s.NAME); }
    return p;
}

fn unpack_surface(p: PackedSurface, geometric_normal: vec3f, view: vec3f) -> Surface {
    var s: Surface;
    s.albedo = p.base.xyz;
    s.shading_normal = oct_decode16(bitcast<u32>(p.base.w));
    s.geometric_normal = geometric_normal;
    s.view = view;
    @if(glossy) { s.specular = unpack_specular(p.specular); }
    @each(lobe) { s.NAME = unpack_NAME(p.NAME); }
    return s;
}

// Whether the surface has a lobe besides its diffuse base.
@if(glossy)
fn reflects_beyond_diffuse(p: PackedSurface) -> bool {
    var beyond = any(p.specular.reflectance != vec4f(0.0));
    @each(base) { beyond = beyond || NAME_is_present(unpack_NAME(p.NAME)); }
    @each(film) { beyond = beyond || NAME_is_present(unpack_NAME(p.NAME)); }
    @each(layer) { beyond = beyond || NAME_is_present(unpack_NAME(p.NAME)); }
    return beyond;
}
