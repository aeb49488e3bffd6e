// The triangles of the BVH, BVH_TRIANGLE_TEXELS texels each, and behind them the instances (lib/instance). In: the
// index of a texel. Out: the texel.

@if(texture_loads && !layered_texels) import package::lib::table::table_texel;
@if(layered_texels) import package::lib::table::{layer_texel, table_layer};

@if(layered_texels)
@group(1) @binding(1) var bvh_triangles: texture_storage_2d_array<rgba32float, read>;
@if(texture_loads && !layered_texels)
@group(1) @binding(1) var bvh_triangles: texture_storage_2d<rgba32float, read>;
@if(!texture_loads && !layered_texels)
@group(1) @binding(1) var<storage, read> bvh_triangles: array<vec4f>;

fn triangle_texel(i: u32) -> vec4f {
    @if(layered_texels) { return textureLoad(bvh_triangles, layer_texel(i), table_layer(i)); }
    @if(texture_loads && !layered_texels) { return textureLoad(bvh_triangles, table_texel(i)); }
    @if(!texture_loads && !layered_texels) { return bvh_triangles[i]; }
}
