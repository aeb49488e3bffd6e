// What a ray meets: material and normals at a hit (glTF 2.0, 3.9 and appendix B; KHR_materials_specular, _ior,
// _transmission, _volume, _clearcoat, _anisotropy, _sheen, _unlit, _emissive_strength, KHR_texture_transform).

@if(texture_loads) import package::lib::table::table_texel;
@if(!procedurals) import package::lib::bvh::triangle_corners;
@if(procedurals) import package::lib::bvh::{traversal_iterations, triangle_corners};
@if(procedurals) import package::lib::procedural::{is_procedural, procedural_clearance, procedural_colour, procedural_material, procedural_normal};
@if(procedurals) import package::lib::procedural_functions::procedural_iterations;
import package::lib::ray::{Hit, Ray};
@if(negative_photons) import package::lib::ray::offset_origin;
import package::lib::math::oct_decode16;
import package::lib::bsdf::Surface;
import package::lib::constants::{
    SURFACE_FLAT, MATERIAL_RECORDS, MATERIAL_DOUBLE_SIDED, MATERIAL_UNLIT, SLOT_RECORDS, SLOT_NEAREST, SLOT_SRGB,
    SLOT_UV1, LAYER_TEXELS_LOG2, TABLE_WIDTH_LOG2
};

// Records a triangle, and the places of those that not every scene has.
override surface_stride: u32;
@if(textures) override uv_record: u32;
@if(vertex_colours) override colour_record: u32;
@if(normal_maps || coat_normals || anisotropy) override tangent_record: u32;

@if(texture_loads) @group(1) @binding(2) var surface_records: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(2) var<storage, read> surface_records: array<vec4u>;
@if(texture_loads) @group(1) @binding(3) var material_records: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(3) var<storage, read> material_records: array<vec4u>;
@if(textures && texture_loads) @group(1) @binding(4) var texture_slots: texture_storage_2d<rgba32uint, read>;
@if(textures && !texture_loads) @group(1) @binding(4) var<storage, read> texture_slots: array<vec4u>;
@if(textures) @group(1) @binding(5) var colour_texels: texture_2d_array<f32>;
@if(textures) @group(1) @binding(6) var data_texels: texture_2d_array<f32>;

fn load_surface_record(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(surface_records, table_texel(i)); }
    @if(!texture_loads) { return surface_records[i]; }
}

fn load_material_record(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(material_records, table_texel(i)); }
    @if(!texture_loads) { return material_records[i]; }
}

@if(textures)
fn load_slot_record(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(texture_slots, table_texel(i)); }
    @if(!texture_loads) { return texture_slots[i]; }
}

// Texture coordinates 0 and 1 of a point of a triangle.
@if(textures)
struct Uv {
    set0: vec2f,
    @if(uv1) set1: vec2f,
}

@if(textures)
fn uv_at(triangle: u32, u: f32, v: f32) -> Uv {
    let base = triangle * surface_stride + uv_record;
    let a = bitcast<vec4f>(load_surface_record(base));
    let b = bitcast<vec4f>(load_surface_record(base + 1u));
    let w = 1.0 - u - v;
    let set0 = w * a.xy + u * a.zw + v * b.xy;
    @if(uv1) {
        let c = bitcast<vec4f>(load_surface_record(base + 2u));
        return Uv(set0, w * b.zw + u * c.xy + v * c.zw);
    }
    @if(!uv1) { return Uv(set0); }
}

// A texel coordinate brought into 0 .. size - 1 by the wrap mode: 0 repeat, 1 mirror, 2 clamp.
@if(textures)
fn wrap_texel(coordinate: i32, size: i32, mode: u32) -> u32 {
    if mode == 2u { return u32(clamp(coordinate, 0, size - 1)); }
    let period = select(size, 2 * size, mode == 1u);
    // Not by %, which software devices do lane by lane. Coordinates are from -2 to twice the size and some, so the
    // quotient is too small for its rounding to reach the half that keeps it off whole numbers.
    let inside = coordinate - period * i32(floor((f32(coordinate) + 0.5) / f32(period)));
    return u32(select(inside, period - 1 - inside, inside >= size));
}

