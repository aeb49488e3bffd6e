// Mesh lights: the triangles of one node and one emissive material.

@if(emissive_alpha) import package::lib::alpha::alpha_coverage;
@if(emissive_volumes) import package::lib::bsdf::transmission::volume_transmittance;
@if(emissive_volumes) import package::lib::bvh::triangle_corners;
import package::lib::constants::{
    EMITTER_TEXELS, LIGHT_CONTOUR_TEXEL, LIGHT_CLOSED_FORM, LIGHT_COVERAGE, LIGHT_EMISSION_TEXEL, LIGHT_KIND_TEXEL,
    LIGHT_NO_AXIS, LIGHT_SPHERE_TEXEL, LIGHT_SAMPLING_TEXEL, LIGHT_TWO_SIDED,
};
import package::lib::light::contour::contour_shines;
import package::lib::light::emitter::{
    EmitterRange, EmitterTriangle, all_emitters, emitter_faces, emitter_sends, load_emitter, load_emitter_texel,
    load_light_vertex, sample_emitter, spherical_emitter, uses_all_emitters,
};
@if(many_emitters) import package::lib::light::emitter::{emitter_probability, emitter_range};
import package::lib::light::receivers::{receiver_cone, sample_bounded_cosine};
import package::lib::light::table::{
    EmittedRay, LightSample, MIN_COSINE, light_texel, light_texel_f32, load_light_texel, no_light_sample,
};
@if(emissive_volumes) import package::lib::light::table::NO_EMITTER;
@if(emissive_textures) import package::lib::material::emission_at;
@if(emissive_volumes) import package::lib::material::material_of;
import package::lib::math::{PI, oct_decode16};
import package::lib::rng::BELOW_ONE;
import package::lib::sampling::{SphericalTriangle, sample_spherical_triangle, sample_triangle};

// A point of a mesh light.
struct MeshPoint {
    position: vec3f,
    // Unit normal on the front.
    normal: vec3f,
    // Emitted radiance.
    radiance: vec3f,
}

// The point of an emitter triangle at barycentric coordinates.
fn mesh_point(light: u32, header: vec4u, triangle: EmitterTriangle, uv: vec2f) -> MeshPoint {
    var radiance: vec3f;
    @if(emissive_textures) { radiance = emission_at(triangle.index, uv.x, uv.y); }
    @else { radiance = light_texel_f32(light, LIGHT_EMISSION_TEXEL).xyz; }
    @if(emissive_alpha) {
        // Transparent parts do not emit.
        if (header.x & LIGHT_COVERAGE) != 0u { radiance *= alpha_coverage(triangle.index, uv.x, uv.y); }
    }
    return MeshPoint(triangle.a + uv.x * triangle.e1 + uv.y * triangle.e2, normalize(triangle.across), radiance);
}

// Transmittance of the volume behind an emitter triangle over a distance.
@if(emissive_volumes)
fn transmittance_behind(triangle: u32, distance: f32) -> vec3f {
    return volume_transmittance(material_of(triangle), distance);
}

// Whether a ray that a mesh light emits begins in the volume behind its triangle.
@if(emissive_volumes)
fn begins_in_volume(emitted: EmittedRay) -> bool {
    if emitted.triangle == NO_EMITTER { return false; }
    let corners = triangle_corners(emitted.triangle);
    return dot(cross(corners[1] - corners[0], corners[2] - corners[0]), emitted.normal) < 0.0;
}

fn mesh_dark(light: u32, header: vec4u, position: vec3f, normal: vec3f) -> bool {
    let sphere = light_texel_f32(light, LIGHT_SPHERE_TEXEL);
    let height = dot(normal, sphere.xyz - position);
    if height <= -sphere.w { return true; }
    if (header.x & LIGHT_CLOSED_FORM) == 0u { return false; }
    let two_sided = (header.x & LIGHT_TWO_SIDED) != 0u;
    let end = header.w + light_texel(light, LIGHT_CONTOUR_TEXEL).x;
    var at = header.w;
    while at < end {
        let plane = load_light_vertex(at);
        let loop_end = at + 1u + u32(plane.w);
        at += 1u;
        let first = load_light_vertex(at).xyz - position;
        let side = dot(plane.xyz, first);
        if contour_shines(plane.xyz, side, two_sided) {
            if height > sphere.w { return false; }
            while at < loop_end {
                if dot(normal, load_light_vertex(at).xyz - position) > 0.0 { return false; }
                at += 1u;
            }
        }
        at = loop_end;
    }
    return true;
}

// The solid angle of the light's bounding sphere; all directions from within it.
fn mesh_max_solid_angle(light: u32, position: vec3f) -> f32 {
    let sphere = light_texel_f32(light, LIGHT_SPHERE_TEXEL);
    let offset = sphere.xyz - position;
    let squared_sine = sphere.w * sphere.w / dot(offset, offset);
    if !(squared_sine < 1.0) { return 4.0 * PI; }
    return 2.0 * PI * squared_sine / (1.0 + sqrt(1.0 - squared_sine));
}

// Minimum cosine at the emitter in a potential, as MIN_COSINE is at the surface. It can be lower, because a light with
// an axis lies in one plane, with one normal.
const MIN_EMITTED_COSINE = 0.02;
// Margin below the emitter's plane, because normals are rounded to 16 bits per coordinate.
const BEHIND_EMITTER = -1e-3;

