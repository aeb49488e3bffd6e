// The points to be shaded: one for each sample of a tile's pixels, and the surfaces they lie on.

import package::lib::math::{oct_decode16, oct_encode16};
import package::lib::bsdf::Surface;

struct Point {
    // Where rays leave from.
    position: vec3f,
    // The surface's geometric normal on the viewer's side (oct_encode16), or INVALID_POINT.
    normal: u32,
}

// Vectors that a surface takes in the array `surfaces`: a; b and c; d; e.
@if(!glossy) const SURFACE_VECTORS = 1u;
@if(glossy && !transmission && !(clearcoat || anisotropy)) const SURFACE_VECTORS = 3u;
@if(glossy && !transmission && (clearcoat || anisotropy)) const SURFACE_VECTORS = 4u;
@if(glossy && transmission && !(clearcoat || anisotropy)) const SURFACE_VECTORS = 4u;
@if(glossy && transmission && (clearcoat || anisotropy)) const SURFACE_VECTORS = 5u;

struct PackedSurface {
    a: vec4f,
    @if(glossy) b: vec4f,
    @if(glossy) c: vec4f,
    @if(transmission) d: vec4f,
    @if(clearcoat || anisotropy) e: vec4f,
}

fn pack_surface(s: Surface) -> PackedSurface {
    var p: PackedSurface;
    p.a = vec4f(s.albedo, bitcast<f32>(oct_encode16(s.shading_normal)));
    @if(glossy) {
        p.b = vec4f(s.f0, s.f90);
        p.c = vec4f(s.dielectric, s.alpha, 0.0);
    }
    @if(transmission) { p.d = vec4f(s.tint, s.eta); }
    @if(clearcoat) { p.e = vec4f(s.coat, 0.0, 0.0); }
    // A tangent of length 0 has no code: its width is negative.
    @if(anisotropy) {
        p.e.z = select(-1.0, s.alpha_along, any(s.tangent != vec3f(0.0)));
        p.e.w = bitcast<f32>(oct_encode16(s.tangent));
    }
    return p;
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
        s.tint = p.d.xyz;
        s.eta = p.d.w;
    }
    @if(clearcoat) { s.coat = p.e.xy; }
    @if(anisotropy) {
        s.alpha_along = p.e.z;
        s.tangent = select(vec3f(0.0), oct_decode16(bitcast<u32>(p.e.w)), p.e.z >= 0.0);
    }
    return s;
}