@if(textures)
fn load_texel(i: u32, srgb: bool) -> vec4f {
    let width_mask = (1u << TABLE_WIDTH_LOG2) - 1u;
    let at = vec2u(i & width_mask, (i >> TABLE_WIDTH_LOG2) & width_mask);
    let layer = i >> LAYER_TEXELS_LOG2;
    if srgb { return textureLoad(colour_texels, at, layer, 0); }
    return textureLoad(data_texels, at, layer, 0);
}

// The texture of slot number `slot` (counted from 1) at a point.
@if(textures)
fn texture_at(slot: u32, uv: Uv) -> vec4f {
    let base = (slot - 1u) * SLOT_RECORDS;
    let m = bitcast<vec4f>(load_slot_record(base));
    let placement = load_slot_record(base + 1u);
    let image = load_slot_record(base + 2u);
    let flags = placement.z;
    var coordinate = uv.set0;
    @if(uv1) { if (flags & SLOT_UV1) != 0u { coordinate = uv.set1; } }
    coordinate = m.xy * coordinate.x + m.zw * coordinate.y + bitcast<vec2f>(placement.xy);
    let size = vec2i(image.yz);
    let srgb = (flags & SLOT_SRGB) != 0u;
    let wrap = vec2u(flags & 3u, (flags >> 2u) & 3u);
    // Far outside the image only the place within the tile counts: keep it where integers and floats are exact.
    let texel = (coordinate - select(vec2f(0.0), 2.0 * floor(0.5 * coordinate), wrap != vec2u(2u))) * vec2f(size);
    let bounded = clamp(texel, vec2f(-1.0), 2.0 * vec2f(size) + 1.0);
    if (flags & SLOT_NEAREST) != 0u {
        let at = vec2i(floor(bounded));
        return load_texel(image.x + wrap_texel(at.x, size.x, wrap.x) + wrap_texel(at.y, size.y, wrap.y) * image.y, srgb);
    }
    let corner = floor(bounded - 0.5);
    let f = bounded - 0.5 - corner;
    let at = vec2i(corner);
    let x0 = wrap_texel(at.x, size.x, wrap.x);
    let x1 = wrap_texel(at.x + 1, size.x, wrap.x);
    let y0 = image.x + wrap_texel(at.y, size.y, wrap.y) * image.y;
    let y1 = image.x + wrap_texel(at.y + 1, size.y, wrap.y) * image.y;
    let top = mix(load_texel(y0 + x0, srgb), load_texel(y0 + x1, srgb), f.x);
    let bottom = mix(load_texel(y1 + x0, srgb), load_texel(y1 + x1, srgb), f.x);
    return mix(top, bottom, f.y);
}

// Alpha of the base colour at a point of a triangle, and the material's flags and cutoff.
struct Alpha {
    value: f32,
    cutoff: f32,
    flags: u32,
}

@if(alpha_test)
fn alpha_at(triangle: u32, u: f32, v: f32) -> Alpha {
    let material = (load_surface_record(triangle * surface_stride).w & ~SURFACE_FLAT) * MATERIAL_RECORDS;
    let words = load_material_record(material + 4u);
    var alpha = bitcast<f32>(load_material_record(material).w);
    @if(textures) { if words.y != 0u { alpha *= texture_at(words.y, uv_at(triangle, u, v)).w; } }
    @if(vertex_colours) { alpha *= vertex_colour_at(triangle, u, v).w; }
    return Alpha(alpha, bitcast<f32>(load_material_record(material + 3u).w), words.x);
}

@if(vertex_colours)
fn vertex_colour_at(triangle: u32, u: f32, v: f32) -> vec4f {
    let a = load_surface_record(triangle * surface_stride + colour_record);
    let b = load_surface_record(triangle * surface_stride + colour_record + 1u);
    let c0 = vec4f(unpack2x16unorm(a.x), unpack2x16unorm(a.y));
    let c1 = vec4f(unpack2x16unorm(a.z), unpack2x16unorm(a.w));
    let c2 = vec4f(unpack2x16unorm(b.x), unpack2x16unorm(b.y));
    return (1.0 - u - v) * c0 + u * c1 + v * c2;
}

