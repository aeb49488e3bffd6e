// The surface at a ray's hit: material and normals (glTF 2.0, 3.9 and appendix B; KHR_materials_unlit,
// _emissive_strength). The files of lib/bsdf/ read the lobes of a material.

import package::lib::attributes::{material_index, surface_texel_of};
@if(vertex_colours) import package::lib::attributes::vertex_colour_at;
import package::lib::bsdf::surface::{HitContext, Surface, add_lobes};
@if(textures) import package::lib::bsdf::surface::texture_factors;
@if(unlit) import package::lib::bsdf::surface::without_light;
@if(transmission) import package::lib::bsdf::surface::passes_light;
@if(transmission) import package::lib::bsdf::transmission::volume_transmittance;
@if(transmission && immersed) import package::lib::bsdf::transmission::medium_transmittance;
@if(!procedurals) import package::lib::bvh::triangle_corners;
@if(procedurals) import package::lib::bvh::{traversal_iterations, triangle_corners};
import package::lib::constants::{
    BASE_COLOUR_TEXEL, EMISSION_TEXEL, MATERIAL_DIFFUSE, MATERIAL_DOUBLE_SIDED, MATERIAL_TRANSMITS, MATERIAL_UNLIT,
    NORMAL_TEXTURE, SURFACE_FLAT, SURFACE_TEXEL,
};
import package::lib::material::{load_material_texel, material_at, material_flags, material_of};
@if(normal_maps && textures) import package::lib::material::texture_info;
@if(instances && smooth_normals) import package::lib::instance::placed_normal;
import package::lib::math::oct_decode16;
@if(procedurals) import package::lib::procedural::{
    is_procedural, procedural_clearance, procedural_colour, procedural_material, procedural_normal,
};
@if(procedurals) import package::lib::procedural_functions::procedural_iterations;
import package::lib::ray::{Hit, Ray};
@if(negative_photons) import package::lib::ray::offset_origin;
@if(normal_maps && textures) import package::lib::shading_normal::mapped_normal;
@if(smooth_normals || normal_maps) import package::lib::shading_normal::bent_to;

// A surface at the hit of a ray.
struct SurfaceHit {
    // Origin of rays that leave: on the triangle, or above it where the triangle approximates a smooth surface.
    position: vec3f,
    // The hit on the triangle, exact to the last bits, and the triangle's normal on the side of the ray's origin.
    triangle_position: vec3f,
    triangle_normal: vec3f,
    // Radiance emitted (or shown, where unlit) towards the ray's origin.
    emission: vec3f,
    // The surface is unlit: it reflects nothing.
    unlit: bool,
    // Base colour, for the albedo AOV.
    base_colour: vec3f,
    // Transmittance of the volume through which the ray came.
    @if(transmission) transmittance: vec3f,
    surface: Surface,
}

// A triangle is part of a smooth surface only if its corners' normals are within 45 degrees of its own. Normals that
// differ by more belong to two surfaces for photons too (`compatible` in lib/grid). Without this limit a cube with
// averaged normals would be shadowed as a ball is.
@if(smooth_normals) const SMOOTH_COSINE = 0.70710678;

// The offset from a point of a triangle, with the given barycentric weights, to the smooth surface that the triangle
// approximates: towards the tangent planes at the corners, where these are above the point. Rays from the triangle
// itself towards a light near the horizon would hit neighbouring triangles, and shadows would show the triangle's
// edges. (Hanika 2021, Ray Tracing Gems II, chapter 4. Hanika's offsets from the tangent planes, summed with weights
// whose moments about the point are 0, give the same.)
@if(smooth_normals)
fn smooth_offset(position: vec3f, weights: vec3f, corners: array<vec3f, 3>, normals: array<vec3f, 3>) -> vec3f {
    return weights.x * min(dot(position - corners[0], normals[0]), 0.0) * -normals[0]
        + weights.y * min(dot(position - corners[1], normals[1]), 0.0) * -normals[1]
        + weights.z * min(dot(position - corners[2], normals[2]), 0.0) * -normals[2];
}

// The ray that continues straight on through the surface.
@if(negative_photons)
fn ray_behind(found: SurfaceHit, direction: vec3f, t_max: f32) -> Ray {
    return Ray(offset_origin(found.triangle_position, -found.triangle_normal), 0.0, direction, t_max);
}

