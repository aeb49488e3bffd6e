// The visible points of a tile, as pass `primary` stored them: points, and the packed surfaces that they lie on
// (lib/point). In: the index of a point. Out: the point, its surface, its specular chain.

@if(glossy) import package::lib::bsdf::specular::PackedSpecular;
import package::lib::bsdf::surface::{Surface, unpack_surface};
import package::lib::math::oct_decode16;
import package::lib::point::{Point, VisibleSurface};
@if(glossy && !specular_chains) import package::lib::point::direct_view;
@if(specular_chains) import package::lib::point::{Chain, unpack_chain};
@if(texture_loads) import package::lib::table::table_texel;

// Each a vector: position and normal.
@if(texture_loads) @group(1) @binding(32) var point_table: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(32) var<storage, read> point_table: array<vec4u>;
// Each `surface_vectors` vectors: a VisibleSurface, member by member.
@if(texture_loads) @group(1) @binding(33) var surface_table: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(33) var<storage, read> surface_table: array<vec4u>;

override surface_vectors: u32;

fn load_point(i: u32) -> Point {
    @if(texture_loads) let words = textureLoad(point_table, table_texel(i));
    @if(!texture_loads) let words = point_table[i];
    return Point(bitcast<vec3f>(words.xyz), words.w);
}

fn load_surface_vector(i: u32) -> vec4f {
    @if(texture_loads) { return bitcast<vec4f>(textureLoad(surface_table, table_texel(i))); }
    @else { return bitcast<vec4f>(surface_table[i]); }
}

// The members in their order. A kernel does not load the members that it does not use: drivers leave these loads out.
fn load_surface(i: u32) -> VisibleSurface {
    var surface: VisibleSurface;
    var next = surface_vectors * i;
    surface.packed.base = load_surface_vector(next);
    next++;
    @if(glossy) {
        surface.packed.specular = PackedSpecular(load_surface_vector(next), load_surface_vector(next + 1u));
        next += 2u;
    }
    @each(lobe) {
        surface.packed.NAME = load_surface_vector(next);
        next++;
    }
    @if(specular_chains) {
        surface.chain = load_surface_vector(next);
        next++;
    }
    @if(thin_lens) {
        surface.eye = load_surface_vector(next);
        next++;
    }
    @if(smooth_normals && (photon_map || caustics)) { surface.triangle = load_surface_vector(next); }
    return surface;
}

@if(specular_chains)
fn visible_chain(surface: VisibleSurface, point: Point) -> Chain {
    return unpack_chain(surface, point.position);
}

// The surface at a point, with the direction towards the viewer, which Lambertian surfaces do not need.
fn visible_surface(surface: VisibleSurface, point: Point) -> Surface {
    var view = vec3f(0.0);
    @if(glossy && !specular_chains) { view = direct_view(surface, point.position); }
    @if(glossy && specular_chains) { view = visible_chain(surface, point).view; }
    return unpack_surface(surface.packed, oct_decode16(point.normal), view);
}