// Radiance that a point of a triangle emits on its front (and on its back where the material is double-sided).
fn emission_at(triangle: u32, u: f32, v: f32) -> vec3f {
    let material = (load_surface_record(triangle * surface_stride).w & ~SURFACE_FLAT) * MATERIAL_RECORDS;
    var emission = bitcast<vec3f>(load_material_record(material + 1u).xyz);
    @if(textures) {
        let slot = load_material_record(material + 5u).x;
        if slot != 0u { emission *= texture_at(slot, uv_at(triangle, u, v)).xyz; }
    }
    return emission;
}

// Both sides of the triangle are shaded, emit and store photons.
fn double_sided(triangle: u32) -> bool {
    let material = (load_surface_record(triangle * surface_stride).w & ~SURFACE_FLAT) * MATERIAL_RECORDS;
    return (load_material_record(material + 4u).x & MATERIAL_DOUBLE_SIDED) != 0u;
}

// What a material's textures say of a point; ones where there is none.
@if(textures)
struct MaterialTexels {
    base: vec3f,
    emission: vec3f,
    @if(normal_maps) normal: vec3f,
    @if(glossy) roughness_metallic: vec2f,
    @if(glossy) specular: f32,
    @if(glossy) specular_colour: vec3f,
    @if(transmission) transmission: f32,
    @if(clearcoat) coat: vec2f,
    @if(coat_normals) coat_normal: vec3f,
    @if(anisotropy) anisotropy: vec3f,
    @if(sheen) sheen: vec4f,
}

// One turn for each texture that there is: software devices run the body of an if for every lane, whatever its condition,
// and six texture look-ups one after the other would be done for materials that have one.
@if(textures)
fn material_texels(material: u32, words: vec4u, more: vec4u, hit: Hit) -> MaterialTexels {
    let uv = uv_at(hit.triangle, hit.u, hit.v);
    var result: MaterialTexels;
    result.base = vec3f(1.0);
    result.emission = vec3f(1.0);
    @if(glossy) {
        result.roughness_metallic = vec2f(1.0);
        result.specular = 1.0;
        result.specular_colour = vec3f(1.0);
    }
    @if(transmission) { result.transmission = 1.0; }
    @if(clearcoat) { result.coat = vec2f(1.0); }
    // Along the tangent, and all of the strength.
    @if(anisotropy) { result.anisotropy = vec3f(1.0, 0.5, 1.0); }
    @if(sheen) { result.sheen = vec4f(1.0); }
    @if(transmission || clearcoat || anisotropy) let lobes = load_material_record(material + 8u);
    @if(sheen) let fibres = load_material_record(material + 11u);
    var left = u32(words.y != 0u) | (u32(more.x != 0u) << 1u);
    @if(normal_maps) { left |= u32(words.w != 0u) << 2u; }
    @if(glossy) { left |= (u32(words.z != 0u) << 3u) | (u32(more.y != 0u) << 4u) | (u32(more.z != 0u) << 5u); }
    @if(transmission) { left |= u32(lobes.x != 0u) << 6u; }
    @if(clearcoat) { left |= (u32(lobes.y != 0u) << 7u) | (u32(lobes.z != 0u) << 8u); }
    @if(coat_normals) { left |= u32(more.w != 0u) << 12u; }
    @if(anisotropy) { left |= u32(lobes.w != 0u) << 9u; }
    @if(sheen) { left |= (u32(fibres.x != 0u) << 10u) | (u32(fibres.y != 0u) << 11u); }
    while left != 0u {
        let which = firstTrailingBit(left);
        left &= left - 1u;
        var slot = select(words.y, more.x, which == 1u);
        @if(normal_maps) { slot = select(slot, words.w, which == 2u); }
        @if(glossy) { slot = select(select(select(slot, words.z, which == 3u), more.y, which == 4u), more.z, which == 5u); }
        @if(transmission) { slot = select(slot, lobes.x, which == 6u); }
        @if(clearcoat) { slot = select(select(slot, lobes.y, which == 7u), lobes.z, which == 8u); }
        @if(coat_normals) { slot = select(slot, more.w, which == 12u); }
        @if(anisotropy) { slot = select(slot, lobes.w, which == 9u); }
        @if(sheen) { slot = select(select(slot, fibres.x, which == 10u), fibres.y, which == 11u); }
        let texel = texture_at(slot, uv);
        result.base = select(result.base, texel.xyz, which == 0u);
        result.emission = select(result.emission, texel.xyz, which == 1u);
        @if(normal_maps) { result.normal = select(result.normal, texel.xyz, which == 2u); }
        @if(glossy) {
            result.roughness_metallic = select(result.roughness_metallic, texel.yz, which == 3u);
            result.specular = select(result.specular, texel.w, which == 4u);
            result.specular_colour = select(result.specular_colour, texel.xyz, which == 5u);
        }
        @if(transmission) { result.transmission = select(result.transmission, texel.x, which == 6u); }
        @if(clearcoat) { result.coat = select(result.coat, texel.xy, vec2<bool>(which == 7u, which == 8u)); }
        @if(coat_normals) { result.coat_normal = select(result.coat_normal, texel.xyz, which == 12u); }
        @if(anisotropy) { result.anisotropy = select(result.anisotropy, texel.xyz, which == 9u); }
        @if(sheen) { result.sheen = select(result.sheen, texel, vec4<bool>(vec3<bool>(which == 10u), which == 11u)); }
    }
    return result;
}

