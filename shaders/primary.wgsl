// primary: camera rays to surface samples, and the radiance that is seen without any lighting.
// In: the scene, the camera. Out: a point and a surface for each sample of the tile; emission in `radiance_direct`
// (w: 1 where the ray met something, be it the environment: the image's alpha); the samples of those AOVs that are asked for.

import package::lib::dispatch::group_index;
import package::lib::tile::{Tile, tile_pixel, tile_sample, pixel_seed};
import package::lib::camera::camera_ray;
import package::lib::bvh::{trace_closest, traversal_overrun};
@if(environment) import package::lib::environment::environment_radiance;
import package::lib::ray::NO_HIT;
import package::lib::surface::surface_at;
import package::lib::math::oct_encode16;
import package::lib::rng::hash2;
import package::lib::sampling::sobol2;
import package::lib::point::{Point, SURFACE_VECTORS, pack_surface};
import package::lib::constants::{INVALID_POINT, DIMENSION_CAMERA, DIMENSION_ALPHA, COUNTER_OVERRUN};

@group(0) @binding(0) var<storage, read_write> points: array<Point>;
@group(0) @binding(1) var<storage, read_write> surfaces: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> radiance_direct: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;
@if(aov_albedo) @group(0) @binding(3) var<storage, read_write> albedo_samples: array<vec4f>;
@if(aov_normal) @group(0) @binding(4) var<storage, read_write> normal_samples: array<vec4f>;
@if(aov_position) @group(0) @binding(5) var<storage, read_write> position_samples: array<vec4f>;

var<immediate> tile: Tile;

@compute @workgroup_size(64)
fn primary(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= tile.point_count { return; }
    let seed = pixel_seed(tile, i);
    let sample_index = tile_sample(tile, i);
    var within = vec2f(0.5);
    if tile.centred == 0u { within = sobol2(sample_index, hash2(seed, DIMENSION_CAMERA)); }
    let film = (vec2f(tile_pixel(tile, i)) + within) / vec2f(f32(tile.width), f32(tile.height));
    let camera = camera_ray(film);
    let hit = trace_closest(camera.ray, hash2(seed, DIMENSION_ALPHA + sample_index));
    if traversal_overrun { atomicAdd(&counters[COUNTER_OVERRUN], 1u); }

    var point = Point(vec3f(0.0), INVALID_POINT);
    var direct = vec4f(0.0);
    @if(environment) { if hit.triangle == NO_HIT { direct = vec4f(environment_radiance(camera.ray.direction), 1.0); } }
    @if(aov_albedo) var albedo = vec4f(0.0);
    @if(aov_normal) var normal = vec4f(0.0);
    @if(aov_position) var position = vec4f(0.0);
    if hit.triangle != NO_HIT {
        let found = surface_at(hit, camera.ray);
        direct = vec4f(found.emission, 1.0);
        if !found.unlit { point = Point(found.position, oct_encode16(found.surface.geometric_normal)); }
        let packed = pack_surface(found.surface);
        surfaces[i * SURFACE_VECTORS] = packed.a;
        @if(glossy) {
            surfaces[i * SURFACE_VECTORS + 1u] = packed.b;
            surfaces[i * SURFACE_VECTORS + 2u] = packed.c;
            @if(transmission) { surfaces[i * SURFACE_VECTORS + 3u] = packed.d; }
            @if(clearcoat || anisotropy) { surfaces[(i + 1u) * SURFACE_VECTORS - 1u] = packed.e; }
        }
        @if(aov_albedo) { albedo = vec4f(found.base_colour, 1.0); }
        @if(aov_normal) { normal = vec4f(found.surface.shading_normal, 1.0); }
        @if(aov_position) { position = vec4f(found.triangle_position, hit.t * camera.cosine); }
    }
    points[i] = point;
    radiance_direct[i] = direct;
    @if(aov_albedo) { albedo_samples[i] = albedo; }
    @if(aov_normal) { normal_samples[i] = normal; }
    @if(aov_position) { position_samples[i] = position; }
}
