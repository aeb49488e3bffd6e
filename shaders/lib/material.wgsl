// The table of materials: the members that every material has. The files of lib/bsdf/ read the members of their lobes.
// src/scene/material.rs makes the table.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::attributes::{material_index, surface_texel_of};
@if(textures) import package::lib::attributes::uv_at;
@if(vertex_colours) import package::lib::attributes::vertex_colour_at;
@if(textures) import package::lib::texture::texture_at;
import package::lib::constants::{
    BASE_COLOUR_TEXEL, BASE_COLOUR_TEXTURE, EMISSION_TEXEL, EMISSION_TEXTURE, MATERIAL_TEXELS,
    SURFACE_TEXEL, TEXTURES_TEXEL,
};

@if(texture_loads) @group(1) @binding(3) var material_texels: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(3) var<storage, read> material_texels: array<vec4u>;

fn load_material_texel(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(material_texels, table_texel(i)); }
    @if(!texture_loads) { return material_texels[i]; }
}

// Index of the first texel of a material.
fn material_at(index: u32) -> u32 {
    return index * MATERIAL_TEXELS;
}

// Index of the first texel of a triangle's material.
fn material_of(triangle: u32) -> u32 {
    return material_at(material_index(surface_texel_of(triangle).w));
}

// Flags, and above them a bit for each texture that the material has.
fn material_flags(material: u32) -> u32 {
    return load_material_texel(material + TEXTURES_TEXEL).x;
}

// Number of the texture info, counted from 1, for a use of textures by the material; 0 for none.
@if(textures)
fn texture_info(material: u32, texture: u32) -> u32 {
    let word = texture + 1u;
    return load_material_texel(material + TEXTURES_TEXEL + (word >> 2u))[word & 3u];
}

// Alpha of the base colour at a point of a triangle, and the material's flags and cutoff.
struct Alpha {
    value: f32,
    cutoff: f32,
    flags: u32,
}

@if(alpha_test)
fn alpha_at(triangle: u32, u: f32, v: f32) -> Alpha {
    let material = material_of(triangle);
    var alpha = bitcast<f32>(load_material_texel(material + BASE_COLOUR_TEXEL).w);
    @if(textures) {
        let info = texture_info(material, BASE_COLOUR_TEXTURE);
        if info != 0u { alpha *= texture_at(info, uv_at(triangle, u, v)).w; }
    }
    @if(vertex_colours) { alpha *= vertex_colour_at(triangle, u, v).w; }
    let cutoff = bitcast<f32>(load_material_texel(material + SURFACE_TEXEL).w);
    return Alpha(alpha, cutoff, material_flags(material));
}

// Radiance that a point of a triangle emits on its front (and on its back if the material is double-sided).
fn emission_at(triangle: u32, u: f32, v: f32) -> vec3f {
    let material = material_of(triangle);
    var emission = bitcast<vec3f>(load_material_texel(material + EMISSION_TEXEL).xyz);
    @if(textures) {
        let info = texture_info(material, EMISSION_TEXTURE);
        if info != 0u { emission *= texture_at(info, uv_at(triangle, u, v)).xyz; }
    }
    return emission;
}
