// Attributes of triangles besides the corners' positions: material, normals, texture coordinates, colours and tangents.
// src/gpu_scene/surfaces.rs makes the table.

@if(texture_loads && !layered_texels) import package::lib::table::table_texel;
@if(layered_texels) import package::lib::table::{layer_texel, table_layer};
@if(instances) import package::lib::instance::{placed_tangent, stored_triangle};
import package::lib::math::oct_decode16;
import package::lib::constants::SURFACE_FLAT;

// Number of texels per triangle, and the offsets of the texels that not every scene has.
override surface_stride: u32;
@if(textures) override uv_offset: u32;
@if(vertex_colours) override colour_offset: u32;
override tangent_offset: u32;

@if(layered_texels)
@group(1) @binding(2) var surface_texels: texture_storage_2d_array<rgba32uint, read>;
@if(texture_loads && !layered_texels)
@group(1) @binding(2) var surface_texels: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads && !layered_texels)
@group(1) @binding(2) var<storage, read> surface_texels: array<vec4u>;

fn load_surface_texel(i: u32) -> vec4u {
    @if(layered_texels) { return textureLoad(surface_texels, layer_texel(i), table_layer(i)); }
    @if(texture_loads && !layered_texels) { return textureLoad(surface_texels, table_texel(i)); }
    @if(!texture_loads && !layered_texels) { return surface_texels[i]; }
}

// The three corners' shading normals (oct_encode16), and the triangle's material with SURFACE_FLAT.
fn surface_texel_of(triangle: u32) -> vec4u {
    @if(instances) return load_surface_texel(stored_triangle(triangle) * surface_stride);
    @if(!instances) return load_surface_texel(triangle * surface_stride);
}

// Index of the material in a triangle's fourth word.
fn material_index(word: u32) -> u32 {
    return word & ~SURFACE_FLAT;
}

// Texture coordinates 0 and 1 of a point of a triangle.
@if(textures)
struct Uv {
    set0: vec2f,
    @if(uv1) set1: vec2f,
}

@if(textures)
fn uv_at(triangle: u32, u: f32, v: f32) -> Uv {
    @if(instances) let base = stored_triangle(triangle) * surface_stride + uv_offset;
    @if(!instances) let base = triangle * surface_stride + uv_offset;
    let a = bitcast<vec4f>(load_surface_texel(base));
    let b = bitcast<vec4f>(load_surface_texel(base + 1u));
    let w = 1.0 - u - v;
    let set0 = w * a.xy + u * a.zw + v * b.xy;
    @if(uv1) {
        let c = bitcast<vec4f>(load_surface_texel(base + 2u));
        return Uv(set0, w * b.zw + u * c.xy + v * c.zw);
    }
    @if(!uv1) { return Uv(set0); }
}

@if(vertex_colours)
fn vertex_colour_at(triangle: u32, u: f32, v: f32) -> vec4f {
    @if(instances) let base = stored_triangle(triangle) * surface_stride + colour_offset;
    @if(instances) let a = load_surface_texel(base);
    @if(instances) let b = load_surface_texel(base + 1u);
    @if(!instances) let a = load_surface_texel(triangle * surface_stride + colour_offset);
    @if(!instances) let b = load_surface_texel(triangle * surface_stride + colour_offset + 1u);
    let c0 = vec4f(unpack2x16unorm(a.x), unpack2x16unorm(a.y));
    let c1 = vec4f(unpack2x16unorm(a.z), unpack2x16unorm(a.w));
    let c2 = vec4f(unpack2x16unorm(b.x), unpack2x16unorm(b.y));
    return (1.0 - u - v) * c0 + u * c1 + v * c2;
}

// Tangent and bitangent for a normal on the outer side; zeros where the tangent is parallel to the normal: what is
// shorter than 1e-6 is rounding of unit vectors.
fn tangent_frame(triangle: u32, u: f32, v: f32, normal: vec3f) -> mat2x3f {
    @if(instances) let texel = load_surface_texel(stored_triangle(triangle) * surface_stride + tangent_offset);
    @if(!instances) let texel = load_surface_texel(triangle * surface_stride + tangent_offset);
    let w = 1.0 - u - v;
    @if(!instances) let t = w * oct_decode16(texel.x) + u * oct_decode16(texel.y) + v * oct_decode16(texel.z);
    @if(instances) let t = w * placed_tangent(triangle, oct_decode16(texel.x))
        + u * placed_tangent(triangle, oct_decode16(texel.y)) + v * placed_tangent(triangle, oct_decode16(texel.z));
    let across = t - normal * dot(t, normal);
    if dot(across, across) < 1e-12 { return mat2x3f(); }
    let tangent = normalize(across);
    return mat2x3f(tangent, cross(normal, tangent) * select(1.0, -1.0, (texel.w & 1u) != 0u));
}
