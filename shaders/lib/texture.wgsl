// Textures of materials: image texels by wrap mode and filter (glTF 2.0, 3.8; KHR_texture_transform).

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::attributes::Uv;
import package::kit::TABLE_WIDTH_LOG2;
import package::lib::constants::{
    TEXTURE_INFO_TEXELS, TEXTURE_NEAREST, TEXTURE_SRGB, TEXTURE_UV1, LAYER_TEXELS_LOG2,
};

// For each texture info: the matrix; offset and flags; first texel of the image, its width and its height.
@if(texture_loads) @group(1) @binding(4) var texture_infos: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(4) var<storage, read> texture_infos: array<vec4u>;
@group(1) @binding(5) var colour_texels: texture_2d_array<f32>;
@group(1) @binding(6) var data_texels: texture_2d_array<f32>;

fn load_texture_info_texel(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(texture_infos, table_texel(i)); }
    @if(!texture_loads) { return texture_infos[i]; }
}

// Wraps a texel coordinate to 0 .. size - 1 by the mode: 0 repeat, 1 mirror, 2 clamp.
fn wrap_texel(coordinate: i32, size: i32, mode: u32) -> u32 {
    if mode == 2u { return u32(clamp(coordinate, 0, size - 1)); }
    let period = select(size, 2 * size, mode == 1u);
    // Not by %, which software devices compute lane by lane. Coordinates lie between -2 and slightly above twice the
    // size, so the quotient is too small for its rounding error to reach the 0.5 that keeps it away from integers.
    let inside = coordinate - period * i32(floor((f32(coordinate) + 0.5) / f32(period)));
    return u32(select(inside, period - 1 - inside, inside >= size));
}

fn load_image_texel(i: u32, srgb: bool) -> vec4f {
    let width_mask = (1u << TABLE_WIDTH_LOG2) - 1u;
    let at = vec2u(i & width_mask, (i >> TABLE_WIDTH_LOG2) & width_mask);
    let layer = i >> LAYER_TEXELS_LOG2;
    if srgb { return textureLoad(colour_texels, at, layer, 0); }
    return textureLoad(data_texels, at, layer, 0);
}

// The texture of info `number` (counted from 1) at a point.
fn texture_at(number: u32, uv: Uv) -> vec4f {
    let base = (number - 1u) * TEXTURE_INFO_TEXELS;
    let m = bitcast<vec4f>(load_texture_info_texel(base));
    let placement = load_texture_info_texel(base + 1u);
    let image = load_texture_info_texel(base + 2u);
    let flags = placement.z;
    var coordinate = uv.set0;
    @if(uv1) { if (flags & TEXTURE_UV1) != 0u { coordinate = uv.set1; } }
    coordinate = m.xy * coordinate.x + m.zw * coordinate.y + bitcast<vec2f>(placement.xy);
    let size = vec2i(image.yz);
    let srgb = (flags & TEXTURE_SRGB) != 0u;
    let wrap = vec2u(flags & 3u, (flags >> 2u) & 3u);
    // Far outside the image only the position within the repeated tile counts: reduce it to a range where integers and
    // floats are exact.
    let texel = (coordinate - select(vec2f(0.0), 2.0 * floor(0.5 * coordinate), wrap != vec2u(2u))) * vec2f(size);
    let bounded = clamp(texel, vec2f(-1.0), 2.0 * vec2f(size) + 1.0);
    let is_nearest = (flags & TEXTURE_NEAREST) != 0u;
    let first = select(bounded - 0.5, bounded, is_nearest);
    let corner = floor(first);
    let f = first - corner;
    let at = vec2i(corner);
    var top_left = vec4f(0.0);
    var top_right = vec4f(0.0);
    var bottom_left = vec4f(0.0);
    var bottom_right = vec4f(0.0);
    // A loop, as lavapipe takes long to compile each place that loads a texel. On other devices the number of
    // iterations is constant: drivers can unroll the loop, so that the four loads do not wait for each other.
    @if(texture_loads) let count = select(4u, 1u, is_nearest);
    @if(!texture_loads) let count = 4u;
    for (var i = 0u; i < count; i++) {
        let x = wrap_texel(at.x + i32(i & 1u), size.x, wrap.x);
        let y = wrap_texel(at.y + i32(i >> 1u), size.y, wrap.y);
        let loaded = load_image_texel(image.x + y * image.y + x, srgb);
        top_left = select(top_left, loaded, i == 0u);
        top_right = select(top_right, loaded, i == 1u);
        bottom_left = select(bottom_left, loaded, i == 2u);
        bottom_right = loaded;
    }
    if is_nearest { return top_left; }
    return mix(mix(top_left, top_right, f.x), mix(bottom_left, bottom_right, f.x), f.y);
}
