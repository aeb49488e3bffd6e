// What the camera sees at the points of a tile, as `primary` left it.

import package::lib::bsdf::surface::{PACKED_VECTORS, PackedSurface, Surface, unpack_surface};
@if(glossy && !chains) import package::lib::camera::view_direction;
import package::lib::math::oct_decode16;
import package::lib::point::{Point, SURFACE_VECTORS};
@if(chains) import package::lib::point::{CHAIN_VECTOR, Chain, unpack_chain};

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read> surfaces: array<vec4f>;

@if(chains)
fn seen_chain(i: u32) -> Chain {
    return unpack_chain(surfaces[i * SURFACE_VECTORS + CHAIN_VECTOR], points[i].position);
}

// The surface at point i, towards the viewer. Lambertian ones look alike from everywhere: they have no view.
fn seen_surface(i: u32) -> Surface {
    var packed: PackedSurface;
    for (var v = 0u; v < PACKED_VECTORS; v++) { packed.vectors[v] = surfaces[i * SURFACE_VECTORS + v]; }
    var view = vec3f(0.0);
    @if(glossy) {
        @if(!chains) { view = view_direction(points[i].position); }
        @if(chains) { view = seen_chain(i).view; }
    }
    return unpack_surface(packed, oct_decode16(points[i].normal), view);
}