// ---- Photons of indirect light

fn flags_at(hit: Hit) -> u32 {
    @if(procedurals) {
        if is_procedural(hit.triangle) { return material_flags(material_at(procedural_material(hit.triangle))); }
    }
    return material_flags(material_of(hit.triangle));
}

// Whether photons of indirect light are stored at a hit. The material decides, not the colour at the hit: irradiance
// does not depend on it, and density estimation would be too dark beside black texels that have no photons.
fn stores_photons(hit: Hit) -> bool {
    return (flags_at(hit) & MATERIAL_DIFFUSE) != 0u;
}

// Whether a hit counts as surface that has photons. A pane that lies on a floor counts too: photons pass it, and lie on
// the floor below.
fn shows_photons(hit: Hit) -> bool {
    return (flags_at(hit) & (MATERIAL_DIFFUSE | MATERIAL_TRANSMITS)) != 0u;
}

// ---- Geometry

// The hit of a ray with a triangle or a procedural object.
struct Met {
    position: vec3f,
    // The geometric normal on the outer side.
    outward: vec3f,
    // Primitive index. For a procedural object it is 0, and the attributes read by it are not used.
    triangle: u32,
    corners: array<vec3f, 3>,
    // The corners' shading normals, and the material with SURFACE_FLAT.
    texel: vec4u,
    procedural: bool,
}

// The position on the triangle is computed from the corners: the far end of a long ray would be off the triangle's
// plane.
fn met_at(hit: Hit, ray: Ray) -> Met {
    var met: Met;
    met.triangle = hit.triangle;
    @if(procedurals) {
        met.procedural = is_procedural(hit.triangle);
        met.triangle = select(met.triangle, 0u, met.procedural);
    }
    met.corners = triangle_corners(met.triangle);
    let e1 = met.corners[1] - met.corners[0];
    let e2 = met.corners[2] - met.corners[0];
    met.position = met.corners[0] + hit.u * e1 + hit.v * e2;
    met.outward = normalize(cross(e1, e2));
    met.texel = surface_texel_of(met.triangle);
    @if(procedurals) {
        if met.procedural {
            met.position = ray.origin + hit.t * ray.direction;
            met.outward = procedural_normal(hit);
            met.texel.w = procedural_material(hit.triangle) | SURFACE_FLAT;
        }
    }
    return met;
}

// The smooth surface that a triangle approximates: the origin of rays that leave it, and its normals on the side of the
// ray's origin.
struct SmoothSurface {
    position: vec3f,
    geometric_normal: vec3f,
    shading_normal: vec3f,
}

// The geometric normal is interpolated from the corners' normals. With the triangle's own normal, whole triangles along
// the terminator would be black.
fn smooth_surface(met: Met, hit: Hit, triangle_normal: vec3f, front: bool) -> SmoothSurface {
    var surface = SmoothSurface(met.position, triangle_normal, triangle_normal);
    @if(smooth_normals) {
        if (met.texel.w & SURFACE_FLAT) == 0u {
            let w = 1.0 - hit.u - hit.v;
            let side = select(-1.0, 1.0, front);
            @if(instances) let normals = array(
                side * placed_normal(met.triangle, oct_decode16(met.texel.x)),
                side * placed_normal(met.triangle, oct_decode16(met.texel.y)),
                side * placed_normal(met.triangle, oct_decode16(met.texel.z)),
            );
            @if(!instances) let normals = array(
                side * oct_decode16(met.texel.x),
                side * oct_decode16(met.texel.y),
                side * oct_decode16(met.texel.z),
            );
            let n = w * normals[0] + hit.u * normals[1] + hit.v * normals[2];
            // Opposite normals at the corners may sum to 0.
            if dot(n, n) > 1e-12 { surface.shading_normal = normalize(n); }
            let cosines = vec2f(dot(normals[1], triangle_normal), dot(normals[2], triangle_normal));
            if min(dot(normals[0], triangle_normal), min(cosines.x, cosines.y)) > SMOOTH_COSINE {
                surface.geometric_normal = surface.shading_normal;
                surface.position += smooth_offset(met.position, vec3f(w, hit.u, hit.v), met.corners, normals);
            }
        }
    }
    return surface;
}

