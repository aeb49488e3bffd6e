// The points to be shaded: one for each sample of a tile's pixels, and the surfaces they lie on.

import package::lib::math::{oct_decode16, oct_encode16};
import package::lib::bsdf::Surface;
@if(chains) import package::lib::camera::view_direction;
@if(chains) import package::lib::constants::INVALID_POINT;

struct Point {
    // Where rays leave from.
    position: vec3f,
    // The surface's geometric normal on the viewer's side (oct_encode16), or INVALID_POINT.
    normal: u32,
}

// Vectors that a surface takes in the array `surfaces`: a; b and c; then, where they are, those at the places named.
@if(glossy) const GLOSSY_VECTORS = 2u;
@if(!glossy) const GLOSSY_VECTORS = 0u;
@if(transmission) const TINT_VECTORS = 1u;
@if(!transmission) const TINT_VECTORS = 0u;
@if(clearcoat || anisotropy) const LOBE_VECTORS = 1u;
@if(!(clearcoat || anisotropy)) const LOBE_VECTORS = 0u;
@if(sheen) const SHEEN_VECTORS = 1u;
@if(!sheen) const SHEEN_VECTORS = 0u;
@if(chains) const CHAIN_VECTORS = 1u;
@if(!chains) const CHAIN_VECTORS = 0u;
@if(smooth_normals && (photon_map || caustics)) const PLACE_VECTORS = 1u;
@if(!(smooth_normals && (photon_map || caustics))) const PLACE_VECTORS = 0u;
const TINT_VECTOR = 1u + GLOSSY_VECTORS;
const LOBE_VECTOR = TINT_VECTOR + TINT_VECTORS;
const SHEEN_VECTOR = LOBE_VECTOR + LOBE_VECTORS;
const CHAIN_VECTOR = SHEEN_VECTOR + SHEEN_VECTORS;
// The point on the triangle, where photons lie, and the triangle's normal (oct_encode16): `points` has those of the smooth
// surface that it stands for, which may be farther from the triangle than a disc of photons is high.
const PLACE_VECTOR = CHAIN_VECTOR + CHAIN_VECTORS;
const SURFACE_VECTORS = PLACE_VECTOR + PLACE_VECTORS;

struct PackedSurface {
    a: vec4f,
    @if(glossy) b: vec4f,
    @if(glossy) c: vec4f,
    @if(transmission) tint: vec4f,
    @if(clearcoat || anisotropy) lobe: vec4f,
    @if(sheen) sheen: vec4f,
    // Throughput of the chain that led here, and the direction back along it (oct_encode16); INVALID_POINT there where the
    // camera sees the point itself.
    @if(chains) chain: vec4f,
}

fn pack_surface(s: Surface) -> PackedSurface {
    var p: PackedSurface;
    p.a = vec4f(s.albedo, bitcast<f32>(oct_encode16(s.shading_normal)));
    @if(glossy) {
        p.b = vec4f(s.f0, s.f90);
        p.c = vec4f(s.dielectric, s.alpha, 0.0);
    }
    @if(transmission) { p.tint = vec4f(s.tint, s.eta); }
    @if(clearcoat) { p.lobe = vec4f(s.coat, 0.0, 0.0); }
    @if(coat_normals) { p.c.w = bitcast<f32>(oct_encode16(s.coat_normal)); }
    @if(sheen) { p.sheen = s.sheen; }
    // A tangent of length 0 has no code: its width is negative.
    @if(anisotropy) {
        p.lobe.z = select(-1.0, s.alpha_along, any(s.tangent != vec3f(0.0)));
        p.lobe.w = bitcast<f32>(oct_encode16(s.tangent));
    }
    return p;
}

// The chain that led to a point: what passes along it, and where it comes from.
@if(chains)
struct Chain {
    throughput: vec3f,
    view: vec3f,
    // It has no link: the camera sees the point itself.
    none: bool,
}

@if(chains)
fn unpack_chain(chain: vec4f, position: vec3f) -> Chain {
    let code = bitcast<u32>(chain.w);
    let none = code == INVALID_POINT;
    return Chain(chain.xyz, select(oct_decode16(code), view_direction(position), none), none);
}

fn unpack_surface(p: PackedSurface, geometric_normal: vec3f, view: vec3f) -> Surface {
    var s: Surface;
    s.albedo = p.a.xyz;
    s.shading_normal = oct_decode16(bitcast<u32>(p.a.w));
    s.geometric_normal = geometric_normal;
    s.view = view;
    @if(glossy) {
        s.f0 = p.b.xyz;
        s.f90 = p.b.w;
        s.dielectric = p.c.xy;
        s.alpha = p.c.z;
    }
    @if(transmission) {
        s.tint = p.tint.xyz;
        s.eta = p.tint.w;
    }
    @if(clearcoat) { s.coat = p.lobe.xy; }
    @if(coat_normals) { s.coat_normal = oct_decode16(bitcast<u32>(p.c.w)); }
    @if(sheen) { s.sheen = p.sheen; }
    @if(anisotropy) {
        s.alpha_along = p.lobe.z;
        s.tangent = select(vec3f(0.0), oct_decode16(bitcast<u32>(p.lobe.w)), p.lobe.z >= 0.0);
    }
    return s;
}
