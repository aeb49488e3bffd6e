// The visible points of a tile, as pass `primary` stored them. In: `points` and packed `surfaces` (lib/point). Out:
// surfaces and specular chains.

import package::lib::bsdf::surface::{Surface, unpack_surface};
@if(glossy && !specular_chains) import package::lib::camera::view_direction;
import package::lib::math::oct_decode16;
import package::lib::point::{Point, VisibleSurface};
@if(specular_chains) import package::lib::point::{Chain, unpack_chain};

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read> surfaces: array<VisibleSurface>;

@if(specular_chains)
fn visible_chain(i: u32) -> Chain {
    return unpack_chain(surfaces[i].chain, points[i].position);
}

// The surface at point i, with the direction towards the viewer, which Lambertian surfaces do not need.
fn visible_surface(i: u32) -> Surface {
    var view = vec3f(0.0);
    @if(glossy && !specular_chains) { view = view_direction(points[i].position); }
    @if(glossy && specular_chains) { view = visible_chain(i).view; }
    return unpack_surface(surfaces[i].packed, oct_decode16(points[i].normal), view);
}