// A point of a surface as a ray meets it.
struct SurfaceHit {
    // Where rays leave from; on the triangle, or over it where that stands for a piece of a smooth surface.
    position: vec3f,
    // The same point on the triangle, to the last bits, and the triangle's normal on the side of the ray's origin.
    triangle_position: vec3f,
    triangle_normal: vec3f,
    // Radiance emitted (or shown, where unlit) towards the ray's origin.
    emission: vec3f,
    // The surface reflects nothing: it is unlit.
    unlit: bool,
    // Base colour, for the albedo AOV.
    base_colour: vec3f,
    // What the volume that the ray came through has left of its light.
    @if(transmission) transmittance: vec3f,
    surface: Surface,
}

// Corners' normals beyond 45 degrees from the triangle's make no smooth surface of it: photons so far apart are of two
// surfaces as well, and a cube whose corners' normals are averaged would cast the shadows of a ball.
@if(smooth_normals) const SMOOTH_COSINE = 0.70710678;

// The offset from a point of a triangle, of those weights, to the smooth surface that the triangle stands for: towards
// the planes through the corners across their normals, where those are over it. From the triangle itself rays to a light
// near the horizon would meet its neighbours, and shadows have its edges (Hanika 2021, Ray Tracing Gems II, chapter 4,
// whose offsets from the planes come, summed with weights whose moments about the point are 0, to this).
@if(smooth_normals)
fn smooth_offset(position: vec3f, weights: vec3f, corners: array<vec3f, 3>, normals: array<vec3f, 3>) -> vec3f {
    return weights.x * min(dot(position - corners[0], normals[0]), 0.0) * -normals[0]
        + weights.y * min(dot(position - corners[1], normals[1]), 0.0) * -normals[1]
        + weights.z * min(dot(position - corners[2], normals[2]), 0.0) * -normals[2];
}

// The ray that goes straight on through the surface.
@if(negative_photons)
fn ray_behind(found: SurfaceHit, direction: vec3f, t_max: f32) -> Ray {
    return Ray(offset_origin(found.triangle_position, -found.triangle_normal), 0.0, direction, t_max);
}