// Approximate irradiance of the surface from the light; see `light_potential`.
fn mesh_potential(light: u32, position: vec3f, normal: vec3f) -> f32 {
    let emission = light_texel(light, LIGHT_SAMPLING_TEXEL).zw;
    let strength = bitcast<f32>(emission.x);
    let sphere = light_texel_f32(light, LIGHT_SPHERE_TEXEL);
    let offset = sphere.xyz - position;
    let radius2 = sphere.w * sphere.w;
    let distance2 = dot(offset, offset);
    let inverse = inverseSqrt(max(distance2, radius2));
    let height = dot(normal, offset) + sphere.w;
    let behind = dot(oct_decode16(emission.y), offset) * inverse;
    var emitted = 1.0;
    if emission.y != LIGHT_NO_AXIS {
        emitted = select(max(-behind, MIN_EMITTED_COSINE), 0.0, -behind <= BEHIND_EMITTER);
    }
    let cosine = clamp(height * inverse, MIN_COSINE, 1.0);
    return select(0.0, strength * emitted * cosine / (distance2 + radius2), height > 0.0);
}

// Densities above this count as infinite.
const MAX_PDF = 1e30;

fn mesh_sample(light: u32, header: vec4u, position: vec3f, u: vec2f) -> LightSample {
    @if(many_emitters) let range = emitter_range(light, header, position, u.x);
    @if(!many_emitters) let range = all_emitters(header, u.x);
    var triangle: EmitterTriangle;
    var spherical: SphericalTriangle;
    var left = range.u;
    var sum = 0.0;
    for (var i = range.first; i < range.end; i++) {
        let next = load_emitter(i);
        let next_spherical = spherical_emitter(next, position);
        let sends = emitter_sends(header, next, next_spherical, position, range.all);
        sum += sends;
        // A reservoir of one (Chao 1982), which reuses the rest of the random number.
        let chance = sends / sum;
        if left < chance {
            triangle = next;
            spherical = next_spherical;
            left /= chance;
        } else if sum > 0.0 {
            left = (left - chance) / (1.0 - chance);
        }
        left = min(left, BELOW_ONE);
    }
    let pdf = select(range.probability, triangle.density, range.all) / sum;
    // No triangle faces the position, the position lies in the light's plane, or the density overflows at a grazing
    // angle.
    if sum <= 0.0 || !(pdf < MAX_PDF) { return no_light_sample(); }
    let point = mesh_point(light, header, triangle, sample_spherical_triangle(spherical, vec2f(left, u.y)));
    let offset = point.position - position;
    let distance2 = dot(offset, offset);
    // A light point at the position itself has no direction.
    if distance2 < 1e-30 { return no_light_sample(); }
    let distance = sqrt(distance2);
    let front = emitter_faces(triangle, position);
    let normal = select(-point.normal, point.normal, front);
    var radiance = point.radiance;
    @if(emissive_volumes) { if !front { radiance *= transmittance_behind(triangle.index, distance); } }
    return LightSample(offset / distance, distance, radiance, pdf, normal, false);
}

// The result of `emitter_of`.
struct Emitter {
    light: u32,
    pdf: f32,
}

// The light to which a triangle belongs, and the density by solid angle with which `light_sample` samples its points
// for a position that it faces; density 0 if the triangle does not emit.
fn emitter_of(triangle: u32, position: vec3f) -> Emitter {
    let header = load_light_texel(0u);
    // The list of emitters by primitive index lies behind their texels.
    let base = header.y * EMITTER_TEXELS;
    var first = base;
    var end = base + header.y;
    while first < end {
        let middle = (first + end) / 2u;
        if load_emitter_texel(middle).x < triangle { first = middle + 1u; } else { end = middle; }
    }
    if first < base + header.y {
        let found = load_emitter_texel(first);
        if found.x == triangle { return Emitter(found.y, emitter_pdf(found.y, found.z, position)); }
    }
    return Emitter(0u, 0.0);
}

fn emitter_pdf(light: u32, emitter: u32, position: vec3f) -> f32 {
    let header = light_texel(light, LIGHT_KIND_TEXEL);
    let all = uses_all_emitters(light, header, position);
    var range = all_emitters(header, 0.0);
    @if(many_emitters) {
        if !all {
            let probability = emitter_probability(light, header, emitter, position);
            range = EmitterRange(emitter, emitter + 1u, false, probability, 0.0);
        }
    }
    var sum = 0.0;
    for (var i = range.first; i < range.end; i++) {
        let triangle = load_emitter(i);
        sum += emitter_sends(header, triangle, spherical_emitter(triangle, position), position, all);
    }
    let probability = select(range.probability, load_emitter(emitter).density, all);
    return select(0.0, min(probability / sum, MAX_PDF), sum > 0.0);
}

// Samples a ray by emitted power and the cosine law, within the cone of the receiver bounds where that is narrower.
fn mesh_emit(light: u32, u: vec4f) -> EmittedRay {
    let header = light_texel(light, LIGHT_KIND_TEXEL);
    let chosen = sample_emitter(header, u.x);
    let triangle = load_emitter(chosen.emitter);
    let point = mesh_point(light, header, triangle, sample_triangle(vec2f(chosen.u, u.y)));
    var normal = point.normal;
    var v = u.zw;
    var flux = point.radiance * (PI / triangle.density);
    if (header.x & LIGHT_TWO_SIDED) != 0u {
        if v.x < 0.5 { normal = -normal; }
        v.x = fract(2.0 * v.x);
        flux *= 2.0;
    }
    let towards = sample_bounded_cosine(normal, receiver_cone(point.position), v);
    return EmittedRay(point.position, towards.direction, normal, triangle.index, flux * towards.share);
}
