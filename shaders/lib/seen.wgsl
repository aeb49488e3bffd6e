// What the camera sees at the points of a tile, as `primary` left it.

import package::lib::bsdf::Surface;
@if(glossy && !chains) import package::lib::camera::view_direction;
import package::lib::math::oct_decode16;
import package::lib::point::{PackedSurface, Point, SURFACE_VECTORS, unpack_surface};
@if(transmission) import package::lib::point::TINT_VECTOR;
@if(clearcoat || anisotropy) import package::lib::point::LOBE_VECTOR;
@if(sheen) import package::lib::point::SHEEN_VECTOR;
@if(chains) import package::lib::point::{CHAIN_VECTOR, Chain, unpack_chain};

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read> surfaces: array<vec4f>;

@if(chains)
fn seen_chain(i: u32) -> Chain {
    return unpack_chain(surfaces[i * SURFACE_VECTORS + CHAIN_VECTOR], points[i].position);
}

fn seen_packed(i: u32) -> PackedSurface {
    var packed: PackedSurface;
    packed.a = surfaces[i * SURFACE_VECTORS];
    @if(glossy) {
        packed.b = surfaces[i * SURFACE_VECTORS + 1u];
        packed.c = surfaces[i * SURFACE_VECTORS + 2u];
        @if(transmission) { packed.tint = surfaces[i * SURFACE_VECTORS + TINT_VECTOR]; }
        @if(clearcoat || anisotropy) { packed.lobe = surfaces[i * SURFACE_VECTORS + LOBE_VECTOR]; }
        @if(sheen) { packed.sheen = surfaces[i * SURFACE_VECTORS + SHEEN_VECTOR]; }
    }
    return packed;
}

// The surface at point i, towards the viewer. Lambertian ones look alike from everywhere: they have no view.
fn seen_surface(i: u32) -> Surface {
    var view = vec3f(0.0);
    @if(glossy && !chains) { view = view_direction(points[i].position); }
    @if(glossy && chains) { view = seen_chain(i).view; }
    return unpack_surface(seen_packed(i), oct_decode16(points[i].normal), view);
}