// ---- Colour

// The base colour factor of a material, times the vertex colours or the object's colour.
fn base_colour(material: u32, met: Met, hit: Hit) -> vec3f {
    var base = bitcast<vec3f>(load_material_texel(material + BASE_COLOUR_TEXEL).xyz);
    @if(vertex_colours && !procedurals) { base *= vertex_colour_at(hit.triangle, hit.u, hit.v).xyz; }
    @if(vertex_colours && procedurals) {
        if !met.procedural { base *= vertex_colour_at(met.triangle, hit.u, hit.v).xyz; }
    }
    @if(procedurals) {
        if met.procedural {
            base = procedural_colour(hit.triangle, base, met.position);
            traversal_iterations += procedural_iterations;
        }
    }
    return base;
}

// The shading normal by the material's normal map.
@if(normal_maps && textures)
fn with_normal_map(material: u32, texel: vec3f, hit: Hit, normal: vec3f, front: bool) -> vec3f {
    if texture_info(material, NORMAL_TEXTURE) == 0u { return normal; }
    let scale = bitcast<f32>(load_material_texel(material + SURFACE_TEXEL).z);
    return mapped_normal(hit, texel, scale, normal, front);
}

// The surface without lobes: its view and its normals.
fn bare_surface(smoothed: SmoothSurface, view: vec3f, material: u32, context: HitContext) -> Surface {
    var bare: Surface;
    bare.geometric_normal = smoothed.geometric_normal;
    bare.shading_normal = smoothed.shading_normal;
    bare.view = view;
    @if(normal_maps && textures) {
        let texel = context.factors.normal;
        bare.shading_normal = with_normal_map(material, texel, context.hit, bare.shading_normal, context.front);
    }
    @if(smooth_normals || normal_maps) { bare.shading_normal = bent_to(bare.shading_normal, view); }
    return bare;
}

// The surface at a hit. The normals face the ray's origin.
fn surface_at(hit: Hit, ray: Ray) -> SurfaceHit {
    let met = met_at(hit, ray);
    let front = dot(met.outward, ray.direction) <= 0.0;
    let triangle_normal = select(-met.outward, met.outward, front);
    let smoothed = smooth_surface(met, hit, triangle_normal, front);
    let material = material_at(material_index(met.texel.w));
    let flags = material_flags(material);
    let emission = bitcast<vec4f>(load_material_texel(material + EMISSION_TEXEL));

    var context: HitContext;
    context.hit = hit;
    context.front = front;
    @if(glossy) { context.metallic = emission.w; }
    context.unmapped_normal = smoothed.shading_normal;
    @if(textures) { context.factors = texture_factors(material, hit); }

    var found: SurfaceHit;
    found.position = smoothed.position;
    @if(procedurals) {
        if met.procedural { found.position += procedural_clearance(hit.triangle) * triangle_normal; }
    }
    found.triangle_position = met.position;
    found.triangle_normal = triangle_normal;
    found.base_colour = base_colour(material, met, hit);
    found.emission = emission.xyz;
    @if(textures) {
        found.base_colour *= context.factors.base;
        found.emission *= context.factors.emission;
    }

    let bare = bare_surface(smoothed, -ray.direction, material, context);
    found.surface = add_lobes(bare, material, found.base_colour, context);
    @if(transmission) {
        found.transmittance = vec3f(1.0);
        if !front { found.transmittance = volume_transmittance(material, hit.t); }
        @if(immersed) { if front { found.transmittance = medium_transmittance(material, hit.t); } }
        // Transmitted light leaves from the other side of the triangle itself, not from the smooth surface above it.
        if passes_light(found.surface) {
            found.position = met.position;
            found.surface.geometric_normal = triangle_normal;
        }
    }
    @if(unlit) {
        if (flags & MATERIAL_UNLIT) != 0u {
            found.unlit = true;
            found.emission = found.base_colour;
            found.surface = without_light(found.surface);
        }
    }
    if !found.unlit && !front && (flags & MATERIAL_DOUBLE_SIDED) == 0u { found.emission = vec3f(0.0); }
    return found;
}
