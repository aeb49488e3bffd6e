// The points to be shaded: one for each sample of a tile's pixels, and the surfaces they lie on.

import package::lib::math::{oct_decode16, oct_encode16};
import package::lib::bsdf::Surface;

struct Point {
    // Where rays leave from.
    position: vec3f,
    // The surface's geometric normal on the viewer's side (oct_encode16), or INVALID_POINT.
    normal: u32,
}

// Vectors that a surface takes in the array `surfaces`.
@if(glossy) const SURFACE_VECTORS: u32 = 3u;
@if(!glossy) const SURFACE_VECTORS: u32 = 1u;

struct PackedSurface {
    a: vec4f,
    @if(glossy) b: vec4f,
    @if(glossy) c: vec4f,
}

fn pack_surface(s: Surface) -> PackedSurface {
    let a = vec4f(s.albedo, bitcast<f32>(oct_encode16(s.shading_normal)));
    @if(glossy) { return PackedSurface(a, vec4f(s.f0, s.f90), vec4f(s.dielectric, s.alpha, 0.0)); }
    @if(!glossy) { return PackedSurface(a); }
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
    return s;
}
