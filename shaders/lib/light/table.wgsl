// The table of lights, which src/gpu_scene/lights/ makes, and the structs that every kind of light returns.

@if(texture_loads) import package::lib::table::table_texel;
import package::lib::constants::{
    LIGHT_CLOSED_FORM, LIGHT_HEADER, LIGHT_KIND_MASK, LIGHT_KIND_TEXEL, LIGHT_TEXELS,
};
@if(point_lights || spot_lights || directional_lights) import package::lib::constants::{LIGHT_ENVIRONMENT, LIGHT_MESH};

@if(texture_loads) @group(1) @binding(7) var light_texels: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(1) @binding(7) var<storage, read> light_texels: array<vec4u>;

fn load_light_texel(i: u32) -> vec4u {
    @if(texture_loads) { return textureLoad(light_texels, table_texel(i)); }
    @else { return light_texels[i]; }
}

// Distance to a light that is infinitely far away.
const FAR_DISTANCE = 3e38;

fn light_count() -> u32 {
    return load_light_texel(0u).x;
}

// A texel of a light; `texel` is one of the LIGHT_..._TEXEL.
fn light_texel(light: u32, texel: u32) -> vec4u {
    return load_light_texel(LIGHT_HEADER + light * LIGHT_TEXELS + texel);
}

fn light_texel_f32(light: u32, texel: u32) -> vec4f {
    return bitcast<vec4f>(light_texel(light, texel));
}

// The kind of a light: LIGHT_MESH, LIGHT_POINT and so on.
fn light_kind(light: u32) -> u32 {
    return light_texel(light, LIGHT_KIND_TEXEL).x & LIGHT_KIND_MASK;
}

fn light_has_closed_form(light: u32) -> bool {
    return (light_texel(light, LIGHT_KIND_TEXEL).x & LIGHT_CLOSED_FORM) != 0u;
}

// Number of light points that a surface point samples, at most `limit`. A light that comes from a single direction has
// one.
fn max_light_points(light: u32, limit: u32) -> u32 {
    @if(point_lights || spot_lights || directional_lights) {
        let kind = light_kind(light);
        return select(1u, limit, kind == LIGHT_MESH || kind == LIGHT_ENVIRONMENT);
    }
    @else { return limit; }
}

struct LightSample {
    // Unit vector from the position to the light.
    direction: vec3f,
    distance: f32,
    // Radiance emitted towards the position; for punctual lights the irradiance perpendicular to the direction.
    radiance: vec3f,
    // Density by solid angle, 0 if no light arrives; 1 for punctual lights.
    pdf: f32,
    // Geometric normal of the emitter on the side of the position; 0 for lights without a surface.
    normal: vec3f,
    // Light arrives from a single direction, so sampling the BSDF cannot hit it.
    delta: bool,
}

fn no_light_sample() -> LightSample {
    return LightSample(vec3f(0.0, 0.0, 1.0), 0.0, vec3f(0.0), 0.0, vec3f(0.0), false);
}

// Minimum cosine at the surface in the potential of a light. The potential takes the cosine towards the light's centre,
// but the light is wider than that and normals are rounded. No light that contributes may have a probability near 0.
// Other values were not compared.
const MIN_COSINE = 0.1;

struct EmittedRay {
    origin: vec3f,
    // Unit.
    direction: vec3f,
    // Geometric normal on the side that the ray leaves; for punctual lights the ray's direction.
    normal: vec3f,
    // Primitive index of the emitter triangle, or NO_EMITTER.
    triangle: u32,
    // Power over the density with which the ray is sampled. Its mean over rays is the light's power.
    flux: vec3f,
}

// Marks an emitted ray that starts on no triangle.
const NO_EMITTER = 0xffffffffu;
