// Shading points, one for each sample of a tile's pixels, and the surfaces that they lie on.

import package::lib::bsdf::surface::{PackedSurface, pack_surface};
@if(specular_chains) import package::lib::math::oct_decode16;
@if(smooth_normals && (photon_map || caustics)) import package::lib::math::oct_encode16;
import package::lib::surface::SurfaceHit;
@if(!thin_lens) import package::lib::camera::view_direction;
@if(specular_chains) import package::lib::constants::INVALID_POINT;

struct Point {
    // Origin of rays.
    position: vec3f,
    // The surface's geometric normal on the viewer's side (oct_encode16), or INVALID_POINT.
    normal: u32,
}

// The surface that a point lies on.
struct VisibleSurface {
    packed: PackedSurface,
    // Throughput of the specular chain that leads here, and the direction back along it (oct_encode16), or
    // INVALID_POINT if the camera sees the point directly.
    @if(specular_chains) chain: vec4f,
    // Where the camera's ray left the lens.
    @if(thin_lens) eye: vec4f,
    // The point on the triangle, where photons lie, and the triangle's normal (oct_encode16). `points` holds those of
    // the smooth surface, which may be farther from the triangle than the height of a search ellipsoid.
    @if(smooth_normals && (photon_map || caustics)) triangle: vec4f,
}

// Data that passes need of the surface that a ray hit, without the way to it: the chain has no link.
fn visible_surface_of(found: SurfaceHit) -> VisibleSurface {
    var surface: VisibleSurface;
    surface.packed = pack_surface(found.surface);
    @if(specular_chains) { surface.chain = vec4f(vec3f(1.0), bitcast<f32>(INVALID_POINT)); }
    @if(smooth_normals && (photon_map || caustics)) {
        surface.triangle = vec4f(found.triangle_position, bitcast<f32>(oct_encode16(found.triangle_normal)));
    }
    return surface;
}

// The specular chain that leads to a point: its throughput, and the direction back along it.
@if(specular_chains)
struct Chain {
    throughput: vec3f,
    view: vec3f,
}

@if(specular_chains)
fn unpack_chain(surface: VisibleSurface, position: vec3f) -> Chain {
    let code = bitcast<u32>(surface.chain.w);
    // Without a link, the camera sees the point directly.
    let none = code == INVALID_POINT;
    return Chain(surface.chain.xyz, select(oct_decode16(code), direct_view(surface, position), none));
}

// The direction from a point that the camera sees directly towards the viewer.
fn direct_view(surface: VisibleSurface, position: vec3f) -> vec3f {
    @if(thin_lens) { return normalize(surface.eye.xyz - position); }
    @else { return view_direction(position); }
}