// The surface at a hit. The normals face the ray's origin; the position on the triangle is computed from the corners and
// not along the ray. Of a triangle that stands for a piece of a smooth surface, the surface's own normal is the
// corners', interpolated: by the triangle's, whole triangles along the terminator would be black.
fn surface_at(hit: Hit, ray: Ray) -> SurfaceHit {
    // A procedural object has no triangle: the first one stands in for what is then not looked at.
    var triangle = hit.triangle;
    @if(procedurals) let procedural = is_procedural(hit.triangle);
    @if(procedurals) { triangle = select(triangle, 0u, procedural); }
    let corners = triangle_corners(triangle);
    let w = 1.0 - hit.u - hit.v;
    let e1 = corners[1] - corners[0];
    let e2 = corners[2] - corners[0];
    var position = corners[0] + hit.u * e1 + hit.v * e2;
    var outward = normalize(cross(e1, e2));
    var first = load_surface_record(triangle * surface_stride);
    @if(procedurals) {
        if procedural {
            position = ray.origin + hit.t * ray.direction;
            outward = procedural_normal(hit);
            first.w = procedural_material(hit.triangle) | SURFACE_FLAT;
        }
    }
    let front = dot(outward, ray.direction) <= 0.0;
    let triangle_normal = select(-outward, outward, front);

    let material = (first.w & ~SURFACE_FLAT) * MATERIAL_RECORDS;
    let m0 = bitcast<vec4f>(load_material_record(material));
    let m1 = bitcast<vec4f>(load_material_record(material + 1u));
    let words = load_material_record(material + 4u);

    var leaving = position;
    var geometric_normal = triangle_normal;
    var shading_normal = triangle_normal;
    @if(smooth_normals) {
        if (first.w & SURFACE_FLAT) == 0u {
            let side = select(-1.0, 1.0, front);
            let normals = array(side * oct_decode16(first.x), side * oct_decode16(first.y), side * oct_decode16(first.z));
            let n = w * normals[0] + hit.u * normals[1] + hit.v * normals[2];
            // Opposite normals at the corners may sum to nothing.
            if dot(n, n) > 1e-12 { shading_normal = normalize(n); }
            let least = min(dot(normals[0], triangle_normal), min(dot(normals[1], triangle_normal), dot(normals[2], triangle_normal)));
            if least > SMOOTH_COSINE {
                geometric_normal = shading_normal;
                leaving += smooth_offset(position, vec3f(w, hit.u, hit.v), corners, normals);
            }
        }
    }
    @if(coat_normals) let unmapped = shading_normal;
    var base = m0.xyz;
    var emission = m1.xyz;
    var metallic = m1.w;
    @if(vertex_colours && !procedurals) { base *= vertex_colour_at(hit.triangle, hit.u, hit.v).xyz; }
    @if(vertex_colours && procedurals) { if !procedural { base *= vertex_colour_at(triangle, hit.u, hit.v).xyz; } }
    @if(procedurals) {
        if procedural {
            base = procedural_colour(hit.triangle, base, position);
            traversal_iterations += procedural_iterations;
            leaving += procedural_clearance(hit.triangle) * triangle_normal;
        }
    }
    @if(textures) let more = load_material_record(material + 5u);
    @if(textures) let texels = material_texels(material, words, more, hit);
    @if(textures) {
        base *= texels.base;
        emission *= texels.emission;
        @if(normal_maps) {
            if words.w != 0u {
                let scale = bitcast<f32>(load_material_record(material + 2u).w);
                shading_normal = mapped_normal(hit, texels.normal, scale, shading_normal, front);
            }
        }
    }
    let view = -ray.direction;
    @if(smooth_normals || normal_maps) { shading_normal = bent_to(shading_normal, view); }

    var surface: Surface;
    surface.geometric_normal = geometric_normal;
    surface.shading_normal = shading_normal;
    surface.view = view;
    surface.albedo = base;
    @if(glossy) {
        let m2 = bitcast<vec4f>(load_material_record(material + 2u));
        let m3 = bitcast<vec4f>(load_material_record(material + 3u));
        var roughness = m2.x;
        var specular = m2.z;
        var specular_colour = m3.xyz;
        @if(textures) {
            roughness *= texels.roughness_metallic.x;
            metallic *= texels.roughness_metallic.y;
            specular *= texels.specular;
            specular_colour *= texels.specular_colour;
        }
        let dielectric = min(m2.y * specular_colour, vec3f(1.0)) * specular;
        surface.albedo = base * (1.0 - metallic);
        surface.f0 = mix(dielectric, base, metallic);
        surface.f90 = mix(specular, 1.0, metallic);
        surface.dielectric = vec2f(max(dielectric.x, max(dielectric.y, dielectric.z)), specular);
        surface.alpha = roughness * roughness;
    }
    @if(transmission || clearcoat || anisotropy) let m7 = bitcast<vec4f>(load_material_record(material + 7u));
    @if(transmission) var volume_transmittance = vec3f(1.0);
    @if(transmission) {
        let m6 = bitcast<vec4f>(load_material_record(material + 6u));
        var passing = m6.x;
        @if(textures) { passing *= texels.transmission; }
        surface.tint = surface.albedo * passing;
        surface.albedo *= 1.0 - passing;
        // Behind its back face lies the volume.
        surface.eta = select(m7.x, 1.0 / m7.x, front);
        if !front { volume_transmittance = exp(-m6.yzw * hit.t); }
        // Light that passes leaves from the other side of the triangle itself, not from over it.
        if any(surface.tint > vec3f(0.0)) {
            leaving = position;
            surface.geometric_normal = triangle_normal;
        }
    }
    @if(clearcoat) {
        surface.coat = m7.yz;
        @if(textures) { surface.coat *= texels.coat; }
        surface.coat.y *= surface.coat.y;
    }
    // Without a map of its own the coat is smooth, whatever its base is (KHR_materials_clearcoat).
    @if(coat_normals) {
        surface.coat_normal = unmapped;
        if more.w != 0u { surface.coat_normal = mapped_normal(hit, texels.coat_normal, m7.w, unmapped, front); }
        surface.coat_normal = bent_to(surface.coat_normal, view);
    }
    @if(anisotropy) {
        let m9 = bitcast<vec4f>(load_material_record(material + 9u));
        surface.alpha_along = surface.alpha;
        if m9.x != 0.0 {
            var strength = m9.x;
            var axis = m9.yz;
            @if(textures) {
                strength *= texels.anisotropy.z;
                let turn = texels.anisotropy.xy * 2.0 - 1.0;
                axis = vec2f(axis.x * turn.x - axis.y * turn.y, axis.y * turn.x + axis.x * turn.y);
            }
            let frame = tangent_frame(hit, select(-shading_normal, shading_normal, front));
            let tangent = frame * axis;
            surface.tangent = select(vec3f(0.0), tangent / max(length(tangent), 1e-6), dot(tangent, tangent) > 1e-12);
            surface.alpha_along = mix(surface.alpha, 1.0, strength * strength);
        }
    }
    @if(sheen) {
        surface.sheen = bitcast<vec4f>(load_material_record(material + 10u));
        @if(textures) { surface.sheen *= texels.sheen; }
    }
    var unlit = false;
    @if(unlit) {
        if (words.x & MATERIAL_UNLIT) != 0u {
            unlit = true;
            emission = base;
            surface.albedo = vec3f(0.0);
            @if(transmission) { surface.tint = vec3f(0.0); }
        }
    }
    if !unlit && !front && (words.x & MATERIAL_DOUBLE_SIDED) == 0u { emission = vec3f(0.0); }
    @if(transmission) { return SurfaceHit(leaving, position, triangle_normal, emission, unlit, base, volume_transmittance, surface); }
    @else { return SurfaceHit(leaving, position, triangle_normal, emission, unlit, base, surface); }
}

// Tangent and bitangent about a normal on the outer side.
@if(normal_maps || coat_normals || anisotropy)
fn tangent_frame(hit: Hit, normal: vec3f) -> mat2x3f {
    let record = load_surface_record(hit.triangle * surface_stride + tangent_record);
    let w = 1.0 - hit.u - hit.v;
    let t = w * oct_decode16(record.x) + hit.u * oct_decode16(record.y) + hit.v * oct_decode16(record.z);
    let across = t - normal * dot(t, normal);
    if dot(across, across) < 1e-12 { return mat2x3f(); }
    let tangent = normalize(across);
    return mat2x3f(tangent, cross(normal, tangent) * select(1.0, -1.0, (record.w & 1u) != 0u));
}

// The normal of a normal map where the surface has another, both on the viewer's side, which may be the outer one.
@if(normal_maps || coat_normals)
fn mapped_normal(hit: Hit, texel: vec3f, scale: f32, normal: vec3f, front: bool) -> vec3f {
    let outer = select(-normal, normal, front);
    let frame = tangent_frame(hit, outer);
    if all(frame[0] == vec3f(0.0)) { return normal; }
    let local = (texel * 2.0 - 1.0) * vec3f(scale, scale, 1.0);
    let mapped = normalize(frame * local.xy + max(local.z, 1e-3) * outer);
    return select(-mapped, mapped, front);
}

// Seen from outside a shading normal's half-space there is no such surface: the normal, bent back until the viewer is in it, as
// far as needed (Schuessler et al. 2017 discuss the choices).
@if(smooth_normals || normal_maps || coat_normals)
fn bent_to(normal: vec3f, view: vec3f) -> vec3f {
    let behind = dot(normal, view);
    if behind >= 1e-3 { return normal; }
    return normalize(normal + (1e-3 - behind) * view);
}
